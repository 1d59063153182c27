"""The loop over lanes: in each turn, every lane that still moves tries one step.

diffrax's own loop knows one time and one end. Under `vmap` it would mask what its lanes
carry three times: for its end, for the steps that it rejects, and once more for its own
copy of the state. Here a lane's state stands in one place and is masked once, and what
the loop does not need (saving, events, dense output) is not compiled.
"""

from typing import Generic, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ..model.system import System
from ..numerics.materialise import any_lane, materialise, replaced, tree_where
from ..numerics.numbers import Scalar
from .control import HALTED, MOVES, VANISHED, ControlState, StepControl
from .fold import AbstractLaneSolver, Where


class Lane(NamedTuple, Generic[Where]):
    """Where a lane is."""

    solver: Where
    control: ControlState
    halt: Scalar  # `MOVES`; `HALTED`: paused or at its end; `VANISHED`: its step has


class LaneLoop(dfx.AbstractAdjoint):
    """In place of diffrax's loop, for a lane solver and `StepControl`.

    `diffeqsolve` must be given `solver_state` and `controller_state`: a motion is
    handed over where it is, with its time, its end and the steps that it has left (0
    for one that does not move). Both stand in the solution if `saveat` asks for them,
    and its result is `dt_min_reached` where a step has vanished. `t0`, `t1` and `dt0`
    say nothing. Derivatives are forward ones.

    **Raises:** `ValueError` if it is asked for more: states saved on the way, a number
    of steps that all lanes share; `NotImplementedError` for an event, and where one of
    the two states is left out.
    """

    def loop(self, *, solver, stepsize_controller, args, init_state, **asked):
        """Turn after turn, while a lane moves."""
        _check_asked(asked)
        state, control = init_state.solver_state, init_state.controller_state
        moves = control.left > 0
        halt = jnp.where(moves, MOVES, HALTED).astype(jnp.result_type(control.t))
        first = jax.tree.map(jnp.asarray, Lane(state, control, halt))

        def move(lane: Lane):
            return any_lane(lane.halt == MOVES)

        def turn(lane: Lane):
            return turned(solver, stepsize_controller, args, lane)

        last = lax.while_loop(move, turn, first)
        result = dfx.RESULTS.where(
            last.halt == VANISHED, dfx.RESULTS.dt_min_reached, dfx.RESULTS.successful
        )
        final = eqx.tree_at(
            lambda s: (s.solver_state, s.controller_state, s.result),
            init_state,
            (last.solver, last.control, result),
        )
        return final, {}


def _check_asked(asked: dict) -> None:
    """Refuse what the loop would not do, of `diffeqsolve`'s arguments."""
    saveat, max_steps = asked["saveat"], asked["max_steps"]
    if saveat.subs is not None or saveat.dense:
        raise ValueError(
            "Argument `saveat` must ask for `solver_state` and `controller_state` "
            f"alone with `LaneLoop`, but is {saveat}."
        )
    if max_steps is not None:
        raise ValueError(
            f"Argument `max_steps` must be None with `LaneLoop`, but is {max_steps}."
        )


def turned(
    solver: AbstractLaneSolver, control: StepControl, system: System, lane: Lane
) -> Lane:
    """The lane after one more step, if it moves."""
    where, state, halt = lane
    ends, moves = (state.t, state.t_next), halt == MOVES

    def judge(y1, error, reached):
        return control.verdict(*ends, where.y, y1, error, solver.degree, reached, moves)

    after, signals = solver.attempt(system, *ends, where, judge)
    following, ended = control.after(*ends, signals, state)

    def masks():
        """As numbers: a vector of flags is unpacked wherever it is used."""
        return jnp.where(moves, 1.0, 0.0), replaced(moves, ended, halt)

    moves, halt = materialise(state.t, masks)
    # the fold's running numbers are those to go on with already
    same = where._replace(folded=after.folded)
    where = tree_where(signals.verdict.accepts > 0, after, same)
    return Lane(where, tree_where(moves > 0, following, state), halt)
