r"""A motion's returns to the section phi1 = 0, and what they tell of where it goes.

A return is $x = (\phi_2, \dots, \omega_1, \dots)$ where the motion passes $\phi_1 = 0$.
Where the chain is bent or pushed aside, so that no rod stands upright at rest, it is
the middle of what $\phi_1$ swings over in place of 0.
Where the scene is odd, $f(-y) = -f(y)$, each half return counts, with its signs turned
so that $\omega_1 > 0$: a symmetric cycle is then a fixed point of half the motion.

$$d_n = \frac{\max |x_k - x_{k-n}|}{\max |x_k|}, \qquad n \in \{1, 2, 3, 4, 6\}$$

falls as the motion nears a cycle of n returns. Where it passes a level, or has been
small for long, the fold asks for a shot (`shots`). To the orbit that a shot has found
the motion must then draw near by itself: from one of its own returns to the next, the
distance e to the orbit's point must follow the orbit's linear map and not grow,

$$|e' - M e|_P \le \tfrac12 (1 - |M|_P)\,|e|_P + \nu, \qquad |e'|_P \le |e|_P + \nu,$$

in the norm in which that contracts. $\nu$ is what steps, and their jitter, leave in a
return: `NOISE` of the orbit's size, as large as that can be in the norm. A motion that
stays beside the orbit, on a torus round it say, does not.
"""

from collections.abc import Sequence
from typing import NamedTuple, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..model.state import PhasePoint
from ..model.system import System
from ..motion.section import SectionPlane, Swing, passage
from ..motion.spans import may_turn_over, turns_over
from ..motion.tangents import push
from ..numerics.elementary import larger
from ..numerics.materialise import if_any_lane, materialise, replaced, tree_where
from ..numerics.numbers import Count, Flag, Flags, Numbers, Scalar
from ..results import CODE
from ..solvers import ACCEPTED, AbstractFold, Explicit, Step, Taylor
from ..solvers.along import expand_along
from .contraction import (
    Matrix,
    Vector,
    contraction_rate,
    image,
    largest,
    length,
    size_of,
)
from .growth import Grown, grown, kick_tangent
from .rest import Rest, fastest
from .trend import Trend, no_trend

RETURNS = (1, 2, 3, 4, 6)  # how many close an orbit
COUNTS = np.arange(1, max(RETURNS) + 1, dtype=np.int32)  # with those that close none
# A shot is asked for where a d_n passes the next of these, or at these times where it
# is small; where it is large again, the first level counts once more.
LEVELS = (6e-4, 2e-4, 7e-5)
TIMES = (130.0, 250.0, 500.0, 800.0, 1100.0, 1400.0)
LATER = 1.25  # and from the last of them on at times that grow by this
SMALL, LARGE = 0.01, 0.03
ALIKE = 3.0  # of fewer returns more is put up with: they close as well
CALM = 20.0  # time units for which a motion at rest stays below the cut
OWN = 3  # returns of its own by which a motion shows that it draws nearer
# Distances, in the orbit's own size: what has left it, and, in the norm in which that
# contracts, what is so near that no torus, and no saddle with one behind it, was seen
# to fit between (0.048 was too far).
LOST, ARRIVED = 0.3, 0.025
STAYS = 0.1  # of the move that an orbit's linear map foretells: it is not near it
NOISE = 2e-4  # of the state: what steps, and their jitter, leave in a return
LEAK = 1.05  # what is forgotten at each return of the smallest d_n
# What a motion that has stopped asks for
NOTHING, A_SHOT, ACCEPTANCE, ENDURES, REST, ESCAPE = range(6)


class Candidate(NamedTuple):
    """A stable orbit that a shot has found, to which the motion shall draw near."""

    there: Bool[Array, ""]
    returns: Int[Array, ""]
    x: Vector  # where it passes the section
    slope: Matrix  # the derivative of the map of so many returns there
    norm: Matrix  # in which that contracts
    radius: Scalar
    modes: Scalar | float = 0.0  # with set-valued friction: a number of its events


class Calm(NamedTuple):
    """Since when no joint has been faster than the cut."""

    start: Scalar
    early: Scalar  # the largest rates in its two halves
    late: Scalar


class Ends(NamedTuple):
    """A step's ends: times, states, accelerations."""

    t0: Scalar
    t1: Scalar
    y0: PhasePoint
    y1: PhasePoint
    a0: Numbers
    a1: Numbers


class Lookout(NamedTuple):
    """The running numbers of `March`."""

    passed: Ends  # the step of a return that has not been looked at
    waits: Scalar  # how many have not
    hurries: Scalar  # 1 where two have come before the first was looked at
    calm: Calm | tuple[()]
    asks: Int[Array, ""]
    grown: Grown | tuple[()] = ()
    swing: Swing | tuple[()] = ()  # where phi1 = 0 may not be the section

    @property
    def level(self) -> Scalar | tuple[()]:
        """The section's; (): 0."""
        return self.swing.level if self.swing else ()


