"""The own sine and cosine against arithmetic of 120 bits."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from ziegler_jax.numerics.elementary import sincos

pytestmark = pytest.mark.usefixtures("optimised")  # bits, as users get them

lanes = jax.vmap(sincos)
sincos_jit = jax.jit(lanes)  # fused: products and sums may be rounded once


def exact(x):
    with mpmath.workprec(200):
        return [(mpmath.sin(mpmath.mpf(v)), mpmath.cos(mpmath.mpf(v))) for v in x]


def errors(x, function=sincos_jit):
    """Absolute errors, and in units of the last place of the exact values."""
    x = np.asarray(x, float)
    # one compiled size
    found = np.stack(function(np.resize(x, SIZE)), -1)[: x.size]
    pairs = exact(x.tolist())
    with mpmath.workprec(200):
        absolute = np.array(
            [
                [float(abs(mpmath.mpf(f) - e)) for f, e in zip(fs, es, strict=True)]
                for fs, es in zip(found.tolist(), pairs, strict=True)
            ]
        )
    ulps = absolute / np.spacing(np.abs(np.array(pairs, dtype=float)))
    return absolute, ulps


SIZE = 12_000


def near_multiples(largest_k, count, rng):
    """The doubles next to k pi/2, where the reduction cancels most."""
    k = np.unique(
        np.concatenate([np.arange(1, 200), rng.integers(1, largest_k, count)])
    )
    with mpmath.workprec(200):
        x = np.array([float(mpmath.mpf(int(v)) * mpmath.pi / 2) for v in k])
    return np.concatenate([x, -x, np.nextafter(x, 0), np.nextafter(x, np.inf)])[:SIZE]


@pytest.mark.parametrize("where", ["anywhere", "small", "near multiples of pi/2"])
def test_error_is_at_most_3_3e_16_up_to_1e6(rng, where):
    x = {
        "anywhere": lambda: rng.uniform(-1e6, 1e6, SIZE),
        "small": lambda: rng.choice([-1, 1], SIZE) * 10 ** rng.uniform(-12, 1, SIZE),
        "near multiples of pi/2": lambda: near_multiples(636_619, 2700, rng),
    }[where]()
    assert np.abs(x).max() <= 1e6
    absolute, _ = errors(x)
    # measured 2.8e-16; 3.2e-16 on a processor that rounds products before sums
    assert absolute.max() <= 3.3e-16


def test_the_sine_of_a_small_angle_loses_no_digits(rng):
    x = rng.choice([-1, 1], SIZE) * 10 ** rng.uniform(-300, 0, SIZE)
    _, ulps = errors(x)
    # measured 0.87
    assert ulps[:, 0].max() <= 2


@pytest.mark.parametrize("function", [lanes, sincos_jit], ids=["by parts", "fused"])
def test_beyond_the_error_is_that_of_the_argument(rng, function):
    x = 2 ** rng.uniform(20, 50, 6000)
    absolute, _ = errors(x, function)
    ratio = (absolute.max(-1) / x).max() * 2.0**52
    # measured 0.49 by parts, 2e-6 fused
    assert ratio <= 1


@pytest.mark.parametrize("x", [np.nan, np.inf, -np.inf, 2.0**51, -1e300])
def test_where_every_digit_is_lost_it_is_nan(x):
    assert np.isnan(np.stack(sincos(x))).all()


def test_zero_is_exact_and_signs_are_odd_and_even(rng):
    assert [float(v) for v in sincos(0.0)] == [0.0, 1.0]
    x = rng.uniform(0, 100, SIZE)
    (s, c), (minus_s, minus_c) = sincos_jit(x), sincos_jit(-x)
    assert (np.asarray(s) == -np.asarray(minus_s)).all()
    assert (np.asarray(c) == np.asarray(minus_c)).all()


def test_derivatives_are_the_other_function_exactly():
    x = np.linspace(-7, 7, 101)
    (s, c), (ds, dc) = jax.jvp(lanes, (x,), (np.full_like(x, 2.0),))
    assert (np.asarray(ds) == 2 * np.asarray(c)).all()
    assert (np.asarray(dc) == -2 * np.asarray(s)).all()
    second = jax.vmap(jax.grad(jax.grad(lambda v: sincos(v)[0])))(x)
    assert (np.asarray(second) == -np.asarray(s)).all()


def test_float32_stays_float32_and_is_jax_own():
    x = np.linspace(-7, 7, 101, dtype=np.float32)
    s, c = lanes(x)
    assert s.dtype == c.dtype == jnp.float32
    assert (np.asarray(s) == np.asarray(jnp.sin(x))).all()
    assert (np.asarray(c) == np.asarray(jnp.cos(x))).all()


@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
def test_any_shape_is_taken(rng, shape):
    x = rng.uniform(-9, 9, shape)
    for found, expected in zip(sincos(x), (np.sin(x), np.cos(x)), strict=True):
        assert found.shape == shape
        # one unit in the last place of each
        np.testing.assert_allclose(found, expected, rtol=0, atol=2.3e-16)
