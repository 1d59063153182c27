"""One hash of what JAX traced: equations, and the bytes of the numbers in them.

A program is known by what it computes. Its variables are numbered as they come, its
constants are known by dtype, shape and bytes, calls within it by their own equations.
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
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Jaxpr

from ..numerics.jaxprs import ClosedJaxpr, JaxprEqn, Literal
from ..numerics.resumable import constants_of, resumable_loop

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
    """What is known of a program by its equations.

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
    given = [*map(walk.number, traced.consts), *(f"argument {n!r}" for n in inputs)]
    results = walk.equations(traced.jaxpr, given)
    for name, result in sorted(zip(outputs, results, strict=True)):
        walk.tokens.append(f"{name!r} is {result}")
    return walk.digest()


# Equations that JAX traced before are the same object again, and hold no table of
# NumPy's, which may be changed in place.
_read_before: WeakKeyDictionary[Jaxpr, Digest] = WeakKeyDictionary()


class _Walk:
    """What equations consist of, as text in their order."""

    def __init__(self, within: "_Walk | None" = None):
        self.tokens: list[str] = []
        self.primitives: set[str] = set()
        self.hosts: set[str] = set()
        self.repeatable = self.lasts = True  # `lasts`: no table of NumPy's is among it
        # what comes again, by its identity, for which it is kept
        self.tables: dict[int, tuple[str, object]] = {}
        self.parts: dict[tuple, tuple[Digest, bool, ClosedJaxpr]] = {}
        if within is not None:
            self.tables, self.parts = within.tables, within.parts

    def digest(self) -> Digest:
        text = "\n".join(self.tokens)
        value = hashlib.sha256(text.encode()).hexdigest()
        about = frozenset(self.primitives), frozenset(self.hosts), self.repeatable
        return Digest(value, *about)

    def value(self, value: object) -> Digest:
        """The digest of a value by itself."""
        self.parameter(value)
        return self.digest()

    def take(self, part: Digest, lasts: bool) -> None:
        """What is within, as one token."""
        self.tokens.append(part.value)
        self.primitives |= part.primitives
        self.hosts |= part.hosts
        self.repeatable &= part.repeatable
        self.lasts &= lasts

    def opened(self, jaxpr: Jaxpr) -> None:
        """Equations within, their constants like their inputs."""
        known, lasts = _read_before.get(jaxpr), True
        if known is None:
            given = [f"constant {i}" for i in range(len(jaxpr.constvars))]
            known, lasts = self.within(jaxpr, given)
            if lasts and known.repeatable:
                _read_before[jaxpr] = known
        self.take(known, lasts)

    def closed(self, closed: ClosedJaxpr) -> None:
        """Equations within, with their constants."""
        if not closed.consts:
            return self.opened(closed.jaxpr)
        key = closed.jaxpr, *map(id, closed.consts)
        if key not in self.parts:
            given = [self.number(x) for x in closed.consts]
            self.parts[key] = *self.within(closed.jaxpr, given), closed
        part, lasts, _ = self.parts[key]
        lasting = all(isinstance(x, jax.Array) for x in closed.consts)
        return self.take(part, lasts and lasting)

    def within(self, jaxpr: Jaxpr, given: Sequence[str]) -> tuple[Digest, bool]:
        """The digest of equations, and whether it lasts."""
        walk = _Walk(self)
        inputs = [f"input {i}" for i in range(len(jaxpr.invars))]
        walk.tokens += walk.equations(jaxpr, [*given, *inputs])
        return walk.digest(), walk.lasts

    # Equations ------------------------------------------------------------------------

    def equations(self, jaxpr: Jaxpr, given: Sequence[str]) -> list[str]:
        """All of them; returns what the results are."""
        variables = [*jaxpr.constvars, *jaxpr.invars]
        names: dict[object, str] = dict(zip(variables, given, strict=True))
        self.tokens += [_kind(v.aval) for v in jaxpr.invars]

        def read(operands: Iterable) -> list[str]:
            return [
                self.number(v.val, v.aval) if isinstance(v, Literal) else names[v]
                for v in operands
            ]

        count = 0
        for equation in jaxpr.eqns:
            operands = read(equation.invars)
            if equation.primitive is resumable_loop:
                operands = self.bodies(equation, operands)
            for v in equation.outvars:
                names[v], count = str(count), count + 1
            results = [f"{names[v]}:{_kind(v.aval)}" for v in equation.outvars]
            name = equation.primitive.name
            self.primitives.add(name)
            head = [*results, "=", name, _setting(equation.ctx), *operands]
            self.tokens.append(" ".join(head))
            if name in _HARMLESS:
                self.repeatable = False  # what it tells is no number
            elif equation.primitive is not resumable_loop:
                for key in sorted(equation.params.keys() - _OF_NO_MEANING):
                    self.tokens.append(key)
                    self.of_equation(equation, key, equation.params[key])
        return read(jaxpr.outvars)

    def bodies(self, loop: JaxprEqn, operands: list[str]) -> list[str]:
        """The parts of a loop, with what they only read; returns the other operands."""
        bodies = loop.params["bodies"]
        constants, state = constants_of(bodies, operands)
        self.tokens.append(f"chunk {loop.params['chunk']}")
        for body, of_parts in zip(bodies, constants, strict=True):
            self.tokens.append(f"body {body.cost!r} {body.every}")
            for part, mine in zip(body.parts, of_parts, strict=True):
                self.take(*self.within(part, mine))
        return state

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
        if getattr(rule, "__module__", "").partition(".")[0] == _PACKAGE:
            return
        self.repeatable = False  # it is asked once more where the batch is traced
        kinds = [(v.aval.shape, v.aval.dtype) for v in equation.invars]  # pyright: ignore
        batch = [jax.ShapeDtypeStruct((_LANES, *s), dtype) for s, dtype in kinds]
        bind = functools.partial(equation.primitive.bind, **equation.params)
        self.closed(jax.make_jaxpr(jax.vmap(bind))(*batch))

    # Values ---------------------------------------------------------------------------

    def parameter(self, value: object) -> None:
        """A value, by what it holds."""
        if isinstance(value, ClosedJaxpr):
            self.closed(value)
        elif isinstance(value, Jaxpr):
            self.opened(value)
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
        if isinstance(value, bool | int | float | complex):
            value = np.asarray(value, aval.dtype)
        array = np.asarray(value)
        self.lasts &= isinstance(value, jax.Array) or not array.ndim
        if array.nbytes <= 16:
            return f"{_kind(aval)}={array.tobytes().hex()}"
        if id(value) not in self.tables:
            whole = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
            self.tables[id(value)] = hashlib.sha256(whole.data).hexdigest(), value
        return f"{_kind(aval)}={self.tables[id(value)][0]}"


def _kind(aval: object) -> str:
    """What a variable is: dtype, shape, and whether the dtype is a weak one."""
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
