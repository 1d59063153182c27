"""Explicit methods converge with their order; the controller ends what cannot go on."""

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax.model.state import PhasePoint
from ziegler_jax.model.system import field
from ziegler_jax.solvers import AbstractFold, LaneLoop, Observed, Signals, StepControl
from ziegler_jax.solvers.control import HALTED, MOVES, NO_LIMIT, VANISHED, Verdict

SPAN = 4.0
START = PhasePoint((0.3, -0.4, 0.5, 0.8))
COLUMN = zj.uniform_rods(2.6, damping=zj.Viscous(0.05, 0.02))
TERMS = dfx.ODETerm(zj.vector_field)
SYSTEM, OF_SYSTEM = COLUMN.system(), dfx.ODETerm(field)
METHODS = {"Tsit5": dfx.Tsit5, "Dopri8": dfx.Dopri8}


def powers(t, y):
    parts = zj.power(COLUMN, y)
    return parts.follower, parts.damping


def fixed_steps(solver):
    """Motions over SPAN in n equal steps, and the two works; one program for all n."""

    def solve(n, start):
        def body(i, carry):
            y, slope, works = carry
            t0 = i * h
            y, _, slope, more, *_ = solver.advance(
                SYSTEM.field, t0, t0 + h, y, slope, powers
            )
            return y, slope, tuple(w + d for w, d in zip(works, more, strict=True))

        h = SPAN / n.astype(float)
        y = PhasePoint(start)
        first = zj.vector_field(0.0, y, COLUMN)
        y, _, works = jax.lax.fori_loop(0, n, body, (y, first, (0.0 * h, 0.0 * h)))
        return jnp.stack(y), jnp.stack(works)

    return jax.jit(jax.vmap(solve, in_axes=(None, 0)))


# An error may pass through zero at some step size: over many starts it does not.
STARTS = np.random.default_rng(5).uniform(-0.4, 0.4, (64, 4))


@pytest.fixture(scope="module")
def solves():
    return {
        name: fixed_steps(zj.Explicit(method.tableau))
        for name, method in METHODS.items()
    }


@pytest.fixture(scope="module")
def fine(solves):
    """The end and the works to about 1e-14."""
    return solves["Dopri8"](np.int64(800), STARTS)


def geometric_mean(errors):
    """Over the starts, of each one's largest: no single start rules it."""
    return np.exp(np.log(np.abs(errors).max(-1)).mean())


def slope_of(errors, counts):
    return -np.polyfit(np.log(counts), np.log(errors), 1)[0]


CASES = [
    # step counts where the leading term rules and rounding does not yet
    ("Tsit5", 5, [80, 113, 160, 226, 320]),
    ("Dopri8", 8, [32, 34, 36, 38, 40, 43, 46]),
]


@pytest.mark.parametrize("name, order, counts", CASES)
def test_the_state_converges_with_the_order(solves, fine, name, order, counts):
    ends = [solves[name](np.int64(n), STARTS)[0] for n in counts]
    errors = [geometric_mean(end - fine[0]) for end in ends]
    # measured 4.85 and 8.09
    assert order - 0.4 < slope_of(errors, counts) < order + 0.7


@pytest.mark.parametrize("name, order, counts", CASES)
def test_the_integrals_converge_with_the_order(solves, fine, name, order, counts):
    works = [solves[name](np.int64(n), STARTS)[1] for n in counts]
    errors = [geometric_mean(work - fine[1]) for work in works]
    # measured 5.34 and 8.46
    assert order - 0.4 < slope_of(errors, counts) < order + 0.7


def test_the_works_balance_the_energy(fine):
    """The reference itself: the works are those of the energy's change."""
    y, works = fine
    energy = jax.vmap(lambda y: zj.energy(COLUMN, tuple(y)))
    change = energy(y) - energy(STARTS)
    # measured 3.9e-15
    assert np.abs(change - (works[:, 0] - works[:, 1])).max() < 4e-14


