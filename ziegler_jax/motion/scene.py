"""What `settle` and `trajectory` ask of a scene, and what they make of it."""

from collections.abc import Callable
from typing import Any

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..context import overridden_tolerances
from ..model.column import Column, State
from ..model.damping import is_polynomial
from ..numerics.numbers import Scalar, Vector4, instance, is_concrete, number
from ..results import OUTCOME
from ..solvers import Explicit, Rosenbrock, Taylor
from .observers import AbstractObserver, Amplitude

REST_RATE = 1e-6  # without friction there is no rate of the column's own
FINEST_IN_FLOAT32 = 1e-5


def outcome_of(result: Any, last_slope: Any, otherwise: Any) -> jax.Array:
    """The code of a lane: what stopped the solver, or otherwise."""
    finite = True
    for slope in jax.tree.leaves(last_slope):
        finite &= jnp.isfinite(slope)
    stopped = result == dfx.RESULTS.dt_min_reached
    reason = jnp.where(finite, OUTCOME.step_vanished, OUTCOME.not_finite)
    outcome = jnp.where(stopped, reason, otherwise)
    spent = result == dfx.RESULTS.max_steps_reached
    return jnp.where(spent, OUTCOME.budget_spent, outcome)


def recorded(**options: Any) -> tuple[tuple[str, Any], ...]:
    """Options for the record; what differs from point to point says so."""
    record = []
    for name, value in options.items():
        if isinstance(value, np.floating):
            value = float(value)
        elif not isinstance(value, (int, str)):
            value = "set at each point"
        record.append((name, value))
    return tuple(record)


def ending(run: Any) -> dict[str, Any]:
    """Where, when and how a motion ended, as a result has it."""
    return {
        "final": State(run.y[:2], run.y[2:]),
        "time": run.time,
        "steps": run.steps,
        "outcome": run.outcome.astype(jnp.int8),
    }


def nan_where(failed: Any, values: Any) -> Any:
    """Values, NaN where a motion failed."""
    return jax.tree.map(lambda x: jnp.where(failed, jnp.nan, x), values)


def prepared(column: Column) -> Column:
    """The column for one motion: what does not change along it is worked out."""
    if column.friction is not None:
        friction = column.friction.prepared(column.q)
        column = eqx.tree_at(lambda c: c.friction, column, friction)
    if column.tangential and column.follower is not None:
        column = eqx.tree_at(lambda c: c.follower, column, None)
    return column


def explicit_method(solver: Any, otherwise: Explicit) -> Explicit:
    """The method where derivatives are carried along, or sections watched for."""
    if solver is not None and not isinstance(solver, Explicit):
        raise ValueError(
            "Argument `solver` must be `Explicit(...)` or None here, but is "
            f"{solver!r}."
        )
    return otherwise if solver is None else solver


def has_series(column: Column) -> bool:
    """Whether `Taylor` can follow this column."""
    law = column.friction
    if law is None or not law.sticks or not is_polynomial(column.damping):
        return False
    return not law.on_reactions


def usual_method(column: Column) -> Taylor | Explicit:
    """The method where none is named: Taylor's if there are series, else Tsit5."""
    return Taylor() if has_series(column) else Explicit()


def method_of(solver: Any, column: Column, otherwise: Any) -> Any:
    """The method for an argument `solver`."""
    if solver is None:
        return otherwise
    if isinstance(solver, Explicit):
        return solver
    if isinstance(solver, Taylor):
        if not has_series(column):
            raise ValueError(
                "Argument `solver` may be `Taylor(...)` with `SetValuedCoulomb` "
                "friction alone, and not with the load `JointReaction()` or a damping "
                "law of one's own, but is "
                f"{solver.name}."
            )
        return solver
    if not isinstance(solver, Rosenbrock):
        raise ValueError(
            "Argument `solver` must be `Explicit(...)`, `Rosenbrock()`, `Taylor()` or "
            f"None, but is {solver!r}."
        )
    if column.sticks:
        raise ValueError(
            "Argument `solver` must be `Taylor()` or `Explicit()` with "
            "`SetValuedCoulomb` friction, which is not stiff, but is `Rosenbrock()`."
        )
    return solver


def layer_of(column: Column, method: Any) -> Scalar | None:
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


def float_state(start: State) -> Vector4:
    """The start as four numbers of the session's precision."""
    dtype = jnp.result_type(float)
    return tuple(jnp.asarray(x, dtype) for x in start.y)  # type: ignore[return-value]


def check_scene(column: Any, start: Any, name: str = "start") -> None:
    """Raise a sentence if these are no column and no start."""
    instance("column", column, Column)
    instance(name, start, State)


def check_maker(make_column: Any) -> None:
    """Raise a sentence if this is no function."""
    if not callable(make_column):
        raise ValueError(
            "Argument `make_column` must be a function of one number, but is "
            f"{make_column!r}."
        )


def made(make_column: Callable[[Any], Column], x: Any) -> Column:
    """The column that `make_column` gives, if it is one."""
    column = make_column(x)
    if not isinstance(column, Column):
        raise ValueError(
            f"Argument `make_column` must return a `Column`, but returns {column!r}."
        )
    return column


def tolerances(rtol: Any, atol: Any) -> tuple[Scalar, Scalar]:
    """Rtol and atol, validated, or those of the context."""
    rtol, atol = number("rtol", rtol, "positive"), number("atol", atol, "positive")
    if jnp.result_type(float) == jnp.float32:
        for name, tol in (("rtol", rtol), ("atol", atol)):
            if is_concrete(tol) and tol < FINEST_IN_FLOAT32:
                raise ValueError(
                    f"Argument `{name}` must be at least {FINEST_IN_FLOAT32:g} in "
                    f"32-bit arithmetic, but is {tol:g}; name coarser tolerances, or "
                    "compute in 64 bits."
                )
    return overridden_tolerances(rtol, atol)


def increasing_times(ts: Any, dtype: Any) -> jax.Array:
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


def rate_cut_of(column: Column, rate_cut: Any) -> Scalar | None:
    """The rate below which a smoothed joint is at rest; None: by modes."""
    if rate_cut is not None:
        return number("rate_cut", rate_cut, "positive")
    return REST_RATE if column.friction is None else column.friction.rate_cut()


def with_amplitude(observers: Any, column: Column) -> tuple[AbstractObserver, ...]:
    """The observers, `Amplitude()` first: the windows are compared by it."""
    try:
        chosen = [o for o in observers if not isinstance(o, Amplitude)]
    except TypeError:
        chosen = [observers]
    names = set()
    for observer in chosen:
        if not isinstance(observer, AbstractObserver):
            raise ValueError(
                "Argument `observers` must be a sequence of observers such as "
                f"`Period()`, but contains {observer!r}."
            )
        if observer.name in names:
            raise ValueError(
                f"Argument `observers` must name each once, but has `{observer.name}` "
                "twice."
            )
        names.add(observer.name)
        observer.check(column)
    return (Amplitude(), *chosen)


Solver = Explicit | Rosenbrock | Taylor | None
