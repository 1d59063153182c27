"""The walk along a branch of cycles, step by step: see `continuation`."""

from collections.abc import Sequence
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..motion.implicit import fixed
from ..numerics.resumable import Phase, place_of, resumable
from ..results import CODE
from .branch_point import AbstractContinuation, BranchPoint

SMALLEST_STEP = 1e-6  # on the arc
STRAIGHT = 0.9  # the cosine of the largest turn between two points
REFINEMENTS = 30  # of a special point, by the Illinois method; some eight are needed
EXACT = 1e-10  # on the arc, of a special point
CROWDED = 1e-4  # a step in which two things happen is not shortened below it

End = Float[Array, "2"]  # of a bracket: s, and the test there


class ContinuationState(NamedTuple):
    """Where the continuation is."""

    here: BranchPoint
    beyond: BranchPoint  # the point behind a special one that is being refined
    step: Float[Array, ""]
    # 0: none, or the code of the special point that is being refined
    seeks: Int[Array, ""]
    low: End  # its bracket on the arc
    high: End
    tries: Int[Array, ""]
    points: BranchPoint
    filled: Int[Array, ""]  # how many of them there are
    special: BranchPoint
    kind: Int[Array, " room"]
    specials: Int[Array, ""]
    outcome: Int[Array, ""]
    attempts: Int[Array, ""]
    left: Int[Array, ""]  # of the step budget
    # whether, since the last point, an attempt failed in another sequence of modes
    modes_change: Bool[Array, ""]


class Attempt(NamedTuple):
    """The point that was tried last."""

    s: Float[Array, ""]  # how far from the last one of the branch
    point: BranchPoint
    good: Bool[Array, ""]  # whether it is a point of the branch
    iterations: Int[Array, ""]  # Newton's
    error: Float[Array, ""]  # of the tangent's prediction, of what it may be
    left: Int[Array, ""]  # of the step budget
    refining: Bool[Array, ""]  # whether a special point is sought
    starting: Bool[Array, ""]  # whether it is the first


class Refinement(NamedTuple):
    """The state of the refinement of a special point."""

    low: End  # its bracket
    high: End
    ended: Bool[Array, ""]  # whether it was found or given up
    there: Bool[Array, ""]  # whether it was found
    point: BranchPoint


