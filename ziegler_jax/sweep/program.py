"""A sweep's program: the scene, identified by its equations, for a batch of lanes.

Each sweep traces the scene anew, in its own trace: it reads attributes, tables and the
environment again. Digests identify the trace: one of the scene, which stores and
`merge` compare, and one of each stage, by which its compiled program is looked up. So
an unchanged scene is neither lowered nor compiled again, and a changed one never gets
the old program.
"""

import itertools
import linecache
import sysconfig
import threading
import time
import warnings
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, cast

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.stages import Lowered

from ..numerics.jaxprs import ClosedJaxpr, JaxprEqn
from ..numerics.resumable import CALLS, equations_within, inlined, resumable_loop
from ..results import Variable, counted
from ..runtime import (
    all_cores,
    compiles_whole_loops,
    held_interrupts,
    own_flags,
    paused_collector,
    quiet_compiler,
    refuse_forked,
)
from .jaxpr_digest import Digest, digest_of, digest_of_function
from .packing import Packing, some_number
from .returned import Returned, empty, labelled
from .stages import Stage, needed, stages
from .tables import tables_as_inputs

# A loop's working set stays in the first caches; where XLA makes many kernels of it,
# each must have enough to do.
BATCH_OF_ONE_KERNEL, BATCH_OF_MANY = 128, 384
SMALLER_BATCHES = (32, 64)  # for sweeps of two of these at most
BATCH_WITHOUT = 8192
CACHED_STAGES = 96
# Lanes are a multiple of four vectors of 512 bits: what is left of a vector, and loops
# of two that the compiler unrolls, round otherwise (batches of 13 and of 8 did).
WHOLE_VECTORS = 32
DIFFRAX = "diffeqsolve"  # what a call is named that integrates a motion
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


class Scene(NamedTuple):
    """A point, traced and cut into stages for batches of lanes."""

    point: Callable[..., Returned]
    names: tuple[str, ...]
    variables: dict[str, Variable]  # values are shapes and dtypes
    attributes: dict[str, object]
    coordinates: dict[str, Sequence[object]]  # of the dimensions of results
    batch_size: int
    stages: tuple[Stage, ...]
    tables: tuple[jax.Array, ...]  # that the point closes over: arguments of its stages
    known: Digest
    seconds: float

    @property
    def digest(self) -> str:
        """A hash of what is computed."""
        return self.known.value

    @property
    def bytes_a_point(self) -> int:
        """The size of a point's results in a dataset."""
        arrays = [empty(variable, ()) for variable in self.variables.values()]
        return sum(array.dtype.itemsize * array.size for array in arrays)


class Compiled(NamedTuple):
    """A scene, compiled."""

    names: tuple[str, ...]  # of the parameters, in the order of the first stage's
    stages: tuple[Stage, ...]  # whose functions run a batch
    results: Packing
    batch_size: int
    compile_seconds: float  # 0 where all was kept from an earlier sweep


# What JAX or diffrax traced for an earlier sweep is not asked: it may have read an
# attribute that has changed since. So each trace has a number, in the key of JAX's
# caches.
_TRACE = jax.make_user_context(default_value=0)
_TRACES = itertools.count(1)


