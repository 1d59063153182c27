"""When a motion has drawn near enough to an orbit."""

import jax
import jax.numpy as jnp
import numpy as np

from ziegler_jax.steady.contraction import contraction_norm, spectral_radius
from ziegler_jax.steady.returns import (
    A_SHOT,
    ACCEPTANCE,
    LATER,
    NOTHING,
    TIMES,
    Candidate,
    Ends,
    Lookout,
    no_returns,
    span_of,
    with_return,
)
from ziegler_jax.steady.trend import no_trend

# The half return's derivative at the stable cycle of the main job's column at q =
# 3.53125, mu = 0.04, and a place beside a saddle cycle from where a motion leaves for a
# torus: 0.008 of the orbit's size away, 0.05 in the norm in which the map contracts.
ORBIT = np.array([0.188763, 0.570416, 2.956718])
SLOPE = np.array(
    [
        [0.950129, -1.237909, -0.409983],
        [0.079374, 0.734599, 0.015766],
        [-0.283986, -0.068730, 0.552665],
    ]
)
BESIDE_THE_SADDLE = np.array([0.0235, 0.0008, -0.0090])


def passing(point, time):
    """A step through the section at this point, without acceleration."""
    phi2, omega1, omega2 = (jnp.asarray(x) for x in point)
    before = (-omega1 / 2, phi2 - omega2 / 2, omega1, omega2)
    after = (omega1 / 2, phi2 + omega2 / 2, omega1, omega2)
    none = (0.0 * phi2, 0.0 * phi2)
    ends = Ends(time, time + 1.0, before, after, none, none)
    return Lookout(ends, jnp.asarray(1.0), jnp.asarray(0.0), (), jnp.asarray(NOTHING))


@jax.jit
def returned(state, point, time, orbit):
    """After a return: one program for all tests."""
    return with_return(state, passing(point, time), False, orbit)


def asks_of(distances, slope):
    """What a motion asks for whose returns lie so far from an orbit with this map."""
    slope, one = jnp.asarray(slope), jnp.asarray(1, jnp.int32)
    radius = spectral_radius(slope)
    norm = contraction_norm(slope, radius)
    there = jnp.asarray(True)
    orbit = Candidate(there, one, jnp.asarray(ORBIT), slope, norm, radius)
    state, asks = no_returns(jnp.asarray(0.0)), NOTHING
    for i, distance in enumerate(distances):
        state = returned(state, ORBIT + distance, 3.0 * i, orbit)
        asks = max(asks, int(state.asks))
    return asks


def followed(distance, slope, count=4):
    """The returns of a motion that goes by the linear map alone."""
    return [np.linalg.matrix_power(slope, i) @ distance for i in range(count)]


def test_three_returns_beside_a_saddle_close_to_the_orbit_are_no_arrival():
    assert np.abs(BESIDE_THE_SADDLE).max() < 0.01 * ORBIT.max()
    assert asks_of(followed(BESIDE_THE_SADDLE, SLOPE), SLOPE) == NOTHING
    # a quarter of it is within what the norm allows: 0.012 < 0.025
    assert asks_of(followed(BESIDE_THE_SADDLE / 4, SLOPE), SLOPE) == ACCEPTANCE


def test_a_motion_that_stands_still_beside_a_stable_orbit_is_no_arrival():
    slope = 0.5 * np.eye(3)
    assert asks_of(followed(BESIDE_THE_SADDLE, slope), slope) == ACCEPTANCE
    # another orbit is there: a shot is to find it
    assert asks_of([BESIDE_THE_SADDLE] * 6, slope) == A_SHOT


def trend_of(sizes):
    """What the largest returns tell, one at each of the times."""
    trend = no_trend(jnp.asarray(0.0))
    for size in sizes:
        trend = trend.after(jnp.asarray(size), True)
    return trend


def test_a_motion_that_grows_or_lasts_endures_and_one_that_falls_does_not():
    marks = np.arange(60)
    assert trend_of(1.02 ** marks[:5]).endures
    # by less than 1 % from one time to the next, on both sides
    assert trend_of(1.005 ** marks[:11]).endures
    assert not trend_of(0.995**marks).endures
    # nor by a ten thousandth: it may still come to rest
    assert not trend_of((1 - 1e-4) ** marks[:12]).endures
    # what grew once, and then stands still, is looked at for as long as any other
    assert not trend_of([1.0, 1.5, 1.5, 1.5]).endures
    wandering = 1 + 0.004 * np.cos(marks)
    assert trend_of(wandering[:12]).endures and not trend_of(wandering[:8]).endures


def test_the_largest_return_since_the_last_time_counts():
    trend = no_trend(jnp.asarray(0.0))
    for size, timed in ((1.0, True), (1.3, False), (0.2, True), (1.4, False)):
        trend = trend.after(jnp.asarray(size), timed)
    assert float(trend.before) == np.float64(1.3)
    assert float(trend.peak) == np.float64(1.4)


def test_a_shot_is_of_as_many_returns_as_close_and_five_close_none():
    point, eye = jnp.asarray(ORBIT), jnp.eye(3)
    none = Candidate(jnp.asarray(False), jnp.asarray(0), point, eye, eye, point[0])
    asked = {}
    for count in (1, 2, 3, 4, 5, 6):
        state = no_returns(jnp.asarray(0.0))
        for i in range(10):
            # the places of a cycle lie farther apart than a shot is asked for
            state = returned(state, ORBIT + 0.05 * (i % count), 20.0 * i, none)
        span = float(span_of(state, state.returns))
        asked[count] = int(state.asks), int(state.returns), span
    assert asked.pop(5)[:2] == (NOTHING, 0)
    # times are halves and wholes: nothing is rounded
    assert asked == {n: (A_SHOT, n, 20.0 * n) for n in asked}


def test_shots_go_on_being_asked_for_at_times_that_grow():
    point, eye = jnp.asarray(ORBIT), jnp.eye(3)
    none = Candidate(jnp.asarray(False), jnp.asarray(0), point, eye, eye, point[0])
    state, due = no_returns(jnp.asarray(0.0)), []
    for time in np.arange(0.0, 4500.0, 10.0):
        due.append(float(state.due))
        state = returned(state, ORBIT, time, none)._replace(
            asks=jnp.asarray(NOTHING, jnp.int32)
        )
    times = sorted(set(due))
    assert times[: len(TIMES)] == list(TIMES)
    assert times[len(TIMES) :] == [TIMES[-1] * LATER**n for n in range(1, 7)]
