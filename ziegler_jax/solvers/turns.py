"""Turns of a loop: in each, every lane that still moves tries one step.

A loop over lanes whose ends and steps are each lane's own would be masked three times:
by the loop, by diffrax for steps that it rejects, and once more for its own copy of the
state. So diffrax is shown turns, which all lanes share: its time counts them, its
solver tries the lanes' steps and keeps what is accepted, and it ends when no lane
moves. A lane's state stands in one place, and is masked once.
"""

from typing import ClassVar, Generic, NamedTuple, cast

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np

from ..model.column import Column
from ..numerics.materialise import (
    any_lane,
    as_one_call,
    materialise,
    replaced,
    tree_where,
)
from ..numerics.numbers import Scalar, Traced, Traced4
from .control import ControlState, Signals, StepControl, Verdict
from .explicit import OKAY
from .fold import AbstractObserved, Where

MOVES, HALTED, VANISHED = 0.0, 1.0, 2.0


class Lane(NamedTuple, Generic[Where]):
    """Where a lane is."""

    solver: Where
    control: ControlState
    halt: Scalar  # `MOVES`; `HALTED`: paused or at its end; `VANISHED`: its step has


class Turns(AbstractObserved[Lane, AbstractObserved]):
    """One step of every lane that moves.

    **Arguments:** `solver`: tries a step; `control`: accepts it, chooses the next.
    """

    solver: AbstractObserved
    control: StepControl

    interpolation_cls: ClassVar = dfx.LocalLinearInterpolation

    def init(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, terms: dfx.AbstractTerm, t0: Traced, t1: Traced, y0: Traced4, args: Column
    ) -> Lane:
        """A motion is handed over where it is."""
        raise NotImplementedError("Argument `solver_state` must be given.")

    @as_one_call
    def try_step(self, terms, t0, t1, y0, args, solver_state, judge=None):
        """A turn; its error tells `UntilNoneMoves` whether a lane moves still."""
        del t0, t1, judge
        where, control, halt = solver_state
        at = cast(tuple[Traced, Traced], (control.t, control.t_next))
        order = self.error_order(terms)
        moves = halt == MOVES

        def verdict(y1, error, reached):
            return self.control.verdict(*at, where.y, y1, error, order, reached, moves)

        y1, errors, _, after, _ = self.solver.try_step(
            terms, *at, where.y, args, where, verdict
        )
        signals = cast(Signals, errors)
        _, _, _, _, following, result = self.control.adapt_step_size(
            *at, where.y, y1, args, signals, order, control
        )

        def masks():
            """As numbers: a vector of flags is unpacked wherever it is used."""
            ended = jnp.where(result == dfx.RESULTS.dt_min_reached, VANISHED, HALTED)
            ended = jnp.where(result == OKAY, MOVES, ended)
            return jnp.where(moves, 1.0, 0.0), replaced(moves, ended, halt)

        moves, halt = materialise(control.t, masks)
        accepts = cast(Verdict, signals.verdict).accepts
        # the fold's running numbers are those to go on with already
        same = where._replace(folded=after.folded)
        where = tree_where(accepts > 0, after, same)
        control = tree_where(moves > 0, following, control)
        moving = jnp.where(any_lane(halt == MOVES), 1.0, 0.0)
        return y0, moving, {"y0": y0, "y1": y0}, Lane(where, control, halt), OKAY


class UntilNoneMoves(dfx.AbstractStepSizeController):
    """Turn after turn, while a lane moves.

    diffrax would check the sign of a `dt0` by a host callback; a program that holds one
    is called slowly, and jaxlib 0.10 does not keep it in its compilation cache.
    """

    def wrap(self, direction):
        """Turns go forward."""
        del direction
        return self

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):  # pyright: ignore
        """The first turn."""
        del terms, t1, y0, dt0, args, func, error_order
        return t0 + 1, None

    def adapt_step_size(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, t0, t1, y0, y1, args, y_error: Traced, error_order, controller_state
    ):
        """The next turn, if one is needed: diffrax calls an end like this an event."""
        del t0, y0, y1, args, error_order
        over = dfx.RESULTS.event_occurred
        result = dfx.RESULTS.where(y_error > 0, dfx.RESULTS.successful, over)
        return True, t1, t1 + 1, False, controller_state, result


class AsManyTurns(dfx.ForwardMode):
    """Forward derivatives, and as many turns as it takes.

    To round steps to its own `t1` diffrax takes the hundredth number before that, one
    `nextafter` after the other: 1500 of a program's 8500 instructions, unless it is
    known when compiled (`loop` is diffrax 0.7's).
    """

    def loop(self, *, t1: jax.Array, **rest):
        """From 0 to no end."""
        return super().loop(t1=np.asarray(np.inf, t1.dtype), **rest)
