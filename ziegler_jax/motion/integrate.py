"""The one place where a motion is integrated: to its end, or to where its fold ends it.

Every question about a motion is a fold over its steps. A motion can be paused between
any two of them, as a sweep does.
"""

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar, cast

import diffrax as dfx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from ..model.state import PhasePoint
from ..model.system import System, field
from ..numerics.numbers import Count, Flag, Numbers, Scalar
from ..numerics.resumable import Phase, place_of, resumable
from ..results import CODE
from ..solvers import (
    AbstractFold,
    ControlState,
    Explicit,
    LaneLoop,
    Observed,
    StepControl,
    StickSlip,
    StickSlipState,
    Taylor,
    TaylorSlip,
    TaylorStepControl,
)
from ..solvers.fold import AbstractLaneSolver, ObservedState
from ..solvers.taylor import TaylorState
from .ending import outcome_of
from .method import layer_of
from .options import Method

FIRST_STEP = 0.01


Folded = TypeVar("Folded")  # a fold's running numbers
# where a solver is
Where = ObservedState[Folded] | StickSlipState[Folded] | TaylorState[Folded]


class Run(NamedTuple, Generic[Folded]):
    """Where a motion is: what a chunk of steps hands to the next."""

    solver: Where[Folded]
    control: ControlState
    steps: Int[Array, ""]
    outcome: Int[Array, ""]  # `not_computed` while it runs

    @property
    def y(self) -> PhasePoint:
        """The state."""
        return self.solver.y

    @property
    def folded(self) -> Folded:
        """The fold's running numbers."""
        return self.solver.folded

    @property
    def time(self) -> Scalar:
        """How far it has come."""
        return self.control.t

    @property
    def running(self) -> Bool[Array, ""]:
        """Whether the motion has no verdict yet."""
        return self.outcome == CODE.not_computed

    @property
    def phase(self) -> Int[Array, ""]:
        """That of a loop of one."""
        return place_of(self.running)

    def paused(self, flag: Flag, folded: Folded) -> "Run[Folded]":
        """The same motion with other running numbers, ended for now where asked."""
        outcome = jnp.where(flag & self.running, CODE.complete, self.outcome)
        solver = self.solver._replace(folded=folded)
        return self._replace(solver=solver, outcome=outcome.astype(jnp.int32))

    def resumed(self) -> "Run[Folded]":
        """The same motion on its way again."""
        return self._replace(outcome=jnp.zeros_like(self.outcome))


class Motion(Generic[Folded]):
    """A system, a fold over its steps that may end it, and the machine that this needs.

    **Arguments:**

    - `system`, `y0`: what runs, from where.
    - `fold`: says by its `outcome` whether it has ended the motion.
    - `method`: the method and its budget.
    - `end`: the time at which the motion ends with the outcome `at_end`, unless the
        fold ended it before.
    - `valid`: whether the numbers keep their rules; else the outcome is `invalid`.
    - `start`: the time at which it begins; `first_step`: about how long its first step
        is; `first_stop`: the first time on which a step must end.
    """

    def __init__(
        self,
        system: System,
        y0: PhasePoint,
        fold: AbstractFold[Folded],
        method: Method,
        *,
        end: Scalar,
        at_end: CODE = CODE.complete,
        valid: Flag = True,
        start: Scalar = 0.0,
        first_step: Scalar = FIRST_STEP,
        first_stop: Scalar = jnp.inf,
    ):
        """Choose the machine."""
        self.system, self.y0, self.fold, self.method = system, y0, fold, method
        self.end, self.at_end, self.valid = end, at_end, valid
        self.start, self.first_step, self.first_stop = start, first_step, first_stop
        self.solver, self.control = machine(system, fold, method, end)

    def begin(self) -> Run[Folded]:
        """The motion before its first step."""
        t0 = jnp.zeros((), jnp.result_type(self.y0[0])) + self.start
        invalid = jnp.where(self.valid, CODE.not_computed, CODE.invalid)
        return Run(
            solver=self.solver.begin(self.system, t0, self.y0),
            control=self.control.start(t0, self.first_step, self.first_stop),
            steps=jnp.zeros((), jnp.int32),
            outcome=invalid.astype(jnp.int32),
        )

    @property
    def phases(self) -> list[Phase[Run[Folded]]]:
        """One: it is advanced by steps."""
        return [Phase(self.advance)]

    def advance(self, run: Run[Folded], max_steps: Count | None = None) -> Run[Folded]:
        """The motion after at most `max_steps` more steps; None: at its end."""
        left = self.method.budget - run.steps
        left = left if max_steps is None else jnp.minimum(left, max_steps)
        left = left.astype(jnp.int32)
        # a motion that has ended does not move
        left = jnp.where(run.running & (run.control.t < self.end), left, 0)
        solution = dfx.diffeqsolve(
            dfx.ODETerm(cast(Callable[..., Numbers], field)),
            self.solver,
            t0=0.0,  # each lane has its own times, in its control's state
            t1=jnp.inf,
            dt0=FIRST_STEP,  # of Python's: a traced one is checked on the host
            y0=run.solver.y,
            args=self.system,
            stepsize_controller=self.control,
            solver_state=run.solver,
            controller_state=run.control._replace(left=left),
            saveat=dfx.SaveAt(solver_state=True, controller_state=True),
            max_steps=None,  # each lane counts its own
            throw=False,
            adjoint=LaneLoop(),
        )
        after = cast(Where[Folded], solution.solver_state)
        where = cast(ControlState, solution.controller_state)
        steps = run.steps + left - where.left
        ended = self.fold.outcome(after.folded)
        over = (ended == CODE.not_computed) & (where.t >= self.end)
        ended = jnp.where(over, self.at_end, ended)
        spent = (ended == CODE.not_computed) & (steps >= self.method.budget)
        ended = jnp.where(spent, CODE.budget_spent, ended)
        ended = jnp.where(self.solver.chatters(after), CODE.chattering, ended)
        vanished = solution.result == dfx.RESULTS.dt_min_reached
        ended = outcome_of(vanished, after.slope, ended)
        outcome = jnp.where(run.running, ended, run.outcome)
        return Run(after, where, steps, outcome)


def follow(motion: Motion[Folded]) -> Run[Folded]:
    """The motion to its end; a sweep follows it in chunks."""
    return resumable(motion.begin(), motion.phases, lambda run: (run.phase, run.steps))


def machine(
    system: System, fold: AbstractFold, method: Method, end: Scalar
) -> tuple[AbstractLaneSolver, StepControl]:
    """The observing solver and the controller that the friction law needs."""
    solver = method.solver
    rtol, atol = method.tolerances
    if isinstance(solver, Taylor):
        control = TaylorStepControl(rtol, atol, end=end)
        return TaylorSlip(solver, fold, rtol, atol), control
    control = StepControl(rtol, atol, layer_of(system, solver), end)
    if system.sticks:
        assert isinstance(solver, Explicit)  # `method_of` saw to it
        if solver.bend is None:
            raise ValueError(
                "Argument `solver` must have an interpolant of its own with set-valued "
                f"friction, which `Explicit()` (Tsit5) has, but is {solver.name}."
            )
        return StickSlip(solver, fold, atol), control
    assert solver is not None
    return Observed(solver, fold), control