@pytest.mark.parametrize(
    "method, order",
    [(dfx.Tsit5, None), (dfx.Dopri8, None), (dfx.Dopri5, 5), (dfx.Bosh3, 3)],
    ids=lambda x: getattr(x, "__name__", ""),
)
def test_one_step_is_diffraxs_own(method, order):
    y0 = PhasePoint(map(jnp.asarray, START))
    ours, theirs = zj.Explicit(method.tableau, order), method()
    assert ours.order == theirs.order(TERMS)
    t0, t1 = jnp.asarray(0.0), jnp.asarray(0.1)

    @jax.jit
    def step(solver_state):
        return theirs.step(TERMS, t0, t1, y0, COLUMN, solver_state, False)

    y_their, error_their, *_ = step(theirs.init(TERMS, t0, t1, y0, COLUMN))
    first = zj.vector_field(t0, y0, COLUMN)
    y_our, error_our, last, *_ = ours.advance(SYSTEM.field, t0, t1, y0, first)
    # angles and rates are of order 1
    np.testing.assert_allclose(y_our, y_their, rtol=0, atol=2e-15)
    np.testing.assert_allclose(error_our, error_their, rtol=0, atol=2e-15)
    # what the next step starts from is the slope at the end
    np.testing.assert_allclose(
        last, zj.vector_field(t1, y_our, COLUMN), rtol=0, atol=2e-15
    )


def test_an_implicit_tableau_is_refused(refuses):
    tableau = dfx.Kvaerno5.tableau
    refuses(lambda: zj.Explicit(tableau), "`tableau`", "explicit", "implicit")


def test_an_unknown_order_is_refused(refuses):
    refuses(lambda: zj.Explicit(dfx.Bosh3.tableau), "`order`", "given")


# The controller -----------------------------------------------------------------------


@pytest.mark.parametrize("order", [5, 8])
def test_the_next_step_follows_the_stated_rule(order):
    control = StepControl(1e-3, 1e-4)
    y0, y1 = (0.3, -2.0, 0.1, 0.0), (-0.5, 1.0, 0.2, 0.0)
    scales = 1e-4 + 1e-3 * np.array([0.5, 2.0, 0.2, 0.0])
    state = control.start(1.0, 0.1, np.inf)
    for size in [1e-9, 0.01, 0.5, 0.89, 1.01, 3.0, 1e6, np.nan]:
        error = tuple(jnp.asarray(size * s) for s in scales)  # E = size
        ends, states = (jnp.asarray(1.0), jnp.asarray(1.1)), (y0, y1)
        states = [PhasePoint(map(jnp.asarray, y)) for y in states]
        verdict = control.verdict(*ends, *states, error, order)
        signals = Signals(verdict, jnp.inf, 0.0)
        after, halt = control.after(*ends, signals, state)
        factor = np.clip(0.8 * size ** (-1 / order), 0.2, 10)
        factor = 0.2 if np.isnan(size) else factor
        assert bool(verdict.accepts) == (size <= 1) and halt == MOVES
        assert float(after.t) == (1.1 if size <= 1 else 1.0)
        # measured 4e-6: the factor has five digits
        np.testing.assert_allclose(after.t_next - after.t, 0.1 * factor, rtol=1e-5)


class Own(eqx.Module):
    """A right-hand side of one's own in a system's place."""

    function: object = eqx.field(static=True)

    def field(self, t, y):
        return self.function(t, y)

    right_hand_side = field


class Nothing(AbstractFold):
    """Watches nothing and never ends a motion."""

    def init(self, system, t0, y0):
        return 0.0 * y0[0]

    def step(self, system, state, step):
        return state, jnp.inf, False


def end_of(function, y0):
    """Why a lane of four scalars ends before t = 10, and after how many steps."""
    solver, control = (
        Observed(zj.Explicit(), Nothing()),
        StepControl(1e-6, 1e-6, end=10),
    )
    zero, system = jnp.asarray(0.0), Own(function)
    y0 = PhasePoint(map(jnp.asarray, y0))
    solution = dfx.diffeqsolve(
        OF_SYSTEM, solver, 0.0, jnp.inf, 0.01, y0, system, stepsize_controller=control,
        solver_state=solver.begin(system, zero, y0),
        controller_state=control.start(zero, 0.01, jnp.inf),
        saveat=dfx.SaveAt(solver_state=True, controller_state=True),
        max_steps=None, throw=False, adjoint=LaneLoop(),
    )  # fmt: skip
    return solution.result, NO_LIMIT - int(solution.controller_state.left)


def test_a_nan_ends_the_lane():
    def decay(t, y):
        return PhasePoint.of(y.omega, [jnp.where(t > 1, jnp.nan, -x) for x in y.omega])

    result, steps = end_of(decay, START)
    assert result == dfx.RESULTS.dt_min_reached
    # measured 89: it halves its way to t = 1 until nothing is left
    assert steps < 300


