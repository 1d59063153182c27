"""What a sweep compiles: the scene, known by its lowered stages, for a batch of lanes.

A scene is traced anew at each sweep, in a trace of its own: whatever it reads, an
attribute of an object, a table, the environment, is read again. (A question that it
asks of this package's own values alone is not, see `as_traced_before`.) What it is
lowered to is kept by what was traced, and a compiled stage by what the lowered one
computes, so that a sweep of what has not changed is neither lowered nor compiled again,
and one of what has is never answered by the old program.
"""

import hashlib
import linecache
import sysconfig
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat
from pathlib import Path
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import (
    ClosedJaxpr,  # pyright: ignore[reportPrivateImportUsage]
    Jaxpr,
)
from jax.stages import Lowered

from ..context import Cuts, may_cut, of_its_own, within
from ..numerics.lowered_digest import lowered_digest
from ..numerics.packing import Packing, some_number
from ..numerics.traced_key import traced_key
from ..results import DIMENSIONS, Variable
from ..runtime import (
    all_cores,
    compiles_whole_loops,
    held_interrupts,
    own_flags,
    paused_collector,
    quiet_compiler,
)
from .axes import Returned, empty, labelled
from .stages import Stage, stages

# A loop's working set stays in the first caches; where XLA makes many kernels of it,
# each must have enough to do.
BATCH_OF_ONE_KERNEL, BATCH_OF_MANY = 128, 384
SMALLER_BATCHES = (32, 64)  # for sweeps of two of these at most
BATCH_WITHOUT = 8192
CACHED_STAGES = 96
LOWERED_SCENES = 16
# Lanes are a multiple of four vectors of 512 bits: what is left of a vector, and loops
# of two that the compiler unrolls, round otherwise (batches of 13 and of 8 did).
WHOLE_VECTORS = 32
SEGMENTS = 8  # batches of lanes that a segment between loops takes at once
# 256 bits is XLA's default; nothing changes where the processor has no AVX-512. LLVM's
# expensive passes are about a tenth of compiling (0.67 of before for 0.74 with them, by
# hand), and a step has as many instructions without (`benchmarks/README.md`).
_CPU_OPTIONS = {
    "xla_cpu_prefer_vector_width": 512,
    "xla_llvm_disable_expensive_passes": True,
}
_NOT_THE_USERS = (
    str(Path(__file__).parents[1]),
    *(sysconfig.get_paths()[key] for key in ("stdlib", "purelib", "platlib")),
)


def is_the_users(file: str) -> bool:
    """Whether code in this file is the user's own, not this package's or another's."""
    return not file.startswith(_NOT_THE_USERS)


class LoweredStage(NamedTuple):
    """A stage for a batch of lanes, not yet compiled."""

    stage: Stage
    run: Callable[..., tuple]  # the jitted function
    lowered: Lowered
    callbacks: tuple  # host functions, which the program's text does not show

    @property
    def digest(self) -> str:
        """What the program computes, and what its arguments hold, as a hash."""
        layout = self.stage.fixed.shapes, self.stage.state.shapes
        text = f"{layout} {lowered_digest(self.lowered.as_text())}"
        return hashlib.sha256(text.encode()).hexdigest()


class Scene(NamedTuple):
    """A point, traced, cut into stages, and lowered for a batch of lanes."""

    point: Callable[..., Returned]
    names: tuple[str, ...]
    wide: bool  # float64
    variables: dict[str, Variable]  # values are shapes and dtypes
    attributes: dict[str, object]
    coordinates: dict[str, Sequence[object]]  # of the dimensions of results
    batch_size: int
    stages: tuple[LoweredStage, ...]
    digests: tuple[str, ...]  # of the stages
    seconds: float

    @property
    def digest(self) -> str:
        """A hash of what will be compiled."""
        return hashlib.sha256(" ".join(self.digests).encode()).hexdigest()

    @property
    def bytes_a_point(self) -> int:
        """What the results of a point take in a dataset."""
        arrays = [empty(variable, ()) for variable in self.variables.values()]
        return sum(array.dtype.itemsize * array.size for array in arrays)


class Program(NamedTuple):
    """A scene, compiled."""

    stages: tuple[Stage, ...]  # whose functions run a batch
    results: Packing
    batch_size: int
    wide: bool
    compile_seconds: float  # 0 where all was kept from an earlier sweep


