"""What a sweep compiles: the scene, known by its lowered program, for a batch of lanes.

A scene is traced and lowered anew at each sweep, in a trace of its own: whatever it
reads, an attribute of an object, a table, the environment, is read again. Its compiled
program is kept by the text of the lowered one, so that a sweep of what has not changed
is not compiled again, and one of what has is never answered by the old program.
"""

import hashlib
import linecache
import sysconfig
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..context import Legs, in_legs, of_its_own, within
from ..results import DIMENSIONS, Variable, empty, named_variables
from ..runtime import compiles_whole_loops, held_interrupts, own_flags


class Packing:
    """Many small arrays a lane as one array a dtype: a call then has few arguments."""

    def __init__(self, shapes: Sequence[Any]):
        """Lay out leaves of these shapes and dtypes."""
        self.shapes = [(tuple(s.shape), np.dtype(s.dtype)) for s in shapes]
        self.dtypes = sorted({dtype for _, dtype in self.shapes}, key=str)
        self.places = []  # which vector, and where in it
        used = [0] * len(self.dtypes)
        for shape, dtype in self.shapes:
            which = self.dtypes.index(dtype)
            first, used[which] = used[which], used[which] + int(np.prod(shape))
            self.places.append((which, slice(first, used[which])))
        self.used = used

    def pack(self, leaves: Sequence[Any]) -> tuple[jax.Array, ...]:
        """One vector a dtype."""
        pairs = list(zip(leaves, self.shapes, strict=True))
        return tuple(
            jnp.concatenate([jnp.ravel(leaf) for leaf, (_, d) in pairs if d == dtype])
            for dtype in self.dtypes
        )

    def unpack(self, packed: Sequence[Any]) -> list[Any]:
        """The leaves again; lanes, if any, stand behind, and stay there."""
        pairs = zip(self.shapes, self.places, strict=True)
        return [
            packed[which][place].reshape(shape + packed[which].shape[1:])
            for (shape, _), (which, place) in pairs
        ]

    def zeros(self) -> tuple[jax.Array, ...]:
        """What `pack` returns, with nothing in it."""
        pairs = zip(self.used, self.dtypes, strict=True)
        return tuple(jnp.zeros(used, dtype) for used, dtype in pairs)

    def empty(self, lanes: int) -> tuple[np.ndarray, ...]:
        """Zeros for a batch that has not started."""
        pairs = zip(self.used, self.dtypes, strict=True)
        return tuple(np.zeros((used, lanes), dtype) for used, dtype in pairs)


# A loop's working set stays in the first caches; where XLA makes many kernels of it,
# each must have enough to do.
BATCH_OF_ONE_KERNEL, BATCH_OF_MANY = 128, 384
BATCH_WITHOUT = 8192
KEPT = 32  # compiled programs
# 256 bits is XLA's default; nothing changes where the processor has no AVX-512
_CPU_OPTIONS = {"xla_cpu_prefer_vector_width": 512}
_NOT_THE_USERS = (
    str(Path(__file__).parents[1]),
    *(sysconfig.get_paths()[key] for key in ("stdlib", "purelib", "platlib")),
)


def is_the_users(file: str) -> bool:
    """Whether code in this file is the user's own, not this package's or another's."""
    return not file.startswith(_NOT_THE_USERS)


class Scene(NamedTuple):
    """A point, traced and lowered for a batch of lanes."""

    point: Callable
    names: tuple[str, ...]
    wide: bool  # float64
    variables: dict[str, Variable]  # values are shapes and dtypes
    attributes: dict[str, Any]
    coordinates: dict[str, Any]  # of the dimensions of results
    batch_size: int
    results: Packing
    carry: Packing | None  # between legs; None: the lanes do not run in legs
    run: Any  # the batch, to be compiled
    lowered: Any
    digest: str  # of the lowered program's text
    callbacks: tuple  # host functions, which the text does not show
    seconds: float

    @property
    def bytes_a_point(self) -> int:
        """What the results of a point take in a dataset."""
        held = [empty(variable, ()) for variable in self.variables.values()]
        return sum(array.dtype.itemsize * array.size for array in held)


class Program(NamedTuple):
    """One batch of a scene, compiled."""

    run: Callable[..., Any]
    results: Packing
    carry: Packing | None
    batch_size: int
    wide: bool
    compile_seconds: float  # 0 where it was kept from an earlier sweep


