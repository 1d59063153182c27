"""A solver that watches its own steps and keeps running numbers in its state.

Nothing is stored but the running numbers, on a rejected step they are undone like the
rest of a solver's state, and the loop stays free of anything that a compiler could not
turn into one kernel.
"""

import abc
from collections.abc import Callable, Mapping
from typing import ClassVar, Generic, NamedTuple, Protocol, TypeVar, cast

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from ..model.column import Column
from ..numerics.materialise import tree_where
from ..numerics.numbers import Count, Flag, Numbers, Pair, Scalar, Traced, Traced4
from .control import Signals, Verdict
from .explicit import OKAY, Explicit, Integrand, dense
from .rosenbrock import Rosenbrock

State = TypeVar("State")  # of a fold: its running numbers
Where = TypeVar("Where")  # of a solve: where it is


class Step(NamedTuple):
    """One step: both ends, the derivatives there, and the integrals over it.

    `t0`, `t1`: its times; `y0`, `y1`: the states there, four scalars, both angles and
    both rates; `f0`, `f1`: their time derivatives; `integrals`: a tuple, in its order
    over the step what an observer's `integrand` gives. With set-valued friction
    `modes`: -1., 0. (sticks) or 1. for each joint, and `event`: the joint on which the
    step ended (0 none, 3 both) with the new modes; else both are empty.
    """

    t0: Traced
    t1: Traced
    y0: Traced4
    y1: Traced4
    f0: Traced4
    f1: Traced4
    integrals: tuple
    modes: Pair | tuple[()] = ()
    event: tuple[Count, Pair] | tuple[()] = ()


class Ending(Protocol):
    """Running numbers that say how the motion ended."""

    @property
    def outcome(self) -> Int[Array, ""]:
        """A `CODE`."""
        ...


class AbstractFold(eqx.Module, Generic[State]):
    """What is kept while a lane runs."""

    def integrand(self, column: Column) -> Integrand | None:
        """A function of y that returns a tuple to be integrated over steps, or None."""
        del column

    def advance(self, solver, terms, t0, t1, y0, column, first, state):
        """A step of the method from y0, where the right-hand side is `first`.

        **Returns:** as `Explicit.advance`; its integrals are those of the step that the
        fold, in this state, is shown.
        """
        del state
        return solver.advance(terms, t0, t1, y0, column, first, self.integrand(column))

    @abc.abstractmethod
    def init(self, column: Column, t0: Traced, y0: Traced4) -> State:
        """The running numbers at the start."""

    def with_slope(self, solver, terms, t0, y0, column) -> tuple[Traced4, State]:
        """The right-hand side at the start, and the running numbers there.

        A fold that works out both at once does so here.
        """
        return solver.init(terms, t0, t0, y0, column), self.init(column, t0, y0)

    @abc.abstractmethod
    def step(
        self, column: Column, state: State, step: Step
    ) -> tuple[State, Scalar, Flag]:
        """The running numbers after a step, the next time to stop on, and whether done.

        The step may have been rejected: then all three are forgotten.
        """

    def accepted(
        self, column: Column, state: State, step: Step, verdict: Verdict | None
    ) -> tuple[State, Scalar, Flag]:
        """The same with the running numbers as they were where a step is rejected.

        None: there is no verdict yet, and whoever gives it forgets them.
        """
        after, stop, done = self.step(column, state, step)
        if verdict is not None:
            after = tree_where(verdict.accepts > 0, after, state)
        return after, stop, done

    def outcome(self, state: State) -> Int[Array, ""]:
        """How the fold has ended the motion; `not_computed`, 0, while it has not."""
        return cast(Ending, state).outcome


class ObservedState(NamedTuple, Generic[State]):
    """Where an observed solve is."""

    y: Traced4
    accelerations: tuple[Traced, Traced]
    folded: State

    @property
    def slope(self) -> Traced4:
        """The right-hand side at y."""
        return (*self.y[2:], *self.accelerations)