@held_interrupts()
@paused_collector()
def traced(
    point: Callable[..., Returned],
    names: tuple[str, ...],
    wide: bool,
    batch_size: int | None,
    points: int | None = None,
) -> Scene:
    """Trace and lower `point`: what has been lowered is what will be compiled.

    **Arguments:** `batch_size`: lanes a batch; None is what suits the point, and so few
    `points` if these are known.

    **Raises:** `ValueError` where it cannot be traced, with the line and a cure.
    """
    started = time.perf_counter()
    context = of_its_own(narrow=not wide)
    described: dict[str, Any] = {}  # what crosses no trace: names, meanings, settings

    def leaves(*values):
        cuts = Cuts()
        with within(context), may_cut(cuts):
            result = point(**dict(zip(names, values, strict=True)))
            variables, coordinates, attributes = labelled(result)
            arrays = [jnp.asarray(v.value) for v in variables.values()]
        described["cuts"] = cuts
        described["attributes"] = attributes
        described["coordinates"] = {**DIMENSIONS, **coordinates}
        described["variables"] = {
            name: v._replace(value=jax.ShapeDtypeStruct(a.shape, a.dtype))
            for (name, v), a in zip(variables.items(), arrays, strict=True)
        }
        return arrays

    scalar = jax.ShapeDtypeStruct((), np.float64 if wide else np.float32)
    with own_flags(), jax.enable_x64(wide):
        try:
            traced_point = jax.make_jaxpr(leaves)(*[scalar] * len(names))
        except _UNTRACEABLE as error:
            raise ValueError(_untraceable(error, names)) from error
        cuts = described.pop("cuts")
        size = batch_size or _usual_size(bool(cuts.motions), points)
        whole = WHOLE_VECTORS if wide else 2 * WHOLE_VECTORS
        width = -(-size // whole) * whole
        # between loops there is little to do, unless a motion runs whole there
        widths = width, width if cuts.refused else width * SEGMENTS
        lowered, digests = _lowered_stages(traced_point, widths, wide)
    return Scene(
        point=point,
        names=names,
        wide=wide,
        **described,
        batch_size=size,
        stages=lowered,
        digests=digests,
        seconds=time.perf_counter() - started,
    )


def _usual_size(motions: bool, points: int | None) -> int:
    """Lanes a batch: fewer where so few points would leave half of it, or a core, idle.

    Of one kernel alone: there a lane has the same bits in any of these sizes.
    """
    if not motions:
        return BATCH_WITHOUT
    if not compiles_whole_loops():
        return BATCH_OF_MANY
    fitting = [s for s in SMALLER_BATCHES if points is not None and points <= 2 * s]
    return min([*fitting, BATCH_OF_ONE_KERNEL])


_lowered_before: OrderedDict[Hashable, tuple] = OrderedDict()
_lowered_lock = threading.Lock()


def _lowered_stages(
    point: ClosedJaxpr, widths: tuple[int, int], wide: bool
) -> tuple[tuple[LoweredStage, ...], tuple[str, ...]]:
    """The stages of a traced point, lowered, and their digests.

    **Arguments:** `widths`: lanes at a loop, and between loops.
    """
    key = traced_key(point)
    key = None if key is None else (key, widths, wide, compiles_whole_loops())
    with _lowered_lock:
        if key in _lowered_before:
            _lowered_before.move_to_end(key)
            return _lowered_before[key]
    parts = stages(point)
    at_loop, between = widths if len(parts) > 1 else (widths[0], widths[0])
    lowered = tuple(
        _lowered(
            part._replace(lanes=at_loop if part.is_loop else between),
            as_one_kernel=compiles_whole_loops() and len(parts) > 1,
        )
        for part in parts
    )
    made = lowered, tuple(stage.digest for stage in lowered)
    if key is not None:
        with _lowered_lock:
            _lowered_before[key] = made
            while len(_lowered_before) > LOWERED_SCENES:
                _lowered_before.popitem(last=False)
    return made


def _lowered(stage: Stage, as_one_kernel: bool) -> LoweredStage:
    """The stage for a batch of lanes."""
    batched = _one_kernel(stage) if as_one_kernel else stage.function
    options = _CPU_OPTIONS if jax.default_backend() == "cpu" else None
    # an unused argument would be left out of the text, and with it what it is
    run = jax.jit(batched, compiler_options=options, keep_unused=True)
    program = run.trace(*_nothing(stage))
    callbacks = tuple(_callbacks(program.jaxpr.jaxpr))
    return LoweredStage(stage, run, program.lower(), callbacks)


def _one_kernel(stage: Stage) -> Callable:
    """A loop of one turn: XLA makes all that is in it a single kernel.

    That runs faster, and compiles in half the time of a kernel for each of its parts.
    """
    # traced once, for its shapes and for the turn
    batched, nothing = jax.jit(stage.function), _nothing(stage)
    shapes = jax.eval_shape(batched, *nothing)
    if not stage.is_loop and some_number(jax.tree.leaves(nothing)) is None:
        return batched

    def run(*rows):
        # one turn, but the compiler cannot count it
        number = some_number(jax.tree.leaves(rows))
        once = rows[0] > 0 if number is None else ~(number * 0 > 1)
        blank = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
        return lax.while_loop(
            lambda turn: turn[0],
            lambda turn: (jnp.zeros_like(turn[0]), batched(*rows)),
            (once, blank),
        )[1]

    return run


def _nothing(stage: Stage) -> tuple:
    """The arguments of a batch, for one step of no lane in particular."""
    packed = stage.fixed.empty(stage.lanes), stage.state.empty(stage.lanes)
    return (np.int32(1), *packed) if stage.ways else packed


_UNTRACEABLE = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
)


