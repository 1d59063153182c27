"""Critical loads of chains: the literature's numbers, closed forms, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax.linear.matrices import about, torques

BECK = 20.0509536  # of the continuous column, P L^2 / (E I)


def q_cr(chain, kind="flutter"):
    load = zj.critical_load(chain, kind)
    assert load.outcome == zj.CODE.found
    return float(load.q_cr)


def test_becks_column_in_rods_tends_to_becks_load():
    """Its error falls as 1/n; two of Richardson's steps give three digits more."""
    loads = {n: q_cr(zj.beck(n)) for n in (2, 4, 6, 8, 10, 12, 14, 16)}
    # an eigenvalue problem of its own has these digits
    np.testing.assert_allclose([loads[2], loads[4]], [10.1668, 14.9932], atol=5e-5)
    # 10.17, 14.99, 17.51, 18.78: as the page on equations has them
    np.testing.assert_allclose([loads[8], loads[16]], [17.51, 18.78], atol=5e-3)
    order = np.log2((BECK - loads[8]) / (BECK - loads[16]))
    assert abs(order - 1) < 0.1  # measured 1.0046
    # measured 7.5e-5
    assert abs(limit(loads) - BECK) < 1e-3


def limit(loads):
    """Richardson's: the polynomial in 1/n through those of six and more, at zero."""
    counts = np.array([n for n in loads if n >= 6])
    values = [loads[n] for n in counts]
    return np.polynomial.polynomial.polyfit(1 / counts, values, len(counts) - 1)[0]


def test_leipholz_column_tends_to_its_load():
    """40.0537, of the continuous column by Galerkin's method with many modes."""
    loads = {n: q_cr(zj.leipholz(n)) for n in (6, 8, 10, 12, 14, 16)}
    assert abs(limit(loads) - 40.0537) < 1e-3  # measured 1.3e-4


@pytest.mark.parametrize("ratio", [0.0, 0.3, 2.0])
def test_pfluegers_column_is_an_eigenvalue_problem_of_its_own(ratio):
    """Assembled here by unit displacements, its flutter bracketed by halves."""
    n = 4
    mass, springs = np.zeros((n, n)), n * np.eye(n)
    for i in range(n):
        arm = np.array([1 / n] * i + [1 / (2 * n)] + [0.0] * (n - i - 1))
        mass += np.outer(arm, arm) / n
        mass[i, i] += 1 / n**3 / 12
    mass += ratio * np.full((n, n), 1 / n**2)
    bent = np.eye(n) - np.eye(n, k=-1)
    turned = np.eye(n) / n
    turned[:, -1] -= 1 / n

    def flutters(q):
        stiffness = bent.T @ springs @ bent - q * turned
        return np.abs(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).imag).max()

    low, high = 0.0, next(q for q in np.arange(0.1, 30, 0.1) if flutters(q) > 1e-3)
    low = high - 0.1
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (low, middle) if flutters(middle) > 1e-5 else (middle, high)
    # to the root of rounding, as two frequencies meet: measured 2e-10
    assert abs(q_cr(zj.pflueger(n, ratio)) - low) < 1e-8


@pytest.mark.parametrize("n", [2, 3])
def test_a_uniform_foundation_does_not_move_becks_load(n):
    """The foundation's moments are those of the mass: all squares shift alike."""
    bare, borne = q_cr(zj.beck(n)), q_cr(zj.beck(n, foundation=7.0))
    assert abs(bare - borne) < 1e-12 * bare  # measured 1.6e-15


def test_gravity_moves_the_flutter_load_of_two_rods_as_its_quadratic_says():
    r"""$K = [[2 - q - g S_1, q - 1], [-1, 1 - g S_2]]$, S = 3/2, 1/2.

    Flutter where $p_2^2 = 4 p_0 p_4$ with $p_2 = a K_{22} + d K_{11} - b (K_{12} +
    K_{21})$, $p_4 = \det K$: a quadratic in q.
    """
    a, b, d, g = 4 / 3, 1 / 2, 1 / 3, 0.2
    k11, k22 = np.poly1d([-1, 2 - 1.5 * g]), np.poly1d([1 - 0.5 * g])
    k12, k21 = np.poly1d([1, -1]), np.poly1d([-1])
    p2, p4 = a * k22 + d * k11 - b * (k12 + k21), k11 * k22 - k12 * k21
    roots = (p2 * p2 - 4 * (a * d - b * b) * p4).roots
    expected = min(x.real for x in roots if x.real > 0)
    for make in (
        zj.uniform_rods(gravity=zj.Gravity(g)),
        zj.Chain(lengths=(1.0, 1.0), gravity=zj.Gravity(g)),
    ):
        assert abs(q_cr(make) - expected) < 1e-13 * expected


