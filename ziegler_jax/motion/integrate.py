"""One motion with running numbers, to where its fold ends it; in a sweep in legs."""

from typing import Any, NamedTuple

import diffrax as dfx
import jax
import jax.numpy as jnp

from ..context import current_legs
from ..model.column import Column, vector_field
from ..model.set_valued import SetValuedCoulomb
from ..numerics.numbers import Scalar, Vector4
from ..results import OUTCOME
from ..solvers import (
    AbstractFold,
    GoingOn,
    Observed,
    Reached,
    StepControl,
    StickSlip,
    Taylor,
    TaylorSlip,
)
from .scene import layer_of, outcome_of, prepared

FIRST_STEP = 0.01


class Run(NamedTuple):
    """Where a motion is: what a leg hands to the next."""

    solver: Any
    control: Any
    steps: Any
    outcome: Any  # `not_computed` while it runs

    @property
    def y(self) -> Vector4:
        """The state."""
        return self.solver.y

    @property
    def folded(self) -> Any:
        """The fold's running numbers."""
        return self.solver.folded

    @property
    def time(self) -> Any:
        """How far it has come."""
        return self.control.t

    @property
    def running(self) -> Any:
        """Whether the motion has no verdict yet."""
        return self.outcome == OUTCOME.not_computed


class Motion:
    """A column, a fold over its steps that ends it, and the machine that this needs.

    **Arguments:**

    - `column`, `y0`: the scene.
    - `fold`: its running numbers carry an `outcome`, which is `not_computed` until it
        ends the motion.
    - `solver`, `rtol`, `atol`, `max_steps`: the method and its budget.
    - `valid`: whether the numbers keep their rules; else the outcome is `invalid`.
    - `first_stop`: the first time on which a step must end.
    - `end`: a time before which the fold ends the motion, and `at_end`: its outcome if
        the fold does not, as where windows are rounded.
    """

    def __init__(
        self,
        column: Column,
        y0: Vector4,
        fold: AbstractFold,
        *,
        solver: Any,
        rtol: Scalar,
        atol: Scalar,
        valid: Any,
        first_stop: Scalar,
        end: Scalar,
        at_end: OUTCOME,
        max_steps: int,
    ):
        """Choose the machine."""
        self.column, self.y0, self.fold = column, y0, fold
        self.method, self.rtol, self.atol = solver, rtol, atol
        self.valid, self.first_stop, self.end = valid, first_stop, end
        self.at_end, self.max_steps = at_end, max_steps
        self.args = prepared(column)
        self.solver, self.control = machine(column, solver, fold, rtol, atol)
        self.terms = dfx.ODETerm(vector_field)

    def begin(self) -> Run:
        """The motion before its first step."""
        zero = jnp.zeros((), self.y0[0].dtype)
        invalid = jnp.where(self.valid, OUTCOME.not_computed, OUTCOME.invalid)
        return Run(
            solver=self.solver.init(self.terms, zero, zero, self.y0, self.args),
            control=self.control.start(zero, FIRST_STEP, self.first_stop),
            steps=jnp.zeros((), jnp.int32),
            outcome=invalid.astype(jnp.int32),
        )

    def advance(self, run: Run, quota: Any = None) -> Run:
        """The motion after at most `quota` more steps; None: at its end."""
        left = self.max_steps - run.steps
        left = left if quota is None else jnp.minimum(left, quota)
        t = run.control.t
        solution = dfx.diffeqsolve(
            self.terms,
            self.solver,
            t0=t,
            # a motion that has ended does not move
            t1=jnp.where(run.running, jnp.zeros_like(t) + self.end, t),
            dt0=None,
            y0=run.solver.y,
            args=self.args,
            stepsize_controller=GoingOn(self.control, run.control.t_next),
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
        over = (ended == OUTCOME.not_computed) & (where.t >= self.end)
        ended = jnp.where(over, self.at_end, ended)
        spent = (ended == OUTCOME.not_computed) & (steps >= self.max_steps)
        ended = jnp.where(spent, OUTCOME.budget_spent, ended)
        if isinstance(self.solver, StickSlip | TaylorSlip):
            ended = unless_chattering(self.solver, after, ended)
        ended = outcome_of(solution.result, after.slope, ended)
        outcome = jnp.where(run.running, ended, run.outcome)
        return Run(after, where, steps, outcome)


def follow(motion: Motion) -> Run:
    """The motion to its end; within a sweep, one leg of it."""
    legs = current_legs()
    if legs is None:
        return motion.advance(motion.begin())
    run = motion.advance(legs.enter(motion.begin()), legs.quota)
    legs.leave(run, run.running, run.steps)
    return run


def machine(column: Column, solver: Any, fold: Any, rtol: Any, atol: Any) -> Any:
    """The observing solver and the controller that the friction law needs."""
    if isinstance(solver, Taylor):
        control = Reached(rtol, atol)  # pyright: ignore
        return TaylorSlip(solver, fold, rtol, atol), control
    control = StepControl(rtol, atol, layer_of(column, solver))  # pyright: ignore
    if isinstance(column.friction, SetValuedCoulomb):
        if solver.bend is None:
            raise ValueError(
                "Argument `solver` must have an interpolant of its own with set-valued "
                f"friction, which `Explicit()` (Tsit5) has, but is {solver.name}."
            )
        return StickSlip(solver, fold, atol), control
    return Observed(solver, fold), control


def unless_chattering(
    solver: StickSlip | TaylorSlip, state: Any, otherwise: Any
) -> jax.Array:
    """`chattering` where events follow each other without time between."""
    return jnp.where(solver.chatters(state), OUTCOME.chattering, otherwise)