class March(AbstractFold[Lookout]):
    """Watches for a return, for rest and for a rod that turns over.

    A return is looked at some steps later, by all lanes of a batch together: what a
    solve carries along it copies in each step. A motion whose next one has come by then
    stops at each from there on, until it is looked at.

    **Arguments:** `odd`: whether half returns count; `rest`: when it is at rest;
    `escape`: an angle that ends it; `carrier`: the method, where the kick's tangent
    goes along.
    """

    odd: Flag
    rest: Rest
    escape: Scalar
    carrier: Explicit | Taylor | None = None
    until: Scalar | None = None  # when the section is chosen; None: it is phi1 = 0

    def init(self, system, t0, y0):
        """The watch before the first return."""
        del system
        zero = 0.0 * y0[0]
        start, none = t0 + zero, (zero,) * len(y0.phi)
        return Lookout(
            passed=Ends(start, start, y0, y0, none, none),
            waits=zero,
            hurries=zero,
            calm=() if self.rest.by_modes else Calm(start, zero, zero),
            asks=jnp.zeros((), jnp.int32),
            grown=() if self.carrier is None else kick_tangent(y0),
            swing=() if self.until is None else Swing(y0[0], y0[0]),
        )

    def advance(self, solver, t0, t1, y0, system, first, state):
        """A step, and the image of the kick's tangent."""
        if self.carrier is None:
            return super().advance(solver, t0, t1, y0, system, first, state)
        _, (y1, images), (error, _), (last, _) = push(
            solver, system, t0, t1, y0, (state.grown.tangent,)
        )
        return y1, error, last, images, None

    def expand(self, system, y0, order, token, state):
        """The series of a step, and of the kick's tangent."""
        if self.carrier is None:
            return super().expand(system, y0, order, token, state)
        return expand_along(
            system, y0, order, token, (cast(Grown, state.grown).tangent,)
        )

    def outcome(self, state):
        """`complete` where it asks for something."""
        asks = state.asks != NOTHING
        none, complete = CODE.not_computed, CODE.complete
        return jnp.where(asks, complete, none).astype(jnp.int32)

    def step(self, system, state, step):
        """Keep the step if it returns, and see whether the motion is over."""
        return self.accepted(system, state, step, ACCEPTED)

    def accepted(self, system, state, step, verdict):
        """The same where the step is accepted: each number is masked once."""
        accepts, growth = verdict.accepts > 0, state.grown
        if self.carrier is not None:
            growth = grown(system, self.carrier, cast(Grown, growth), step)

        def look():
            """As numbers, and once: what a passage leaves asks for it 15 times."""
            falls = self.odd & (step.y1[0] < step.y0[0])
            heights = step.y0[0], step.y1[0]
            if state.swing:
                level = state.swing.level
                heights = heights[0] - level, heights[1] - level
            before, after = (jnp.where(falls, -x, x) for x in heights)
            rests, goes_on = self._rests(system, state, step)
            asks = jnp.where(accepts & rests, REST, state.asks)
            passes = accepts & (before < 0) & (after >= 0)
            if self.until is not None:
                passes &= step.t0 > self.until
            there = jnp.where(passes, 1.0, 0.0)
            return there, asks.astype(jnp.int32), jnp.where(goes_on, 1.0, 0.0)

        def escaped(asks):
            over = near & turns_over(step, self.escape)
            return jnp.where(over, ESCAPE, asks).astype(asks.dtype)

        there, asks, goes_on = materialise(step.t0, look)
        near = accepts & may_turn_over(step, self.escape)
        asks = if_any_lane(near, escaped, asks)
        ends = Ends(step.t0, step.t1, step.y0, step.y1, step.f0.omega, step.f1.omega)
        passed = tree_where(there > 0, ends, state.passed)
        calm = state.calm
        if not self.rest.by_modes:
            rate = fastest(step.y1)
            anew = Calm(step.t1, 0.0 * rate, 0.0 * rate)
            calm = tree_where(goes_on > 0, _longer(cast(Calm, calm), step, rate), anew)
        calm, growth = replaced(accepts, (calm, growth), (state.calm, state.grown))
        waits = state.waits + there
        hurries = jnp.where(waits > 1, 1.0, state.hurries)
        swing = state.swing
        if swing and self.until is not None:
            swing = tree_where(accepts, _wider(swing, step, self.until), swing)
        after = Lookout(passed, waits, hurries, calm, asks, growth, swing)
        return after, jnp.inf, (asks != NOTHING) | (hurries * waits > 0)

    def _rests(self, system: System, state: Lookout, step: Step) -> Flags:
        """Whether it rests for long enough, not on its way up; or is calm so far."""
        if self.rest.by_modes:
            return self.rest.sticks(step), True
        rate = fastest(step.y1)
        calm = _longer(cast(Calm, state.calm), step, rate)
        over = step.t1 - calm.start >= CALM
        slow = self.rest.slow(system, rate)
        rests = slow & over & (calm.late <= calm.early)
        return rests, slow & (jnp.logical_not(over) | rests)


