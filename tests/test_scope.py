"""The page on scope: its recipes run as they stand, and are right."""

import re
from pathlib import Path

import models
import numpy as np
import pytest
from scipy.integrate import solve_ivp

PAGE = Path(__file__).parents[1] / "docs" / "learn" / "scope.md"


@pytest.fixture(scope="module")
def names():
    """What the page's blocks leave, run one after the other."""
    made = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S):
        exec(compile(block, str(PAGE), "exec"), made)  # noqa: S102
    return made


def test_a_base_that_shakes_moves_the_column_as_newton_says(names):
    """By both rods' centres in the fixed frame, at each time a linear system."""

    def field(t, y):
        p1, p2, w1, w2 = y
        shake = 0.05 * np.cos(0.5 * t)  # the base's acceleration
        c, s = np.cos([p1, p2]), np.sin([p1, p2])
        # of each centre (x, z): accelerations by those of the angles, and the rest
        arms = np.array([
            [[c[0] / 2, 0], [-s[0] / 2, 0]],
            [[c[0], c[1] / 2], [-s[0], -s[1] / 2]],
        ])  # fmt: skip
        rest = np.array([
            [-s[0] * w1**2 / 2 + shake, -c[0] * w1**2 / 2],
            [-s[0] * w1**2 - s[1] * w2**2 / 2 + shake,
             -c[0] * w1**2 - c[1] * w2**2 / 2],
        ])  # fmt: skip
        mass = np.einsum("bki,bkj->ij", arms, arms) + np.eye(2) / 12
        knee, base = (p2 - p1) + 0.1 * (w2 - w1), p1 + 0.1 * w1
        load = np.array([np.sin(p1 - p2), 0.0])  # q = 1
        right = load + np.array([knee - base, -knee])
        right = right - np.einsum("bki,bk->i", arms, rest)
        return [w1, w2, *np.linalg.solve(mass, right)]

    response = names["response"]
    exact = solve_ivp(
        field, (0, 200), np.zeros(4), "DOP853", response.ts, rtol=1e-11, atol=1e-12
    ).y.T
    assert np.abs(exact[:, 1]).max() > 0.05
    # measured 3.6e-11
    np.testing.assert_allclose(response.phi, exact[:, :2], rtol=0, atol=1e-9)


def test_a_load_that_lags_moves_the_column_as_scipy_says(names):
    def field(t, y):
        slope = models.field(y[:4], y[4], 0.0, 1.0, 0.1, 0.1)
        return [*slope, (2.0 - y[4]) / 50.0]

    start, ts = (0.0, 0.0, 0.0, 0.01, 0.0), np.linspace(0, 300, 601)
    exact = solve_ivp(field, (0, 300), start, "DOP853", ts, rtol=1e-11, atol=1e-13).y
    found = np.stack(names["solution"].ys)
    # measured 8.3e-7
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-5)