def _untraceable(error: BaseException, names: tuple[str, ...]) -> str:
    """Where the user's function asks for a number that is traced, and the cure."""
    if isinstance(error, jax.errors.TracerBoolConversionError):
        asks, cure = "decides in Python by", "write `jnp.where(condition, a, b)`"
    elif isinstance(error, jax.errors.TracerArrayConversionError):
        asks, cure = "gives NumPy", "write `jnp.sin` for `np.sin`, and so on"
    elif isinstance(error, jax.errors.TracerIntegerConversionError):
        asks, cure = "takes as an index", "write `jnp.asarray(table)[i]`"
    else:
        asks, cure = "makes a Python number of", "leave `float(...)` out"
    where, trace = "", error.__traceback__
    while trace is not None:
        code, line = trace.tb_frame.f_code, trace.tb_lineno
        if is_the_users(code.co_filename):
            source = linecache.getline(code.co_filename, line).strip()
            where = f" at `{source}`" if source else f" at line {line}"
        trace = trace.tb_next
    return (
        "Argument `point` must be a function that JAX can trace, once for all values "
        f"of {', '.join(names)}, but{where} {asks} a number that depends on them: "
        f"{cure} (`import jax.numpy as jnp`)."
    )


def _callbacks(jaxpr: Jaxpr) -> Iterator[Callable]:
    """The host functions that a program calls."""
    for equation in jaxpr.eqns:
        for name, value in equation.params.items():
            if name == "callback":
                yield value
            for part in value if isinstance(value, tuple | list) else (value,):
                inner = getattr(part, "jaxpr", part)
                if hasattr(inner, "eqns"):
                    yield from _callbacks(inner)


_cache: OrderedDict[tuple, Callable] = OrderedDict()
_kept_lock = threading.Lock()
_library_lock = threading.Lock()


@held_interrupts()
def compiled(scene: Scene) -> Program:
    """The scene, compiled, stages beside each other; each kept by its digest."""
    started = time.perf_counter()
    keys = [(d, s.callbacks) for d, s in zip(scene.digests, scene.stages, strict=True)]
    unlike = dict(zip(keys, scene.stages, strict=True))
    pool = ThreadPoolExecutor(min(len(unlike), all_cores()))
    with pool, quiet_compiler():
        done = pool.map(_compiled, unlike.values(), unlike, repeat(scene.wide))
        made = dict(zip(unlike, done, strict=True))
    runs = [made[key] for key in keys]
    seconds = time.perf_counter() - started
    return Program(
        stages=tuple(
            lowered.stage._replace(function=run)
            for (run, _), lowered in zip(runs, scene.stages, strict=True)
        ),
        results=Packing(
            cast(jax.ShapeDtypeStruct, v.value) for v in scene.variables.values()
        ),
        batch_size=scene.batch_size,
        wide=scene.wide,
        compile_seconds=seconds if any(new for _, new in runs) else 0.0,
    )


def _compiled(lowered: LoweredStage, key: tuple, wide: bool) -> tuple[Callable, bool]:
    """The stage's program, and whether it was compiled just now."""
    key = *key, wide
    with _kept_lock:
        if key in _cache:
            _cache.move_to_end(key)
            return _cache[key], False
    with own_flags(), jax.enable_x64(wide):
        if lowered.stage.is_loop:
            # a call of a jitted function costs half of its compiled form's
            run = lowered.run
            run(*_nothing(lowered.stage))
        else:  # not run: what it would do with these numbers is not known
            run = lowered.lowered.compile()
    if calls_libraries(lowered):
        run = _one_at_a_time(run)
    with _kept_lock:
        _cache[key] = run
        while len(_cache) > CACHED_STAGES:
            _cache.popitem(last=False)
    return run, True


def calls_libraries(lowered: LoweredStage) -> bool:
    """Whether the program calls LAPACK or a Fourier transform."""
    text = lowered.lowered.as_text()
    return "custom_call @lapack" in text or "stablehlo.fft" in text


def _one_at_a_time(run: Callable) -> Callable:
    """The program, in one thread at a time.

    jaxlib's kernels for LAPACK hand parts of a batch to the threads of the pool that
    they run on, and wait. Two of them on two cores wait for each other for ever: so
    two threads with `jnp.linalg.eigvals` did, on jaxlib 0.10.2, after some 50 sweeps.
    """

    def alone(*arguments):
        with _library_lock:
            return jax.block_until_ready(run(*arguments))

    return alone
