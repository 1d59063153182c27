"""Forces of one's own: against those of the package, closed forms and scipy."""

import functools
from typing import ClassVar

import diffrax as dfx
import jax
import jax.numpy as jnp
import models
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import ziegler_jax as zj
from ziegler_jax.linear.matrices import about
from ziegler_jax.linear.parameters import as_function

KICK = zj.State(omega=(0.0, 0.3))
FLAT = zj.ConstantLoad(1.0)


class Weights(zj.AbstractForce):
    """Gravity, of any direction, by the rods' first moments with what hangs on them."""

    rules: ClassVar = {"size": "finite", "arms": "finite"}
    units: ClassVar = {"size": "k/(m l)", "arms": "m l", "direction": "rad"}
    size: float
    arms: object
    direction: float = 0.0

    def torques(self, t, phi, omega):
        rows = zip(self.arms, phi, strict=True)
        return [self.size * s * jnp.sin(x - self.direction) for s, x in rows]

    def energy(self, phi):
        d = self.direction
        rows = zip(self.arms, phi, strict=True)
        return sum(self.size * s * (jnp.cos(x - d) - jnp.cos(d)) for s, x in rows)


class Dashpots(zj.AbstractForce):
    """Viscous joints of two rods."""

    rules: ClassVar = {"c": "nonnegative"}
    c: float

    def torques(self, t, phi, omega):
        knee = self.c * (omega[1] - omega[0])
        return knee - self.c * omega[0], -knee


class Push(zj.AbstractForce):
    """A force across the vertical on the tip that grows with time."""

    autonomous: ClassVar[bool] = False
    rate: float

    def torques(self, t, phi, omega):
        return tuple(self.rate * t * jnp.cos(x) for x in phi)


class Pulsation(zj.AbstractLoadHistory):
    p: float
    rate: float

    def load(self, t):
        return self.p * jnp.cos(self.rate * t)


RODS = {"lengths": (1.0, 0.8, 1.2), "masses": (1.0, 0.7, 0.9), "tip_mass": 0.2}
# first moments: m l / 2 of each rod, and the masses beyond at its end
ARMS = (0.5 + 1.8, 0.28 + 1.1 * 0.8, 0.54 + 0.2 * 1.2)


@pytest.mark.parametrize("direction", [0.0, 0.4])
def test_weights_written_as_a_force_are_gravity(rng, direction):
    own = zj.Chain(1.3, **RODS, forces=Weights(0.2, np.array(ARMS), direction))
    same = zj.Chain(1.3, **RODS, gravity=zj.Gravity(0.2, direction))

    @jax.jit
    def asked(y):
        rows = [[*zj.vector_field(0.0, y, c)[3:], zj.energy(c, y)] for c in (own, same)]
        return jnp.array(rows), zj.power(own, y), zj.power(same, y).follower

    for _ in range(20):
        (one, other), power, follower = asked(tuple(rng.uniform(-1.5, 1.5, 6)))
        # measured 2e-15
        np.testing.assert_allclose(one, other, rtol=0, atol=2e-14)
        assert abs(power.follower - follower) < 1e-14 and abs(power.forces) < 1e-14


def test_linear_questions_see_an_autonomous_force_as_they_see_gravity():
    """About a bent equilibrium, with the derivative of the critical load."""

    def chain(own, size):
        part = {"forces": Weights(size, np.array(ARMS), 0.2)}
        part = part if own else {"gravity": zj.Gravity(size, 0.2)}
        return zj.Chain(0.5, **RODS, **part, damping=zj.Viscous(0.02, 0.02, 0.02))

    for question in (zj.linearise, zj.spectrum):
        x = [jax.tree.leaves(question(chain(own, 0.1))) for own in (True, False)]
        for own, same in zip(*x, strict=True):
            # measured 2.8e-15
            np.testing.assert_allclose(np.sort(own), np.sort(same), rtol=0, atol=1e-12)

    def load(own):
        return jax.jvp(lambda s: zj.critical_load(chain(own, s)).q_cr, (0.1,), (1.0,))

    # measured 3.3e-16
    np.testing.assert_allclose(load(True), load(False), rtol=1e-10)