class OneStep(Protocol):
    """What an observing solver asks of its method."""

    def order(self, terms: dfx.AbstractTerm) -> int:
        """The order of convergence."""
        ...

    def error_order(self, terms: dfx.AbstractTerm) -> int:
        """The power of h that the error estimate falls with."""
        ...

    def func(self, terms, t0, y0, args):
        """The right-hand side."""
        ...


Inner = TypeVar("Inner", bound=OneStep)
# what diffrax wants of a step: its end, its error or what stands for that, what lies
# between, where the solver is, and that all is well
Trial = tuple[Traced4, Signals | Scalar, Mapping[str, Numbers], Where, dfx.RESULTS]
# the verdict on a step: its end, its error, and where it was cut
Judge = Callable[[Traced4, Numbers, Scalar | None], Verdict]


class AbstractObserved(dfx.AbstractSolver[Where], Generic[Where, Inner]):
    """What a solver with a fold leaves to the method that it runs."""

    solver: eqx.AbstractVar[Inner]

    term_structure: ClassVar = dfx.AbstractTerm
    interpolation_cls: ClassVar = dfx.ThirdOrderHermitePolynomialInterpolation

    def order(self, terms):
        """The method's."""
        return self.solver.order(terms)

    def error_order(self, terms):
        """The method's."""
        return self.solver.error_order(terms)

    def func(self, terms, t0, y0, args):
        """The right-hand side."""
        return self.solver.func(terms, t0, y0, args)

    @abc.abstractmethod
    def try_step(
        self,
        terms: dfx.AbstractTerm,
        t0: Traced,
        t1: Traced,
        y0: Traced4,
        args: Column,
        solver_state: Where,
        judge: Judge | None = None,
    ) -> Trial[Where]:
        """A step, as diffrax asks for it.

        **Arguments:** `judge`: gives the verdict on it, which is then among the
        signals, and the fold's running numbers are those that the lane goes on with;
        None: that is left to diffrax.
        """

    def step(  # pyright: ignore[reportIncompatibleMethodOverride]
        self,
        terms: dfx.AbstractTerm,
        t0: Traced,
        t1: Traced,
        y0: Traced4,
        args: Column,
        solver_state: Where,
        made_jump: Flag,
    ):
        """A step under diffrax itself."""
        del made_jump
        return self.try_step(terms, t0, t1, y0, args, solver_state)

    def chatters(self, state: Where) -> Flag:
        """Whether the lane cannot go on, because events follow without time between."""
        del state
        return False  # there are none


class Observed(AbstractObserved[ObservedState, Explicit | Rosenbrock]):
    """A one-step method with a fold over its accepted steps.

    diffrax runs it with `StepControl`, which understands its `Signals`: read its
    `ObservedState` back with `SaveAt(solver_state=True)`. Under `vmap`, `LaneLoop` runs
    the same faster, from a given state to the controller's `end`.
    """

    solver: Explicit | Rosenbrock
    fold: AbstractFold

    def init(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, terms: dfx.AbstractTerm, t0: Traced, t1: Traced, y0: Traced4, args: Column
    ) -> ObservedState:
        """The solver's first stage and the fold's start."""
        del t1
        first, folded = self.fold.with_slope(self.solver, terms, t0, y0, args)
        return ObservedState(y0, first[2:], folded)

    def try_step(self, terms, t0, t1, y0, args, solver_state, judge=None):
        """One step, seen by the fold."""
        f0, folded = solver_state.slope, solver_state.folded
        y1, error, f1, integrals, *_ = self.fold.advance(
            self.solver, terms, t0, t1, y0, args, f0, folded
        )
        step = Step(t0, t1, y0, y1, f0, f1, integrals)
        verdict = None if judge is None else judge(y1, error, None)
        folded, stop, done = self.fold.accepted(args, folded, step, verdict)
        done = jnp.asarray(done, jnp.result_type(t1))
        signals = Signals(error, stop, done, verdict=verdict)
        after = ObservedState(y1, f1[2:], folded)
        return y1, signals, dense(t0, t1, y0, y1, f0, f1), after, OKAY
