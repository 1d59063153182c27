"""Each observer against dense sampling of the same motion, and against closed forms."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax.numerics.hermite import Quintic

FROM, SPAN = 200.0, 30.0
CUT = 0.05
OBSERVERS = (zj.Mean(), zj.Period(), zj.StickFraction(CUT), zj.EnergyBalance())
TIGHT = {"method": zj.Method(rtol=1e-10, atol=1e-10)}


def scene():
    """A cycle with all kinds of loss."""
    friction = zj.SmoothCoulomb(
        0.24, 0.2, pin_radius=0.05, v_stribeck=0.3, v_smooth=0.05
    )
    return zj.uniform_rods(2.8, friction=friction, damping=zj.Viscous(0.01, 0.01))


START = zj.State(omega=(0.0, 0.3))


@pytest.fixture(scope="module")
def observed():
    @jax.jit
    def point():
        return zj.settle(
            scene(),
            START,
            windows=zj.Windows(transient=FROM, length=SPAN, max_windows=1),
            observers=OBSERVERS,
            **TIGHT,
            certify=False,
        )

    found = point()
    assert int(found.outcome) == zj.CODE.unsettled  # one window cannot agree
    return found


@pytest.fixture(scope="module")
def dense():
    """The same motion at 30 001 times: t, phi (n, 2), omega (n, 2)."""
    ts = np.concatenate([[0.0], np.linspace(FROM, FROM + SPAN, 30_001)])
    motion = jax.jit(lambda ts: zj.trajectory(scene(), START, ts, **TIGHT))(ts)
    assert int(motion.outcome) == zj.CODE.complete
    return ts[1:], np.asarray(motion.phi)[1:], np.asarray(motion.omega)[1:]


def test_the_motion_moves(dense):
    """Else the comparisons below would hold trivially."""
    assert np.ptp(dense[1], axis=0).min() > 0.5


def test_amplitude_is_the_largest_angle(observed, dense):
    _, phi, _ = dense
    rods = np.abs(phi).max(0)
    knee = np.abs(phi[:, 1] - phi[:, 0]).max()
    error = np.abs(observed.rod_amplitude - rods).max()
    joints = np.array([rods[0], knee])
    error = max(error, np.abs(observed.joint_amplitude - joints).max())
    # measured 9.7e-9: samples 1e-3 apart miss a peak by as much
    assert error < 1e-7


def test_mean_is_the_mean_angle(observed, dense):
    ts, phi, _ = dense
    error = np.abs(observed.mean_angle - np.trapezoid(phi, ts, axis=0) / SPAN).max()
    # measured 2.4e-9
    assert error < 3e-8


def test_period_is_the_mean_time_between_upward_passages(observed, dense):
    ts, phi, _ = dense
    up = np.flatnonzero((phi[:-1, 0] < 0) & (phi[1:, 0] >= 0))
    share = -phi[up, 0] / (phi[up + 1, 0] - phi[up, 0])
    times = ts[up] + share * np.diff(ts)[up]
    assert times.size >= 3
    error = abs(observed.period - np.diff(times).mean())
    # measured 1.9e-10
    assert error < 3e-9


def test_stick_fraction_is_the_share_below_the_cut(observed, dense):
    """Between samples the rate is a line: 3e-6 of a share."""
    _, _, omega = dense
    rates = np.stack([omega[:, 0], omega[:, 1] - omega[:, 0]], -1)
    low = np.minimum(rates[1:], rates[:-1])
    high = np.maximum(rates[1:], rates[:-1])
    inside = np.clip(np.minimum(high, CUT) - np.maximum(low, -CUT), 0, None)
    shares = (inside / (high - low)).mean(0)
    assert (shares > 0.02).all()
    error = np.abs(observed.stick_fraction / shares - 1).max()
    # measured 2.7e-6, of the samples; by a step's straight line it was 6e-4 here, 1e-2
    # at a tolerance of 1e-6, where this is 6e-5
    assert error < 3e-5


def test_powers_are_the_mean_powers_and_balance(observed, dense):
    ts, phi, omega = dense
    y = (phi[:, 0], phi[:, 1], omega[:, 0], omega[:, 1])
    powers = jax.jit(jax.vmap(lambda y: zj.power(scene(), y)))(y)
    for name in ("follower", "damping", "friction"):
        mean = np.trapezoid(getattr(powers, name), ts) / SPAN
        error = abs(getattr(observed, f"{name}_power") - mean)
        # measured 4.7e-9: the trapezoidal rule's own error
        assert error < 5e-8 and abs(mean) > 1e-3
    # measured 2.8e-12
    assert abs(observed.energy_imbalance) < 3e-11


# Closed forms: a mode of small free oscillation at q = 0 ------------------------------

MASS = np.array([[4 / 3, 1 / 2], [1 / 2, 1 / 3]])
SPRINGS = np.array([[2.0, -1.0], [-1.0, 1.0]])


def mode(which):
    """Frequency and shape (largest part 1) of K v = w^2 M v."""
    root = np.linalg.inv(np.linalg.cholesky(MASS))
    squares, shapes = np.linalg.eigh(root @ SPRINGS @ root.T)
    shape = root.T @ shapes[:, which]
    return np.sqrt(squares[which]), shape / np.abs(shape).max()


SMALL = 1e-4  # the next term of the sine is 1e-8 times as large


@jax.jit
def oscillation(w, shape, window, cut):
    # shape cos(w t - 1): the first peak comes after the start
    phi, omega = SMALL * np.cos(1.0) * shape, SMALL * np.sin(1.0) * w * shape
    return zj.settle(
        zj.uniform_rods(0.0),
        zj.State((phi[0], phi[1]), (omega[0], omega[1])),
        windows=zj.Windows(transient=0.0, length=window, max_windows=1),
        observers=(
            zj.Mean(), zj.Period(), zj.StickFraction(SMALL * cut), zj.EnergyBalance()
        ),
        method=zj.Method(rtol=1e-10, atol=1e-15), certify=False
    )  # fmt: skip


@pytest.fixture(scope="module", params=[0, 1], ids=["slow mode", "fast mode"])
def linear(request):
    w, shape = mode(request.param)
    cut = 0.3 * w * np.abs(shape[0])
    # ten and a half turns
    return w, shape, cut, oscillation(w, shape, 10.5 * 2 * np.pi / w, cut)


def test_a_modes_amplitude_is_its_shape(linear):
    _, shape, _, found = linear
    largest = [*np.abs(shape), np.abs(shape[0]), np.abs(shape[1] - shape[0])]
    sizes = np.concatenate([found.rod_amplitude, found.joint_amplitude])
    error = np.abs(sizes / SMALL - largest).max()
    # measured 2.9e-9
    assert error < 3e-8


def test_a_modes_period_is_two_pi_over_its_frequency(linear):
    w, _, _, found = linear
    # measured 8.1e-9: the sine's next term
    assert abs(found.period * w / (2 * np.pi) - 1) < 3e-8


@pytest.mark.parametrize("which", [0, 1, 2])
def test_a_bent_chains_period_is_that_of_its_mode(which):
    """Of three rods about 0.3: phi1 never passes zero, and starts anywhere."""
    mass = np.array(
        [[7 / 3, 3 / 2, 1 / 2], [3 / 2, 4 / 3, 1 / 2], [1 / 2, 1 / 2, 1 / 3]]
    )
    bent = np.eye(3) - np.eye(3, k=-1)
    root = np.linalg.inv(np.linalg.cholesky(mass))
    squares, shapes = np.linalg.eigh(root @ bent.T @ bent @ root.T)
    w, shape = np.sqrt(squares[which]), root.T @ shapes[:, which]
    shape = SMALL * shape / np.abs(shape).max()
    for begins in (1.0, 4.0):  # rising, falling
        found = bent_swing(w, shape, begins, 10.5 * 2 * np.pi / w)
        # measured 3.2e-8: the sine's next term
        assert abs(found.period * w / (2 * np.pi) - 1) < 3e-7
    assert "middle of its swing" in found.to_dataset().period.long_name


@jax.jit
def bent_swing(w, shape, begins, window):
    phi, omega = 0.3 + jnp.cos(begins) * shape, w * jnp.sin(begins) * shape
    return zj.settle(
        zj.Chain(lengths=(1.0,) * 3, rest_angles=(0.3, 0.0, 0.0)),
        zj.State(tuple(phi), tuple(omega)),
        windows=zj.Windows(transient=0.0, length=window, max_windows=1),
        observers=(zj.Period(),),
        method=zj.Method(rtol=1e-10, atol=1e-15),
        certify=False,
    )


def test_a_modes_mean_is_that_of_the_cosine(linear):
    w, shape, _, found = linear
    # half a turn more than whole ones
    expected = SMALL * shape * 2 * np.sin(1.0) / (10.5 * 2 * np.pi)
    error = np.abs(found.mean_angle / expected - 1).max()
    # measured 1.9e-7
    assert error < 2e-6


def test_a_mode_is_slow_for_two_asin_over_pi(linear):
    w, shape, cut, found = linear
    rates = w * np.abs([shape[0], shape[1] - shape[0]])
    # half turns share alike
    expected = 2 / np.pi * np.arcsin(np.minimum(cut / rates, 1.0))
    error = np.abs(found.stick_fraction - expected).max()
    # measured 2.9e-4: a step's straight line for the rate
    assert error < 1e-3


def test_a_free_mode_gives_and_takes_nothing(linear):
    _, _, _, found = linear
    assert float(found.follower_power) == 0
    assert not {"damping_power", "friction_power"} & set(found.variables())
    assert not hasattr(found, "damping_power") and not hasattr(found, "friction_power")
    energy = SMALL**2
    # measured 4e-11
    assert abs(found.energy_imbalance) < 4e-10 * energy


def test_fewer_than_two_passages_have_no_period():
    w, shape = mode(0)
    found = oscillation(w, shape, 0.9 * 2 * np.pi / w, 1.0)
    assert np.isnan(found.period)


def test_the_quintics_peak_lies_inside_a_step():
    """A step over the top of a cosine: its ends are lower than the amplitude."""
    from ziegler_jax.solvers import Step

    h, phase = 0.4, 0.17  # from -phase to h - phase about the top
    t0, t1 = -phase, h - phase

    def at(t):
        return zj.PhasePoint(map(jnp.asarray, (np.cos(t), 0.0, -np.sin(t), 0.0)))

    y0, y1 = at(t0), at(t1)
    f0, f1 = (zj.PhasePoint((y[2], y[3], -y[0], y[3])) for y in (y0, y1))
    step = Step(t0, t1, y0, y1, f0, f1, ())
    amplitude = zj.Amplitude()
    _, peak = amplitude.step(None, amplitude.init(None, t0, y0), step)[0]
    assert max(y0[0], y1[0]) < 0.986
    # the quintic's own h^6 / 46080 = 8.9e-8, and the cubic's place (measured 1.02e-7)
    assert abs(float(peak) - 1) < 1.2e-7


def test_an_angle_that_hardly_moves_has_the_amplitude_of_its_ends():
    """Rates far below what a rise of the angle can tell, down to underflow.

    Fuzzing found such lanes, nearly at rest, with an amplitude of infinity or NaN.
    """
    rng, n = np.random.default_rng(3), 100_000
    x0 = rng.choice([0.0, 0.3, 1e-23], n)
    x1 = x0 + rng.integers(-2, 3, n) * np.spacing(x0)
    size, sign = 10.0 ** rng.uniform(-320, -16, (4, n)), rng.choice([-1, 1], (4, n))
    v0, v1, a0, a1 = size * sign
    largest = jax.jit(lambda *ends: Quintic(*ends).largest())
    peak = np.asarray(largest(x0, v0, a0, x1, v1, a1))
    ends = np.maximum(np.abs(x0), np.abs(x1))
    assert (peak >= np.abs(x1)).all()
    # slopes and second derivatives count less than once; measured no excess
    assert (peak <= ends + size.sum(0) + 4 * np.spacing(ends)).all()


def test_an_amplitude_has_the_derivative_of_its_motion():
    """The place of a peak moves as well: were it held still, it would err by 2e-2."""

    @functools.partial(jax.jit, static_argnums=1)
    @functools.partial(jax.vmap, in_axes=(0, None))
    def slope(q, rtol):
        def peaks(q):
            windows = zj.Windows(transient=20.0, length=20.0, max_windows=1)
            return zj.settle(
                zj.uniform_rods(q), zj.State(omega=(0.0, 0.2)), windows=windows,
                method=zj.Method(rtol=rtol), certify=False,
            ).rod_amplitude  # fmt: skip

        return jax.jvp(peaks, (q,), (jnp.ones_like(q),))[1]

    q = jnp.asarray([1.5, 2.0, 2.2, 2.5, 2.6])
    found, exact = slope(q, 1e-6), slope(q, 1e-12)
    # measured 2.1e-3
    np.testing.assert_allclose(found, exact, rtol=6e-3)


def test_a_step_that_begins_with_next_to_no_rate_sees_its_peak():
    # x = v x + 0.4 x^2 - 0.3 x^3, the largest at x = 8/9: 256/2430
    for v in (1e-5, 1e-17, 1e-200):
        ends = (0.0, v, 0.8, 0.1 + v, -0.1 + v, -1.0)
        peak = Quintic(*map(jnp.asarray, ends)).largest()
        # the least v moves it by 8/9 v
        assert abs(float(peak) - 256 / 2430 - 8 / 9 * v) < 1e-9