def test_dashpots_written_as_a_force_are_viscous_joints():
    """Spectrum, motion, and that a motion is no conservative one."""
    own = zj.uniform_rods(1.0, forces=Dashpots(0.05))
    same = zj.uniform_rods(1.0, damping=zj.Viscous(0.05, 0.05))
    x = [np.sort_complex(zj.spectrum(c)) for c in (own, same)]
    np.testing.assert_allclose(*x, rtol=0, atol=1e-12)  # measured 2e-15
    assert zj.regime(own) == zj.regime(same) == zj.CODE.stable
    plain = zj.uniform_rods(1.0, forces=Weights(0.0, (1.0, 1.0)))
    assert zj.regime(plain) == zj.CODE.marginal
    still = jnp.zeros(2)
    assert about(plain.system(), still).damping is None  # it reads no rates
    assert about(own.system(), still).damping is not None
    ends = [zj.settle(c, KICK) for c in (own, same)]
    assert [int(e.outcome) for e in ends] == [zj.CODE.rest] * 2
    laws = {"forces": Dashpots(0.05)}, {"damping": zj.Viscous(0.05, 0.05)}
    columns = [zj.uniform_rods(2.6, **law) for law in laws]
    ends = [zj.settle(c, KICK, certify=False) for c in columns]
    assert [int(e.outcome) for e in ends] == [zj.CODE.repeats] * 2
    # measured 8.1e-15
    np.testing.assert_allclose(*(e.joint_amplitude for e in ends), rtol=1e-12)


def test_an_undamped_column_with_a_force_of_position_is_that_with_gravity():
    own = zj.uniform_rods(forces=Weights(0.1, (1.5, 0.5)))
    loads = [
        zj.critical_load(c) for c in (own, zj.uniform_rods(gravity=zj.Gravity(0.1)))
    ]
    assert [int(x.outcome) for x in loads] == [zj.CODE.found] * 2
    np.testing.assert_allclose(*(x.q_cr for x in loads), rtol=1e-12)  # measured 0


class Jitted(zj.AbstractForce):
    @jax.jit
    def torques(self, t, phi, omega):
        return tuple(-0.1 * x for x in phi)


class Pair(zj.AbstractLoadHistory):
    def load(self, t):
        return jnp.stack([t, t])


class Follows(zj.SmoothCoulomb):
    def load_law(self):
        return None


def test_what_a_force_or_history_reads_and_gives_is_looked_at(refuses):
    zj.uniform_rods(1.0, forces=Jitted()).system()  # it does not read the time
    pair = zj.uniform_rods(1.0, forces=Pair())
    refuses(pair.system, "`Pair`", "one real number")
    ramp = zj.LoadHistory((0.0, 1.0), (0.0, 1.0))
    law = Follows(0.1, pin_radius=0.1, v_smooth=0.1)
    refuses(
        lambda: zj.uniform_rods(1.0, friction=law, forces=ramp), "`friction`", "follow"
    )
    column = zj.uniform_rods(1.0, forces=ramp)
    refuses(lambda: zj.power(column, (0.1, 0.2, 0.3, 0.4)), "time", "give `t`")
    load = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.1, load=zj.JointReaction())
    zj.uniform_rods(1.0, friction=load, forces=())  # no force is there


class Small(zj.AbstractDamping):
    def rows(self, sines, omega):
        return (1.0, 0.0), (0.0, 1.0)


def test_a_damping_law_of_another_number_of_rods_is_refused(refuses):
    refuses(
        lambda: zj.Chain(1.0, lengths=(1.0,) * 3, damping=Small()), "`Small`", "3 rows"
    )


