"""Where a mode ends, among series whose roots are known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import Polynomial

from ziegler_jax.numerics.bernstein import first_event, first_look

ORDER = 8
TOL = 1e-9


@jax.jit
@jax.vmap
def ends(first, second, limits, slips):
    """The time looked over, the event's, and whose it is."""
    rows = enumerate((first, second))
    joints = [(list(w), limits[i], slips[i], TOL) for i, w in rows]
    at = first[0]
    s, kinds = first_look(joints, jnp.ones_like(at), at)
    found, mine = first_event(joints, kinds, s, at)
    return s, found, mine


def first_low(coefficients, limit, slips, span):
    """The first time at which a mode is left, by the roots of its polynomials."""
    p = Polynomial(coefficients)
    guards = [p] if slips else [limit - p, limit + p]
    times = [np.inf]
    for guard in guards:
        below = guard + TOL
        roots = below.roots()
        real = roots[np.abs(roots.imag) < 1e-9].real
        inside = np.sort(real[(real > 0) & (real <= span)])
        falls = [t for t in inside if below.deriv()(t) < 0]
        times += falls[:1]
        if below(0.0) < 0:
            times.append(0.0)
    return min(times)


def test_the_first_end_of_a_mode_is_found_among_random_polynomials():
    rng = np.random.default_rng(5)
    count = 4000
    decay = rng.uniform(0.2, 0.9, (count, 1, 1)) ** np.arange(ORDER + 1)
    w = rng.normal(size=(count, 2, ORDER + 1)) * decay
    slips = rng.random((count, 2)) < 0.5
    limits = np.where(slips, 0.0, np.abs(w[..., 0]) + rng.uniform(0, 1, (count, 2)))
    w[..., 0] = np.where(slips, np.abs(w[..., 0]), w[..., 0])
    # some begin on their limit, as what has just been set free does
    w[::7, 0, 0] = np.where(slips[::7, 0], 0.0, w[::7, 0, 0])
    lanes = map(jnp.asarray, (w[:, 0], w[:, 1], limits, slips))
    s, found, (mine1, mine2) = (jax.tree.map(np.asarray, x) for x in ends(*lanes))
    events = mine1 | mine2
    halved = 0
    for i in range(count):
        span = s[i]
        expected = [first_low(w[i, j], limits[i, j], slips[i, j], span) for j in (0, 1)]
        first = min(expected)
        if not events[i]:
            assert first == np.inf, (i, first)
            halved += span < 1
            continue
        # half a tolerance before what is left for good, by the guard's slope
        j = int(mine2[i])
        p = Polynomial(w[i, j])
        guard = p(found[i]) if slips[i, j] else limits[i, j] - abs(p(found[i]))
        if found[i] > 0:
            assert abs(guard) < 2 * TOL, (i, guard)  # worst: 0.52
        assert abs(found[i] - first) < 1e-5, (i, found[i], first)  # worst: 6e-7
    assert events.sum() > count / 3
    assert 0 < halved < count / 10  # most are told at first sight


@pytest.mark.parametrize("depth", [1e-8, 1e-6, 1e-4, 1e-2])
def test_an_excursion_is_seen_however_short_it_is(depth):
    """A torque that passes its limit by `depth` at `place`, and comes back."""
    places = np.geomspace(1e-3, 0.99, 200)
    moved = np.zeros((2, places.size, ORDER + 1))
    moved[1, :, 0] = 0.5  # the other one has room
    limits, slips = np.ones((places.size, 2)), np.zeros((places.size, 2), bool)
    start, past, seen = np.zeros(places.size), np.zeros(places.size, bool), 0
    for _ in range(60):  # steps until all are seen, or passed unseen
        # 1 + depth - (t - place)^2 from `start` on
        left = places - start
        moved[0, :, :3] = np.stack([1 + depth - left**2, 2 * left, -1 + 0 * left], -1)
        lanes = map(jnp.asarray, (*moved, limits, slips))
        s, found, (mine, _) = (jax.tree.map(np.asarray, x) for x in ends(*lanes))
        event = np.where(past, False, mine)
        here = (start + found)[event]
        expected = (places - np.sqrt(depth))[event]
        # worst: 4.8e-6, where half a tolerance is a tenth of the depth
        np.testing.assert_allclose(here, np.maximum(expected, 0), rtol=0, atol=5e-5)
        seen += event.sum()
        start = start + s
        past |= event | (start > places + np.sqrt(depth))
    assert seen == places.size
