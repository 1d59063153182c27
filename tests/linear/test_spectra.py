"""Linear maps, spectra and regimes: by pairs of independent formulations."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax.linear.spectrum import _positive_roots
from ziegler_jax.model.friction import AbstractRateFriction
from ziegler_jax.results import CODE

SQRT7 = np.sqrt(7.0)


def random_numbers(seed, n):
    """Columns of any inertia, stiffness, follower fraction, lengths and damping."""
    rng = np.random.default_rng(seed)
    a, d = rng.uniform(0.2, 4, n), rng.uniform(0.1, 3, n)
    return {
        "q": rng.uniform(0, 6, n),
        "a": a,
        "b": rng.uniform(-0.9, 0.9, n) * np.sqrt(a * d),
        "d": d,
        "kappa": 10 ** rng.uniform(-1, 1, n),
        "follower": rng.uniform(-0.5, 1.7, n),
        "l2": rng.uniform(0.4, 2, n),
        "c1": 10 ** rng.uniform(-3, 0.5, n),
        "c2": 10 ** rng.uniform(-3, 0.5, n),
        "e1": rng.uniform(0, 1, n),
        "e2": rng.uniform(0, 1, n),
    }


def column_of(p, damped=True):
    damping = None
    if damped:
        air = zj.Air(p["e1"], p["e2"], p["l2"])
        damping = zj.Sum(zj.Viscous(p["c1"], p["c2"]), air)
    return zj.Column(
        p["q"], p["a"], p["b"], p["d"], p["kappa"], p["follower"], damping, l2=p["l2"]
    )


def jacobian(column):
    """The field's own derivative at rest, for (phi1, phi2, omega1, omega2)."""
    rest = (0.0, 0.0, 0.0, 0.0)
    rows = jax.jacfwd(lambda y: zj.vector_field(0.0, y, column))(rest)
    return jnp.stack([jnp.stack(row) for row in rows])


@pytest.mark.parametrize("damped", [True, False])
def test_linearise_is_the_derivative_of_the_field(damped):
    def error(p):
        column = column_of(p, damped)
        m, c, k = zj.linearise(column)
        inverse = jnp.linalg.inv(m)
        lower = jnp.concatenate([-inverse @ k, -inverse @ c], axis=1)
        scale = 1 + jnp.max(jnp.abs(lower))
        return jnp.max(jnp.abs(jacobian(column)[2:] - lower)) / scale

    # worst measured 2e-15, on an inertia within 0.19 of singular
    assert jnp.max(jax.jit(jax.vmap(error))(random_numbers(0, 500))) < 1e-13


def test_undamped_damping_matrix_is_zero():
    assert not np.any(zj.linearise(zj.uniform_rods()).damping)


def test_spectrum_is_that_of_the_field():
    p = random_numbers(1, 200)
    ours, fields = jax.jit(
        jax.vmap(lambda p: (zj.spectrum(column_of(p)), jacobian(column_of(p))))
    )(p)
    ours, fields = np.asarray(ours), np.linalg.eigvals(np.asarray(fields))
    nearest = np.abs(ours[:, :, None] - fields[:, None, :]).min(axis=2)
    assert nearest.max() < 1e-7  # worst measured 2e-14; 1e-8 at a coalescence


def test_undamped_spectrum_of_the_seed_is_the_closed_form():
    # at q = 0: s^2 = (-p2 +- sqrt(p2^2 - 4 p0 p4)) / (2 p0), p0, p2, p4 = 7/36, 3, 1
    squares = (-3 + np.array([1, -1]) * np.sqrt(9 - 7 / 9)) * 36 / 14
    s = np.asarray(zj.spectrum(zj.uniform_rods()))
    np.testing.assert_allclose(
        np.sort(s.imag),
        np.sort(np.concatenate([1, -1] * np.sqrt(-squares)[:, None])),
        rtol=1e-13,
    )
    assert np.abs(s.real).max() < 1e-14


def test_spectral_abscissa_is_the_growth_rate_beyond_flutter():
    # physics of the paper: at q = 2.60 the growth rate is already 0.25
    assert float(zj.spectral_abscissa(zj.uniform_rods(q=2.6))) == pytest.approx(
        np.sqrt((np.sqrt(36 / 7) - (3 - 2.6 * 5 / 6) * 18 / 7) / 2), rel=1e-9
    )