def _longer(calm: Calm, step: Step, rate: Scalar) -> Calm:
    """The same calm a step later."""
    since = step.t1 - calm.start
    first_half = since <= CALM / 2
    early = jnp.where(first_half, larger(calm.early, rate), calm.early)
    late = jnp.where(first_half, calm.late, larger(calm.late, rate))
    return Calm(calm.start, early, late)


def _wider(swing: Swing, step: Step, until: Scalar) -> Swing:
    """A step later: over the second half of the time that there is."""
    phi = step.y1[0]
    anew, over = step.t1 <= until / 2, step.t1 > until
    low = jnp.where(anew, phi, jnp.minimum(swing.low, phi))
    high = jnp.where(anew, phi, jnp.maximum(swing.high, phi))
    return tree_where(over, swing, Swing(low, high))


class Returns(NamedTuple):
    """The returns so far, and the distances between them."""

    points: Float[Array, "7 m"]  # the last ones, newest first
    times: Float[Array, "7"]
    passages: Scalar
    last: Float[Array, "6"]  # d_n at the newest; infinity where n closes no orbit
    nearest: Scalar  # about the smallest of the last d_n
    level: Scalar  # how many of them have been used up
    due: Scalar  # the next of the times
    trend: Trend
    own: Scalar  # returns since the shot that found the candidate
    follows: Scalar  # how many of its own in a row draw near
    lost: Bool[Array, ""]  # whether the motion has left the candidate
    asks: Int[Array, ""]
    returns: Int[Array, ""]  # and for a shot of how many


def no_returns(zero: Scalar, size: int = 3) -> Returns:
    """Before the first; `size`: the numbers of each."""
    none = jnp.zeros((), jnp.int32)
    counts = len(COUNTS)
    return Returns(
        points=jnp.zeros((1 + counts, size), jnp.result_type(zero)) + zero,
        times=jnp.zeros(1 + counts, jnp.result_type(zero)) + zero,
        passages=zero,
        last=jnp.full(counts, jnp.inf, jnp.result_type(zero)) + zero,
        nearest=zero + jnp.inf,
        level=zero,
        due=zero + TIMES[0],
        trend=no_trend(zero),
        own=zero,
        follows=zero,
        lost=jnp.asarray(False),
        asks=none,
        returns=none,
    )


def with_return(
    state: Returns,
    lookout: Lookout,
    odd: Flag,
    orbit: Candidate,
    until_it_endures: bool = False,
) -> Returns:
    """After the return that waits.

    **Arguments:** `orbit`: the one it may draw near to; `until_it_endures`: whether a
    motion that does is over.
    """
    ends = lookout.passed

    def side():
        return jnp.where(odd & (ends.y1[0] < ends.y0[0]), -1.0, 1.0)

    sign = materialise(ends.t0, side)  # once for all numbers
    y0, y1 = (PhasePoint(sign * x for x in y) for y in (ends.y0, ends.y1))
    f0, f1 = (
        PhasePoint.of(y.omega, [sign * x for x in a])
        for y, a in ((y0, ends.a0), (y1, ends.a1))
    )
    step = Step(ends.t0, ends.t1, y0, y1, f0, f1, ())
    swing = lookout.swing
    plane = SectionPlane(level=swing.level) if swing else SectionPlane()
    here = passage(plane, step)
    point = jnp.stack(here.y[1:])
    points = jnp.concatenate([point[None], state.points[:-1]])
    times = jnp.concatenate([jnp.stack([here.time]), state.times[:-1]])
    # where two came at once one is lost: what was before says nothing of what follows
    count = jnp.where(lookout.waits > 1, 1.0, state.passages + 1)
    apart = jnp.max(jnp.abs(points[1:] - point[None]), axis=1) / size_of(point)
    closes = count > jnp.asarray(COUNTS, count.dtype)
    apart = jnp.where(np.isin(COUNTS, RETURNS) & closes, apart, jnp.inf)
    after = state._replace(
        points=points,
        times=times,
        passages=count,
        last=apart,
        nearest=jnp.minimum(LEAK * state.nearest, jnp.min(apart)),
    )
    trend = after.trend.after(largest(point), after.times[0] > after.due)
    after = after._replace(trend=trend)
    after = after._replace(own=after.own + 1)
    after = if_any_lane(
        orbit.there & ~after.lost, lambda now: _drawn_near(now, orbit), after
    )
    after = materialise(here.time, _with_request, state, after, orbit)
    if not until_it_endures:
        return after
    over = trend.endures & (after.asks == NOTHING)
    return after._replace(asks=jnp.where(over, ENDURES, after.asks).astype(jnp.int32))


