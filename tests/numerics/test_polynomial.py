"""What a step's own series says of its middle, against numpy's roots."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ziegler_jax.numerics.passages import first_fall
from ziegler_jax.numerics.polynomial import Polynomial, over_step

COUNT, ORDER = 2000, 8


@pytest.fixture(scope="module")
def courses():
    """Swings of random phase and of about half a turn a step, to the eighth order."""
    source = np.random.default_rng(3)
    phase, rate = source.uniform(0, 2 * np.pi, COUNT), source.uniform(0.3, 2.5, COUNT)
    bend = source.uniform(-0.1, 0.1, (COUNT, ORDER + 1))
    factorials = np.cumprod([1.0, *range(1, ORDER + 1)])
    turns = phase[:, None] + np.arange(ORDER + 1) * np.pi / 2
    return (np.sin(turns) + bend) / factorials * rate[:, None] ** np.arange(ORDER + 1)


def of(terms):
    return Polynomial(tuple(jnp.asarray(c) for c in terms), sum(terms))


def turns_of(row):
    """Where a polynomial turns within the step."""
    roots = np.polynomial.Polynomial(row).deriv().roots()
    real = roots[np.abs(roots.imag) < 1e-9].real
    return real[(real > 0) & (real < 1)]


def test_the_largest_number_of_a_step_is_where_its_series_turns(courses):
    extent = jax.jit(jax.vmap(lambda terms: of(terms).extent()))
    low, high = extent(tuple(courses.T))
    checked = 0
    for row, least, most in zip(courses, low, high, strict=True):
        places = turns_of(row)
        if places.size != 1:
            continue
        there = np.polynomial.Polynomial(row)(np.append(places, 1.0))
        assert abs(least - there.min()) < 1e-7  # measured 5e-8
        assert abs(most - there.max()) < 1e-7
        checked += 1
    assert checked > 500


def test_where_it_turns_it_moves_as_the_series_does_there(courses):
    def extremum(terms):
        return of(terms).extremum()

    one = [row for row in courses if turns_of(row).size == 1][:200]
    slopes = jax.vmap(jax.grad(extremum))(tuple(np.transpose(one)))
    places = np.array([turns_of(row)[0] for row in one])
    powers = places[:, None] ** np.arange(ORDER + 1)
    assert np.abs(np.stack(slopes, 1) - powers).max() < 1e-12  # measured 5e-14


def test_it_falls_through_zero_where_numpys_first_root_is(courses):
    def fall(terms):
        return first_fall(of(terms))

    there, left, right = jax.jit(jax.vmap(fall))(tuple(courses.T))
    for row, found, low, high in zip(courses, there, left, right, strict=True):
        course = np.polynomial.Polynomial(row)
        roots = course.roots()
        real = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
        falls = [x for x in real if 0 < x < 1 and course.deriv()(x) < 0]
        assert bool(found) == bool(falls)
        if falls:
            assert low <= falls[0] <= high


def test_its_mean_is_its_integrals(courses):
    means = np.array([np.polynomial.Polynomial(row).integ()(1.0) for row in courses])
    mean = jax.vmap(lambda terms: of(terms).mean())(tuple(courses.T))
    assert np.abs(mean - means).max() < 1e-13  # measured 1e-15


def test_a_series_in_time_over_a_step_of_length_h(courses):
    h, x = 0.7, np.linspace(0, 1, 5)
    path = over_step(list(courses.T), h, 0.0)
    for share in x:
        wanted = [np.polynomial.Polynomial(row)(share * h) for row in courses]
        assert np.abs(np.asarray(path(share)) - wanted).max() < 1e-13  # measured 2e-15