def verdict(s, real):
    """The regime by eigenvalues, and whether they are clear of every boundary."""
    grows = s.real > 1e-6
    oscillates = np.abs(s.imag) > 1e-5
    clear = (np.abs(s.real).min(axis=1) > 1e-6) if real else np.full(len(s), True)
    clear &= ~(grows & (np.abs(s.imag) > 1e-9) & ~oscillates).any(axis=1)
    # two real roots about to meet, or a pair just parted
    gaps = np.abs(s[:, :, None] - s[:, None, :]) + np.eye(4)
    clear &= gaps.min(axis=(1, 2)) > 1e-3
    code = np.where(grows.any(axis=1), CODE.flutter, CODE.stable)
    code[(grows & ~oscillates).any(axis=1)] = CODE.divergence
    return code, clear


def test_regime_is_the_verdict_of_the_spectrum():
    # margin: every |Re s| > 1e-6, no two eigenvalues within 1e-3
    p = random_numbers(2, 20_000)
    s = np.asarray(jax.jit(jax.vmap(lambda p: zj.spectrum(column_of(p))))(p))
    code = np.asarray(jax.vmap(lambda p: zj.regime(column_of(p)))(p))
    expected, clear = verdict(s, True)
    assert clear.sum() > 19_000
    np.testing.assert_array_equal(code[clear], expected[clear])
    assert {CODE.stable, CODE.flutter, CODE.divergence} == set(
        code[clear]
    )  # the sample meets all three


def test_undamped_regime_is_the_verdict_of_the_spectrum():
    # margin: no two eigenvalues within 1e-3
    p = random_numbers(3, 20_000)
    s = np.asarray(jax.jit(jax.vmap(lambda p: zj.spectrum(column_of(p, False))))(p))
    code = np.asarray(jax.vmap(lambda p: zj.regime(column_of(p, False)))(p))
    expected, clear = verdict(s, False)
    expected[expected == CODE.stable] = CODE.marginal
    assert clear.sum() > 19_000
    np.testing.assert_array_equal(code[clear], expected[clear])
    assert {CODE.marginal, CODE.flutter, CODE.divergence} == set(code[clear])


def test_sturm_counts_the_positive_roots():
    # random roots, so that all counts from 0 to 4 occur
    rng = np.random.default_rng(4)
    for _ in range(300):
        pairs = rng.integers(0, 3)
        roots = list(rng.uniform(-2, 2, 4 - 2 * pairs))
        for _ in range(pairs):
            z = complex(rng.uniform(-2, 2), rng.uniform(0.1, 2))
            roots += [z, z.conjugate()]
        b, c, d, e = np.real(np.poly(roots))[1:]
        count = sum(1 for z in roots if np.imag(z) == 0 and np.real(z) > 0)
        assert int(_positive_roots(*map(jnp.asarray, (b, c, d, e)))) == count


@pytest.mark.parametrize(
    ("q", "code"),
    [
        (0.0, CODE.marginal),
        ((18 - 2 * SQRT7) / 5 - 1e-12, CODE.marginal),
        ((18 - 2 * SQRT7) / 5 + 1e-12, CODE.flutter),
        ((18 + 2 * SQRT7) / 5 - 1e-12, CODE.flutter),
        ((18 + 2 * SQRT7) / 5 + 1e-12, CODE.divergence),
    ],
)
def test_regimes_of_the_seed_turn_at_its_closed_forms(q, code):
    assert int(zj.regime(zj.uniform_rods(q=q))) == code


@pytest.mark.parametrize("c", [1e-100, 1e-9, 1e-3])
def test_damping_however_small_moves_the_threshold(c):
    # the limit is 74/45 = 1.6444, far below the undamped 2.5417
    def at(q):
        return int(zj.regime(zj.uniform_rods(q=q, damping=zj.Viscous(c, c))))

    assert at(74 / 45 - 1e-4) == CODE.stable
    assert at(74 / 45 + 1e-4) == CODE.flutter


def test_zero_damping_is_the_undamped_regime():
    q = np.linspace(0, 6, 61)
    zero = jax.vmap(lambda q: zj.regime(zj.uniform_rods(q, damping=zj.Viscous(0, 0))))
    none = jax.vmap(lambda q: zj.regime(zj.uniform_rods(q)))
    np.testing.assert_array_equal(zero(q), none(q))


