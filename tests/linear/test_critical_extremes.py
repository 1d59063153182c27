"""Critical loads where a joint is soft, undamped, or damped beyond all measure."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from test_critical_loads import boundary, load

import ziegler_jax as zj
from ziegler_jax.model.damping import AbstractDamping
from ziegler_jax.results import CODE


def test_a_soft_undamped_base_has_its_closed_form():
    # uniform rods, eta = 1, c1 = 0, any c2: q_cr = 5 kappa / 16
    kappa = jnp.geomspace(1e-8, 1e3, 45)

    def found(kappa):
        damping = zj.Viscous(0.0, 0.1)
        return zj.critical_load(zj.uniform_rods(kappa=kappa, damping=damping))

    loads = jax.vmap(found)(kappa)
    assert (loads.outcome == CODE.found).all()
    # worst measured 4e-16
    np.testing.assert_allclose(loads.q_cr, 5 * kappa / 16, rtol=1e-13, atol=0)
    for way in (jax.grad, jax.jacfwd):
        slope = jax.vmap(way(lambda kappa: found(kappa).q_cr))(kappa)
        np.testing.assert_allclose(slope, 5 / 16, rtol=1e-13)


def test_soft_joints_with_one_undamped_to_50_digits():
    rng = np.random.default_rng(20)
    n = 40
    a, d = rng.uniform(0.3, 4, n), rng.uniform(0.2, 3, n)
    b = rng.uniform(-0.5, 0.9, n) * np.sqrt(a * d)
    eta = np.where(np.arange(n) % 3 == 0, 1.0, rng.uniform(-0.5, 1.7, n))
    kappa, l2 = 10 ** rng.uniform(-8, 0, n), rng.uniform(0.4, 2, n)
    c = 10 ** rng.uniform(-6, 2, (2, n))
    c[0, ::2], c[1, 1::4] = 0.0, 0.0
    hard = [2.1754393997571446, -0.18487899434499413, 0.08780251434155983]
    tail = [-2.7113808001075403, 15.700071777749642, 0.0, 160.40290791678174]
    rows = np.stack([a, b, d, kappa, eta, l2, *c], axis=1)
    soft = [0.11350387733836308, 2.1382780840654867e-06]
    rows = np.array([*rows, *([*hard, k, *tail] for k in soft)])
    found, slopes = (
        jax.jit(jax.vmap(f))(rows) for f in (load, jax.grad(lambda p: load(p).q_cr))
    )
    assert (found.outcome[-2:] == CODE.found).all()
    also = jax.vmap(lambda p: load(p, "divergence").outcome)(rows)
    assert (also[-2:] == CODE.preceded).all()
    kept = np.flatnonzero(found.outcome >= CODE.preceded)
    assert len(kept) > 20
    with mp.workdps(80):
        for i in kept:
            p = [mp.mpf(float(x)) for x in rows[i]]
            q = exact_root(p, float(found.q_cr[i]))
            assert abs(float(found.q_cr[i]) / q - 1) < 1e-13  # worst measured 8e-15
            h = p[3] * mp.mpf(10) ** -25
            near = [exact_root([*p[:3], p[3] + s, *p[4:]], q) for s in (h, -h)]
            slope = (near[0] - near[1]) / (2 * h)
            size = abs(slope) + 1e-3 * abs(q / p[3])  # without c2 it is zero
            assert abs(float(slopes[i, 3]) - slope) < 1e-11 * size


def exact_root(p, near):
    """The root of the textbook quadratic that is nearest."""
    f = [boundary(p, mp.mpf(q), "flutter", True) for q in (-1, 0, 1)]
    f1, f2 = (f[2] - f[0]) / 2, (f[2] + f[0]) / 2 - f[1]
    side = mp.sqrt(f1 * f1 - 4 * f[1] * f2)
    roots = [2 * f[1] / (s - f1) for s in (side, -side) if s != f1]
    return min(roots, key=lambda q: abs(q - near))


def test_a_damping_without_symmetry_has_its_textbook_boundary():
    class Skew(AbstractDamping):
        c: jax.Array

        def matrix(self, cos_d, omega):
            return (self.c[0], self.c[1]), (self.c[2], self.c[3])

        def valid(self):
            return jnp.isfinite(self.c).all()

    def polynomial(q, skew):
        m, c, k = zj.linearise(zj.Column(q, 1.3, 0.4, 0.5, 0.7, 0.8, skew, l2=1.2))
        at = np.linspace(-1, 1, 5)
        values = [np.linalg.det(m * s * s + c * s + k) for s in at]
        return np.polyfit(at, values, 4)

    skew = Skew(jnp.array([0.3, 0.1, -0.25, 0.4]))
    column = zj.Column(0.0, 1.3, 0.4, 0.5, 0.7, 0.8, skew, l2=1.2)
    found = zj.critical_load(column)
    p0, p1, p2, p3, p4 = polynomial(float(found.q_cr), skew)
    assert abs(p1 * p2 * p3 - p0 * p3**2 - p1**2 * p4) < 1e-12
    np.testing.assert_allclose(float(found.frequency) ** 2, p3 / p1, rtol=1e-11)


BROKEN = {
    "a light mass": lambda x: zj.uniform_rods(m1=-0.5 * x),
    "a negative length": lambda x: zj.uniform_rods(l2=-x),
    "a lever that is NaN": lambda x: zj.Column(0.0, 1.0, 0.5, 1.0, l2=x * jnp.nan),
    "a negative lever": lambda x: zj.Column(0.0, 1.0, 0.5, 1.0, l2=-x),
    "a negative mass of rod 2": lambda x: zj.Column(0.0, 1.0, 0.5, 1.0, m2=-x),
    "a knee below nothing": lambda x: zj.point_masses(-0.5 * x, 1.0),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_rule_known_only_when_traced_is_invalid(what):
    def ask(x):
        column = BROKEN[what](x)
        return zj.critical_load(column).outcome, zj.regime(column)

    critical, regime = jax.vmap(ask)(jnp.array([1.0]))
    assert (critical == CODE.invalid).all() and (regime == CODE.invalid).all()


@pytest.mark.parametrize("d", [0.3, 0.5, 0.7])
def test_an_unloaded_mode_that_damping_misses_is_marginal(d):
    # b = -d and c1 = 0: joint 2 never turns in phi1 = phi2
    column = zj.Column(0.0, 2.0, -d, d, damping=zj.Viscous(0.0, 0.3))
    assert int(zj.regime(column)) == CODE.marginal


@pytest.mark.parametrize("c", [2.3e-308, 1e-300, 1e-150])
def test_the_smallest_damping_gives_the_limit(c):
    found = zj.critical_load(zj.uniform_rods(damping=zj.Viscous(c, c)))
    np.testing.assert_allclose(float(found.q_cr), 74 / 45, rtol=1e-14)
    assert int(found.outcome) == CODE.found


@pytest.mark.parametrize("c", [1e6, 1e8, 1e20])
def test_large_damping_keeps_its_signs(c):
    # flutter where r and p4 change sign together: r is there a small difference
    damping = zj.Viscous(c, c)
    found = zj.critical_load(zj.uniform_rods(follower=0.3, damping=damping))
    assert int(found.outcome) == CODE.no_load
    # in the limit p2 s^2 + p3 s + p4 with p2 = det C: its own discriminant decides
    column = zj.uniform_rods(6.0, follower=0.3, damping=damping)
    assert int(zj.regime(column)) == CODE.divergence


def test_second_derivatives_in_damping_overflow_below_1e_150():
    def bend(c):
        def q(c1):
            return zj.critical_load(zj.uniform_rods(damping=zj.Viscous(c1, c))).q_cr

        return jax.jvp(jax.grad(q), (c,), (1.0,))[1]

    scaled = jax.jit(lambda c: bend(c) * c * c)
    np.testing.assert_allclose(scaled(1e-150), scaled(1e-9), rtol=1e-9)
    assert not np.isfinite(jax.jit(bend)(1e-160))


def test_one_joint_damped_beyond_telling_is_invalid():
    column = zj.uniform_rods(2.3, follower=0.5, damping=zj.Viscous(500.0, 5e13))
    assert int(zj.regime(column)) == CODE.invalid


def test_drag_over_another_length_is_refused():
    for law in (zj.Air(0.1, 0.1), zj.Sum(zj.Viscous(0.1, 0.1), zj.Air(0.1, 0.1))):
        with pytest.raises(ValueError, match="`l2` of `Air` must be the column's, 2"):
            zj.uniform_rods(l2=2.0, damping=law)
    assert zj.uniform_rods(l2=2.0, damping=zj.Air(0.1, 0.1, 2.0)).damping is not None
