"""The own power of two and hyperbolic tangent against arithmetic of 200 bits."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from ziegler_jax.numerics import elementary
from ziegler_jax.numerics.elementary import short_power

pytestmark = pytest.mark.usefixtures("optimised")  # bits, as users get them

SIZE = 6000


def half_to_the(x):
    numerator, denominator = elementary.half_to_the(x)
    return numerator / denominator


def tanh2(x):
    numerator, denominator, _ = elementary.tanh2(x)
    return numerator / denominator


def sech2(x):
    _, denominator, product = elementary.tanh2(x)
    return product / denominator**2


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
    "name, bound, low, high",
    # the docstrings' bounds; measured 2.4, 2.4, 4.3 (in one call), 3.2
    [
        ("half_to_the", 3, -1000, 1000),
        ("half_to_the", 3, 0, 3),
        ("tanh2", 5, -60, 60),
        ("tanh2", 5, -3, 3),
    ],
)
def test_errors_stay_below_the_stated_ulps(rng, name, bound, low, high):
    function, exact = FUNCTIONS[name]
    assert largest_error(function, exact, rng.uniform(low, high, SIZE)) < bound


def test_one_less_the_square_loses_no_digits(rng):
    def exact(x):
        return 1 / mpmath.cosh(x * mpmath.log(2) / 2) ** 2

    x = rng.uniform(-60, 60, SIZE)
    # measured 5.0
    assert largest_error(sech2, exact, x) < 10


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


LN2 = np.log(2)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_derivatives_are_the_closed_forms(order):
    x = jnp.linspace(-4, 4, 81)
    t, p = np.tanh(LN2 / 2 * x), 2.0**-x
    square = (LN2 / 2) ** order * (1 - t**2)
    closed = {
        tanh2: {1: square, 2: -2 * t * square, 3: (6 * t**2 - 2) * square},
        half_to_the: {order: (-LN2) ** order * p},
    }
    for function, slopes in closed.items():
        for turn in (jax.grad, jax.jacfwd):
            slope = function
            for _ in range(order):
                slope = turn(slope)
            # measured 8e-16 relative; 4e-17 where the third is near zero
            np.testing.assert_allclose(
                jax.vmap(slope)(x), slopes[order], rtol=5e-15, atol=1e-15
            )


@pytest.mark.parametrize("x", [61.0, -61.0, 1e9, 1e300, np.inf])
def test_where_they_are_their_limits_they_have_no_slope(x):
    for slope in (jax.grad(tanh2), jax.grad(jax.grad(tanh2)), jax.grad(sech2)):
        assert float(slope(x)) == 0
    assert float(jax.grad(half_to_the)(abs(x) + 1000.0)) == 0


def test_float32_stays_float32_and_is_jax_own():
    x = np.linspace(-3, 3, 61, dtype=np.float32)
    to_tanh = np.float32(np.log(2) / 2)
    for found, theirs in (
        (half_to_the(x), jnp.exp2(-x)),
        (tanh2(x), jnp.tanh(x * to_tanh)),
    ):
        assert found.dtype == jnp.float32
        assert (np.asarray(found) == np.asarray(theirs)).all()