def test_air_damping_takes_out_the_work_of_the_drag():
    e1, e2, l2, w1, w2 = 0.3, 0.7, 1.4, 0.8, -1.9
    angle = 0.9
    s = np.linspace(0, 1, 20001)
    rod1 = e1 * np.trapezoid((w1 * s) ** 2, s)
    knee = w1 * np.array([np.cos(angle), np.sin(angle)])
    points = knee[:, None] + np.array([1.0, 0.0])[:, None] * w2 * l2 * s
    rod2 = e2 * l2 * np.trapezoid((points**2).sum(axis=0), s)
    column = zj.uniform_rods(l2=l2, damping=zj.Air(e1, e2, l2))
    lost = zj.power(column, (angle, 0.0, w1, w2)).damping
    assert float(lost) == pytest.approx(rod1 + rod2, rel=1e-8)  # trapezoids: 1e-9


def test_equal_air_on_uniform_rods_is_proportional_to_the_inertia():
    m, c, _ = zj.linearise(zj.uniform_rods(l2=1.3, damping=zj.Air(0.2, 0.2, 1.3)))
    rods = zj.uniform_rods(m2=1.3, l2=1.3)  # equal mass a length
    np.testing.assert_allclose(c, 0.2 * zj.linearise(rods).mass, rtol=1e-15)
    assert m[0, 0] != rods.a


def test_a_sum_of_laws_adds_matrices():
    one, two = zj.Viscous(0.1, 0.2), zj.Air(0.3, 0.4)
    c = [zj.linearise(zj.uniform_rods(damping=x)).damping for x in (one, two)]
    both = zj.linearise(zj.uniform_rods(damping=zj.Sum(one, two))).damping
    np.testing.assert_allclose(both, c[0] + c[1], rtol=1e-15)


FRICTION = zj.SmoothCoulomb(
    (0.3, 0.4), (0.2, 0.3), pin_radius=(0.1, 0.2), v_stribeck=0.05, v_smooth=0.01
)


@pytest.mark.parametrize(
    "ask",
    [
        zj.linearise,
        zj.spectrum,
        zj.spectral_abscissa,
        zj.regime,
        zj.critical_load,
        zj.sensitivity,
    ],
)
def test_friction_is_refused_and_tangent_column_named(ask):
    with pytest.raises(ValueError, match="no friction .* `tangent_column"):
        ask(zj.uniform_rods(q=1.0, friction=FRICTION))


class OwnLaw(AbstractRateFriction):
    """Torques of its own, which rest on no load."""

    rules = {"c": "nonnegative"}  # noqa: RUF012
    c: float

    def levers(self, u1, u2):
        return self.c * jnp.tanh(u1), 2 * self.c * jnp.tanh(u2)

    def load_law(self):
        return None

    def rate_cut(self):
        return 0.1


def test_a_law_of_ones_own_has_a_tangent_and_rules():
    tangent = zj.tangent_column(zj.uniform_rods(2.0, friction=OwnLaw(0.3)))
    assert (float(tangent.damping.c1), float(tangent.damping.c2)) == (0.3, 0.6)
    assert OwnLaw(0.3).valid() and not OwnLaw(-0.3).valid()
    pairs = eqx.tree_at(lambda law: law.c, OwnLaw(0.3), np.array([0.1, -0.2]))
    assert not pairs.valid()


@pytest.mark.parametrize(
    "load", [zj.FollowerLoad(), zj.ConstantLoad((0.5, 2.0)), zj.JointReaction()]
)
@pytest.mark.parametrize("damping", [None, zj.Viscous(0.1, 0.2)])
def test_tangent_column_is_the_derivative_of_the_smoothed_field(load, damping):
    law = eqx.tree_at(lambda law: law.load, FRICTION, load)
    column = zj.uniform_rods(q=1.7, follower=0.8, damping=damping, friction=law)
    tangent = zj.tangent_column(column)
    assert tangent.friction is None
    # worst measured 4e-14 of a largest entry of 60
    slope = jax.jit(jacobian)
    np.testing.assert_allclose(slope(tangent), slope(column), atol=1e-11)


def test_tangent_damping_is_tau_s_over_v_smooth():
    column = zj.uniform_rods(q=2.0, friction=FRICTION)
    damping = zj.tangent_column(column).damping
    expected = [0.3 * 0.1 * 2 / 0.01, 0.4 * 0.2 * 2 / 0.01]
    np.testing.assert_allclose([damping.c1, damping.c2], expected, rtol=1e-14)


def test_tangent_column_without_friction_is_the_column():
    column = zj.uniform_rods()
    assert zj.tangent_column(column) is column


