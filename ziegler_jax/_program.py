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
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ._context import Context, of_its_own, within
from ._cpu import compiles_whole_loops
from ._debug import own_flags
from ._interrupt import held_interrupts
from ._legs import Legs, in_legs
from ._packing import Packing
from ._variables import DIMENSIONS, Variable, named_variables

# A loop's working set stays in the first caches; where XLA makes many kernels of it,
# each must have enough to do.
BATCH_OF_ONE_KERNEL, BATCH_OF_MANY = 128, 384
BATCH_WITHOUT = 8192
KEPT = 32  # compiled programs
# 256 bits is XLA's default; nothing changes where the processor has no AVX-512
_CPU_OPTIONS = {"xla_cpu_prefer_vector_width": 512}
_NOT_THE_USERS = (
    str(Path(__file__).parent),
    *(sysconfig.get_paths()[key] for key in ("stdlib", "purelib", "platlib")),
)


def is_the_users(file: str) -> bool:
    """Whether code in this file is the user's own, not this package's or another's."""
    return not file.startswith(_NOT_THE_USERS)


class Scene(NamedTuple):
    """A point, traced and lowered."""

    point: Callable
    names: tuple[str, ...]
    wide: bool  # float64
    variables: dict[str, Variable]  # values are shapes and dtypes
    attributes: dict[str, Any]
    coordinates: dict[str, Any]  # of the dimensions of results
    digest: str  # of the lowered program's text
    callbacks: tuple  # host functions, which the text does not show
    context: Context  # that it was traced in
    carry: Packing | None  # between legs; None: the lanes do not run in legs
    batch_size: int
    seconds: float

    @property
    def bytes_a_point(self) -> int:
        """What the results of a point take."""
        values = [variable.value for variable in self.variables.values()]
        return sum(max(v.dtype.itemsize, 1) * int(np.prod(v.shape)) for v in values)


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
    """Trace and lower `point` for one lane.

    **Arguments:** `batch_size`: lanes a batch; None is the usual one for the point.

    **Raises:** `ValueError` where it cannot be traced, with the line and a cure.
    """
    started = time.perf_counter()
    context = of_its_own(narrow=not wide)
    described: dict[str, Any] = {}  # what crosses no trace: names, meanings, settings

    def numbers(*values):
        with within(context):
            result = point(**dict(zip(names, values, strict=True)))
            described["variables"] = variables = named_variables(result)
        described["attributes"] = getattr(result, "attributes", dict)()
        own = getattr(result, "coordinates", dict)()
        described["coordinates"] = {**DIMENSIONS, **own}
        return [jnp.asarray(v.value) for v in variables.values()]

    def find_legs(quota, fresh, values):
        with in_legs(Legs(quota, fresh, None)) as legs:
            numbers(*values)
        described["solves"] = legs.refused or legs.calls > 0
        return legs.left if legs.calls == 1 else None

    scalar = jax.ShapeDtypeStruct((), np.float64 if wide else np.float32)
    flag, count = jax.ShapeDtypeStruct((), bool), jax.ShapeDtypeStruct((), np.int32)
    with own_flags(), jax.enable_x64(wide):
        try:
            program = jax.jit(numbers).trace(*[scalar] * len(names))
        except _UNTRACEABLE as error:
            raise ValueError(_untraceable(error, names)) from error
        text = program.lower().as_text()
        carried = jax.eval_shape(find_legs, count, flag, [scalar] * len(names))
    usual = BATCH_OF_ONE_KERNEL if compiles_whole_loops() else BATCH_OF_MANY
    usual = usual if described["solves"] else BATCH_WITHOUT
    pairs = zip(described["variables"].items(), program.out_info, strict=True)
    return Scene(
        point=point,
        names=names,
        wide=wide,
        variables={
            name: variable._replace(
                value=jax.ShapeDtypeStruct(shape.shape, shape.dtype)
            )
            for (name, variable), shape in pairs
        },
        attributes=described["attributes"],
        coordinates=described["coordinates"],
        digest=hashlib.sha256(text.encode()).hexdigest(),
        callbacks=tuple(_callbacks(program.jaxpr.jaxpr)),
        context=context,
        carry=None if carried is None else Packing(carried),
        batch_size=batch_size or usual,
        seconds=time.perf_counter() - started,
    )


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
    """The scene for a batch of lanes; kept by the text of its program."""
    key = scene.digest, scene.callbacks, scene.batch_size, scene.wide
    with _kept_lock:
        if key in _kept:
            _kept.move_to_end(key)
            return _kept[key]._replace(compile_seconds=0.0)
    program = compile_scene(scene)
    with _kept_lock:
        _kept[key] = program
        while len(_kept) > KEPT:
            _kept.popitem(last=False)
    return program


def compile_scene(scene: Scene) -> Program:
    """Compile the scene for a batch of lanes."""
    size, carry = scene.batch_size, scene.carry
    dtype = np.dtype(np.float64 if scene.wide else np.float32)

    def leaves(values):
        with within(scene.context):
            result = scene.point(**dict(zip(scene.names, values, strict=True)))
            return [jnp.asarray(v.value) for v in named_variables(result).values()]

    results = Packing([variable.value for variable in scene.variables.values()])
    started = time.perf_counter()
    with own_flags(), jax.enable_x64(scene.wide):
        if carry is None:
            lanes = [jax.ShapeDtypeStruct((size,), dtype)] * len(scene.names)
            once = _batched(lambda values: results.pack(leaves(values)), (0,))
            run: Any = once.lower(lanes).compile()
        else:
            run = _in_legs(leaves, results, carry)
            # one step of no lane in particular: a call of a jitted function costs half
            # of what calling its compiled form does
            begun = [np.ones(size, dtype)] * len(scene.names)
            run(np.int32(1), np.ones(size, bool), begun, carry.empty(size))
    seconds = time.perf_counter() - started
    return Program(run, results, carry, size, scene.wide, seconds)


def _in_legs(leaves: Callable, results: Packing, carry: Packing) -> Any:
    """The program of a leg, for a batch."""

    def leg(quota, fresh, values, carried):
        with in_legs(Legs(quota, fresh, carry.unpack(carried))) as legs:
            found = leaves(values)
        left = carry.pack(legs.left)
        return results.pack(found), left, legs.running, legs.steps

    def one_kernel(quota, *arguments):
        """A loop of one turn: XLA makes all that is in it a single kernel."""
        shapes = jax.eval_shape(leg, quota, *arguments)
        nothing = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
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
