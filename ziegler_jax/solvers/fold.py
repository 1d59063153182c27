"""A solver that watches its own steps and keeps running numbers in its state.

Nothing is stored but the running numbers, on a rejected step they are undone like the
rest of a solver's state, and the loop stays free of anything that a compiler could not
turn into one kernel.
"""

import abc
from collections.abc import Callable
from typing import ClassVar, Generic, NamedTuple, Protocol, TypeVar, cast

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from ..model.state import PhasePoint
from ..model.system import System, field
from ..numerics.materialise import tree_where
from ..numerics.numbers import Count, Flag, Numbers, Scalar
from .along import Moved, StateSeries
from .control import NOT_HERE, Signals, Verdict
from .expansion import Expansion, allowed, expand
from .explicit import Explicit, Integrand
from .rosenbrock import Rosenbrock

State = TypeVar("State")  # of a fold: its running numbers
Where = TypeVar("Where")  # of a solve: where it is


class Step(NamedTuple):
    """One step: both ends, the derivatives there, and the integrals over it.

    `t0`, `t1`: its times; `y0`, `y1`: the states there, scalars, the rods' angles and
    their rates, `y0.phi` and `y0.omega`; `f0`, `f1`: their time derivatives;
    `integrals`: a tuple, in its order over the step what an observer's `integrand`
    gives. With set-valued friction
    `modes`: -1., 0. (sticks) or 1. for each joint, and `event`: the joint on which the
    step ended (0 none, 1, 2, 4, ... for joint 1, 2, 3, ..., of several their sum) with
    the new modes; else both are empty.
    `series`: of a step of Taylor's the coefficients of the states' numbers in time from
    its start; `moved`: the differences that a fold carries on such steps, before that
    event. Of other steps both are empty.
    """

    t0: Scalar
    t1: Scalar
    y0: PhasePoint
    y1: PhasePoint
    f0: PhasePoint
    f1: PhasePoint
    integrals: tuple
    modes: Numbers = ()
    event: tuple[Count, Numbers] | tuple[()] = ()
    series: StateSeries = ()
    moved: tuple[Moved, ...] = ()


class Ending(Protocol):
    """Running numbers that say how the motion ended."""

    @property
    def outcome(self) -> Int[Array, ""]:
        """A `CODE`."""
        ...


class AbstractFold(eqx.Module, Generic[State]):
    """What is kept while a lane runs.

    `needs_slope`: whether the last right-hand side is asked for, which Taylor's steps
    do not leave behind.
    """

    needs_slope: ClassVar[bool] = False

    def integrand(self, system: System) -> Integrand | None:
        """Of t and y a tuple of what is to be integrated over steps, or None."""
        del system

    def advance(self, solver, t0, t1, y0, system, first, state):
        """A step of the method from y0, where the right-hand side is `first`.

        **Returns:** as `Explicit.advance`; its integrals are those of the step that the
        fold, in this state, is shown.
        """
        del state
        step = system.right_hand_side, t0, t1, y0, first, self.integrand(system)
        if isinstance(solver, Rosenbrock):
            return solver.advance(*step, autonomous=system.autonomous)
        return solver.advance(*step)

    def expand(
        self, system: System, y0: PhasePoint, order: int, token: Scalar, state: State
    ) -> tuple[Expansion, list[StateSeries]]:
        """The series of a step of Taylor's, and of the differences that go along."""
        del state
        return expand(system, y0, order, token), []

    def allowed(
        self, motion: Expansion, along: list[StateSeries], rtol: Scalar, atol: Scalar
    ) -> Scalar:
        """How long that step may be."""
        del along
        return allowed(motion.y, rtol, atol)

    @abc.abstractmethod
    def init(self, system: System, t0: Scalar, y0: PhasePoint) -> State:
        """The running numbers at the start."""

    def with_slope(
        self, t0: Scalar, y0: PhasePoint, system: System
    ) -> tuple[PhasePoint, State]:
        """The right-hand side at the start, and the running numbers there.

        A fold that works out both at once does so here.
        """
        return field(t0, y0, system), self.init(system, t0, y0)

    @abc.abstractmethod
    def step(
        self, system: System, state: State, step: Step
    ) -> tuple[State, Scalar, Flag]:
        """The running numbers after a step, the next time to stop on, and whether done.

        The step may have been rejected: then all three are forgotten.
        """

    def accepted(
        self, system: System, state: State, step: Step, verdict: Verdict
    ) -> tuple[State, Scalar, Flag]:
        """The same with the running numbers as they were where a step is rejected."""
        after, stop, done = self.step(system, state, step)
        return tree_where(verdict.accepts > 0, after, state), stop, done

    def outcome(self, state: State) -> Int[Array, ""]:
        """How the fold has ended the motion; `not_computed`, 0, while it has not."""
        return cast(Ending, state).outcome


