"""Values with numbers in SI units, in the column's own: each field by its unit."""

import dataclasses
import math
from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..model.chain_of_rods import Chain
from ..model.column import Column
from ..numerics.numbers import Scalar, is_concrete
from .known import PURE, UNITS, Powers

Value = TypeVar("Value", bound=eqx.Module)
NUMBERS = int, float, np.number, np.ndarray, jax.Array
Size = Callable[[Powers], Scalar]  # of a unit, in SI


def scaled_value(value: Value, size: Size) -> Value:
    """The same value, each number in it divided by its unit.

    **Raises:** `ValueError` for a number that has none.
    """
    made = object.__new__(type(value))  # as JAX does: its constructor may take others
    for field in dataclasses.fields(value):
        object.__setattr__(made, field.name, _scaled_field(value, field, size))
    return made


def scaled_column(column: Column, size: Size) -> Column:
    """A column in its own units, in which rod 1 has the length 1.

    **Raises:** `ValueError` where the length of rod 1 is not known, or is not l.
    """
    if column.l1 is None:
        raise ValueError(
            "Argument `value` must have `l1`, the length of rod 1 in m, as a column in "
            "SI units does, but has none: write `uniform_rods(q, m1=, m2=, l1=, l2=)` "
            "in newtons, kilograms and metres."
        )
    made, length = scaled_value(column, size), size(UNITS["l"].powers)
    inertia = made.a
    if not is_concrete(column.l1) or not is_concrete(length):
        same = jnp.abs(column.l1 / length - 1) < 1e-12  # else the column is invalid
        inertia = jnp.where(same, inertia, jnp.nan)
    elif not math.isclose(column.l1, length, rel_tol=1e-12):
        raise ValueError(
            "Argument `value` must have a rod 1 of the length l of its units, "
            f"{length:g} m, but has `l1` = {column.l1:g}."
        )
    return eqx.tree_at(lambda c: (c.l1, c.a), made, (None, inertia))


def scaled_chain(chain: Chain, size: Size) -> Chain:
    """A chain in units of m, l and k.

    **Raises:** `ValueError` for masses or springs that are left out.
    """
    for name in ("masses", "springs"):
        if getattr(chain, name) is None:
            raise ValueError(
                f"Argument `value` must have `{name}`, as in SI units nothing has a "
                "default, but has none: write them in kilograms and newton metres."
            )
    return scaled_value(chain, size)


def _scaled_field(owner: eqx.Module, field: dataclasses.Field, size: Size) -> object:
    """A field's numbers by its unit; values in it by the units of their own."""
    content = getattr(owner, field.name)
    unit = getattr(owner, "units", {}).get(field.name)
    # whole numbers and switches that are static change the program: no quantities
    fixed = int if unit is None and field.metadata.get("static") else bool

    def scaled(part: object) -> object:
        if isinstance(part, eqx.Module):
            return scaled_value(part, size)
        if not isinstance(part, NUMBERS) or isinstance(part, fixed):
            return part
        return part / size(_powers(owner, field.name, unit))

    if unit in PURE:
        return content
    return jax.tree.map(scaled, content, is_leaf=lambda x: isinstance(x, eqx.Module))


def _powers(owner: eqx.Module, name: str, unit: str | Powers | None) -> Powers:
    """The unit of a number in powers of m, l and k.

    **Raises:** `ValueError` for a field without a unit, or with another one.
    """
    kind = type(owner).__name__
    if unit is None:
        raise ValueError(
            f"Argument `value` must say the units of its numbers, but `{name}` of "
            f'`{kind}` has none: write `units = {{"{name}": "1"}}` in its class for a '
            f"pure number, or {', '.join(UNITS)}, rad."
        )
    if isinstance(unit, tuple):
        return unit
    if unit not in UNITS:
        raise ValueError(
            f"The unit of `{name}` of `{kind}` must be one of {', '.join(UNITS)}, rad, "
            f"1, or the powers of m, l and k, such as (0.5, 1, -0.5), but is {unit!r}."
        )
    return UNITS[unit].powers