def test_a_vanishing_step_ends_the_lane():
    """w' = w^2 ends at t = 1 / w(0) in no finite state."""

    def blow_up(t, y):
        return PhasePoint.of(y.omega, [x * x for x in y.omega])

    result, steps = end_of(blow_up, (0.2, 0.1, 1.0, 0.5))
    assert result == dfx.RESULTS.dt_min_reached
    # measured 278
    assert steps < 800


class Stops(AbstractFold):
    """Asks for a stop every pi/10 and counts hits, passes and steps."""

    def init(self, system, t0, y0):
        zero = 0.0 * y0[0]
        return zero + np.pi / 10, zero, zero, zero

    def step(self, system, state, step):
        stop, hits, passed, steps = state
        hit = step.t1 == stop
        after = (
            jnp.where(hit, stop + np.pi / 10, stop),
            hits + jnp.where(hit, 1.0, 0.0),
            passed + jnp.where(step.t1 > stop, 1.0, 0.0),
            steps + 1.0,
        )
        return after, after[0], after[1] >= 20.0


class UnderDiffrax(Observed):
    """A lane solver as diffrax's own loop can run it, beside `ControlUnderDiffrax`."""

    control: StepControl = StepControl(1e-6, 1e-6)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        def judge(y1, error, reached):
            return self.control.verdict(t0, t1, y0, y1, error, self.degree, reached)

        after, signals = self.attempt(args, t0, t1, solver_state, judge)
        between = {"y0": y0, "y1": after.y}
        return after.y, signals, between, after, dfx.RESULTS.successful


class ControlUnderDiffrax(StepControl):
    """A lane's controller under that loop, which hands it signals for an error."""

    def adapt_step_size(self, t0, t1, y0, y1_candidate, args, y_error, *more):
        _, state = more
        signals = Signals(Verdict(*y_error[0]), *y_error[1:])
        after, halt = self.after(t0, t1, signals, state)
        results = dfx.RESULTS
        result = results.where(
            halt == HALTED, results.event_occurred, results.successful
        )
        result = results.where(halt == VANISHED, results.dt_min_reached, result)
        keep = signals.verdict.accepts > 0
        return keep, after.t, after.t_next, False, after, result


def test_steps_end_on_the_asked_times_and_the_lane_ends_when_done():
    """Under diffrax's own loop, which counts what is accepted."""
    control = ControlUnderDiffrax(1e-6, 1e-6)
    watching = UnderDiffrax(zj.Explicit(), Stops())
    y0 = PhasePoint(map(jnp.asarray, START))
    zero = jnp.asarray(0.0)
    solution = dfx.diffeqsolve(
        OF_SYSTEM, watching, zero, jnp.asarray(100.0), jnp.asarray(0.01), y0, SYSTEM,
        stepsize_controller=control,
        solver_state=watching.begin(SYSTEM, zero, y0),
        controller_state=control.start(zero, 0.01, np.pi / 10),
        saveat=dfx.SaveAt(solver_state=True, controller_state=True),
        max_steps=None, throw=False, adjoint=dfx.ForwardMode(),
    )  # fmt: skip
    _, hits, passed, steps = solution.solver_state.folded
    assert solution.result == dfx.RESULTS.event_occurred
    assert (float(hits), float(passed)) == (20, 0)
    # 20 additions round
    np.testing.assert_allclose(solution.controller_state.t, 2 * np.pi, rtol=1e-14)
    # the fold saw the accepted steps alone, and there were rejected ones
    assert float(steps) == int(solution.stats["num_accepted_steps"])
    assert int(solution.stats["num_rejected_steps"]) > 0


def solve_from(lane, left, adjoint, rtol=1e-6):
    """After `left` more attempts: the solver's state, the controller's, the result."""
    solver_state, control_state = lane
    y0 = PhasePoint(map(jnp.asarray, START))
    solution = dfx.diffeqsolve(
        OF_SYSTEM, UnderDiffrax(zj.Explicit(), Stops()), 0.0, jnp.inf, 0.01, y0, SYSTEM,
        stepsize_controller=ControlUnderDiffrax(rtol, rtol), solver_state=solver_state,
        controller_state=control_state._replace(left=jnp.asarray(left, jnp.int32)),
        saveat=dfx.SaveAt(solver_state=True, controller_state=True),
        max_steps=None, throw=False, adjoint=adjoint,
    )  # fmt: skip
    return solution.solver_state, solution.controller_state, solution.result