class Walk:
    """A walk along a branch.

    **Arguments:** `problem`; `room`: for how many special points; `kinds`: which of
    them, a flag for each test; `stop`: whether the first of them ends the walk.
    """

    def __init__(
        self,
        problem: AbstractContinuation,
        room: int,
        kinds: Sequence[bool],
        stop: bool,
    ):
        """Keep them."""
        self.problem, self.room, self.stop = problem, room, stop
        self.kinds = jnp.asarray(kinds)
        self.most = cast(int, problem.arc.points)
        self.points = 1 if stop else self.most  # on the way none is asked for
        self.longest = fixed(jnp.asarray(problem.arc.step, problem.first.dtype))
        # of a branch's points; on the way to a fold none is asked for
        self.error = jnp.inf if stop else fixed(problem.arc.error)

    def follow(self) -> ContinuationState:
        """Walk until all points are there, or the special one."""
        begin = self.begin()

        def some(
            now: ContinuationState, max_steps: Int[Array, ""]
        ) -> ContinuationState:
            least = now.left - max_steps
            return lax.while_loop(
                lambda m: self.goes_on(m) & (m.left > least), self.attempt, now
            )

        def status(now: ContinuationState) -> tuple[Int[Array, ""], Int[Array, ""]]:
            return place_of(self.goes_on(now)), begin.left - now.left

        end = resumable(begin, [Phase(some)], status)
        spent = jnp.where(end.left > 0, CODE.not_converged, CODE.not_integrated)
        unended = end.outcome == CODE.not_computed
        outcome = jnp.where(unended, spent, end.outcome).astype(jnp.int32)
        return end._replace(outcome=outcome)

    def begin(self) -> ContinuationState:
        """Before the first point."""
        dtype, empty = self.problem.first.dtype, self.problem.blank()

        def room(n):
            return jax.tree.map(
                lambda x: jnp.full((n, *x.shape), jnp.nan, dtype), empty
            )

        none, pair = jnp.zeros((), jnp.int32), jnp.zeros(2, dtype)
        return ContinuationState(
            here=empty._replace(x=self.problem.first, tangent=self.problem.forward()),
            beyond=empty,
            step=self.longest,
            seeks=none,
            low=pair,
            high=pair,
            tries=none,
            points=room(self.points),
            filled=none,
            special=room(self.room),
            kind=jnp.zeros(self.room, jnp.int32),
            specials=none,
            outcome=self.problem.failure.astype(jnp.int32),
            attempts=none,
            left=self.problem.left,
            modes_change=jnp.asarray(False),
        )

    def goes_on(self, now: ContinuationState) -> Bool[Array, ""]:
        """Whether there is more to try."""
        going = (now.outcome == CODE.not_computed) & (now.left > 0)
        return going & (now.attempts < 6 * self.most + 40)

    def attempt(self, now: ContinuationState) -> ContinuationState:
        """Try one point: the next one, or one nearer to the special one."""
        base, tried = now.here, self._tried(now)
        kind, tried = self._passed(now, tried)
        begins, walked = kind > 0, tried.good & ~tried.refining & (kind == 0)
        special = self._refined(now, tried)
        most = jnp.where(tried.iterations <= 4, 1.5, 1.0)
        # the prediction's error goes with the square of the step
        best = 0.9 / jnp.sqrt(jnp.maximum(tried.error, 0.1))
        grown = now.step * jnp.clip(best, 0.4, most)
        step = jnp.where(tried.good, jnp.minimum(grown, self.longest), 0.4 * now.step)
        step = jnp.where(tried.refining, now.step, step)
        which = jnp.maximum(kind - 1, 0)
        ends = [jnp.stack([0.0 * tried.s, base.tests[which]]),
                jnp.stack([tried.s, tried.point.tests[which]])]  # fmt: skip
        real = special.there & self.problem.confirms(now.seeks, special.point)
        place = jnp.where(real, now.specials, self.room)

        def choose(new, beyond, old):
            after = jnp.where(special.ended, beyond, old)
            return jnp.where(walked, new, after)

        on = walked | special.ended
        here = jax.tree.map(choose, tried.point, now.beyond, base)
        after = now._replace(
            here=here,
            beyond=jax.tree.map(
                lambda a, b: jnp.where(begins, a, b), tried.point, now.beyond
            ),
            step=step,
            seeks=jnp.where(begins, kind, jnp.where(special.ended, 0, now.seeks)),
            low=jnp.where(begins, ends[0], special.low),
            high=jnp.where(begins, ends[1], special.high),
            tries=jnp.where(tried.refining, now.tries + 1, 0),
            points=_put(now.points, jnp.where(on, now.filled, self.points), here),
            filled=now.filled + on.astype(jnp.int32),
            special=_put(now.special, place, special.point),
            kind=now.kind.at[place].set(now.seeks, mode="drop"),
            specials=now.specials + real.astype(jnp.int32),
            attempts=now.attempts + 1,
            left=tried.left,
            modes_change=~on & (now.modes_change | _other_modes(base, tried.point)),
        )
        return after._replace(outcome=self._outcome(after, tried, on))

    def _tried(self, now: ContinuationState) -> Attempt:
        """The next point, along the tangent or within the bracket."""
        refining, starting = now.seeks > 0, now.filled == 0
        (sa, fa), (sb, fb) = now.low, now.high
        inside = (sa * fb - sb * fa) / jnp.where(fa == fb, 1.0, fb - fa)
        s = jnp.where(refining, inside, jnp.where(starting, 0.0 * sa, now.step))
        base = now.here
        ahead = base.x + s * base.tangent
        point, good, count, left = self.problem.correct(ahead, base.tangent, now.left)
        free = starting | refining
        smooth = self.problem.smooth()
        kink = (s < self.problem.kink) & _other_modes(base, point)
        free |= kink
        good &= free | _straight(point.tangent[smooth], base.tangent[smooth])
        off = (point.x - ahead)[smooth]
        error = jnp.where(free, 0.0, jnp.sqrt(off @ off) / self.error)
        good &= error <= 1
        return Attempt(s, point, good, count, error, left, refining, starting)

    def _passed(
        self, now: ContinuationState, tried: Attempt
    ) -> tuple[Int[Array, ""], Attempt]:
        """The test whose zero the step went past, counted from 1, 0 for none."""
        base = now.here
        changed = (tried.point.tests * base.tests < 0) & self.kinds & ~tried.starting
        changed = self.problem.real_changes(changed, base, tried.point)
        # one at a time: of two within a step the second would go unnoticed
        crowded = ~tried.refining & (jnp.sum(changed) > 1) & (tried.s > CROWDED)
        good = tried.good & ~crowded
        kind = jnp.where(jnp.any(changed), 1 + jnp.argmax(changed), 0)
        # where a branch is born at an equilibrium its parameter turns: that is no fold
        free = good & ~tried.refining & (now.specials < self.room)
        free &= ~self.problem.collapsed(tried.point, now.points)
        kind = jnp.where(free, kind, 0).astype(jnp.int32)
        return kind, tried._replace(good=good)

    def _refined(self, now: ContinuationState, tried: Attempt) -> Refinement:
        """The bracket after the attempt, by the Illinois method."""
        (sa, fa), (sb, fb) = now.low, now.high
        f = tried.point.tests[jnp.maximum(now.seeks - 1, 0)]
        same = f * fb > 0
        low = jnp.where(same, jnp.stack([sa, 0.5 * fa]), now.high)
        exact = (jnp.abs(tried.s - sb) < EXACT) | (f == 0)
        lost = tried.refining & ~tried.good
        there = tried.refining & tried.good & (exact | (now.tries >= REFINEMENTS))
        # where branches cross Newton's method is singular: the chord will do
        at = self.problem.crossing
        crossing = lost & (now.seeks == at) & (tried.left > 0)
        point = jax.tree.map(
            lambda a, b: jnp.where(crossing, b, a),
            tried.point,
            _chord(now.here, now.beyond, at - 1),
        )
        there |= crossing
        return Refinement(low, jnp.stack([tried.s, f]), there | lost, there, point)

    def _outcome(
        self, after: ContinuationState, tried: Attempt, on: Bool[Array, ""]
    ) -> Int[Array, ""]:
        """Whether the walk has ended, and why; `on`: whether it has gone on."""
        problem, here = self.problem, after.here
        outcome = jnp.where(after.filled >= self.most, CODE.found, after.outcome)
        outcome = jnp.where(problem.left_bounds(here), CODE.beyond, outcome)
        collapsed = problem.collapsed(here, after.points)
        outcome = jnp.where(collapsed, CODE.collapsed, outcome)
        outcome = jnp.where(on, outcome, after.outcome)
        outcome = jnp.where(self.stop & (after.specials > 0), CODE.found, outcome)
        lost_way = (after.step < SMALLEST_STEP) | (tried.starting & ~tried.good)
        spent = (tried.left <= 0) & ~tried.good
        outcome = jnp.where(lost_way & ~spent, CODE.not_converged, outcome)
        return outcome.astype(jnp.int32)


def _other_modes(one: BranchPoint, other: BranchPoint) -> Bool[Array, ""]:
    """Whether joints stick and slip in another sequence."""
    return one.modes != other.modes


def _straight(new: Float[Array, " n"], old: Float[Array, " n"]) -> Bool[Array, ""]:
    """Whether a branch turns little between two points."""
    return new @ old > STRAIGHT * jnp.sqrt((new @ new) * (old @ old))


def _put(points: BranchPoint, place: Int[Array, ""], point: BranchPoint) -> BranchPoint:
    """The point in its place; none beyond the end."""
    return jax.tree.map(lambda a, x: a.at[place].set(x, mode="drop"), points, point)


def _chord(low: BranchPoint, high: BranchPoint, at: int) -> BranchPoint:
    """Between two points, where a test would vanish if it were linear."""
    rise = high.tests[at] - low.tests[at]
    share = -low.tests[at] / jnp.where(rise == 0, 1.0, rise)
    return jax.tree.map(lambda a, b: a + share * (b - a), low, high)
