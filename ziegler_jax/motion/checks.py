"""What a question asks of its arguments, before anything is traced."""

import inspect
from collections.abc import Callable, Sequence
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike, DTypeLike
from jaxtyping import Array, Float

from ..model.column import Column, State, refuse_si
from ..model.friction import check_slopes
from ..model.state import PhasePoint
from ..model.system import System
from ..numerics.numbers import Scalar, is_concrete
from ..numerics.rules import instance
from .observers import AbstractObserver, Amplitude

Times = Sequence[float] | Float[ArrayLike, " n"]


def valid_scene(column: Column, y0: PhasePoint) -> jax.Array:
    """Whether the numbers of column and start keep their rules."""
    good = jnp.asarray(column.valid())
    for x in y0:
        good &= jnp.isfinite(x)
    return good


def float_state(start: State) -> PhasePoint:
    """The start as four numbers of the session's precision."""
    dtype = jnp.result_type(float)
    return PhasePoint(jnp.asarray(x, dtype) for x in start.y)


def check_scene(column: Column, start: State, name: str = "start") -> None:
    """Raise a sentence if these are no column and no start."""
    instance("column", column, Column)
    refuse_si(column)
    instance(name, start, State)
    check_slopes(column.friction)


def check_maker(make_column: Callable[..., Column], count: int = 1) -> None:
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


def made(make_column: Callable[[Scalar], Column], x: Scalar) -> Column:
    """The column that `make_column` gives, if it is one."""
    column = make_column(x)
    if not isinstance(column, Column):
        raise ValueError(
            f"Argument `make_column` must return a `Column`, but returns {column!r}."
        )
    return column


def scene_at(
    cell: Callable[..., tuple[Column, State]], *numbers: Scalar, **named: Scalar
) -> tuple[Column, State]:
    """The column and the start that `cell` gives, if it does."""
    match cell(*numbers, **named):
        case Column() as column, State() as start:
            return column, start
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