def a_begin():
    y0, zero = PhasePoint(map(jnp.asarray, START)), jnp.asarray(0.0)
    watching = Observed(zj.Explicit(), Stops())
    first = watching.begin(SYSTEM, zero, y0)
    return first, StepControl(1e-6, 1e-6).start(zero, 0.01, np.pi / 10)


def test_the_loop_takes_the_steps_of_that_of_diffrax():
    for left in (1, 16, 10_000):  # the last ends by its fold
        here = solve_from(a_begin(), left, LaneLoop())[:2]
        there = solve_from(a_begin(), left, dfx.ForwardMode())[:2]
        for a, b in zip(jax.tree.leaves(here), jax.tree.leaves(there), strict=True):
            # measured: 3e-10, the length that an error allows
            np.testing.assert_allclose(a, b, rtol=1e-8)


def test_a_lane_ends_whose_step_vanishes_and_its_batch_mates_go_on():
    def solve(rtol):
        _, control, result = solve_from(a_begin(), 1000, LaneLoop(), rtol)
        return control.t, result == dfx.RESULTS.dt_min_reached

    times, vanished = jax.vmap(solve)(jnp.asarray([1e-100, 1e-6, 1e-100]))
    assert vanished.tolist() == [True, False, True]
    # the fold ends it; 20 additions round
    np.testing.assert_allclose(times, [0.0, 2 * np.pi, 0.0], rtol=1e-14)


@pytest.mark.parametrize(
    "asked, kind, words",
    [
        ({"saveat": dfx.SaveAt(t1=True)}, ValueError, "Argument `saveat` must"),
        ({"max_steps": 100}, ValueError, "`max_steps` must be None .* 100"),
        (
            {"event": dfx.Event(lambda t, *_, **__: t > 1)},
            NotImplementedError,
            "without an `event`",
        ),
        (
            {"controller_state": None},
            NotImplementedError,
            "a given .* `controller_state`",
        ),
    ],
)
def test_the_loop_refuses_what_it_would_not_do(asked, kind, words):
    solver_state, controller_state = a_begin()
    states = dfx.SaveAt(solver_state=True, controller_state=True)
    asked = {
        "solver_state": solver_state, "controller_state": controller_state,
        "saveat": states, "max_steps": None, **asked,
    }  # fmt: skip
    solver = Observed(zj.Explicit(), Stops())
    with pytest.raises(kind, match=words):
        dfx.diffeqsolve(
            OF_SYSTEM, solver, 0.0, jnp.inf, 0.01, START, SYSTEM,
            stepsize_controller=StepControl(1e-6, 1e-6), adjoint=LaneLoop(), **asked,
        )  # fmt: skip


def test_a_loop_ends_where_no_lane_moves_and_goes_on_as_it_left_off():
    """What motions in chunks lean on; lanes of a batch halt each for itself."""

    def solve(lane, left):
        return solve_from(lane, left, LaneLoop())[:2]

    begin = solve(a_begin(), 0)  # as the loop gives numbers: weak ones round otherwise
    whole, parts = solve(begin, 23), solve(solve(begin, 16), 7)
    for run in (parts, solve(whole, 0)):
        ends = (jax.tree.leaves(run), jax.tree.leaves(whole))
        assert all(np.array_equal(a, b) for a, b in zip(*ends, strict=True))

    batch = jax.vmap(solve, (None, 0))(begin, jnp.asarray([16, 5, 1]))
    assert (batch[1].left == 0).all()
    steps = batch[0].folded[3]
    alone = [float(solve(begin, n)[0].folded[3]) for n in (16, 5)]
    assert steps[:2].tolist() == alone and alone[0] > alone[1]
    times = jax.vmap(solve)(batch, jnp.asarray([7, 18, 22]))[1].t
    # measured: 5e-12; alone, and as the third of three, a lane is rounded otherwise
    np.testing.assert_allclose(times, whole[1].t, rtol=1e-10)


def test_diffrax_s_own_loop_is_refused():
    """Lane solvers leave to `LaneLoop` what it would ask them for."""
    first, control = a_begin()
    with pytest.raises(NotImplementedError, match="must be run by `LaneLoop`"):
        dfx.diffeqsolve(
            OF_SYSTEM, Observed(zj.Explicit(), Stops()), 0.0, 1.0, 0.01, START, SYSTEM,
            stepsize_controller=StepControl(1e-6, 1e-6), solver_state=first,
            controller_state=control,
        )  # fmt: skip
