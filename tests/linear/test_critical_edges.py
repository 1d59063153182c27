"""What a critical load is where it is exact to 50 digits, and where there is none."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from test_critical_loads import (
    KINDS,
    column_of,
    kept,
    load,
    matrices,
    random_parameters,
)

import ziegler_jax as zj
from ziegler_jax.results import CODE

SQRT7 = np.sqrt(7.0)


def to_50_digits(p, start, damped):
    """(q, omega^2) of flutter by det(-w M + i sqrt(w) C + K) = 0, not by Hurwitz.

    Undamped: w is a double root, det = 0 and d det / dw = 0.
    """

    def det(q, w):
        m, c, k0, k1 = matrices(p)
        rate = 1j * mp.sqrt(w) if damped else 0
        e = [
            [-w * m[i][j] + rate * c[i][j] + k0[i][j] + q * k1[i][j] for j in (0, 1)]
            for i in (0, 1)
        ]
        return e[0][0] * e[1][1] - e[0][1] * e[1][0]

    def equations(q, w):
        if damped:
            value = det(q, w)
            return [mp.re(value), mp.im(value)]
        # det is quadratic in w: this difference is its derivative exactly
        return [det(q, w), (det(q, w + 1) - det(q, w - 1)) / 2]

    return mp.findroot(equations, start, tol=1e-80)


@pytest.mark.parametrize("damped", [True, False])
def test_load_frequency_and_derivatives_to_50_digits(damped):
    rows = kept(12, 60, "flutter", damped)[0][:3]

    def numbers(p):
        found = load(p, "flutter", damped)
        return jnp.stack([found.q_cr, found.frequency])

    answers, slopes, bends = (
        np.asarray(jax.jit(jax.vmap(f))(rows))
        for f in (numbers, jax.jacrev(numbers), jax.hessian(lambda p: numbers(p)[0]))
    )
    step = mp.mpf(10) ** -15
    with mp.workdps(50):
        for i, row in enumerate(rows):
            p = [mp.mpf(float(x)) for x in row]
            start = (answers[i, 0], answers[i, 1] ** 2)
            q, w = to_50_digits(p, start, damped)
            assert abs(answers[i, 0] / q - 1) < 1e-13  # worst measured 9e-16
            assert abs(answers[i, 1] / mp.sqrt(w) - 1) < 1e-13  # worst measured 2e-15
            largest = np.abs(row * slopes[i, 0]).max()
            for j in range(8 if damped else 6):
                h = p[j] * step
                near = [
                    to_50_digits([*p[:j], p[j] + s * h, *p[j + 1 :]], (q, w), damped)
                    for s in (1, -1)
                ]
                want = (near[0][0] - near[1][0]) / (2 * h)
                tilt = (mp.sqrt(near[0][1]) - mp.sqrt(near[1][1])) / (2 * h)
                bend = (near[0][0] - 2 * q + near[1][0]) / h**2
                scale = abs(want) + 1e-6 * largest / abs(row[j])
                # worst measured 8e-13 (slope), 2e-12 (tilt), 6e-13 (bend)
                assert abs(slopes[i, 0, j] - want) < 1e-11 * scale
                tilt_scale = abs(tilt) + 1e-6 * abs(mp.sqrt(w) / row[j])
                assert abs(slopes[i, 1, j] - tilt) < 1e-10 * tilt_scale
                bend_scale = abs(bend) + abs(want / row[j])
                assert abs(bends[i, j, j] - bend) < 1e-9 * bend_scale


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_are_central_differences_of_masses_lengths_and_air(kind):
    # six points, h = 3e-4 p; margin: no elasticity above 5, no neighbour without load
    def q_cr(p):
        m1, m2, l2, kappa, eta, c1, c2, e1, e2 = p
        damping = zj.Sum(zj.Viscous(c1, c2), zj.Air(e1, e2, l2))
        column = zj.uniform_rods(
            m1=m1, m2=m2, l2=l2, kappa=kappa, follower=eta, damping=damping
        )
        return zj.critical_load(column, kind).q_cr

    rng = np.random.default_rng(13)
    n = 12_000 if kind == "flutter" else 22_000
    low = np.array([0.3, 0.3, 0.5, 0.3, 0.6, 0.05, 0.05, 0.05, 0.05])
    high = np.array([3.0, 3.0, 2.0, 3.0, 1.2, 1.0, 1.0, 1.0, 1.0])
    if kind == "divergence":
        low[4], high[4] = -0.3, 0.5
    p = rng.uniform(low, high, (n, 9))
    many = jax.jit(jax.vmap(q_cr))
    q, slopes = jax.jit(jax.vmap(jax.value_and_grad(q_cr)))(p)
    q, slopes = np.asarray(q), np.asarray(slopes)
    differences = np.empty_like(p)
    for j in range(9):
        h = 3e-4 * p[:, j]
        step = np.zeros_like(p)
        step[:, j] = h
        side = [np.asarray(many(p + k * step) - many(p - k * step)) for k in (1, 2, 3)]
        differences[:, j] = (45 * side[0] - 9 * side[1] + side[2]) / 60 / h
    elasticity = np.abs(p * slopes) / q[:, None]
    keep = np.isfinite(differences).all(axis=1) & (elasticity.max(axis=1) < 5)
    assert keep.sum() > 10_000
    # an entry is compared to itself, or to an elasticity of a thousandth: below it
    # the rounding of q over h, 1e-12, is all that a difference shows
    scale = np.abs(slopes) + 1e-3 * q[:, None] / p
    error = np.abs(differences - slopes)[keep] / scale[keep]
    assert error.max() < 1e-6  # worst measured 6e-9


@pytest.mark.parametrize("damped", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_no_number_or_derivative_is_nan_in_silence(kind, damped):
    p = random_parameters(14, 5000)
    found = jax.jit(jax.vmap(lambda p: load(p, kind, damped)))(p)
    stands = np.asarray(found.outcome) >= CODE.preceded
    assert 0 < stands.sum() < len(p)
    np.testing.assert_array_equal(np.isfinite(found.q_cr), stands)
    np.testing.assert_array_equal(np.isfinite(found.frequency), stands)
    slopes = jax.jit(jax.vmap(jax.grad(lambda p: load(p, kind, damped).q_cr)))(p)
    inertia_and_springs = np.asarray(slopes)[:, :4]
    np.testing.assert_array_equal(np.isfinite(inertia_and_springs).all(axis=1), stands)
    assert np.isnan(inertia_and_springs[~stands]).any(axis=1).all()


def test_derivatives_of_the_seed_are_closed_forms():
    # q_cr = (a + 2 b + d (kappa + 1) - 2 sqrt(kappa (a d - b^2))) / (b + d), eta = 1
    slopes = jax.grad(lambda c: zj.critical_load(c).q_cr)(zj.uniform_rods())
    root, q = SQRT7 / 6, (18 - 2 * SQRT7) / 5
    np.testing.assert_allclose(float(slopes.a), (1 - 1 / 3 / root) * 6 / 5, rtol=1e-13)
    np.testing.assert_allclose(
        float(slopes.b), (2 + 2 * 0.5 / root - q) * 6 / 5, rtol=1e-13
    )
    np.testing.assert_allclose(
        float(slopes.d), (2 - 4 / 3 / root - q) * 6 / 5, rtol=1e-13
    )
    np.testing.assert_allclose(float(slopes.kappa), (1 / 3 - root) * 6 / 5, rtol=1e-13)


def test_forward_and_reverse_agree_to_second_order_in_every_leaf():
    column = zj.uniform_rods(
        follower=0.9, damping=zj.Sum(zj.Viscous(0.1, 0.3), zj.Air(0.2, 0.1))
    )
    leaves, tree = jax.tree.flatten(column)

    def q_cr(x):
        return zj.critical_load(jax.tree.unflatten(tree, list(x))).q_cr

    x = jnp.array(leaves)
    forward, reverse = (jax.jit(way(q_cr))(x) for way in (jax.jacfwd, jax.jacrev))
    np.testing.assert_allclose(forward, reverse, rtol=1e-12, atol=1e-14)
    ways = [jax.jit(f(g(q_cr)))(x) for f, g in _WAYS]
    for other in ways[1:]:
        np.testing.assert_allclose(ways[0], other, rtol=1e-10, atol=1e-10)
    used = [p for p in jax.tree_util.tree_leaves_with_path(column)]
    names = [jax.tree_util.keystr(path, simple=True) for path, _ in used]
    for name, slope in zip(names, forward, strict=True):
        assert (slope != 0) == (name not in ("q", "m2", "s1")), name


_WAYS = [
    (jax.jacfwd, jax.jacrev),
    (jax.jacrev, jax.jacrev),
]


def test_the_columns_own_load_does_not_matter():
    at = [zj.critical_load(zj.uniform_rods(q=q)).q_cr for q in (0.0, 2.6, -4.0)]
    assert at[0] == at[1] == at[2]
    slope = jax.grad(lambda q: zj.critical_load(zj.uniform_rods(q=q)).q_cr)(1.0)
    assert float(slope) == 0.0


def test_the_limit_of_vanishing_damping_depends_on_the_ratio_alone():
    def limit(c1, c2):
        return float(zj.critical_load(zj.uniform_rods(damping=zj.Viscous(c1, c2))).q_cr)

    for ratio in (0.1, 1.0, 30.0):
        at = [limit(ratio * c, c) for c in (1e-10, 1e-100, 1e-300)]
        np.testing.assert_allclose(at, at[0], rtol=1e-14)
        assert at[0] < (18 - 2 * SQRT7) / 5 - 1e-4


def test_derivatives_along_vanishing_damping_scale_with_it():
    # homogeneous of degree 0: c dq/dc is one number across the ratio, opposite signs
    def slopes(c):
        def load(c1, c2):
            return zj.critical_load(zj.uniform_rods(damping=zj.Viscous(c1, c2))).q_cr

        return jax.grad(load, (0, 1))(c, c)

    for c in (1e-9, 1e-200):
        s1, s2 = slopes(c)
        np.testing.assert_allclose(float(s1) * c, -float(s2) * c, rtol=1e-13)
        np.testing.assert_allclose(float(s1) * c, float(slopes(1e-12)[0]) * 1e-12)
    assert np.isfinite(float(s1))


def test_zero_damping_is_the_undamped_load_and_says_that_it_jumps():
    column = zj.uniform_rods(damping=zj.Viscous(0.0, 0.0))
    found = zj.critical_load(column)
    np.testing.assert_allclose(float(found.q_cr), (18 - 2 * SQRT7) / 5, rtol=1e-14)
    assert int(found.outcome) == CODE.undamped
    near = zj.critical_load(zj.uniform_rods(damping=zj.Viscous(1e-300, 1e-300)))
    assert float(near.q_cr) < 1.7 and int(near.outcome) == CODE.found
    slopes = jax.grad(lambda c: zj.critical_load(c).q_cr)(column)
    plain = jax.grad(lambda c: zj.critical_load(c).q_cr)(zj.uniform_rods())
    for name in ("a", "b", "d", "kappa", "follower"):
        np.testing.assert_allclose(getattr(slopes, name), getattr(plain, name), 1e-13)
    assert float(slopes.damping.c1) == float(slopes.damping.c2) == 0.0


def test_a_double_root_is_refused():
    # undamped, kappa = 1, l2 = 1, (1 - eta)^2 9 = 4 (1 - eta): det K touches zero
    found = zj.critical_load(zj.uniform_rods(follower=5 / 9), "divergence")
    assert int(found.outcome) == CODE.double_root and np.isnan(found.q_cr)
    # beside it: a load below eta = 5/9, none above; slopes grow as the inverse root
    make = lambda eta: zj.critical_load(zj.uniform_rods(follower=eta), "divergence")  # noqa: E731
    assert int(make(5 / 9 + 1e-9).outcome) == CODE.no_load
    slope = [float(jax.grad(lambda e: make(e).q_cr)(5 / 9 - x)) for x in (1e-6, 1e-8)]
    np.testing.assert_allclose(slope[1] / slope[0], 10, rtol=0.01)
    assert np.isnan(jax.grad(lambda e: make(e).q_cr)(5 / 9))


def test_one_frequency_for_both_modes_at_zero_load_is_a_double_root():
    found = zj.critical_load(zj.Column(0.0, 2.0, -1.0, 1.0, follower=0.9))
    assert int(found.outcome) == CODE.double_root


def test_at_an_exchange_of_the_kinds_each_keeps_its_load_and_derivative():
    # more damping of joint 2 lifts flutter above the divergence of eta > 1
    @jax.jit
    def both(c2):
        p = (2.4, 0.57, 0.75, 0.97, 1.12, 1.76, 1.87, c2)
        return [load(p, kind) for kind in KINDS]

    low, high = 0.2, 0.4
    above = both(low)[0].q_cr > both(low)[1].q_cr
    assert above != (both(high)[0].q_cr > both(high)[1].q_cr)
    for _ in range(60):
        c2 = (low + high) / 2
        flutter, divergence = both(c2)
        same = (flutter.q_cr > divergence.q_cr) == above
        low, high = (c2, high) if same else (low, c2)
    codes = [[int(x.outcome) for x in both(c2 + h)] for h in (-1e-6, 1e-6)]
    found, preceded = int(CODE.found), int(CODE.preceded)
    assert sorted(codes) == [[preceded, found], [found, preceded]]
    slope = jax.jit(jax.grad(lambda c2: both(c2)[0].q_cr))
    assert float(slope(c2)) != 0
    np.testing.assert_allclose(slope(c2 - 1e-9), slope(c2 + 1e-9), rtol=1e-6)


def test_a_free_joint_is_unstable_at_zero():
    for damping in (None, zj.Viscous(0.1, 0.1)):
        found = zj.critical_load(zj.uniform_rods(kappa=0.0, damping=damping))
        assert int(found.outcome) == CODE.unstable_at_zero and np.isnan(found.q_cr)


def test_damping_that_misses_a_mode_is_not_stable_at_zero():
    # phi1 = phi2 is a mode at q = 0 where b = -d: joint 2 never turns
    column = zj.Column(0.0, 2.0, -0.5, 0.5, damping=zj.Viscous(0.0, 0.3))
    assert int(zj.critical_load(column).outcome) == CODE.unstable_at_zero


@pytest.mark.parametrize("kind", KINDS)
def test_an_invalid_lane_is_alone(kind):
    p = random_parameters(15, 1)[0]
    bad = {0: np.inf, 1: 9.0, 2: -1.0, 3: -0.5, 4: np.nan, 6: -1.0, 7: np.nan}
    rows = np.stack([p, *(np.where(np.arange(8) == j, x, p) for j, x in bad.items())])
    many = jax.jit(jax.vmap(lambda p: load(p, kind)))
    found, healthy = many(rows), many(np.broadcast_to(p, rows.shape))
    assert np.asarray(found.outcome)[1:].tolist() == [CODE.invalid] * 7
    assert np.isnan(found.q_cr[1:]).all() and np.isnan(found.frequency[1:]).all()
    np.testing.assert_array_equal(found.q_cr[0], healthy.q_cr[0])
    assert found.outcome[0] == healthy.outcome[0] >= CODE.preceded


def test_misuse_is_an_error_that_names_the_argument():
    with pytest.raises(ValueError, match="`kind` must be one of"):
        zj.critical_load(zj.uniform_rods(), "buckling")  # pyright: ignore
    with pytest.raises(ValueError, match="flutter_end"):
        zj.critical_load(zj.uniform_rods(damping=zj.Viscous(1, 1)), "flutter_end")
    with pytest.raises(ValueError, match="`column` must be"):
        zj.critical_load(2.0)  # pyright: ignore
    for bad in ({"kappa": -1.0}, {"kappa": np.nan}, {"m1": -1.0}):
        with pytest.raises(ValueError, match="must be"):
            zj.critical_load(zj.uniform_rods(**bad))
    with pytest.raises(ValueError, match="positive definite"):
        zj.critical_load(zj.Column(0.0, 1.0, 1.0, 1.0))


def test_the_other_root_of_a_dead_loads_stiffness_is_no_loss():
    # beyond the first root of det K the second rises: stiffness comes back
    found = zj.critical_load(column_of([4 / 3, 0.5, 1 / 3, 1, 0.0, 1, 0, 0], False))
    assert int(found.outcome) == CODE.no_load