def test_a_certificate_with_a_force_is_that_with_gravity():
    law = zj.SmoothCoulomb(0.02, pin_radius=1.0, v_smooth=0.1, load=FLAT)
    own = zj.uniform_rods(2.6, friction=law, forces=Weights(0.1, (1.5, 0.5)))
    same = zj.uniform_rods(2.6, friction=law, gravity=zj.Gravity(0.1))
    ends = [zj.settle(c, KICK) for c in (own, same)]
    assert [int(e.outcome) for e in ends] == [zj.CODE.cycle] * 2
    for name in ("period", "largest_multiplier", "joint_amplitude"):
        # two searches at 1e-8; measured 4.7e-6, of the multiplier
        x = [getattr(e, name) for e in ends]
        np.testing.assert_allclose(*x, rtol=1e-4)


def pulsed(t, y, q, p, rate, tau, v):
    return models.field(y, q + p * np.cos(rate * t), tau, v, 0.01, 0.02)


METHODS = {
    "Dopri8": (zj.Explicit(dfx.Dopri8()), 0.1, 1e-9),
    "Tsit5": (zj.Explicit(), 0.1, 2e-8),
    "Rodas5P": (zj.Rosenbrock(), 1e-3, 2e-7),
}


@pytest.mark.parametrize("name", METHODS)
def test_a_pulsating_load_moves_the_column_as_scipy_says(name):
    solver, v, error = METHODS[name]
    numbers = 2.0, 0.6, 3.0, 0.02, v
    law = zj.SmoothCoulomb(0.02, pin_radius=1.0, v_smooth=v, load=FLAT)
    parts = {"friction": law, "damping": zj.Viscous(0.01, 0.02)}
    column = zj.uniform_rods(2.0, **parts, forces=Pulsation(0.6, 3.0))
    ts = np.linspace(1.0, 21.0, 11)  # not from zero on
    motion = zj.trajectory(column, KICK, ts, method=zj.Method(solver, rtol=1e-9))
    found = np.concatenate([motion.phi, motion.omega], 1)
    exact = solve_ivp(pulsed, (1.0, 21.0), KICK.y, "Radau" if v < 0.01 else "DOP853",
                      ts, args=numbers, rtol=1e-11, atol=1e-12)  # fmt: skip
    # measured 7e-11, 1.2e-9, 1.4e-8
    worst = np.abs(found - exact.y.T).max()
    assert worst < error, worst


def test_rosenbrocks_order_holds_with_a_load_that_depends_on_time():
    """Ten times finer steps of an error of order 5: without df/dt of order 2.1."""
    law = zj.SmoothCoulomb(0.02, pin_radius=1.0, v_smooth=0.1, load=FLAT)
    column = zj.uniform_rods(2.0, friction=law, forces=Pulsation(0.6, 3.0))

    def end(method):
        motion = zj.trajectory(column, KICK, [0.0, 10.0], method=method)
        return np.array(motion.phi[-1]), int(motion.steps)

    exact, _ = end(zj.Method(rtol=1e-12))
    runs = [end(zj.Method(zj.Rosenbrock(), rtol=tol)) for tol in (1e-5, 1e-9)]
    errors = [np.abs(x - exact).max() for x, _ in runs]
    order = np.log(errors[0] / errors[1]) / np.log(runs[1][1] / runs[0][1])
    assert order > 4.0, order


