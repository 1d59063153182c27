"""Power series: products, sines, rates and values are those of polynomials."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import Polynomial

from ziegler_jax.numerics.elementary import sincos
from ziegler_jax.numerics.series import Series, value, value_and_slope


def series(*coefficients):
    return Series(jnp.zeros(()), known=tuple(map(jnp.asarray, coefficients)))


def coefficients(x, count):
    x.ready(count - 1)
    return np.array([float(x[k]) for k in range(count)])


def test_products_are_those_of_polynomials():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 7))
    found = coefficients(3.0 * series(*a) * (2.0 - series(*b)) * series(*a), 7)
    pa, pb = Polynomial(a), Polynomial(b)
    expected = (3 * pa * (2 - pb) * pa).coef[:7]
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-14)  # worst: 2e-15
    square = series(*a)
    np.testing.assert_allclose(
        coefficients(square * square, 7), (pa * pa).coef[:7], rtol=0, atol=2e-15
    )


def test_the_sine_of_a_series_is_that_of_its_value():
    x = series(0.4, 1.0, -0.7, 0.3, 0.1, *(0.0,) * 9)
    s, c = (coefficients(part, 13) for part in sincos(x))
    t = 0.05
    angle = 0.4 + t - 0.7 * t**2 + 0.3 * t**3 + 0.1 * t**4
    # what is left out is below t^13: no difference was seen
    np.testing.assert_allclose(Polynomial(s)(t), np.sin(angle), rtol=0, atol=1e-15)
    np.testing.assert_allclose(Polynomial(c)(t), np.cos(angle), rtol=0, atol=1e-15)


def test_rate_and_integral_undo_each_other():
    x = series(0.4, 1.0, -0.7, 0.3)
    again = coefficients(x.derivative().integral(x[0]), 4)
    np.testing.assert_allclose(again, [0.4, 1.0, -0.7, 0.3], rtol=1e-15)


def test_horner_gives_the_value_and_the_slope():
    p = Polynomial([0.3, -1.0, 2.0, 0.7])
    found = value_and_slope(list(p.coef), 0.6)
    assert found == pytest.approx((p(0.6), p.deriv()(0.6)), rel=1e-15)
    assert value(list(p.coef), 0.6) == found[0]