def test_too_heavy_rods_fall_without_load():
    r"""$\det [[2 - 3g/2, -1], [-1, 1 - g/2]] = 0$, the smaller root."""
    g = (2.5 - np.sqrt(3.25)) / 1.5
    below, above = (
        zj.critical_load(zj.Chain(lengths=(1.0, 1.0), gravity=zj.Gravity(x)))
        for x in (0.999 * g, 1.001 * g)
    )
    assert below.outcome == zj.CODE.found
    assert above.outcome == zj.CODE.unstable_at_zero and np.isnan(above.q_cr)


def test_a_dead_load_lets_two_rods_fall_at_the_smaller_root():
    r"""$(2 - p)(1 - p) = 1$ at $p = (3 - \sqrt 5)/2$, of dead and of turned force."""
    expected = (3 - np.sqrt(5)) / 2
    pattern = zj.FollowerForces((0.0, 1.0), follower=0.0)
    chain = zj.Chain(lengths=(1.0, 1.0), forces=pattern)
    assert abs(q_cr(chain, "divergence") - expected) < 1e-14
    for share, outcome in ((0.999, zj.CODE.marginal), (1.001, zj.CODE.divergence)):
        held = zj.Chain(lengths=(1.0, 1.0), dead_load=zj.DeadLoad(share * expected))
        assert zj.regime(held) == outcome


PARTS = {
    "plain": {},
    "damped": {"damping": zj.Viscous(0.1, 0.15, 0.2)},
    "all": {
        "damping": zj.Viscous(0.1, 0.15, 0.2), "air": 0.05, "foundation": 0.1,
        "gravity": zj.Gravity(0.05, 0.4), "rest_angles": (0.1, -0.05, 0.02),
        "dead_load": zj.DeadLoad(0.05, -0.3), "tip_mass": 0.2,
        "forces": zj.FollowerForces((0.2, 0.3, 1.0), (1.0, 0.8, 0.9), 0.7),
    },
}  # fmt: skip


@pytest.mark.parametrize("parts", PARTS)
def test_the_matrices_are_the_derivatives_of_the_motions_own_forces(rng, parts):
    system = zj.Chain(1.3, lengths=(1.0, 0.8, 0.6), **PARTS[parts]).system()
    angles = jnp.asarray(rng.uniform(-0.5, 0.5, 3) * (parts == "all"))

    def right(phi, omega):
        return jnp.stack(system.balance(zj.PhasePoint.of(phi, omega)).right)

    zero = jnp.zeros(3)
    here = about(system, angles)
    np.testing.assert_allclose(torques(system, angles), right(angles, zero), atol=1e-15)
    by_angle, by_rate = jax.jacfwd(right, (0, 1))(angles, zero)
    np.testing.assert_allclose(-here.stiffness, by_angle, atol=2e-15)
    if here.damping is None:
        assert not np.any(by_rate)
    else:
        np.testing.assert_allclose(-here.damping, by_rate, atol=1e-15)


@pytest.mark.parametrize("parts", PARTS)
def test_the_critical_load_is_where_the_spectrum_says(parts):
    """The field's own eigenvalues, a little below and above."""
    make = lambda q: zj.Chain(q, lengths=(1.0, 0.8, 0.6), **PARTS[parts])  # noqa: E731
    load = zj.critical_load(make(0.0))
    assert load.outcome == zj.CODE.found
    s = np.array(zj.spectrum(make(load.q_cr)))
    assert np.min(np.abs(s.imag - float(load.frequency))) < 1e-6
    below, above = (zj.spectral_abscissa(make(x * load.q_cr)) for x in (0.999, 1.001))
    assert below < 1e-7 < above


@pytest.mark.parametrize("parts", PARTS)
def test_its_derivatives_are_those_of_differences(parts):
    """By every number at once, along a line through all of them."""

    def load(x):
        parts_of = PARTS[parts]
        parts_moved = jax.tree.map(lambda p: p * (1 + 0.3 * x), parts_of)
        chain = zj.Chain(
            lengths=(1.0 + x, 0.8 - x, 0.6), masses=(1.0, 1 + 2 * x, 1.0),
            springs=(1.0, 1.0 - x, 1 + 0.5 * x), **parts_moved,
        )  # fmt: skip
        return zj.critical_load(chain).q_cr

    load = jax.jit(load)
    for slope in (jax.grad(load)(0.0), jax.jacfwd(load)(0.0)):
        h = 1e-4
        difference = (8 * (load(h) - load(-h)) - (load(2 * h) - load(-2 * h))) / (
            12 * h
        )
        # measured 1.1e-11
        assert abs(slope - difference) < 1e-9 * abs(difference)
    if parts != "all":  # that would take minutes to compile
        slope = jax.jit(jax.grad(load))
        difference = (slope(h) - slope(-h)) / (2 * h)
        # measured 1.2e-8
        assert abs(jax.grad(slope)(0.0) - difference) < 1e-6 * abs(difference)


