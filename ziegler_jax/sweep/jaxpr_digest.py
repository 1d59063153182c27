"""One hash of what JAX traced: equations, and the bytes of the numbers in them.

A program is known by what it computes: by the equations that its results ask for
(`numerics/asked.py`). Its variables are numbered as they are read, its constants are
known by dtype, shape and bytes, calls within it by their own equations.
Names of functions, lines of source, addresses, places on devices and rules for
derivatives, which a traced point asks no more, leave no trace. So the digest is the
same in every process, thread and kind of CPU; it changes with the version of JAX.

The equations do not show what the host computes in a callback. A rule of one's own for
batches (`jax.custom_batching.custom_vmap`) is known by what it traces.
"""

import enum
import functools
import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Jaxpr, Var

from ..numerics.asked import Part, asked, inside_of, is_of_this_package, part_of
from ..numerics.jaxprs import ClosedJaxpr, JaxprEqn, Literal

# Parameters without a meaning for numbers: how a custom derivative is worked out (by
# a point that is traced none is), names, and where arrays lie.
_OF_NO_MEANING = {"jvp_jaxpr_fun", "fwd_jaxpr_thunk", "bwd", "out_trees", "name"}
_OF_NO_MEANING |= {"in_tree", "out_tree", "debug_info", "ctx_mesh", "inline"}
_OF_NO_MEANING |= {"in_shardings", "out_shardings", "sharding", "out_sharding"}
_OF_NO_MEANING |= {"in_layouts", "out_layouts", "donated_invars", "keep_unused"}
_HARMLESS = {"debug_callback", "debug_print"}
_PACKAGE = __name__.partition(".")[0]
_FIXED = {_PACKAGE, "jax"}  # whose functions stay what they are
_LANES = 32  # of the batch for which a foreign batching rule is traced
_ADDRESS = re.compile(r"0x[0-9a-fA-F]+")


class Digest(NamedTuple):
    """A program's identity, by its equations.

    **Arguments:** `value`: the hash; `primitives`: their names; `hosts`: the functions
    that the host runs for it, of which the hash knows the names alone; `repeatable`:
    whether equal hashes mean equal programs within this process, without looking again.
    """

    value: str
    primitives: frozenset[str] = frozenset()
    hosts: frozenset[str] = frozenset()
    repeatable: bool = True


def digest_of(*parts: object) -> Digest:
    """The digest of equations, closed or not, and of what stands beside them."""
    return _Walk().value(parts)


def digest_of_function(
    traced: ClosedJaxpr, inputs: Sequence[str], outputs: Sequence[str]
) -> Digest:
    """The digest of a function of named numbers, which returns named numbers.

    In whatever order they stand.
    """
    walk = _Walk()
    arguments = zip(inputs, traced.jaxpr.invars, strict=True)
    given = [f"argument {name!r}:{_kind(v.aval)}" for name, v in arguments]
    walk.tokens += sorted(given)
    given = [*map(walk.number, traced.consts), *given]
    results, _ = walk.equations(traced.jaxpr, given, (True,) * len(outputs))
    for name, result in sorted(zip(outputs, results, strict=True)):
        walk.tokens.append(f"{name!r} is {result}")
    return walk.digest()


class _Read(NamedTuple):
    """Equations within another, read.

    `inputs`: those that they read of what they are given, in the order in which they
    do; `lasts`: whether no table of NumPy's is among them, which may be changed in
    place.
    """

    digest: Digest
    inputs: tuple[int, ...]
    lasts: bool


# Equations that JAX traced before are the same object again.
_read_before: WeakKeyDictionary[Jaxpr, dict[tuple, _Read]] = WeakKeyDictionary()


