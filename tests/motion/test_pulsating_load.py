r"""A load that pulsates, q + p cos(w t): where a small kick grows, beside Floquet's.

Without damping and friction the linear column about rest is $M\ddot x + K(t)\,x = 0$
with matrices of Newton's laws, written out here; scipy integrates it over a period. A
kick grows where a multiplier lies outside the unit circle. The first region stands on
twice the lower frequency, $w = 2\omega_1$ at p = 0.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import ziegler_jax as zj

Q = 1.0
# two uniform rods of mass and length 1: moments about joints, springs of 1
MASS = np.array([[1 / 3 + 1, 1 / 2], [1 / 2, 1 / 3]])
SPRINGS = np.array([[2.0, -1.0], [-1.0, 1.0]])
PUSH = np.array([[1.0, -1.0], [0.0, 0.0]])  # q sin(phi1 - phi2) on rod 1
LOWER = np.sqrt(np.linalg.eigvals(np.linalg.solve(MASS, SPRINGS - Q * PUSH)).real.min())
PULSATIONS = (0.1, 0.2, 0.3, 0.4, 0.5)
BESIDE = 0.005  # of the rate: how far from a border
SPAN = 800.0


@functools.cache
def growth(p, rate):
    """The largest rate of growth by the multipliers of a period."""
    inverse, period = np.linalg.inv(MASS), 2 * np.pi / rate

    def field(t, y):
        stiffness = SPRINGS - (Q + p * np.cos(rate * t)) * PUSH
        x = y.reshape(4, 4)
        return np.concatenate([x[2:], -inverse @ stiffness @ x[:2]]).ravel()

    end = solve_ivp(
        field, (0, period), np.eye(4).ravel(), "DOP853", rtol=1e-10, atol=1e-12
    ).y[:, -1]
    multipliers = np.linalg.eigvals(end.reshape(4, 4))
    return np.log(np.abs(multipliers).max()) / period


@functools.cache
def border(p, side):
    """The rate at which growth begins, below (-1) or above (1) the region's middle."""
    far = 2 * LOWER * (1 + 0.4 * side)
    return brentq(lambda rate: growth(p, rate) - 1e-5, 2 * LOWER, far, xtol=1e-6)


class Pulsation(zj.AbstractLoadHistory):
    p: float
    rate: float

    def load(self, t):
        return self.p * jnp.cos(self.rate * t)


def peaks(p, rate):
    """The largest angle in each quarter of a long motion after a small kick."""
    column = zj.uniform_rods(Q, forces=Pulsation(p, rate))
    ts = jnp.linspace(0.0, SPAN, 2001)
    start = zj.State(omega=(1e-12, 2e-12))
    motion = zj.trajectory(column, start, ts, method=zj.Method(rtol=1e-9, atol=1e-17))
    angle = jnp.abs(motion.phi[1:]).max(1)
    return angle.reshape(4, -1).max(1)


@pytest.fixture(scope="module")
def points():
    """Twenty points: five pulsations, both borders, inside and outside of each."""
    rows = []
    for p in PULSATIONS:
        for side in (-1, 1):
            at = border(p, side)
            rows += [(p, at * (1 - way * side * BESIDE)) for way in (1, -1)]
    p, rate = np.array(rows).T
    return p, rate, np.asarray(jax.jit(jax.vmap(peaks))(p, rate))


def test_twenty_points_beside_the_first_region_grow_where_multipliers_say(points):
    p, rate, sizes = points
    expected = np.array([growth(*x) for x in zip(p, rate, strict=True)]) > 1e-4
    assert expected.tolist() == [True, False] * 10
    # from the second quarter to the last: at least 11.9 inside, at most 1.061 outside
    grown = sizes[:, 3] / sizes[:, 1]
    assert ((grown > 5) == expected).all() and ((grown < 1.5) == ~expected).all(), grown


def test_a_small_kick_grows_at_the_rate_of_the_multipliers():
    """In the middle of the region, over the last three quarters of a motion."""
    for p in (0.1, 0.2):
        rate = (border(p, -1) + border(p, 1)) / 2
        sizes = np.asarray(jax.jit(peaks)(p, rate))
        found = np.log(sizes[2] / sizes[1]) / (SPAN / 4)
        # measured 1.7 %: peaks beat within a period of the load
        np.testing.assert_allclose(found, growth(p, rate), rtol=0.05)