def test_closed_forms_of_two_rods_are_met_with_all_derivatives():
    def formula(kappa, m1, c1):
        column = zj.uniform_rods(kappa=kappa, m1=m1, damping=zj.Viscous(c1, 0.2))
        return zj.critical_load(column).q_cr

    def search(kappa, m1, c1):
        chain = zj.Chain(
            lengths=(1.0, 1.0), masses=(m1, 1.0), springs=(kappa, 1.0),
            damping=zj.Viscous(c1, 0.2),
        )  # fmt: skip
        return zj.critical_load(chain).q_cr

    at = 1.1, 0.9, 0.1
    for derivative in (lambda f: f, jax.grad, lambda f: jax.hessian(f, (0, 1, 2))):
        one, other = (
            derivative(f)(*at)
            if derivative is not jax.grad
            else jax.grad(f, (0, 1, 2))(*at)
            for f in (formula, search)
        )
        pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
        for a, b in pairs:
            assert abs(a - b) < 1e-10 * (1 + abs(a))  # measured 3.9e-16


@pytest.mark.parametrize("kappa", [1e4, 10.0, 0.05, 0.01, 1e-3])
def test_springs_far_apart_do_not_hide_the_load(kappa):
    """A search by units of the softest spring must go far: closed forms are met."""
    expected = q_cr(zj.uniform_rods(kappa=kappa))
    search = q_cr(zj.Chain(lengths=(1.0, 1.0), springs=(kappa, 1.0)))
    assert abs(search - expected) < 1e-9 * expected


def test_a_load_that_turns_nothing_has_no_critical_value():
    pattern = zj.FollowerForces((1.0, 0.0, 0.0))
    load = zj.critical_load(zj.Chain(lengths=(1.0,) * 3, forces=pattern))
    assert load.outcome == zj.CODE.no_load


def test_air_alone_is_damping():
    assert zj.regime(zj.Chain(1.0, lengths=(1.0,) * 3, air=1e-9)) == zj.CODE.stable


def test_without_damping_a_law_of_zeros_is_told():
    chain = zj.Chain(lengths=(1.0,) * 3, damping=zj.Viscous(0.0, 0.0, 0.0))
    load, bare = zj.critical_load(chain), zj.critical_load(zj.Chain(lengths=(1.0,) * 3))
    assert load.outcome == zj.CODE.undamped
    assert abs(load.q_cr - bare.q_cr) < 1e-12


def test_an_equilibrium_is_where_nothing_turns_the_rods():
    chain = zj.Chain(
        1.0, lengths=(1.0,) * 3, rest_angles=0.1, gravity=zj.Gravity(0.1, 1.0)
    )
    linear = zj.linearise(chain)
    angles = jnp.array([0.0] * 3)
    system = chain.system()
    for _ in range(30):
        here = about(system, angles)
        angles = angles + jnp.linalg.solve(here.stiffness, torques(system, angles))
    assert jnp.max(jnp.abs(torques(system, angles))) < 1e-14
    np.testing.assert_allclose(
        linear.stiffness, about(system, angles).stiffness, atol=1e-12
    )


def test_where_there_is_no_equilibrium_a_sentence_says_so(refuses):
    chain = zj.Chain(50.0, lengths=(1.0,) * 3, rest_angles=0.5)
    refuses(lambda: zj.linearise(chain), "`column`", "equilibrium", "q = 50")
    traced = jax.jit(
        lambda q: zj.linearise(zj.Chain(q, lengths=(1.0,) * 3, rest_angles=0.5))
    )(50.0)
    assert np.isnan(traced.stiffness).all()


def test_sensitivity_and_stabilise_take_chains():
    chain = zj.beck(3, damping=zj.Viscous(0.1, 0.1, 0.1))
    names = ["damping.c1", "damping.c2", "damping.c3"]
    table = zj.sensitivity(chain, parameters=["springs", *names])
    h = 1e-5

    def load(c1, c3=0.1):
        return q_cr(zj.beck(3, damping=zj.Viscous(c1, 0.1, c3)))

    one = (load(0.1 + h) - load(0.1 - h)) / (2 * h)
    three = (load(0.1, 0.1 + h) - load(0.1, 0.1 - h)) / (2 * h)
    found = table.derivative.sel(parameter=["damping.c1", "damping.c3"])
    # measured 1.5e-9
    np.testing.assert_allclose(found, [one, three], rtol=1e-6)
    best = zj.stabilise(
        lambda c: zj.beck(3, damping=zj.Viscous(c, 0.1, 0.1)), {"c": (0.05, 0.3)}
    )
    assert float(best.load.q_cr) >= load(0.1)


def test_the_regime_of_a_chain_is_that_of_its_eigenvalues():
    load = zj.critical_load(zj.beck(4)).q_cr
    assert zj.regime(zj.beck(4, 0.99 * load)) == zj.CODE.marginal
    assert zj.regime(zj.beck(4, 1.01 * load)) == zj.CODE.flutter
    damping = zj.Viscous(*(0.01,) * 4)
    assert zj.regime(zj.beck(4, 1.0, damping=damping)) == zj.CODE.stable


def test_flutters_end_is_of_two_rods(refuses):
    refuses(lambda: zj.critical_load(zj.beck(3), "flutter_end"), "`kind`", "two rods")