def test_a_held_joint_breaks_loose_when_a_growing_force_reaches_its_most():
    """F = r t across the tip of a straight column: joint 1 bears 2 F."""
    rate, static, kinetic = 0.01, 0.1, 0.08
    law = zj.SetValuedCoulomb(static, kinetic, pin_radius=1.0, load=FLAT)
    column = zj.uniform_rods(0.0, friction=law, forces=Push(rate))
    ts = np.array([0.0, 5.5, 6.0, 6.5])
    motion = zj.trajectory(column, zj.State(), ts)
    assert motion.events is not None
    # measured 2.5e-9: the torque is met within a hundredth of a step's 1e-8
    assert abs(motion.events.times[1] - static / (2 * rate)) < 1e-8
    assert motion.events.modes[1].tolist() == [1, 0]
    a, b, d = models.UNIFORM

    def rod(t, y):  # joint 2 is held: one rod of length 2
        pushed = 2 * rate * t * np.cos(y[0]) - y[0] - kinetic
        return y[1], pushed / (a + 2 * b + d)

    begin = static / (2 * rate)
    exact = solve_ivp(rod, (begin, 6.5), (0.0, 0.0), "DOP853", ts[1:],
                      rtol=1e-11, atol=1e-13)  # fmt: skip
    assert motion.events.count == 2  # joint 2 is held throughout
    for i in (0, 1):
        np.testing.assert_allclose(
            motion.phi[1:, i], exact.y[0], rtol=0, atol=2e-9
        )  # measured 7.9e-11


def test_what_rests_now_is_not_settled_where_forces_may_move_it_later():
    law = zj.SetValuedCoulomb(0.1, pin_radius=1.0, load=FLAT)
    column = zj.uniform_rods(0.0, friction=law, forces=Push(0.01))
    windows = zj.Windows(transient=1.0, length=1.0, max_windows=2)
    still = zj.settle(column, zj.State(), windows=windows)
    assert int(still.outcome) == zj.CODE.unsettled and still.time == 3.0
    moved = zj.settle(column, zj.State(), windows=zj.Windows(transient=6.0, length=1.0))
    assert moved.joint_amplitude[0] > 1e-3


BALANCED = {
    "a potential": (Weights(0.1, (1.5, 0.5), 0.3), None),
    "dashpots": (Dashpots(0.01), None),
    "a push": (Push(0.002), None),
    "a pulsation": (Pulsation(0.3, 2.0), None),
    "both, stiff": ((Push(0.002), Pulsation(0.3, 2.0)), zj.Rosenbrock()),
}


@pytest.mark.parametrize("dry", [False, True], ids=["smoothed", "dry"])
@pytest.mark.parametrize("which", BALANCED)
def test_energy_and_powers_balance(which, dry):
    """By windows: the load, friction and forces account for the energy's change."""
    forces, solver = BALANCED[which]
    if dry and solver is not None:
        pytest.skip("set-valued friction is not stiff")
    law = zj.SetValuedCoulomb if dry else zj.SmoothCoulomb
    more = {} if dry else {"v_smooth": 0.1}
    friction = law(0.02, pin_radius=1.0, load=FLAT, **more)
    column = zj.uniform_rods(2.6, friction=friction, forces=forces)
    end = zj.settle(
        column, KICK, windows=zj.Windows(transient=5.0, length=10.0, max_windows=1),
        observers=(zj.EnergyBalance(),), certify=False,
        method=zj.Method(solver, rtol=1e-9),
    )  # fmt: skip
    # measured 6e-11 (stiff), of powers of about 0.05
    assert abs(end.energy_imbalance) < 1e-9
    if which == "a potential":
        assert abs(end.force_power) < 1e-15
    elif which == "a pulsation":
        assert "force_power" not in end.numbers
    else:
        assert abs(end.force_power) > 1e-4