def _with_request(before: Returns, now: Returns, orbit: Candidate) -> Returns:
    """Whether it is time for a shot, and of how many returns."""
    t, least = now.times[0], jnp.min(now.last)
    level = jnp.where(least > LARGE, 0.0, now.level)
    bound = _nth((*LEVELS, 0.0), level)
    passed = jnp.any((now.last < bound) & (now.last < before.last))
    timed = t > now.due
    times, levels = (jnp.asarray(x, t.dtype) for x in (TIMES, LEVELS))
    following = jnp.min(jnp.where(now.due < times, times, jnp.inf))
    following = jnp.where(now.due < TIMES[-1], following, LATER * now.due)
    asks = passed | (timed & (least < SMALL))
    # no shot at an orbit that is known, and that the motion has not left
    asks &= ~orbit.there | now.lost
    asks &= now.asks == NOTHING
    enough = ALIKE * jnp.maximum(jnp.where(passed, bound, 0.0), least)
    first = jnp.min(jnp.where(now.last < enough, COUNTS, COUNTS[-1]))
    below = jnp.sum(jnp.where(least < levels, 1.0, 0.0))
    return now._replace(
        level=jnp.where(passed, jnp.maximum(level, below), level),
        due=jnp.where(timed, following, now.due),
        asks=jnp.where(asks, A_SHOT, now.asks).astype(jnp.int32),
        returns=jnp.where(asks, first, now.returns).astype(jnp.int32),
    )


def _drawn_near(now: Returns, orbit: Candidate) -> Returns:
    """Whether the motion follows the candidate's linear map, return by return.

    Where it has none, or has left it, all stays as it was: batch mates come here too.
    """
    own = now.own
    returns = jnp.maximum(orbit.returns, 1).astype(jnp.result_type(own))
    # whole numbers, far below those whose quotients would be rounded
    mine = own - returns * jnp.floor((own + 0.5) / returns) == 0
    mine &= orbit.there & ~now.lost
    distance, size = now.points[0] - orbit.x, size_of(orbit.x)
    was = now.points[orbit.returns] - orbit.x
    good = follows(orbit, was, distance, NOISE * size)
    row = jnp.where(mine, jnp.where(good, now.follows + 1, 0.0), now.follows)
    arrived = mine & (row >= OWN) & (length(orbit.norm, distance) < ARRIVED * size)
    asks = jnp.where(arrived, ACCEPTANCE, now.asks)
    gone = largest(distance) > LOST * size
    # near the orbit it would move on: here is another one
    gone |= (
        length(orbit.norm, distance - was)
        < STAYS * length(orbit.norm, image(orbit.slope, was) - was) - NOISE * size
    )
    return now._replace(
        follows=row,
        lost=now.lost | (mine & gone),
        asks=asks.astype(jnp.int32),
    )


def follows(
    orbit: Candidate, before: Vector, after: Vector, noise: Scalar
) -> Bool[Array, ""]:
    """Whether distances from an orbit go on as its linear map says, and do not grow."""
    rate = contraction_rate(orbit.norm, orbit.radius)
    rest = length(orbit.norm, after - image(orbit.slope, before))
    was, now = length(orbit.norm, before), length(orbit.norm, after)
    # the norm stretches noise by the root of its trace at most
    noise = noise * jnp.sqrt(jnp.trace(orbit.norm))
    return (rest <= (1 - rate) / 2 * was + noise) & (now <= was + noise)


def ask_no_more(state: Returns) -> Returns:
    """The motion goes on."""
    return state._replace(asks=jnp.zeros_like(state.asks))


def with_candidate(state: Returns) -> Returns:
    """The motion goes on, under the watch of a new candidate."""
    zero, no = jnp.zeros_like(state.own), jnp.zeros_like(state.lost)
    return ask_no_more(state)._replace(own=zero, follows=zero, lost=no)


def span_of(state: Returns, returns: Count) -> Scalar:
    """The time that the last so many returns took."""
    return state.times[0] - state.times[returns]


def _nth(numbers: Sequence[Scalar], place: Scalar) -> Scalar:
    """One of a few numbers."""
    pairs = enumerate(numbers)
    none = jnp.zeros_like(place)
    return sum((jnp.where(place == i, x, 0.0) for i, x in pairs), none)
