"""Where a quartic guard first falls below zero within a step."""

import numpy as np

from ziegler_jax.numerics.hermite import Course, place, plainly_falls, rough_place


def course(coefficients):
    """A quartic on [0, 1] as the solver holds it."""
    g = np.polynomial.Polynomial(coefficients)
    d = g.deriv()
    return Course(g(0.0), g(1.0), d(0.0), d(1.0), g.coef[4])


def test_a_guard_that_dips_within_a_step_is_seen_and_found(rng):
    """Random quartics, grazing ones too, against all their roots."""
    tol, seen = 1e-9, 0
    for _ in range(2000):
        c = rng.normal(size=5)
        c[0] = abs(c[0])
        g = course(c)
        p = np.polynomial.Polynomial(c)
        x = np.linspace(0, 1, 2001)
        first = np.flatnonzero(p(x) < -tol)
        plain, falls = plainly_falls(g, tol)
        if plain:  # it may not be, but then it must be right
            assert bool(falls) == bool(first.size)
            if falls:
                about = rough_place(g, 0.0, 1.0)
                found = float(place(g, -tol / 2, about, 0.0, 1.0))
                seen += 1
                # a bracketed Newton method of four steps: within 0.02 at worst
                assert abs(found - x[first[0]]) < 0.05
    assert seen > 200
