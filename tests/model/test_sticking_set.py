"""The sticking set: where the joints hold what is at rest, and its closed form."""

import jax
import numpy as np

import ziegler_jax as zj

LAW = zj.SetValuedCoulomb(
    (0.2, 0.3), (0.1, 0.2), pin_radius=1.0, load=zj.ConstantLoad(1.0)
)


def test_the_sticking_set_by_random_points(rng):
    for parts in ({}, {"kappa": 0.7}, {"follower": 0.6, "kappa": 1.4}):
        column = zj.uniform_rods(2.3, friction=LAW, **parts)
        still = zj.sticking_set(column)
        phi = rng.uniform(-1.5, 1.5, (2, 4000))
        zero = np.zeros(4000)
        y = (*phi, zero, zero)
        _, _, a1, a2 = jax.vmap(zj.vector_field, (None, 0, None))(0.0, y, column)
        rests = (np.asarray(a1) == 0) & (np.asarray(a2) == 0)
        np.testing.assert_array_equal(still.contains(*phi), rests)
        assert 20 < rests.sum() < 3000


def test_the_sticking_set_is_a_parallelogram(rng):
    column = zj.uniform_rods(2.3, kappa=0.7, friction=LAW)
    still = zj.sticking_set(column)
    np.testing.assert_allclose(still.area, 4 * 0.2 * 0.3 / 0.7, rtol=1e-14)
    low, high = np.min(still.corners, axis=0), np.max(still.corners, axis=0)
    phi = rng.uniform(low[:, None], high[:, None], (2, 200_000))
    share = np.mean(np.asarray(still.contains(*phi)))
    # the box holds the curved sides; a share's deviation is below 0.0012
    np.testing.assert_allclose(share * np.prod(high - low), still.area, rtol=0.02)
    inner = 0.999 * np.asarray(still.corners)
    assert np.asarray(still.contains(*inner.T)).all()
    assert not np.asarray(still.contains(*(1.001 / 0.999 * inner).T)).any()
