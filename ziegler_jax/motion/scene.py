"""What `settle` and `trajectory` ask of a scene, and what they make of it."""

import inspect
from collections.abc import Callable, Sequence
from typing import Protocol, TypedDict, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike, DTypeLike
from jaxtyping import Array, Float, Int

from ..model.column import Column, State, refuse_si, vector_field
from ..model.damping import is_polynomial
from ..model.friction import check_slopes
from ..numerics.materialise import as_one_call
from ..numerics.numbers import Flag, Scalar, Traced4, Vector4, instance, is_concrete
from ..results import CODE
from ..solvers import Explicit, Rosenbrock, Taylor
from .observers import AbstractObserver, Amplitude
from .options import Method, Solver, complete

Tree = TypeVar("Tree")  # a pytree of numbers
Times = Sequence[float] | Float[ArrayLike, " n"]
REST_RATE = 1e-6  # without friction there is no rate of the column's own
# the vector field, traced once for such arguments: a scene asks for it ten times
field = as_one_call(vector_field, inline=True)


def outcome_of(
    vanished: Flag, last_slope: Vector4, otherwise: Int[Array, ""]
) -> Int[Array, ""]:
    """The code of a lane: that its steps have vanished, and why, or otherwise."""
    finite = True
    for slope in jax.tree.leaves(last_slope):
        finite &= jnp.isfinite(slope)
    reason = jnp.where(finite, CODE.step_vanished, CODE.not_finite)
    return jnp.where(vanished, reason, otherwise)


class Ending(TypedDict):
    """Where, when and how a motion ended."""

    final: State
    time: Float[Array, ""]
    steps: Int[Array, ""]
    outcome: Int[Array, ""]


class Ended(Protocol):
    """What of a motion's `Run` says so."""

    @property
    def y(self) -> Vector4:
        """The state."""
        ...

    @property
    def time(self) -> Scalar:
        """How far it has come."""
        ...

    @property
    def steps(self) -> Int[Array, ""]:
        """Attempted steps."""
        ...

    @property
    def outcome(self) -> Int[Array, ""]:
        """A `CODE`."""
        ...


def ending(run: Ended) -> Ending:
    """Where, when and how a motion ended, as a result has it."""
    return {
        "final": State(run.y[:2], run.y[2:]),
        "time": cast(jax.Array, run.time),
        "steps": run.steps,
        "outcome": run.outcome.astype(jnp.int8),
    }


def nan_where(failed: Flag, values: Tree) -> Tree:
    """Values, NaN where a motion failed, and so are their derivatives."""
    mark = jnp.where(failed, jnp.nan, 1.0)
    return jax.tree.map(lambda x: x * mark.astype(x.dtype), values)


def prepared(column: Column) -> Column:
    """The column for one motion: what does not change along it is worked out."""
    if column.friction is not None:
        friction = column.friction.prepared(column.q)
        column = eqx.tree_at(lambda c: c.friction, column, friction)
    if column.tangential and column.follower is not None:
        column = eqx.tree_at(lambda c: c.follower, column, None)
    return column


def has_series(column: Column) -> bool:
    """Whether `Taylor` can follow this column."""
    law = column.friction
    if law is None or not law.sticks or not is_polynomial(column.damping):
        return False
    return not law.on_reactions


def usual_method(column: Column) -> Taylor | Explicit:
    """The method where none is named: Taylor's if there are series, else Tsit5."""
    return Taylor() if has_series(column) else Explicit()


def explicit_method(
    question: str, method: Method, usual: Explicit | None = None
) -> Method:
    """The method where derivatives are carried along, or sections watched for.

    **Raises:** `ValueError` for a solver that is not explicit.
    """
    instance("method", method, Method)
    solver = method.solver
    if solver is not None and not isinstance(solver, Explicit):
        raise ValueError(
            "Argument `solver` must be an explicit method of diffrax, `Explicit(...)` "
            f"or None in `{question}`, but is `{solver.name}`."
        )
    if solver is None:
        solver = Explicit() if usual is None else usual
    return complete(question, method, solver)


def method_of(question: str, method: Method, column: Column, usual: Solver) -> Method:
    """The method of any motion.

    **Raises:** `ValueError` for one that cannot follow the column.
    """
    instance("method", method, Method)
    solver = method.solver
    if isinstance(solver, Taylor) and not has_series(column):
        raise ValueError(
            "Argument `solver` may be `Taylor(...)` with `SetValuedCoulomb` friction "
            "alone, and not with the load `JointReaction()` or a damping law of one's "
            f"own, but is {solver.name}."
        )
    if isinstance(solver, Rosenbrock) and column.sticks:
        raise ValueError(
            "Argument `solver` must be `Taylor()` or explicit with `SetValuedCoulomb` "
            "friction, which is not stiff, but is `Rosenbrock()`."
        )
    return complete(question, method, usual if solver is None else solver)


def layer_of(column: Column, method: Solver | None) -> Scalar | None:
    """The width of the friction layer that a stiff method's steps resolve."""
    if column.friction is None or not isinstance(method, Rosenbrock):
        return None
    return column.friction.rate_cut()


def valid_scene(column: Column, y0: Vector4) -> jax.Array:
    """Whether the numbers of column and start keep their rules."""
    good = column.valid()
    for x in y0:
        good &= jnp.isfinite(x)
    return good


def float_state(start: State) -> Traced4:
    """The start as four numbers of the session's precision."""
    dtype = jnp.result_type(float)
    return cast(Traced4, tuple(jnp.asarray(x, dtype) for x in start.y))


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


def rate_cut_of(column: Column) -> Scalar | None:
    """The rate below which a joint is at rest; None: by modes."""
    return REST_RATE if column.friction is None else column.friction.rate_cut()


def with_amplitude(
    observers: Sequence[AbstractObserver], column: Column
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
        observer.check(column)
    return (Amplitude(), *chosen)
