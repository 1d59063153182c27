"""A solver that watches its own steps and keeps running numbers in its state.

Nothing is stored but the running numbers, diffrax undoes them on a rejected step like
the rest of a solver's state, and the loop stays free of anything that a compiler could
not turn into one kernel.
"""

import abc
from typing import Any, ClassVar, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp

from ..numerics.numbers import Scalar, Vector4
from .control import Signals
from .explicit import OKAY, Explicit, dense
from .rosenbrock import Rosenbrock


class Step(NamedTuple):
    """One step: both ends, the derivatives there, and the integrals over it."""

    t0: Scalar
    t1: Scalar
    y0: Vector4
    y1: Vector4
    f0: Vector4
    f1: Vector4
    integrals: tuple
    modes: Any = ()  # with set-valued friction: -1., 0. or 1. for each joint
    event: Any = ()  # and on which joint it ended (0 none, 3 both), and the new modes


class AbstractFold(eqx.Module):
    """What is kept while a lane runs."""

    def integrand(self, column: Any) -> Any:
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
    def init(self, column: Any, t0: Scalar, y0: Vector4) -> Any:
        """The running numbers at the start."""

    @abc.abstractmethod
    def step(self, column: Any, state: Any, step: Step) -> tuple[Any, Any, Any]:
        """The running numbers after a step, the next time to stop on, and whether done.

        The step may still be rejected: then all three are forgotten.
        """

    def outcome(self, state: Any) -> Any:
        """How the fold has ended the motion; `not_computed`, 0, while it has not."""
        return state.outcome


class ObservedState(NamedTuple):
    """Where an observed solve is."""

    y: Vector4
    slope: Vector4  # the right-hand side at y
    folded: Any


class AbstractObserved(dfx.AbstractSolver):
    """What a solver with a fold leaves to the method that it runs."""

    solver: eqx.AbstractVar[Any]

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

    def chatters(self, state: Any) -> Any:
        """Whether the lane cannot go on, because events follow without time between."""
        del state
        return False  # there are none


class Observed(AbstractObserved):
    """A one-step method with a fold over its accepted steps.

    Read its `ObservedState` back with `SaveAt(solver_state=True)`. That holds y too:
    `SaveAt(t1=True)` saves by a scatter, which XLA runs lane by lane on a CPU. Needs
    `StepControl`, which understands its `Signals`.
    """

    solver: Explicit | Rosenbrock
    fold: AbstractFold

    def init(self, terms, t0, t1, y0, args):
        """The solver's first stage and the fold's start."""
        first = self.solver.init(terms, t0, t1, y0, args)
        return ObservedState(y0, first, self.fold.init(args, t0, y0))

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """One step, seen by the fold."""
        del made_jump
        _, f0, folded = solver_state
        y1, error, f1, integrals, *_ = self.fold.advance(
            self.solver, terms, t0, t1, y0, args, f0, folded
        )
        seen = Step(t0, t1, y0, y1, f0, f1, integrals)
        folded, stop, done = self.fold.step(args, folded, seen)
        done = jnp.asarray(done, jnp.result_type(t1))
        signals = Signals(error, stop, done)
        after = ObservedState(y1, f1, folded)
        return y1, signals, dense(t0, t1, y0, y1, f0, f1), after, OKAY
