"""One motion with running numbers, to where its fold ends it; in legs in a sweep."""

from typing import Any, NamedTuple

import diffrax as dfx
import jax.numpy as jnp

from ._legs import current_legs
from ._scene import outcome_of, prepared
from ._types import Scalar, Vector4
from .column import Column, vector_field
from .outcome import OUTCOME
from .set_valued import SetValuedCoulomb
from .solvers import (
    AbstractFold,
    Explicit,
    LandingControl,
    Observed,
    StepControl,
    StickSlip,
)

FIRST_STEP = 0.01


class Followed(NamedTuple):
    """Where a motion ended, and the fold's running numbers there."""

    folded: Any
    y: Vector4
    time: Any
    steps: Any  # attempted steps, rejected ones included
    outcome: Any  # the fold's own code, or why the motion could not be followed


def follow(
    column: Column,
    y0: Vector4,
    fold: AbstractFold,
    *,
    solver: Explicit,
    rtol: Scalar,
    atol: Scalar,
    valid: Any,
    first_stop: Scalar,
    end: Scalar,
    max_steps: int,
) -> Followed:
    """Integrate from t = 0 until the fold ends the lane.

    **Arguments:**

    - `column`, `y0`: the scene.
    - `fold`: its running numbers carry an `outcome`, which is `not_computed` until it
        ends the lane.
    - `valid`: whether the numbers keep their rules; else the outcome is `invalid`.
    - `first_stop`: the first time on which a step must end.
    - `end`: a time before which the fold has ended the lane.
    """
    args = prepared(column)
    watching, control = machine(column, solver, fold, rtol, atol)
    terms = dfx.ODETerm(vector_field)
    zero = jnp.zeros((), y0[0].dtype)
    invalid = jnp.where(valid, OUTCOME.not_computed, OUTCOME.invalid)
    begin = _Run(
        solver=watching.init(terms, zero, zero, y0, args),
        control=control.start(zero, FIRST_STEP, first_stop),
        steps=jnp.zeros((), jnp.int32),
        outcome=invalid.astype(jnp.int32),
    )
    legs = current_legs()
    run = begin if legs is None else legs.enter(begin)
    left = max_steps - run.steps
    left = left if legs is None else jnp.minimum(left, legs.quota)
    t = run.control.t
    solution = dfx.diffeqsolve(
        terms,
        watching,
        t0=t,
        # a lane that has ended does not move
        t1=jnp.where(run.outcome == OUTCOME.not_computed, zero + end, t),
        # t + (t_next - t) is t_next to the last bit as soon as t >= t_next / 2
        # (Sterbenz), and a leg is many steps long: a pause changes nothing
        dt0=run.control.t_next - t,
        y0=run.solver.y,
        args=args,
        stepsize_controller=control,
        solver_state=run.solver,
        controller_state=run.control._replace(left=left.astype(jnp.int32)),
        saveat=dfx.SaveAt(solver_state=True, controller_state=True),
        max_steps=None,  # the controller counts
        throw=False,
        adjoint=dfx.ForwardMode(),
    )
    after: Any = solution.solver_state
    where: Any = solution.controller_state
    steps = run.steps + solution.stats["num_steps"]
    ended = after.folded.outcome
    spent = (ended == OUTCOME.not_computed) & (steps >= max_steps)
    ended = jnp.where(spent, OUTCOME.budget_spent, ended)
    if isinstance(watching, StickSlip):
        ended = unless_chattering(watching, after, ended)
    ended = outcome_of(solution.result, after.slope, ended)
    outcome = jnp.where(run.outcome == OUTCOME.not_computed, ended, run.outcome)
    if legs is not None:
        paused = _Run(after, where, steps, outcome)
        legs.leave(paused, outcome == OUTCOME.not_computed, steps)
    return Followed(after.folded, after.y, where.t, steps, outcome)


def machine(column: Column, solver: Explicit, fold: Any, rtol: Any, atol: Any) -> Any:
    """The observing solver and the controller that the friction law needs."""
    if isinstance(column.friction, SetValuedCoulomb):
        control = LandingControl(rtol, atol)  # pyright: ignore[reportCallIssue]
        return StickSlip(solver, fold, atol), control
    control = StepControl(rtol, atol)  # pyright: ignore[reportCallIssue]
    return Observed(solver, fold), control


def unless_chattering(solver: StickSlip, state: Any, otherwise: Any) -> Any:
    """`chattering` where stick and slip change without time going on."""
    return jnp.where(solver.chatters(state), OUTCOME.chattering, otherwise)


class _Run(NamedTuple):
    """Where a lane is: what a leg hands to the next."""

    solver: Any
    control: Any
    steps: Any
    outcome: Any
