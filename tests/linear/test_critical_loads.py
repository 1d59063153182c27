"""Critical loads and their derivatives, against formulas that share no code with them.

Margin of the random columns: the two roots of the boundary's quadratic differ by more
than a tenth of their mean, |gap| > 0.01 of the larger of f1^2 and 4 |f0 f2|.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax.results import CODE

SQRT2, SQRT7 = np.sqrt(2.0), np.sqrt(7.0)
KINDS = ("flutter", "divergence")
NAMES = ("a", "b", "d", "kappa", "follower", "l2", "c1", "c2")


def column_of(p, damped=True, q=0.0):
    a, b, d, kappa, eta, l2, c1, c2 = p
    damping = zj.Viscous(c1, c2) if damped else None
    return zj.Column(q, a, b, d, kappa, eta, damping, l2=l2)


def load(p, kind="flutter", damped=True):
    return zj.critical_load(column_of(p, damped), kind)


def random_parameters(seed, n, follower=(-0.5, 1.7)):
    rng = np.random.default_rng(seed)
    a, d = rng.uniform(0.3, 4, n), rng.uniform(0.2, 3, n)
    b = rng.uniform(-0.5, 0.9, n) * np.sqrt(a * d)
    damping = 10 ** rng.uniform(-3, 0.3, (2, n))
    other = 10 ** rng.uniform(-1, 1, n), rng.uniform(*follower, n)
    return np.stack([a, b, d, *other, rng.uniform(0.4, 2, n), *damping], axis=1)


def matrices(p):
    """M, C and K(q) = K0 + q K1, written down once more."""
    a, b, d, kappa, eta, l2, c1, c2 = p
    k1 = ((-1.0, eta), (0.0, -l2 * (1 - eta)))
    return (
        ((a, b), (b, d)),
        ((c1 + c2, -c2), (-c2, c2)),
        ((kappa + 1, -1.0), (-1.0, 1.0)),
        k1,
    )


def boundary(p, q, kind, damped):
    """The textbook boundary function of physics, from determinants at one load."""
    (m, c, k0, k1), zero = matrices(p), ((0.0, 0.0), (0.0, 0.0))
    c = c if damped else zero
    k = [[k0[i][j] + q * k1[i][j] for j in (0, 1)] for i in (0, 1)]

    def mixed(x, y):  # the part of det(x s + y) linear in s
        return (
            x[0][0] * y[1][1]
            + x[1][1] * y[0][0]
            - x[0][1] * y[1][0]
            - (x[1][0] * y[0][1])
        )

    def det(x):
        return x[0][0] * x[1][1] - x[0][1] * x[1][0]

    p0, p1, p3, p4 = det(m), mixed(m, c), mixed(c, k), det(k)
    p2 = mixed(m, k) + det(c)
    if kind == "divergence":
        return p4
    if damped:
        return p1 * p2 * p3 - p0 * p3**2 - p1**2 * p4
    return p2**2 - 4 * p0 * p4


def closed_form(p, kind, damped):
    """Both roots of that quadratic, and its relative gap."""

    def at(q):
        return boundary(p, q, kind, damped)

    def slope(q):
        return jax.jvp(at, (q,), (1.0,))[1]

    f0, f1, f2 = at(0.0), slope(0.0), jax.jvp(slope, (0.0,), (1.0,))[1] / 2
    gap = f1 * f1 - 4 * f0 * f2
    size = jnp.maximum(f1 * f1, 4 * jnp.abs(f0 * f2))
    side = jnp.sqrt(jnp.where(gap > 0, gap, jnp.nan))
    large = -(f1 + jnp.where(f1 < 0, -side, side))  # no cancellation
    return jnp.stack([2 * f0 / large, large / (2 * f2)]), gap / size


def close(value, exact, rtol=1e-12):
    np.testing.assert_allclose(float(value), float(exact), rtol=rtol, atol=0)


def test_closed_forms_of_the_seed():
    column = zj.uniform_rods()
    close(zj.critical_load(column).q_cr, (18 - 2 * SQRT7) / 5)
    close(zj.critical_load(column, "flutter_end").q_cr, (18 + 2 * SQRT7) / 5)
    # both frequencies there: p2 = 2 sqrt(p0 p4), omega^4 = p4 / p0 = 36/7
    close(zj.critical_load(column).frequency, (36 / 7) ** 0.25)
    assert int(zj.critical_load(column).outcome) == CODE.found


def test_closed_forms_of_zieglers_column():
    close(zj.critical_load(zj.point_masses(2, 1)).q_cr, 7 / 2 - SQRT2)
    close(zj.critical_load(zj.point_masses(2, 1), "flutter_end").q_cr, 7 / 2 + SQRT2)


@pytest.mark.parametrize("c", [1e-200, 1e-9, 1e-3, 0.1, 0.5, 1.0, 2.0])
def test_ziegler_with_equal_damping_is_41_28_and_half_c_squared(c):
    made = zj.point_masses(2, 1, damping=zj.Viscous(c, c))
    close(zj.critical_load(made).q_cr, 41 / 28 + c * c / 2)


@pytest.mark.parametrize("c", [1e-300, 1e-100, 1e-9])
def test_vanishing_damping_of_uniform_rods_gives_74_45(c):
    close(zj.critical_load(zj.uniform_rods(damping=zj.Viscous(c, c))).q_cr, 74 / 45)


def test_proportional_air_has_its_closed_form():
    # C = e M: s (s + e) takes the undamped s^2, p2^2 + 2 e^2 p0 p2 - 4 p0 kappa = 0
    for e in (1e-6, 0.1, 1.0):
        p0 = 7 / 36
        p2 = -(e**2) * p0 + np.sqrt(e**4 * p0**2 + 4 * p0)
        found = zj.critical_load(zj.uniform_rods(damping=zj.Air(e, e)))
        close(found.q_cr, (3 - p2) * 6 / 5)
    assert found.q_cr > zj.critical_load(zj.uniform_rods()).q_cr


def test_unequal_air_destabilises():
    for e1, e2 in ((1e-6, 0.0), (0.0, 1e-6)):
        found = zj.critical_load(zj.point_masses(2, 1, damping=zj.Air(e1, e2)))
        assert found.q_cr < 7 / 2 - SQRT2 - 0.01


def test_dead_load_buckles():
    # eta = 0, kappa = 1, l2 = 1: q^2 - 3 q + 1 = 0
    found = zj.critical_load(zj.uniform_rods(follower=0.0), "divergence")
    close(found.q_cr, (3 - np.sqrt(5)) / 2)
    assert float(found.frequency) == 0.0 and int(found.outcome) == CODE.found


def test_a_pure_follower_load_has_no_divergence_and_a_dead_load_no_flutter():
    for column, kind in (
        (zj.uniform_rods(), "divergence"),
        (zj.uniform_rods(follower=0.0), "flutter"),
    ):
        found = zj.critical_load(column, kind)
        assert int(found.outcome) == CODE.no_load
        assert np.isnan(found.q_cr) and np.isnan(found.frequency)


@pytest.mark.parametrize("damped", [True, False])
def test_the_first_loss_of_stability_is_where_eigenvalues_lose_it(damped):
    p = random_parameters(10, 300)
    found = {k: jax.vmap(lambda p, k=k: load(p, k, damped))(p) for k in KINDS}
    first = np.min(
        [np.where(f.outcome == CODE.found, f.q_cr, np.inf) for f in found.values()],
        axis=0,
    )
    loads = np.linspace(0, 12, 601)
    for i, row in enumerate(p):
        m, c, k0, k1 = map(np.asarray, matrices(row))
        k = k0 + loads[:, None, None] * k1
        if damped:
            inverse = np.linalg.inv(m)
            lower = np.concatenate([-inverse @ k, [-inverse @ c] * len(loads)], axis=2)
            upper = np.concatenate([np.zeros((2, 2)), np.eye(2)], axis=1)
            field = np.concatenate([[upper] * len(loads), lower], axis=1)
            lost = np.linalg.eigvals(field).real.max(axis=1) > 1e-9
        else:
            squares = np.linalg.eigvals(np.linalg.inv(m) @ k)  # omega^2
            lost = (np.abs(squares.imag) > 1e-6).any(axis=1)
            lost |= (squares.real < -1e-9).any(axis=1)
        if lost.any():
            at = loads[lost.argmax()]
            assert at - 0.0201 <= first[i] <= at + 1e-9
        else:
            assert first[i] > 12 - 0.0201


def kept(seed, n, kind, damped):
    """Random columns with such a load, within the margin; the load; which root."""
    p = random_parameters(seed, n)
    found = jax.jit(jax.vmap(lambda p: load(p, kind, damped)))(p)
    roots, gap = jax.vmap(lambda p: closed_form(p, kind, damped))(p)
    keep = (np.asarray(found.outcome) >= CODE.preceded) & (np.asarray(gap) > 0.01)
    # beyond: a load that hardly follows or buckles
    keep &= np.asarray(found.q_cr) < 100
    which = np.abs(roots - found.q_cr[:, None]).argmin(axis=1)
    return p[keep], np.asarray(found.q_cr)[keep], np.asarray(roots)[keep], which[keep]


@pytest.mark.parametrize("damped", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_loads_and_derivatives_are_those_of_the_closed_form(kind, damped):
    p, q, roots, which = kept(11, 26_000 if kind == "flutter" else 15_000, kind, damped)
    p, q, roots, which = (x[:10_000] for x in (p, q, roots, which))
    assert len(p) == 10_000
    exact = np.take_along_axis(roots, which[:, None], axis=1)[:, 0]
    np.testing.assert_allclose(q, exact, rtol=1e-12)  # worst measured 2.5e-13

    def ours(p, which):
        return load(p, kind, damped).q_cr

    def theirs(p, which):
        return closed_form(p, kind, damped)[0][which]

    want = jax.jit(jax.vmap(jax.grad(theirs)))(p, which)
    # an entry is compared to itself, or to a millionth of the largest elasticity
    floor = 1e-6 * jnp.max(jnp.abs(p * want), axis=1, keepdims=True) / jnp.abs(p)
    for way in (jax.grad, jax.jacfwd):
        got = jax.jit(jax.vmap(way(ours)))(p, which)
        error = jnp.abs(got - want) / (jnp.abs(want) + floor)
        # worst measured 2e-10, damped: the closed form's own cancellation (against 50
        # digits it is off by as much, ours by 1e-11)
        assert error.max() < 1e-9


@pytest.mark.parametrize("damped", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_second_derivatives_are_those_of_the_closed_form(kind, damped):
    p, _, _, which = kept(16, 26_000 if kind == "flutter" else 15_000, kind, damped)
    p, which = p[:10_000], which[:10_000]

    def ours(p, which):
        return load(p, kind, damped).q_cr

    def theirs(p, which):
        return closed_form(p, kind, damped)[0][which]

    got = jax.jit(jax.vmap(jax.hessian(ours)))(p, which)
    want = jax.jit(jax.vmap(jax.hessian(theirs)))(p, which)
    size = jnp.abs(p[:, :, None] * p[:, None, :])
    error = jnp.abs(got - want) * size
    error = error.max(axis=(1, 2)) / (jnp.abs(want) * size).max(axis=(1, 2))
    assert error.max() < 1e-9  # worst measured 2e-12