def test_a_history_is_straight_between_its_times_and_q_follows_it():
    history = zj.LoadHistory((1.0, 3.0, 4.0), (0.0, 2.0, 1.0))
    column = zj.uniform_rods(0.5, forces=history)
    y = (0.3, -0.2, 0.1, 0.4)
    for t, q in ((0.0, 0.5), (2.0, 1.5), (3.0, 2.5), (3.5, 2.0), (9.0, 1.5)):
        found = zj.vector_field(t, y, column)
        exact = zj.vector_field(0.0, y, zj.uniform_rods(q))
        np.testing.assert_allclose(found, exact, rtol=1e-15)
        one, other = zj.power(column, y, t), zj.power(zj.uniform_rods(q), y)
        assert abs(one.follower - other.follower) < 1e-15
    pattern = zj.FollowerForces((0.3, 0.3, 0.4), at=0.5)
    y = (0.3, -0.2, 0.1, 0.4, 0.2, 0.1)
    own = zj.Chain(0.5, **RODS, forces=(pattern, history))
    same = zj.Chain(1.5, **RODS, forces=pattern)
    rows = zj.vector_field(2.0, y, own), zj.vector_field(0.0, y, same)
    np.testing.assert_allclose(*rows, rtol=1e-14)
    leipholz = [zj.leipholz(3, 0.5, forces=history), zj.leipholz(3, 1.5)]
    rows = [zj.vector_field(2.0, y, c) for c in leipholz]
    np.testing.assert_allclose(*rows, rtol=1e-14)


def test_motions_are_derived_by_a_forces_numbers_and_arrays():
    law = zj.SmoothCoulomb(0.02, pin_radius=1.0, v_smooth=0.1, load=FLAT)

    def end(numbers):
        forces = zj.LoadHistory(numbers[:2] * 10, numbers[2:]), Push(0.1 * numbers[3])
        column = zj.uniform_rods(1.0, friction=law, forces=forces)
        method = zj.Method(rtol=1e-12)  # a step that holds a kink errs by more
        return zj.trajectory(column, KICK, [0.0, 8.0], method=method).phi[-1]

    at = jnp.array([0.1, 0.7, 0.2, 1.2])
    slopes = jax.jit(jax.jacfwd(end))(at)
    beside = np.array(at) + 1e-4 * np.stack([np.eye(4), -np.eye(4)])
    high, low = jax.jit(jax.vmap(jax.vmap(end)))(beside)
    # measured 6.0e-6, of a time, at which the load has a kink
    np.testing.assert_allclose(slopes.T, (high - low) / 2e-4, rtol=0, atol=1e-4)


def test_a_sweep_maps_a_forces_numbers_and_calls_broken_rules_invalid():
    windows = zj.Windows(transient=2.0, length=3.0, max_windows=1)

    def point(size, p):
        forces = Weights(size, jnp.array([1.5, 0.5])), Pulsation(p, 3.0)
        column = zj.uniform_rods(1.0, forces=forces)
        return zj.settle(column, KICK, windows=windows)

    axes = {"size": [0.0, 0.1], "p": [0.1, 0.3]}
    ds = zj.sweep(point, **axes, progress=False)
    alone = point(0.1, 0.3)
    found = ds.joint_amplitude.sel(size=0.1, p=0.3)
    np.testing.assert_allclose(found, alone.joint_amplitude, rtol=1e-12)

    def broken(c):
        column = zj.uniform_rods(1.0, forces=(Dashpots(c),))
        return zj.settle(column, KICK, windows=windows, certify=False)

    with pytest.warns(UserWarning, match="invalid"):
        ds = zj.sweep(broken, c=[-1.0, 0.1], progress=False)
    assert ds.outcome.values.tolist() == [zj.CODE.invalid, zj.CODE.unsettled]
    traced = jax.jit(lambda t: zj.uniform_rods(
        1.0, forces=zj.LoadHistory((0.0, t), (0.0, 1.0))).valid())  # fmt: skip
    assert traced(1.0) and not traced(-1.0)