class _Walk:
    """The parts of equations, as text in their order."""

    def __init__(self, within: "_Walk | None" = None):
        self.tokens: list[str] = []
        self.primitives: set[str] = set()
        self.hosts: set[str] = set()
        self.repeatable = self.lasts = True  # `lasts`: no table of NumPy's is among it
        # what comes again, by its identity, for which it is kept
        self.tables: dict[int, tuple[str, object]] = {}
        if within is not None:
            self.tables = within.tables

    def digest(self) -> Digest:
        text = "\n".join(self.tokens)
        value = hashlib.sha256(text.encode()).hexdigest()
        about = frozenset(self.primitives), frozenset(self.hosts), self.repeatable
        return Digest(value, *about)

    def value(self, value: object) -> Digest:
        """The digest of a value by itself."""
        self.parameter(value)
        return self.digest()

    def whole(self, equations: ClosedJaxpr | Jaxpr) -> None:
        """Equations of which all that they are given is their own."""
        self.part(part_of(equations), self.literal)

    def part(self, part: Part, operand: Callable[[Any], str]) -> None:
        """Equations within, as one token, and the operands that they read."""
        before, key = _read_before.setdefault(part.jaxpr, {}), part.key
        read = before.get(key)
        if read is None:
            read = self.within(part)
            if read.lasts and read.digest.repeatable:
                before[key] = read
        self.tokens.append(read.digest.value)
        self.primitives |= read.digest.primitives
        self.hosts |= read.digest.hosts
        self.repeatable &= read.digest.repeatable
        self.lasts &= read.lasts
        self.tokens += [operand(part.given[place]) for place in read.inputs]

    def within(self, part: Part) -> _Read:
        """Equations, read by themselves."""
        walk = _Walk(self)
        inputs = [*part.jaxpr.constvars, *part.jaxpr.invars]
        own = inputs[len(part.given) :]
        walk.tokens += [_kind(v.aval) for v in own]
        given = [None] * len(part.given) + [f"input {i}" for i in range(len(own))]
        results, read = walk.equations(part.jaxpr, given, part.results)
        walk.tokens += results
        return _Read(walk.digest(), tuple(read), walk.lasts)

    # Equations ------------------------------------------------------------------------

    def equations(
        self, jaxpr: Jaxpr, given: Sequence[str | None], results: tuple[bool, ...]
    ) -> tuple[list[str], list[int]]:
        """The equations that some results need.

        **Arguments:** `given`: the names of constants and inputs; None is one that is
        named when it is read.

        **Returns:** what the results are, and which of the unnamed were read.
        """
        inputs = [*jaxpr.constvars, *jaxpr.invars]
        names = {v: x for v, x in zip(inputs, given, strict=True) if x is not None}
        unnamed: list[Var] = []

        def read(v: Var | Literal) -> str:
            if isinstance(v, Literal):
                return self.literal(v)
            if v not in names:
                names[v] = f"read {len(unnamed)}"
                unnamed.append(v)
                self.tokens.append(f"{names[v]}:{_kind(v.aval)}")
            return names[v]

        count, needed = 0, asked(jaxpr, results).results
        for equation, wanted in zip(jaxpr.eqns, needed, strict=True):
            if wanted is None:
                continue
            inside = inside_of(equation, wanted)
            operands = equation.invars if inside is None else inside.operands
            head = [equation.primitive.name, _setting(equation.ctx)]
            self.tokens.append(" ".join([*head, *map(read, operands)]))
            self.primitives.add(equation.primitive.name)
            self.parameters(equation, set() if inside is None else inside.said)
            for name, part in () if inside is None else inside.parts:
                self.tokens.append(name)
                self.part(part, read)
            comes = [True] * len(wanted) if inside is None else inside.results
            gives = [v for v, mine in zip(equation.outvars, comes, strict=True) if mine]
            for v in gives:
                names[v], count = str(count), count + 1
            kinds = [f"{names[v]}:{_kind(v.aval)}" for v in gives]
            self.tokens.append(" ".join(["gives", *kinds]))
        place = {v: i for i, v in enumerate(inputs)}
        outputs = zip(jaxpr.outvars, results, strict=True)
        last = [read(v) for v, mine in outputs if mine]
        return last, [place[v] for v in unnamed]

    def literal(self, value: Literal) -> str:
        """A constant in its place."""
        return self.number(value.val, value.aval)

    def parameters(self, equation: JaxprEqn, said: set[str]) -> None:
        """The parameters that affect numbers and are not written elsewhere."""
        if equation.primitive.name in _HARMLESS:
            self.repeatable = False  # what it tells is no number
            return
        for key in sorted(equation.params.keys() - _OF_NO_MEANING - said):
            self.tokens.append(key)
            self.of_equation(equation, key, equation.params[key])

    def of_equation(self, equation: JaxprEqn, key: str, value: object) -> None:
        """A parameter of an equation."""
        if key == "callback":
            self.hosts.add(_called(value))
            self.repeatable = False  # the hash knows its name alone
            self.tokens.append(_called(value))
        elif key == "rule" and equation.primitive.name == "custom_vmap_call":
            self.rule(equation, getattr(value, "rule", value))
        else:
            self.parameter(value)

    def rule(self, equation: JaxprEqn, rule: object) -> None:
        """How a batch is computed: one's own rule by what it traces."""
        self.tokens.append(_called(rule))
        if is_of_this_package(equation):
            return
        self.repeatable = False  # it is asked once more where the batch is traced
        kinds = [(v.aval.shape, v.aval.dtype) for v in equation.invars]  # pyright: ignore
        batch = [jax.ShapeDtypeStruct((_LANES, *s), dtype) for s, dtype in kinds]
        bind = functools.partial(equation.primitive.bind, **equation.params)
        self.whole(jax.make_jaxpr(jax.vmap(bind))(*batch))

    # Values ---------------------------------------------------------------------------

    def parameter(self, value: object) -> None:
        """A value, by what it holds."""
        if isinstance(value, ClosedJaxpr | Jaxpr):
            self.whole(value)
        elif isinstance(value, enum.Enum):
            self.tokens.append(f"{type(value).__qualname__}.{value.name}")
        elif value is None or isinstance(value, bool | int | str | bytes):
            self.tokens.append(f"{type(value).__name__} {value!r}")
        elif type(value) in (float, complex):
            self.tokens.append(np.asarray(value).tobytes().hex())
        elif isinstance(value, np.dtype):
            self.tokens.append(f"dtype {value.name}")
        elif isinstance(value, np.ndarray | np.generic | jax.Array):
            self.tokens.append(self.number(value))
        elif isinstance(value, tuple | list):
            self.tokens.append(f"{len(value)} of {type(value).__qualname__}")
            for part in value:
                self.parameter(part)
        elif isinstance(value, Mapping):
            self.tokens.append(f"{len(value)} by name")
            for name in sorted(value, key=repr):
                self.tokens.append(repr(name))
                self.parameter(value[name])
        elif isinstance(value, set | frozenset):
            self.parameter(sorted(value, key=repr))
        elif isinstance(value, jax.core.AbstractValue):
            self.tokens.append(_kind(value))
        elif isinstance(value, type):
            self.tokens.append(f"{value.__module__}.{value.__qualname__}")
        elif callable(value):
            name = _called(value)
            fixed = name.partition(".")[0] in _FIXED and "<" not in name
            self.repeatable &= fixed  # another may have its name
            self.tokens.append(name)
        else:
            self.other(value)

    def other(self, value: object) -> None:
        """An object: by what it shows, or by its fields."""
        kind = type(value)
        self.tokens.append(f"{kind.__module__}.{kind.__qualname__}")
        text = repr(value)
        if _ADDRESS.search(text):
            self.repeatable = False
            text = _ADDRESS.sub("", text)
        self.tokens.append(text)

    def number(self, value: Any, aval: Any = None) -> str:
        """An array as a token: its dtype, shape and bytes."""
        if isinstance(value, jax.core.Tracer):
            return "operand"  # of the same equation
        aval = jax.typeof(value) if aval is None else aval
        if jnp.issubdtype(aval.dtype, jax.dtypes.extended):  # a key's type
            value = jax.random.key_data(value)
        made = isinstance(value, bool | int | float | complex)
        array = np.asarray(value, aval.dtype if made else None)
        self.lasts &= not isinstance(value, np.ndarray)  # which may be changed in place
        if array.nbytes <= 16:
            return f"{_kind(aval)}={array.tobytes().hex()}"
        if id(value) not in self.tables:
            whole = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
            self.tables[id(value)] = hashlib.sha256(whole.data).hexdigest(), value
        return f"{_kind(aval)}={self.tables[id(value)][0]}"


def _kind(aval: object) -> str:
    """A variable's dtype, shape, and whether the dtype is a weak one."""
    dtype, shape = getattr(aval, "dtype", None), getattr(aval, "shape", ())
    if dtype is None:
        return _ADDRESS.sub("", f"{type(aval).__name__} {aval}")
    return f"{dtype.name}{list(shape)}{'*' * bool(getattr(aval, 'weak_type', False))}"


def _setting(ctx: object) -> str:
    """The settings of JAX that an equation was traced with, and lowers by."""
    about = (
        getattr(ctx, "compute_type", None),
        getattr(ctx, "threefry_partitionable", None),
        getattr(ctx, "xla_metadata", None),
    )
    return "" if about == (None, True, None) else _ADDRESS.sub("", repr(about))


def _called(function: object) -> str:
    """A function by its name."""
    while isinstance(function, functools.partial):
        function = function.func
    function = getattr(function, "callback_func", function)  # of JAX's wrapper
    function = getattr(function, "__wrapped__", function)
    name = getattr(function, "__qualname__", type(function).__qualname__)
    return f"{getattr(function, '__module__', '')}.{name}"