@held_interrupts()
@paused_collector()
def traced(
    point: Callable[..., Returned],
    names: tuple[str, ...],
    batch_size: int | None,
    points: int | None = None,
) -> Scene:
    """Trace `point`: what has been traced is what will be compiled.

    **Arguments:** `batch_size`: lanes a batch; None is what suits the point, and so few
    `points` if these are known.

    **Raises:** `ValueError` where it cannot be traced, with the line and a cure.
    """
    refuse_forked()
    started = time.perf_counter()
    number = next(_TRACES)
    described: dict[str, Any] = {}  # what crosses no trace: names, meanings, settings

    def leaves(*values):
        with _TRACE(number):
            result = point(**dict(zip(names, values, strict=True)))
            variables, coordinates, attributes = labelled(result)
            arrays = [jnp.asarray(v.value) for v in variables.values()]
        described["attributes"] = attributes
        described["coordinates"] = {**counted(variables), **coordinates}
        described["variables"] = {
            name: v._replace(value=jax.ShapeDtypeStruct(a.shape, a.dtype))
            for (name, v), a in zip(variables.items(), arrays, strict=True)
        }
        return arrays

    scalar = jax.ShapeDtypeStruct((), np.float64)
    with own_flags(), jax.enable_x64(True):
        try:
            whole = inlined(jax.make_jaxpr(leaves)(*[scalar] * len(names)))
        except _UNTRACEABLE as error:
            raise ValueError(_untraceable(error, names)) from error
        refuse_tracers(*whole.consts)
        whole = needed(whole)
        motions = _motions(whole)
        known = digest_of_function(whole, names, [*described["variables"]])
        with_tables, tables = tables_as_inputs(whole)
        parts = stages(with_tables, len(tables))
    size = batch_size or _usual_size(motions != Motions(0, 0), points)
    at_loop = between = -(-size // WHOLE_VECTORS) * WHOLE_VECTORS
    if len(parts) > 1 and not motions.whole:
        # between loops there is little to do, unless a motion runs whole there
        between = at_loop * SEGMENTS
    return Scene(
        point=point,
        names=names,
        **described,
        batch_size=size,
        stages=tuple(
            part._replace(lanes=at_loop if part.is_loop else between) for part in parts
        ),
        tables=tables,
        known=known,
        seconds=time.perf_counter() - started,
    )


def refuse_tracers(*values: object) -> None:
    """Refuse a sweep of numbers that JAX only stands for (ValueError)."""
    if any(isinstance(x, jax.core.Tracer) for x in values):
        raise ValueError(
            "A sweep must be called outside of JAX's transformations, but is inside "
            "one (`jit`, `vmap`, a derivative, another sweep): it compiles and runs "
            "programs of its own. Give the other sweep one more axis instead."
        )


class Motions(NamedTuple):
    """How many motions a point follows."""

    cut: int
    whole: int  # within a loop or a transformation of its own


def _motions(whole: ClosedJaxpr) -> Motions:
    others = [e for e in whole.jaxpr.eqns if not _is_loop(e)]
    cut = len(whole.jaxpr.eqns) - len(others)
    inner = [e for other in others for e in (other, *equations_within(other))]
    deeper = sum(map(_is_loop, inner))
    others = [e for e in others if e.primitive.name not in CALLS]
    holding = (e for e in others if any(_is_loop(x) for x in equations_within(e)))
    if any(map(_is_written_by_the_user, holding)):
        warnings.warn(
            "`point` follows motions within a loop or a conditional of its own, where "
            "a sweep cannot pause them: a batch of lanes waits there for its slowest. "
            "Take them out of it, or give the sweep one more axis.",
            stacklevel=6,  # the user's call of `sweep`
        )
    # a transformation of the point's own leaves diffrax's call
    solved = sum(e.params.get("name") == DIFFRAX for e in inner)
    return Motions(cut, deeper + solved)


def _is_loop(equation: JaxprEqn) -> bool:
    return equation.primitive is resumable_loop


def _is_written_by_the_user(equation: JaxprEqn) -> bool:
    """Whether the user's own code made the equation, not this package's."""
    traceback = equation.source_info.traceback
    for frame in traceback.frames if traceback else ():
        if is_the_users(frame.file_name):
            return True
        if frame.file_name.startswith(_NOT_THE_USERS[0]):
            return False
    return False


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


class Lowering(NamedTuple):
    """A stage's jitted function, and what it was lowered to."""

    run: Callable[..., tuple]
    lowered: Lowered


def lowered(stage: Stage, scene: Scene) -> Lowering:
    """A stage of the scene for a batch of lanes, not yet compiled."""
    as_one_kernel = compiles_whole_loops() and len(scene.stages) > 1
    options = _CPU_OPTIONS if jax.default_backend() == "cpu" else None
    with own_flags(), jax.enable_x64(True):
        batched = _one_kernel(stage, scene.tables) if as_one_kernel else stage.function
        run = jax.jit(batched, compiler_options=options)
        return Lowering(run, run.lower(scene.tables, *_nothing(stage)))


def _one_kernel(stage: Stage, tables: Sequence) -> Callable:
    """A loop of one turn: XLA makes all that is in it a single kernel.

    That runs faster, and compiles in half the time of a kernel for each of its parts.
    """
    # traced once, for its shapes and for the turn
    batched, nothing = jax.jit(stage.function), _nothing(stage)
    shapes = jax.eval_shape(batched, tables, *nothing)
    if not stage.is_loop and some_number(jax.tree.leaves(nothing)) is None:
        return batched

    def run(tables, *rows):
        # one turn, but the compiler cannot count it
        number = some_number(jax.tree.leaves(rows))
        once = rows[0] > 0 if number is None else ~(number * 0 > 1)
        blank = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
        return lax.while_loop(
            lambda turn: turn[0],
            lambda turn: (jnp.zeros_like(turn[0]), batched(tables, *rows)),
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


class _Key(NamedTuple):
    """By what a stage's program is found again in this process."""

    known: Digest
    lanes: int
    settings: tuple[Hashable, ...]


def _key(number: int, scene: Scene) -> _Key:
    stage = scene.stages[number]
    layouts = stage.is_loop, stage.fixed.shapes, stage.state.shapes
    like = [(x.shape, x.dtype) for x in scene.tables]
    values = sorted((name, repr(x)) for name, x in jax.config.values.items())
    settings = jax.default_backend(), compiles_whole_loops(), *values
    alone = len(scene.stages) == 1  # then it is not made one kernel
    known = digest_of(stage.equations, layouts, like)
    if not known.repeatable:  # two that look alike may not be
        settings = number, *settings
    return _Key(known, stage.lanes, (alone, *settings))


_cache: OrderedDict[_Key, Callable] = OrderedDict()
_kept_lock = threading.Lock()
_library_lock = threading.Lock()
# what calls LAPACK or a Fourier transform
_OF_LIBRARIES = {"cholesky", "eig", "eigh", "fft", "geqp3", "geqrf", "hessenberg"}
_OF_LIBRARIES |= {"householder_product", "lu", "ormqr", "qr", "schur", "svd"}
_OF_LIBRARIES |= {"triangular_solve", "tridiagonal", "tridiagonal_solve"}


@held_interrupts()
@paused_collector()
def compiled(scene: Scene) -> Compiled:
    """The scene, compiled, stages beside each other; each kept by its digest."""
    started = time.perf_counter()
    keys = [_key(number, scene) for number in range(len(scene.stages))]
    unlike = dict(zip(keys, scene.stages, strict=True))
    runs = {key: _kept(key) for key in unlike}
    new = {
        key: (stage, lowered(stage, scene), key.known)
        for key, stage in unlike.items()
        if runs[key] is None
    }
    pool = ThreadPoolExecutor(max(1, min(len(new), all_cores())))
    with pool, quiet_compiler():
        done = pool.map(partial(_compiled, scene), new.values())
        made = dict(zip(new, done, strict=True))
    for key, run in made.items():
        _keep(key, run)
    runs |= made
    seconds = time.perf_counter() - started
    return Compiled(
        names=scene.names,
        stages=tuple(
            stage._replace(function=partial(cast(Callable, runs[key]), scene.tables))
            for stage, key in zip(scene.stages, keys, strict=True)
        ),
        results=Packing(
            cast(jax.ShapeDtypeStruct, v.value) for v in scene.variables.values()
        ),
        batch_size=scene.batch_size,
        compile_seconds=seconds if made else 0.0,
    )


def _kept(key: _Key) -> Callable | None:
    with _kept_lock:
        if key in _cache:
            _cache.move_to_end(key)
        return _cache.get(key)


def _keep(key: _Key, run: Callable) -> None:
    if not key.known.repeatable:
        return
    with _kept_lock:
        _cache[key] = run
        while len(_cache) > CACHED_STAGES:
            _cache.popitem(last=False)


def _compiled(scene: Scene, new: tuple[Stage, Lowering, Digest]) -> Callable:
    """The stage's program."""
    stage, (run, lowered), known = new
    with own_flags(), jax.enable_x64(True):
        if stage.is_loop:
            # a call of a jitted function costs half of its compiled form's
            run(scene.tables, *_nothing(stage))
        else:  # not run: what it would do with these numbers is not known
            run = lowered.compile()
    return _one_at_a_time(run) if known.primitives & _OF_LIBRARIES else run


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