def test_forces_in_si_units_are_scaled_by_theirs():
    si = zj.SI(m=2.0, l=0.5, k=3.0)
    rods = {"m1": 2.0, "m2": 2.0, "l1": 0.5, "l2": 0.5}
    history = zj.LoadHistory((0.0, 4.0), (0.0, 12.0))
    forces = Weights(9.81, (1.5, 0.5)), history
    column = si.scaled(zj.uniform_rods(6.0, **rods, forces=forces))
    weight, load = column.forces
    np.testing.assert_allclose(weight.size, 9.81 * 2.0 * 0.5 / 3.0)
    np.testing.assert_allclose(weight.arms, (1.5 / (2.0 * 0.5), 0.5 / (2.0 * 0.5)))
    np.testing.assert_allclose(load.loads, (0.0, 12.0 * 0.5 / 3.0))
    np.testing.assert_allclose(load.times, (0.0, 4.0 / float(si.time)))


# ---- what is refused

SMOOTH = zj.SmoothCoulomb(0.02, pin_radius=1.0, v_smooth=0.1, load=FLAT)
DRY = zj.SetValuedCoulomb(0.02, pin_radius=1.0, load=FLAT)
TIMED = zj.uniform_rods(1.0, friction=SMOOTH, forces=Push(0.1))
BARE = zj.uniform_rods(1.0, forces=Pulsation(0.1, 2.0))


def timed(q):
    return zj.uniform_rods(q, friction=SMOOTH, forces=Pulsation(0.1, 2.0))


@functools.cache
def orbit():
    """Of a column that is the same at all times."""
    column = zj.uniform_rods(2.6, friction=SMOOTH)
    return zj.periodic_orbit(column, zj.settle(column, KICK, certify=False).final)


def points():
    """The same as a flip of a branch."""
    found, one = orbit(), lambda x: jnp.asarray(x)[None]
    return zj.CyclePoints(
        parameter=one(2.6), phi=one(jnp.stack(found.state.phi)),
        omega=one(jnp.stack(found.state.omega)), period=one(found.period),
        rod_amplitude=one(found.rod_amplitude),
        joint_amplitude=one(found.joint_amplitude), monodromy=one(found.monodromy),
        kind=one(int(zj.CODE.flip)), settings=found.settings,
    )  # fmt: skip


AT_ALL_TIMES = {
    "bifurcation": lambda: zj.bifurcation(timed, "fold", orbit(), 2.0),
    "bifurcation_curve": lambda: zj.bifurcation_curve(
        lambda q, tau: timed(q), "fold", orbit(), second=0.1, first=2.6
    ),
    "branch_off": lambda: zj.branch_off(timed, "flip", points()),
    "continue_cycle": lambda: zj.continue_cycle(timed, orbit(), 2.0),
    "critical_kick": lambda: zj.critical_kick(TIMED, KICK, (0.0, 1.0)),
    "critical_load": lambda: zj.critical_load(BARE),
    "flutter_onset": lambda: zj.flutter_onset(timed, KICK, (0.0, 1.0)),
    "is_stiff": lambda: zj.is_stiff(TIMED, 1e-6),
    "least_kick": lambda: zj.least_kick(TIMED, (0.0, 1.0)),
    "linearise": lambda: zj.linearise(BARE),
    "lyapunov_exponents": lambda: zj.lyapunov_exponents(TIMED, KICK),
    "periodic_orbit": lambda: zj.periodic_orbit(TIMED, KICK),
    "poincare": lambda: zj.poincare(TIMED, KICK),
    "regime": lambda: zj.regime(BARE),
    "sensitivity": lambda: zj.sensitivity(BARE),
    "settle": lambda: zj.settle(TIMED, KICK, certify=True),
    "settle, exponents": lambda: zj.settle(TIMED, KICK, exponents=2),
    "spectral_abscissa": lambda: zj.spectral_abscissa(BARE),
    "spectrum": lambda: zj.spectrum(BARE),
    "stabilise": lambda: zj.stabilise(BARE, {"kappa": (0.5, 2.0)}),
    "sticking_set": lambda: zj.sticking_set(
        zj.uniform_rods(1.0, friction=DRY, forces=Push(0.1))
    ),
    "sweep_up_down": lambda: zj.sweep_up_down(timed, [1.0, 2.0], kick=KICK),
    "tangent_column": lambda: zj.tangent_column(TIMED),
    "threshold": lambda: zj.threshold(lambda q: (timed(q), KICK), (0.0, 1.0)),
}
# of a column in time, or of none
OTHERS = {
    "beck", "compare", "configure_cache", "configure_cpu", "energy", "follow_again",
    "label_cycles", "leipholz", "merge", "open_sweep", "pflueger", "point_masses",
    "power", "reactions", "refine", "sweep", "tableaus", "trajectory", "uniform_rods",
    "vector_field",
}  # fmt: skip