BAD = {
    "singular inertia": {"b": 1.0},
    "indefinite inertia": {"b": 3.0},
    "negative stiffness": {"kappa": -0.1},
    "a NaN": {"follower": np.nan},
    "an infinite mass": {"a": np.inf},
    "negative damping": {"c2": -1.0},
    "a negative length": {"l2": -1.0},
}
GOOD = {"q": 1.0, "a": 1.0, "b": 0.5, "d": 1.0, "kappa": 1.0, "follower": 0.8}
GOOD |= {"l2": 1.0, "c1": 0.1, "c2": 0.1, "e1": 0.0, "e2": 0.0}


@pytest.mark.parametrize("what", BAD)
def test_bad_numbers_are_an_error_where_concrete(what):
    with pytest.raises(ValueError, match="must"):
        column_of(GOOD | BAD[what])


@pytest.mark.parametrize("what", BAD)
def test_bad_numbers_end_their_lane_alone(what):
    lanes = {k: jnp.array([v, (GOOD | BAD[what])[k], v]) for k, v in GOOD.items()}
    code, s = regimes_and_spectra(lanes)
    assert code.tolist() == [CODE.stable, CODE.invalid, CODE.stable]
    assert np.isnan(s[1]).all() and np.isfinite(s[0]).all()
    np.testing.assert_array_equal(s[0], s[2])


@jax.jit
@jax.vmap
def regimes_and_spectra(p):
    column = column_of(p)
    return zj.regime(column), zj.spectrum(column)


class ByItsSize(AbstractRateFriction):
    """A law of |u|: to JAX without a slope at rest."""

    mu: float

    def levers(self, u1, u2):
        return tuple(jnp.sign(u) * self.mu * jnp.tanh(abs(u) / 0.02) for u in (u1, u2))

    def rate_cut(self):
        return 0.02


def test_a_law_without_its_slope_at_rest_is_refused_where_it_first_meets_numbers():
    start, told = zj.State(omega=(0.0, 0.1)), r"rises by 5 .* derivative there is 0"
    column = zj.uniform_rods(1.0, friction=ByItsSize(0.1))
    for question in (zj.tangent_column, lambda c: zj.settle(c, start)):
        with pytest.raises(ValueError, match=told):
            question(column)

    def swept(q):  # the law's own number is known in a sweep, too
        return zj.settle(zj.uniform_rods(q, friction=ByItsSize(0.1)), start)

    with pytest.raises(ValueError, match=told):
        zj.sweep(swept, q=[1.0, 2.0], progress=False)
    traced = jax.jit(lambda mu: zj.tangent_column(
        zj.uniform_rods(1.0, friction=ByItsSize(mu))).damping.c1)  # fmt: skip
    assert jnp.isnan(traced(0.1))


def own(f):
    class Own(ByItsSize):
        def levers(self, u1, u2):
            return self.mu * f(u1), self.mu * f(u2)

    return zj.tangent_column(zj.uniform_rods(1.0, friction=Own(0.1)))


@pytest.mark.parametrize(
    "f, slope",
    [
        (lambda u: u**3, 0.0),
        (lambda u: jnp.sign(u) * abs(u) ** 1.5, 0.0),
        (lambda u: jnp.sign(u) * abs(u) ** 1.1, 0.0),
        (lambda u: jnp.tanh(u / 1e-8), 1e7),
        (lambda u: jnp.tanh(u / 1e-14), 1e13),
        (lambda u: u / jnp.sqrt(u * u + 1e-4), 10.0),
    ],
)
def test_a_law_whose_slope_jax_sees_is_taken_flat_or_steep(f, slope):
    np.testing.assert_allclose(own(f).damping.c1, slope, rtol=1e-12)  # 2e-16


@pytest.mark.parametrize(
    "f, rise",
    [
        (jnp.sign, "5e.11"),
        (lambda u: jnp.sign(u) * (1 - jnp.exp(-abs(u) / 1e-9)), "1e.08"),
        (lambda u: jnp.sign(u) * abs(u) / (abs(u) + 0.01), "10"),
        (lambda u: jnp.where(u == 0, 0 * u, jnp.tanh(u / 0.01)), "10"),
    ],
)
def test_a_law_whose_slope_jax_does_not_see_is_refused(f, rise):
    with pytest.raises(ValueError, match=rf"rises by {rise} .* there is 0"):
        own(f)
