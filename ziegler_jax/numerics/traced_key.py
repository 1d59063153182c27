"""A traced point as a key, by which what it was lowered to is found again.

Tracing a point reads whatever the scene reads. Batching and lowering it, which take
longer, depend on its equations alone, on the numbers that they hold, and on JAX's
settings. So where these are those of an earlier sweep, its lowered program is that of
this one, too.
"""

from collections.abc import Hashable
from weakref import WeakKeyDictionary

import jax
import jax.core
import numpy as np
from jax.extend.core import (
    ClosedJaxpr,  # pyright: ignore[reportPrivateImportUsage]
    Jaxpr,
    Literal,
)

# How a custom derivative is worked out: of no meaning once a point is traced
_DERIVATIVES = ("jvp_jaxpr_fun", "fwd_jaxpr_thunk", "bwd")
_PACKAGE = __name__.partition(".")[0]


class _NotKnown(Exception):
    """An equation holds what may lower to something else another time."""


def traced_key(point: ClosedJaxpr) -> Hashable | None:
    """A key of the traced point; None for one that must be lowered anew.

    Equal keys mean equal programs; so may unequal ones. Batching calls the rules of
    `jax.custom_batching.custom_vmap`, which may read anything: with one that is not
    this package's own there is no key. (Lowering calls the rules of primitives, too;
    one of the user's own must not read what changes.)
    """
    try:
        settings = tuple(sorted((k, repr(v)) for k, v in jax.config.values.items()))
        whole = _Tokens()
        whole.parameter(point)
        return settings, jax.default_backend(), tuple(whole.tokens)
    except Exception:  # what cannot be hashed or read, whatever that raises
        return None


class _Part:
    """What equations consist of, hashed once."""

    __slots__ = "hash", "tokens"

    def __init__(self, tokens: list[Hashable]):
        self.tokens = tuple(tokens)
        self.hash = hash(self.tokens)

    def __hash__(self) -> int:
        return self.hash

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Part):
            return NotImplemented
        if self is other:
            return True
        return self.hash == other.hash and self.tokens == other.tokens


# Equations that JAX traced for an earlier sweep are the same object again. Those that
# hold a table of NumPy's, which may be changed in place, are read again all the same.
_read_before: WeakKeyDictionary[Jaxpr, _Part] = WeakKeyDictionary()


class _Tokens:
    """What equations consist of, in their order."""

    def __init__(self):
        self.tokens: list[Hashable] = []
        self.lasts = True  # no table is among them

    def part(self, jaxpr: Jaxpr) -> None:
        """Equations within, as one."""
        part = _read_before.get(jaxpr)
        if part is None:
            whole = _Tokens()
            whole.equations(jaxpr)
            part = _Part(whole.tokens)
            if whole.lasts:
                _read_before[jaxpr] = part
            self.lasts &= whole.lasts
        self.tokens.append(part)

    def parameter(self, value: object) -> None:
        """A parameter of an equation."""
        if isinstance(value, ClosedJaxpr):
            self.part(value.jaxpr)
            for constant in value.consts:
                self.number(constant)
        elif isinstance(value, Jaxpr):
            self.part(value)
        elif isinstance(value, tuple | list):
            self.tokens += type(value), len(value)
            for part in value:
                self.parameter(part)
        elif isinstance(value, dict):
            self.tokens += "dict", len(value)
            for name, part in value.items():
                self.tokens.append(name)
                self.parameter(part)
        elif isinstance(value, np.ndarray | np.generic | jax.Array):
            self.number(value)
        elif type(value).__name__ == "ClosedRule":  # of a `custom_vmap`
            rule = getattr(value, "rule", None)
            if getattr(rule, "__module__", "").partition(".")[0] != _PACKAGE:
                raise _NotKnown
            self.tokens.append(rule)
        else:
            hash(value)
            # 1, True and 1.0 are equal, and so are zeros of either sign
            exact = value.hex() if isinstance(value, float) else value
            self.tokens += type(value), exact

    def number(self, value: object) -> None:
        """An array, by its bits."""
        if isinstance(value, jax.core.Tracer):  # an operand of the same equation
            self.tokens.append("operand")
            return
        self.lasts &= not (isinstance(value, np.ndarray) and value.ndim)
        array = np.asarray(value)
        if array.dtype == object:
            raise _NotKnown
        weak = bool(getattr(value, "weak_type", False))
        self.tokens += array.dtype.str, array.shape, weak, array.tobytes()

    def equations(self, jaxpr: Jaxpr) -> None:
        """All of them, their variables numbered."""
        numbers: dict[object, int] = {}

        def new(variables):
            for v in variables:
                numbers[v] = len(numbers)
                self.tokens.append(v.aval)

        def read(operands):
            self.tokens.append(len(operands))
            for v in operands:
                if isinstance(v, Literal):
                    self.tokens.append(v.aval)
                    self.number(v.val)
                else:
                    self.tokens.append(numbers[v])

        new([*jaxpr.constvars, *jaxpr.invars])
        self.tokens.append(len(jaxpr.constvars))
        for equation in jaxpr.eqns:
            self.tokens += equation.primitive, equation.ctx
            read(equation.invars)
            new(equation.outvars)
            for name, value in equation.params.items():
                if name not in _DERIVATIVES:
                    self.tokens.append(name)
                    self.parameter(value)
        read(jaxpr.outvars)
