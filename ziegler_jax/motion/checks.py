"""Checks of a question's arguments, before anything is traced."""

import inspect
from collections.abc import Callable, Sequence
from typing import TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike, DTypeLike
from jaxtyping import Array, Float

from ..model.chain_of_rods import AbstractChain, check_column
from ..model.column import refuse_si
from ..model.friction import check_slopes
from ..model.state import PhasePoint, State
from ..model.system import System
from ..numerics.numbers import Scalar, is_concrete
from ..numerics.rules import instance
from .observers import AbstractObserver, Amplitude

Some = TypeVar("Some", bound=AbstractChain)
Times = Sequence[float] | Float[ArrayLike, " n"]


def valid_scene(column: AbstractChain, y0: PhasePoint) -> jax.Array:
    """Whether the numbers of column and start keep their rules."""
    good = jnp.asarray(column.valid())
    for x in y0:
        good &= jnp.isfinite(x)
    return good


def float_state(start: State) -> PhasePoint:
    """The start as numbers of the session's precision."""
    dtype = jnp.result_type(float)
    return PhasePoint(jnp.asarray(x, dtype) for x in start.y)


def check_scene(column: AbstractChain, start: State, name: str = "start") -> None:
    """Raise a sentence if these are no column or chain and no start of it."""
    check_column(column)
    refuse_si(column)
    instance(name, start, State)
    if len(start.phi) != column.joints:
        raise ValueError(
            f"Argument `{name}` must have one angle and rate for each of "
            f"{column.joints} rods, but is of {len(start.phi)}."
        )
    check_slopes(column.friction, column.joints)


def check_two_rods(question: str, column: AbstractChain) -> None:
    """Refuse a longer chain where a question is one of two rods.

    **Raises:** `ValueError`.
    """
    if column.joints != 2:
        raise ValueError(
            f"Argument `column` must have two rods for `{question}`, but has "
            f"{column.joints}."
        )


def check_maker(make_column: Callable[..., AbstractChain], count: int = 1) -> None:
    """Raise a sentence if this is no function of so many numbers."""
    numbers = "one number" if count == 1 else "two numbers"
    needs = f"Argument `make_column` must be a function of {numbers}"
    check_takes(needs, make_column, count)


def check_takes(needs: str, function: Callable[..., object], count: int) -> None:
    """Raise the sentence that begins so if this is no function of so many things."""
    if not callable(function):
        raise ValueError(f"{needs}, but is {function!r}.")
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # of a function that is not Python's own
        return
    try:
        signature.bind(*[0.0] * count)
    except TypeError:
        raise ValueError(f"{needs}, but takes {signature}.") from None


def made(make_column: Callable[[Scalar], Some], x: Scalar) -> Some:
    """The column that `make_column` gives, if it is one."""
    column = make_column(x)
    if not isinstance(column, AbstractChain):
        raise ValueError(
            "Argument `make_column` must return a `Column` or a `Chain`, but returns "
            f"{column!r}."
        )
    return column


def scene_at(
    cell: Callable[..., tuple[Some, State]], *numbers: Scalar, **named: Scalar
) -> tuple[Some, State]:
    """The column and the start that `cell` gives, if it does."""
    match cell(*numbers, **named):
        case AbstractChain() as column, State() as start:
            return cast(Some, column), start
        case other:
            raise ValueError(
                "Argument `cell` must return a column and a start, as `return column, "
                f"start`, but returns {other!r}."
            )


def increasing_times(ts: Times, dtype: DTypeLike) -> Float[Array, " n"]:
    """Output times, validated; NaN where traced ones do not increase."""
    if np.ndim(ts) != 1 or np.shape(ts)[0] < 2:
        raise ValueError(
            "Argument `ts` must be at least two times in one dimension, but has shape "
            f"{np.shape(ts)}."
        )
    if is_concrete(ts):
        known = np.asarray(ts, dtype=float)
        if not (np.all(np.diff(known) > 0) and np.all(np.isfinite(known))):
            raise ValueError("Argument `ts` must be finite and increase, but does not.")
    return jnp.asarray(ts, dtype)


def with_amplitude(
    observers: Sequence[AbstractObserver], system: System
) -> tuple[AbstractObserver, ...]:
    """The observers, `Amplitude()` first: the windows are compared by it."""
    try:
        chosen = [o for o in observers if not isinstance(o, Amplitude)]
    except TypeError:
        chosen = [cast(AbstractObserver, observers)]
    names = set()
    for observer in chosen:
        if not isinstance(observer, AbstractObserver):
            raise ValueError(
                "Argument `observers` must be a sequence of observers such as "
                f"`StickFraction()`, but contains {observer!r}."
            )
        if observer.name in names:
            raise ValueError(
                f"Argument `observers` must name each once, but has `{observer.name}` "
                "twice."
            )
        names.add(observer.name)
        observer.check(system)
    return (Amplitude(), *chosen)