class ObservedState(NamedTuple, Generic[State]):
    """Where an observed solve is."""

    y: PhasePoint
    accelerations: Numbers
    folded: State

    @property
    def slope(self) -> PhasePoint:
        """The right-hand side at y."""
        return PhasePoint.of(self.y.omega, self.accelerations)


# the verdict on a step: its end, its error, and where it was cut
Judge = Callable[[PhasePoint, Numbers, Scalar | None], Verdict]


class AbstractLaneSolver(dfx.AbstractSolver[Where], Generic[Where]):
    """A solver of one lane with a fold over its accepted steps, run by `LaneLoop`.

    `diffeqsolve` is given a state of its own to go on from, and asks for no more than
    the order of the error. Read the state back with `SaveAt(solver_state=True)`.
    """

    term_structure: ClassVar = dfx.AbstractTerm
    interpolation_cls: ClassVar = dfx.LocalLinearInterpolation

    @abc.abstractmethod
    def begin(self, system: System, t0: Scalar, y0: PhasePoint) -> Where:
        """Where a lane is before its first step."""

    @abc.abstractmethod
    def attempt(
        self, system: System, t0: Scalar, t1: Scalar, where: Where, judge: Judge
    ) -> tuple[Where, Signals]:
        """A step on which `judge` gives the verdict, seen by the fold.

        The fold's running numbers are those to go on with, whatever the verdict.
        """

    @property
    @abc.abstractmethod
    def degree(self) -> int:
        """The power of the step that its error estimate falls with."""

    def order(self, terms):
        """The same: all that diffrax asks for."""
        del terms
        return self.degree

    def chatters(self, state: Where) -> Flag:
        """Whether the lane cannot go on, because events follow without time between."""
        del state
        return False  # there are none

    # ---- what diffrax does not ask for where `LaneLoop` runs

    def init(self, terms, t0, t1, y0, args):
        """See `begin`."""
        raise NotImplementedError(NOT_HERE)

    def func(self, terms, t0, y0, args):
        """See `begin`."""
        raise NotImplementedError(NOT_HERE)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """See `attempt`."""
        raise NotImplementedError(NOT_HERE)


class Observed(AbstractLaneSolver[ObservedState]):
    """A one-step method with a fold over its accepted steps."""

    solver: Explicit | Rosenbrock
    fold: AbstractFold

    @property
    def degree(self) -> int:
        """The method's order."""
        return self.solver.order

    def begin(self, system, t0, y0):
        """The method's first stage and the fold's start."""
        first, folded = self.fold.with_slope(t0, y0, system)
        return ObservedState(y0, first.omega, folded)

    def attempt(self, system, t0, t1, where, judge):
        """One step of the method."""
        y0, f0 = where.y, where.slope
        y1, error, f1, integrals, *_ = self.fold.advance(
            self.solver, t0, t1, y0, system, f0, where.folded
        )
        step, verdict = Step(t0, t1, y0, y1, f0, f1, integrals), judge(y1, error, None)
        folded, stop, done = self.fold.accepted(system, where.folded, step, verdict)
        done = jnp.asarray(done, jnp.result_type(t1))
        return ObservedState(y1, f1.omega, folded), Signals(verdict, stop, done)
