"""The loop over lanes: in each turn, every lane that still moves tries one step.

diffrax's own loop knows one time and one end. Under `vmap` it would mask what its lanes
carry three times: for its end, for the steps that it rejects, and once more for its own
copy of the state. Here a lane's state stands in one place and is masked once, and what
the loop does not need (saving, events, dense output) is not compiled.
"""

from typing import Generic, NamedTuple, cast

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ..numerics.materialise import any_lane, materialise, replaced, tree_where
from ..numerics.numbers import Scalar, Traced
from .control import ControlState, Signals, StepControl, Verdict
from .explicit import OKAY
from .fold import AbstractObserved, Where

MOVES, HALTED, VANISHED = 0.0, 1.0, 2.0


class Lane(NamedTuple, Generic[Where]):
    """Where a lane is."""

    solver: Where
    control: ControlState
    halt: Scalar  # `MOVES`; `HALTED`: paused or at its end; `VANISHED`: its step has


class LaneLoop(dfx.AbstractAdjoint):
    """In place of diffrax's loop, for an observing solver and `StepControl`.

    `diffeqsolve` must be given `solver_state` and `controller_state`: a motion is
    handed over where it is, with its time, its end and the steps that it has left (0
    for one that does not move). Both stand in the solution if `saveat` asks for them,
    and its result is `dt_min_reached` where a step has vanished. `t0`, `t1` and `dt0`
    say nothing. Derivatives are forward ones.

    **Raises:** `ValueError` if it is asked for more: states saved on the way, an event,
    a number of steps that all lanes share.
    """

    def loop(self, *, solver, stepsize_controller, terms, args, init_state, **asked):
        """Turn after turn, while a lane moves."""
        _check_asked(asked)
        state, control = init_state.solver_state, init_state.controller_state
        moves = control.left > 0
        halt = jnp.where(moves, MOVES, HALTED).astype(jnp.result_type(control.t))
        first = jax.tree.map(jnp.asarray, Lane(state, control, halt))

        def move(lane: Lane):
            return any_lane(lane.halt == MOVES)

        def turn(lane: Lane):
            return turned(solver, stepsize_controller, terms, args, lane)

        last = lax.while_loop(move, turn, first)
        result = dfx.RESULTS.where(
            last.halt == VANISHED, dfx.RESULTS.dt_min_reached, OKAY
        )
        final = eqx.tree_at(
            lambda s: (s.solver_state, s.controller_state, s.result),
            init_state,
            (last.solver, last.control, result),
        )
        return final, {}


def _check_asked(asked: dict) -> None:
    """Refuse what the loop would not do, of `diffeqsolve`'s arguments."""
    if not (asked["passed_solver_state"] and asked["passed_controller_state"]):
        raise ValueError(
            "Arguments `solver_state` and `controller_state` must be given with "
            "`LaneLoop`, but one is None."
        )
    saveat, event, max_steps = asked["saveat"], asked["event"], asked["max_steps"]
    if saveat.subs is not None or saveat.dense:
        raise ValueError(
            "Argument `saveat` must ask for `solver_state` and `controller_state` "
            f"alone with `LaneLoop`, but is {saveat}."
        )
    if event is not None or max_steps is not None:
        raise ValueError(
            "Arguments `event` and `max_steps` must be None with `LaneLoop`, but "
            f"are {event} and {max_steps}."
        )


def turned(
    solver: AbstractObserved,
    stepsize_controller: StepControl,
    terms: dfx.AbstractTerm,
    args,
    lane: Lane,
) -> Lane:
    """The lane after one more step, if it moves."""
    where, control, halt = lane
    at = cast(tuple[Traced, Traced], (control.t, control.t_next))
    order = solver.error_order(terms)
    moves = halt == MOVES

    def verdict(y1, error, reached):
        return stepsize_controller.verdict(
            *at, where.y, y1, error, order, reached, moves
        )

    y1, errors, _, after, _ = solver.try_step(terms, *at, where.y, args, where, verdict)
    signals = cast(Signals, errors)
    _, _, _, _, following, result = stepsize_controller.adapt_step_size(
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
    return Lane(where, control, halt)
