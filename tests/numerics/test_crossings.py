"""Where a guard first falls below zero within a step: dips, grazing, both ends.

`hermite` looks at cubics and quartics between a step's ends, `bernstein` at the power
series of a step. The truth are all roots, by NumPy.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import Polynomial

from ziegler_jax.numerics.bernstein import first_event, first_look
from ziegler_jax.numerics.hermite import (
    HermiteQuartic,
    Quintic,
    bezier_verdict,
    chord_root,
    extrema,
    falls_below,
    place,
)
from ziegler_jax.numerics.passages import first_fall, share_within

COUNT = 20_000


@jax.jit
def looked_at(g0, g1, v0, v1, bend, tol):
    """As a step does: whether the polygon decides, whether it falls, and where."""
    course = HermiteQuartic(g0, g1, v0, v1, bend)
    plain, falls = bezier_verdict(course, tol)
    closely, left, right = falls_below(course, tol, extrema(course))
    left, right = jnp.where(plain, 0.0, left), jnp.where(plain, 1.0, right)
    falls = jnp.where(plain, falls, closely)
    x = place(course, -0.5 * tol, chord_root(course, left, right), left, right)
    return plain, falls, x, course(x), course.slope(x)


def of(coefficients, tol):
    """The same of polynomials on [0, 1], rows of up to five coefficients."""
    c = np.zeros((len(coefficients), 5))
    c[:, : coefficients.shape[1]] = coefficients
    ahead = c @ np.ones(5), c @ np.arange(5.0)
    ends = c[:, 0], ahead[0], c[:, 1], ahead[1], c[:, 4]
    return [np.asarray(x) for x in looked_at(*ends, np.full(len(c), tol))]


def first_root(coefficients, level):
    """The first place in [0, 1] where the polynomial falls to `level`, or NaN."""
    p = Polynomial(coefficients) - level
    if p(0.0) < 0:
        return 0.0
    roots = p.roots()
    real = np.sort(roots[np.abs(roots.imag) < 1e-12].real)
    falls = [x for x in real if 0 <= x <= 1 and p.deriv()(x) < 0]
    return falls[0] if falls else np.nan


def dips(depth, rng, count=COUNT):
    """Cubics that are positive at 0 and 1, and least within, at -depth."""
    at, bend = rng.uniform(0.02, 0.98, count), 10 ** rng.uniform(-1, 1, count)
    # (x - at)^2 (1 + tilt (x - at)) has no other minimum in [0, 1]
    tilt = rng.uniform(-0.6, 0.6, count)
    c = np.stack(
        [
            at**2 - tilt * at**3,
            -2 * at + 3 * tilt * at**2,
            1 - 3 * tilt * at,
            tilt,
        ],
        axis=1,
    )
    c *= bend[:, None]
    c[:, 0] -= depth
    return at, bend, c


@pytest.mark.parametrize("depth", [1e-12, 1e-9, 1e-6, 1e-4])
def test_a_guard_that_dips_and_comes_back_within_a_step_is_seen(rng, depth):
    at, bend, c = dips(depth, rng)
    inside = c[:, 0] > 2 * depth, c.sum(1) > 2 * depth
    inside = inside[0] & inside[1]
    assert inside.mean() > 0.9
    tol = 0.1 * depth
    plain, falls, x, _, slope = (part[inside] for part in of(c, tol))
    assert falls.all() and not plain.any()
    # on the way down; how near to the root a step is told by the guard itself
    assert (x < at[inside]).all() and (x >= 0).all() and (slope <= 0).all()


@pytest.mark.parametrize("depth", [1e-12, 1e-9, 1e-6, 1e-4])
def test_a_guard_that_stays_above_zero_does_not_fall(rng, depth):
    """Its least value is as near to zero, on the other side."""
    _, _, c = dips(-depth, rng)
    _, falls, *_ = of(c, 0.1 * depth)
    assert not falls.any()


def test_a_quintic_falls_where_a_fine_grid_says(rng):
    """Also where it falls and comes back, once or twice, within the step."""
    g0, g1, v0, v1 = rng.normal(size=(4, 5000)) * [[0.3], [0.3], [1], [1]]
    a0, a1 = 5 * rng.normal(size=(2, 5000))
    course = Quintic(g0, v0, a0, g1, v1, a1)
    there, left, right = jax.jit(jax.vmap(first_fall))(course)
    x = np.linspace(0, 1, 1001)
    on_grid = np.array(course(x[:, None]))
    falls = (on_grid[:-1] > 0) & (on_grid[1:] <= 0)
    known = falls.any(0)
    # some that turn three times within half a step: measured 3
    assert (known & ~np.asarray(there)).sum() < 8
    assert (known & (g1 > 0)).sum() > 250 and (falls.sum(0) > 1).sum() > 12
    first = x[falls.argmax(0)]
    inside = (left <= first + 2e-3) & (first - 2e-3 <= right)
    assert (known & np.asarray(there & ~inside)).sum() < 4  # measured 1
    found = np.asarray(there)
    assert (np.asarray(course(left))[found] > -1e-13).all()
    assert (np.asarray(course(right))[found] < 1e-13).all()


def share_by_roots(coefficients, most):
    """The share of [0, 1] in which the polynomial lies within +-most."""
    p, edges = Polynomial(coefficients), [0.0, 1.0]
    for level in (most, -most):
        roots = (p - level).roots()
        edges += [x for x in roots[np.abs(roots.imag) < 1e-12].real if 0 < x < 1]
    edges = np.sort(edges)
    inside = np.abs(p((edges[1:] + edges[:-1]) / 2)) < most
    return (np.diff(edges) * inside).sum()


# of the value, measured 8e-6, 7e-8, 6e-11, with steps that graze a level 3e-3, 5e-6,
# 7e-10; of its derivative, relative, measured 2e-4, 3e-7, 1e-9 (differences)
@pytest.mark.parametrize(
    "h, of_value, of_grazing, of_slope",
    [
        (0.4, 2e-5, 6e-3, 3e-4),
        (0.2, 2e-7, 2e-5, 1e-6),
        (0.1, 2e-10, 3e-9, 1e-8),
    ],
)
def test_the_share_of_a_step_within_a_band_and_how_it_moves(
    rng, h, of_value, of_grazing, of_slope
):
    """The time below a rate, with its derivative in the band, as steps grow short."""
    phase, height = rng.uniform(0, 2 * np.pi, 2000), rng.uniform(0.5, 3, 2000)
    g0, g1 = (height * np.sin(phase + x) for x in (0, h))
    v0, v1 = (h * height * np.cos(phase + x) for x in (0, h))
    p0, p1 = (-height * np.cos(phase + x) for x in (0, h))
    path = Quintic(p0, h * g0, h * v0, p1, h * g1, h * v1)
    run = jax.jit(jax.vmap(jax.value_and_grad(lambda c, p: share_within(p, h * c))))
    value, slope = run(jnp.full(2000, 0.5), path)
    quartic = np.stack(np.broadcast_arrays(*path.slopes()), axis=1) / h
    d = 1e-6
    less, exact, wider = (
        np.array([share_by_roots(row, 0.5 + e) for row in quartic]) for e in (-d, 0, d)
    )
    grazes = np.abs(wider - 2 * exact + less) > 1e-9  # an extremum is near a level
    crosses = (exact > 0) & (exact < 1) & ~grazes
    assert crosses.sum() > 100
    assert np.abs(value - exact)[crosses].max() < of_value
    assert np.abs(value - exact).max() < of_grazing
    difference = (wider - less)[crosses] / (2 * d)
    np.testing.assert_allclose(slope[crosses], difference, of_slope)


@pytest.mark.parametrize("tol", [1e-6, 1e-12])
def test_random_cubics_fall_where_their_roots_say(rng, tol):
    c = rng.normal(size=(COUNT, 4)) * 10 ** rng.uniform(-3, 1, (COUNT, 4))
    c[:, 0] = np.abs(c[:, 0]) * (rng.random(COUNT) > 0.1)  # some begin at zero
    plain, falls, x, value, _ = of(c, tol)
    exact = np.array([first_root(row, -tol) for row in c])
    np.testing.assert_array_equal(falls, np.isfinite(exact))
    assert falls.sum() > 8000 and (falls & ~plain).sum() > 800  # 8592, 920
    # a bracketed Newton method of four steps: mostly exact, at worst the right branch
    exact = np.array([first_root(row, -0.5 * tol) for row in c[falls]])
    away = np.abs(x[falls] - exact)
    # measured 1e-14, two in three within 1e-6, and 0.24
    assert np.median(away) < 1e-12 and away.max() < 0.5


@pytest.mark.parametrize("share, missed", [(1.0, 0.02), (0.03, 0.0)])
def test_quartics_fall_where_their_roots_say_if_they_are_nearly_cubics(
    rng, share, missed
):
    """A step looks at a quartic where its cubic has extrema.

    What a Runge-Kutta step's quartic adds to its cubic is a term of the next order.
    Where the polygon decides nothing is left open, however large that is.
    """
    tol = 1e-9
    c = rng.normal(size=(COUNT, 5))
    c[:, 0], c[:, 4] = np.abs(c[:, 0]), share * c[:, 4]
    plain, falls, *_ = of(c, tol)
    exact = np.isfinite([first_root(row, -tol) for row in c])
    np.testing.assert_array_equal(falls[plain], exact[plain])
    assert plain.mean() < 0.97  # 0.94
    assert not (falls & ~exact).any()  # none is invented
    # measured 0.0078 of those in doubt, and none
    assert (exact & ~falls)[~plain].mean() <= missed


# Ends of modes in a power series ------------------------------------------------------

ORDER, FINE, MOST = 8, 1e-13, 32.0


@jax.jit
@jax.vmap
def first_end(guard, slips, side):
    """The time looked over, whether the mode ends in it, and when.

    Of a joint that slips its rate is the guard, of one that sticks it is what is left
    of the limit on that side; the other joint has room.
    """
    first = jnp.where(slips, guard, side * (MOST * jnp.eye(ORDER + 1)[0] - guard))
    other = [0.5 * guard[0] ** 0, *(0.0 * guard[1:])]
    limit = jnp.where(slips, 0.0, MOST)
    joints = [(list(first), limit, slips, FINE)]
    joints += [(other, jnp.ones(()), jnp.zeros((), bool), FINE)]
    s, kinds = first_look(joints, jnp.ones(()), guard[0])
    found, mine = first_event(joints, kinds, s, guard[0])
    return s, mine[0], found


def walked(c, slips, side):
    """Steps to the end of [0, 1]: when a mode first ends, NaN if it does not."""
    count = len(c)
    start, ends = np.zeros(count), np.full(count, np.nan)
    for _ in range(100):
        going = np.isnan(ends) & (start < 1)
        if not going.any():
            return ends
        moved = np.zeros((count, ORDER + 1))
        for i in np.flatnonzero(going):
            shifted = Polynomial(c[i])(Polynomial([start[i], 1.0])).coef
            moved[i, : len(shifted)] = shifted
        moved[~going, 0] = 1.0
        s, mine, found = map(np.asarray, first_end(moved, slips, side))
        here = going & mine & (start + found < 1)
        ends[here] = (start + found)[here]
        start = start + s
    raise AssertionError("steps do not end")


@pytest.mark.parametrize("depth", [1e-12, 1e-9, 1e-4])
@pytest.mark.parametrize("mode", ["slips", "sticks", "sticks, other side"])
def test_a_mode_ends_in_a_dip_and_goes_on_where_it_is_just_not_reached(
    rng, depth, mode
):
    at, bend, c = dips(depth, rng, 300)
    inside = (c[:, 0] > 2 * depth) & (c.sum(1) > 2 * depth)
    at, bend, c = at[inside], bend[inside], c[inside]
    slips = np.full(len(c), mode == "slips")
    side = np.full(len(c), -1.0 if "other" in mode else 1.0)
    ends = walked(c, slips, side)
    assert np.isfinite(ends).all()
    width = np.sqrt(depth / bend)
    exact = np.array([first_root(row, -0.5 * FINE) for row in c])
    # measured 0.025: half of what a limit is met by, where that is a tenth of the depth
    assert (np.abs(ends - exact) < 0.1 * width).all() and (ends < at).all()
    assert np.isnan(walked(c + 2 * depth * np.eye(4)[0], slips, side)).all()
