"""The own power of two and hyperbolic tangent against arithmetic of 200 bits."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from ziegler_jax.numerics import elementary
from ziegler_jax.numerics.elementary import short_power

SIZE = 6000


def half_to_the(x):
    numerator, denominator = elementary.half_to_the(x)
    return numerator / denominator


def tanh2(x):
    numerator, denominator = elementary.tanh2(x)
    return numerator / denominator


def exact_tanh2(x):
    less_one = mpmath.expm1(x * mpmath.log(2))
    return less_one / (less_one + 2)


FUNCTIONS = {
    "half_to_the": (half_to_the, lambda x: mpmath.power(2, -x)),
    "tanh2": (tanh2, exact_tanh2),
}


def largest_error(function, exact, x):
    """In units of the last place of the exact value."""
    found = np.asarray(jax.jit(jax.vmap(function))(x)).tolist()
    with mpmath.workprec(200):
        values = [exact(mpmath.mpf(v)) for v in x.tolist()]
        errors = [abs(mpmath.mpf(f) - v) for f, v in zip(found, values, strict=True)]
        ulps = [
            e / np.spacing(abs(float(v))) for e, v in zip(errors, values, strict=True)
        ]
    return float(max(ulps))


@pytest.mark.parametrize(
    "name, low, high",
    [
        ("half_to_the", -1000, 1000),
        ("half_to_the", 0, 3),
        ("tanh2", -60, 60),
        ("tanh2", -3, 3),
    ],
)
def test_errors_stay_below_three_ulps(rng, name, low, high):
    function, exact = FUNCTIONS[name]
    # measured 2.31, 2.29, 2.46, 2.75
    assert largest_error(function, exact, rng.uniform(low, high, SIZE)) < 3


@pytest.mark.parametrize("name", FUNCTIONS)
def test_small_arguments_lose_no_digits(rng, name):
    x = rng.choice([-1, 1], SIZE) * 10 ** rng.uniform(-300, 0, SIZE)
    function, exact = FUNCTIONS[name]
    # measured 2.36 and 2.63
    assert largest_error(function, exact, x) < 3


def test_far_out_they_are_their_limits():
    assert all(float(half_to_the(x)) == 2.0**-1000 for x in (1001.0, 1e300, np.inf))
    assert [float(half_to_the(float(n))) for n in (0, 1, -3, 1000)] == [
        *(1, 0.5, 8, 2.0**-1000)
    ]
    assert [float(tanh2(x)) for x in (61.0, 1e300, np.inf, 0.0)] == [1, 1, 1, 0]
    assert [float(tanh2(-x)) for x in (61.0, 1e300, np.inf)] == [-1, -1, -1]
    assert np.isnan(half_to_the(np.nan)) and np.isnan(tanh2(np.nan))


@pytest.mark.parametrize("exponent", [-1.0, -0.1, -0.0625, 0.5])
def test_short_powers_have_five_digits(rng, exponent):
    x = 10 ** rng.uniform(-300, 300, SIZE)
    x = np.concatenate([x, 2.0 ** np.arange(-1000, 1000), np.nextafter(2.0, [0, 3])])
    power = np.asarray(short_power(jnp.asarray(x), exponent))
    # measured 7.2e-6 at -1, else 7.0e-6
    assert np.abs(power / x**exponent - 1).max() < 7e-6 * (1 + abs(exponent))


def test_tanh2_is_odd_to_the_last_bit(rng):
    x = rng.uniform(-70, 70, SIZE)
    assert (np.asarray(tanh2(-x)) == -np.asarray(tanh2(x))).all()


def test_derivatives_are_the_closed_forms():
    x = np.linspace(-3, 3, 61)
    for function, closed in (
        (tanh2, lambda y: np.log(2) / 2 * (1 - y**2)),
        (half_to_the, lambda y: -np.log(2) * y),
    ):
        y, slope = jax.vmap(
            lambda x, f=function: jax.jvp(f, (x,), (jnp.ones_like(x),))
        )(x)
        # measured 6.7e-16 of the slope
        np.testing.assert_allclose(slope, closed(np.asarray(y)), rtol=2e-15)


def test_float32_stays_float32_and_is_jax_own():
    x = np.linspace(-3, 3, 61, dtype=np.float32)
    to_tanh = np.float32(np.log(2) / 2)
    for found, theirs in (
        (half_to_the(x), jnp.exp2(-x)),
        (tanh2(x), jnp.tanh(x * to_tanh)),
    ):
        assert found.dtype == jnp.float32
        assert (np.asarray(found) == np.asarray(theirs)).all()
