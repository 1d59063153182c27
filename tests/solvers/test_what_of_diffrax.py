"""What of diffrax the lanes rely on, in words; a newer diffrax has to keep it.

`diffeqsolve` is called once, in `motion/integrate.py`. It hands the whole loop to its
`adjoint`, with the states that it was given as they were, and gives back what that
returns. Of a solver and a controller whose states are given it asks the order and
`wrap`, and nothing else: neither a first step nor the right-hand side's value.
"""

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp

import ziegler_jax as zj
from ziegler_jax.model.state import PhasePoint
from ziegler_jax.model.system import field
from ziegler_jax.solvers import AbstractFold, Observed, StepControl

SYSTEM = zj.uniform_rods(2.0).system()
START = PhasePoint(map(jnp.asarray, (0.1, 0.2, 0.0, 0.0)))
STATES = dfx.SaveAt(solver_state=True, controller_state=True)
ASKED = []  # by diffrax, of solver and controller


class Nothing(AbstractFold):
    """Watches nothing."""

    def init(self, system, t0, y0):
        return 0.0 * y0[0]

    def step(self, system, state, step):
        return state, jnp.inf, False


class Solver(Observed):
    """One that says what it is asked for."""

    def order(self, terms):
        ASKED.append("order")
        return super().order(terms)


class Control(StepControl):
    """One that says so, too."""

    def wrap(self, direction):
        ASKED.append("wrap")
        return super().wrap(direction)


class Handed(dfx.AbstractAdjoint):
    """In place of a loop: what it is handed, and one number changed."""

    def loop(self, *, init_state, **handed):
        ASKED.append({"init_state": init_state, **handed})
        moved = init_state.controller_state._replace(t=jnp.asarray(3.0))
        vanished = dfx.RESULTS.dt_min_reached
        after = eqx.tree_at(
            lambda s: (s.controller_state, s.result), init_state, (moved, vanished)
        )
        return after, {}


def test_the_adjoint_is_handed_the_loop_and_the_states_as_they_were_given():
    ASKED.clear()
    solver, control = Solver(zj.Explicit(), Nothing()), Control(1e-6, 1e-6)
    where, steps = solver.begin(SYSTEM, 0.0, START), control.start(0.0, 0.1, 9.0)
    solution = dfx.diffeqsolve(
        dfx.ODETerm(field), solver, 0.0, jnp.inf, 0.01, START, SYSTEM,
        stepsize_controller=control, solver_state=where, controller_state=steps,
        saveat=STATES, max_steps=None, throw=False, adjoint=Handed(),
    )  # fmt: skip
    *asked, handed = ASKED
    assert set(asked) == {"wrap", "order"}
    begin = handed["init_state"]
    assert jax.tree.structure(begin.solver_state) == jax.tree.structure(where)
    assert type(handed["solver"]) is Solver
    assert type(handed["stepsize_controller"]) is Control
    assert jax.tree.structure(handed["args"]) == jax.tree.structure(SYSTEM)
    assert handed["max_steps"] is None and handed["saveat"].subs is None
    # and gives back what that made of it
    assert float(solution.controller_state.t) == 3.0
    assert float(solution.controller_state.stop) == 9.0
    assert float(solution.solver_state.y[1]) == 0.2
    assert solution.result == dfx.RESULTS.dt_min_reached