@held_interrupts()
def traced(
    point: Callable, names: tuple[str, ...], wide: bool, batch_size: int | None
) -> Scene:
    """Trace and lower `point`: what has been lowered is what will be compiled.

    **Arguments:** `batch_size`: lanes a batch; None is the usual one for the point.

    **Raises:** `ValueError` where it cannot be traced, with the line and a cure.
    """
    started = time.perf_counter()
    context = of_its_own(narrow=not wide)
    described: dict[str, Any] = {}  # what crosses no trace: names, meanings, settings

    def leaves(values):
        with within(context):
            result = point(**dict(zip(names, values, strict=True)))
            variables = named_variables(result)
            arrays = [jnp.asarray(v.value) for v in variables.values()]
        described["attributes"] = getattr(result, "attributes", dict)()
        own = getattr(result, "coordinates", dict)()
        described["coordinates"] = {**DIMENSIONS, **own}
        described["variables"] = {
            name: v._replace(value=jax.ShapeDtypeStruct(a.shape, a.dtype))
            for (name, v), a in zip(variables.items(), arrays, strict=True)
        }
        return arrays

    def find_legs(quota, fresh, values):
        with in_legs(Legs(quota, fresh, None)) as legs:
            found = leaves(values)
        described["solves"] = legs.refused or legs.calls > 0
        return found, (legs.left if legs.calls == 1 else None)

    dtype = np.dtype(np.float64 if wide else np.float32)
    scalar = jax.ShapeDtypeStruct((), dtype)
    flag, count = jax.ShapeDtypeStruct((), bool), jax.ShapeDtypeStruct((), np.int32)
    with own_flags(), jax.enable_x64(wide):
        try:
            once = jax.jit(find_legs).trace(count, flag, [scalar] * len(names))
        except _UNTRACEABLE as error:
            raise ValueError(_untraceable(error, names)) from error
        usual = BATCH_OF_ONE_KERNEL if compiles_whole_loops() else BATCH_OF_MANY
        size = batch_size or (usual if described["solves"] else BATCH_WITHOUT)
        shapes, left = once.out_info
        results, carry = Packing(shapes), None if left is None else Packing(left)
        if carry is None:
            run = _batched(lambda values: results.pack(leaves(values)), (0,))
        else:
            run = _in_legs(leaves, results, carry)
        program = run.trace(*_nothing(size, dtype, len(names), carry))
        lowered = program.lower()
    return Scene(
        point=point,
        names=names,
        wide=wide,
        variables=described["variables"],
        attributes=described["attributes"],
        coordinates=described["coordinates"],
        batch_size=size,
        results=results,
        carry=carry,
        run=run,
        lowered=lowered,
        digest=hashlib.sha256(lowered.as_text().encode()).hexdigest(),
        callbacks=tuple(_callbacks(program.jaxpr.jaxpr)),
        seconds=time.perf_counter() - started,
    )


def _nothing(size: int, dtype: np.dtype, names: int, carry: Packing | None) -> tuple:
    """The arguments of a batch, for one step of no lane in particular."""
    values = [np.ones(size, dtype)] * names
    if carry is None:
        return (values,)
    return np.int32(1), np.ones(size, bool), values, carry.empty(size)


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


def _callbacks(jaxpr: Any) -> Iterator[Any]:
    """The host functions that a program calls."""
    for equation in jaxpr.eqns:
        for name, value in equation.params.items():
            if name == "callback":
                yield value
            for part in value if isinstance(value, tuple | list) else (value,):
                inner = getattr(part, "jaxpr", part)
                if hasattr(inner, "eqns"):
                    yield from _callbacks(inner)


_kept: OrderedDict[Any, Program] = OrderedDict()
_kept_lock = threading.Lock()


@held_interrupts()
def compiled(scene: Scene) -> Program:
    """The scene, compiled; kept by the text of its program."""
    key = scene.digest, scene.callbacks, scene.wide
    with _kept_lock:
        if key in _kept:
            _kept.move_to_end(key)
            return _kept[key]._replace(compile_seconds=0.0)
    started = time.perf_counter()
    size, dtype = scene.batch_size, np.dtype(np.float64 if scene.wide else np.float32)
    with own_flags(), jax.enable_x64(scene.wide):
        if scene.carry is None:
            run = scene.lowered.compile()
        else:  # a call of a jitted function costs half of its compiled form's
            run = scene.run
            run(*_nothing(size, dtype, len(scene.names), scene.carry))
    seconds = time.perf_counter() - started
    program = Program(run, scene.results, scene.carry, size, scene.wide, seconds)
    with _kept_lock:
        _kept[key] = program
        while len(_kept) > KEPT:
            _kept.popitem(last=False)
    return program


def _in_legs(leaves: Callable, results: Packing, carry: Packing) -> Any:
    """The program of a leg, for a batch."""

    def leg(quota, fresh, values, carried):
        with in_legs(Legs(quota, fresh, carry.unpack(carried))) as legs:
            found = leaves(values)
        left = carry.pack(legs.left)
        return results.pack(found), left, legs.running, legs.steps

    def one_kernel(quota, *arguments):
        """A loop of one turn: XLA makes all that is in it a single kernel."""
        flag, none = jnp.zeros((), bool), jnp.zeros((), jnp.int32)
        nothing = results.zeros(), carry.zeros(), flag, none
        return lax.while_loop(
            lambda state: state[0] > 0,  # the compiler cannot count this
            lambda state: (0 * state[0], leg(quota, *arguments)),
            (quota, nothing),
        )[1]

    whole = compiles_whole_loops()
    return _batched(one_kernel if whole else leg, (None, 0, 0, -1))


def _batched(function: Callable, in_axes: tuple) -> Any:
    options = _CPU_OPTIONS if jax.default_backend() == "cpu" else None
    function = jax.vmap(function, in_axes=in_axes, out_axes=-1)
    return jax.jit(function, compiler_options=options)