def test_every_question_that_wants_a_column_of_all_times_is_tried():
    functions = {name for name in zj.__all__ if name.islower()}
    assert functions - OTHERS == {name.split(",")[0] for name in AT_ALL_TIMES}


@pytest.mark.parametrize("question", AT_ALL_TIMES)
def test_what_holds_at_all_times_is_not_asked_of_a_column_in_time(question, refuses):
    refuses(AT_ALL_TIMES[question], "`forces` of the column must not depend on time")


class Silent(zj.AbstractForce):
    """It depends on time and does not say so."""

    def torques(self, t, phi, omega):
        return jnp.sin(t), 0.0


class Short(zj.AbstractForce):
    def torques(self, t, phi, omega):
        return (phi[0],)


def test_forces_that_cannot_be_are_refused(refuses):
    rods = zj.uniform_rods
    y = KICK.y
    refuses(lambda: rods(1.0, forces=3.0), "`forces`", "but has 3.0")
    refuses(lambda: zj.energy(rods(1.0, forces=Silent()), y), "`Silent`", "reads `t`")
    refuses(lambda: zj.energy(rods(1.0, forces=Short()), y), "`Short`", "of 2 rods")
    pattern = zj.FollowerForces((0.5, 0.5))
    refuses(lambda: rods(1.0, forces=pattern), "`Column`", "at most 0 patterns")
    refuses(lambda: zj.leipholz(2, 1.0, forces=pattern), "`Chain`", "but has 2")
    follows = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.1)
    history = zj.LoadHistory((0, 1), (0, 1))
    refuses(lambda: rods(0, friction=follows, forces=history), "`ConstantLoad(n)`")
    rods(0, friction=follows, forces=Push(0.1))  # whose q is one number
    load = zj.JointReaction()
    law = zj.SetValuedCoulomb(0.1, pin_radius=0.1, load=load)
    refuses(lambda: rods(1.0, friction=law, forces=Push(0.1)), "`forces` must be None")
    refuses(lambda: zj.reactions(TIMED, y), "`forces` must be None")
    column = rods(1.0, friction=DRY, forces=Push(0.1))
    method = zj.Method(zj.Taylor())
    call = lambda: zj.trajectory(column, KICK, [0.0, 1.0], method=method)  # noqa: E731
    refuses(call, "`solver`", "forces of one's own", "Taylor")
    refuses(lambda: column.system().power(y), "`system.at(t)`")
    refuses(lambda: zj.LoadHistory((0, 1), (0,)), "`loads`", "two numbers")
    refuses(lambda: zj.LoadHistory((0, 1), (0, 1, 2)), "`loads`", "2 and 3")
    refuses(lambda: zj.LoadHistory((1, 1), (0, 1)), "`times` must increase")
    refuses(lambda: zj.LoadHistory((0, np.nan), (0, 1)), "`times[1]` must be finite")


def test_names_of_parameters_are_single_numbers(refuses):
    """A row of numbers has no one name, and is left out of tables."""
    column = zj.uniform_rods(1.0, forces=Weights(0.1, np.array([1.5, 0.5])))
    _, values = as_function(column, None)
    assert "forces.size" in values and "forces.arms" not in values
    refuses(
        lambda: zj.sensitivity(column, parameters=["forces.arms"]), "must name leaves"
    )
