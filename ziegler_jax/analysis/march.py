r"""The walk along a branch of cycles, step by step: see `continuation`."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ..context import resumable
from ..model.column import State
from ..motion.scene import check_maker, check_scene, float_state, made
from ..numerics.numbers import is_concrete, keeps, number, whole_number
from ..results import ORBIT, SPECIAL
from ..solvers import Explicit
from .implicit import fixed
from .periodic_orbit import approximation, method_for, settings_of
from .shooting import Shot, blank_shot, newton, shot_motion, shot_of, solve

SMALLEST_STEP = 1e-6  # on the arc
STRAIGHT = 0.9  # the cosine of the largest turn between two points
NEWTON_STEPS = 10  # more say that the step was too long
REFINEMENTS = 30  # of a special point, by the Illinois method; some eight are needed
EXACT = 1e-10  # on the arc, of a special point
CROWDED = 1e-4  # a step in which two things happen is not shortened below it


class Kept(NamedTuple):
    """Points of a branch as they are kept, arrays (n, ...)."""

    x: Any  # (5,) scaled
    tangent: Any  # (5,)
    extent: Any  # (3,)
    moved: Any  # (4, 4)
    matrix: Any  # (4, 5) of R in z and the parameter
    tests: Any  # (4,)


class March(NamedTuple):
    """Where the continuation is."""

    here: Kept
    beyond: Kept  # the point behind a special one that is being refined
    step: Any
    seeks: Any  # 0. none, or the code of the special point that is being refined
    low: Any  # its bracket on the arc, two (s, test)
    high: Any
    tries: Any
    kept: Kept
    count: Any
    special: Kept
    kind: Any
    specials: Any
    outcome: Any
    attempts: Any
    left: Any  # of the step budget


class Road:
    """What a continuation needs: the problem, its scales, and where it starts."""

    def __init__(
        self,
        make_column: Callable,
        guess: State,
        start: Any,
        direction: int,
        step: Any,
        bounds: tuple,
        *,
        period: Any = None,
        section: Any = 0.0,
        loops: int = 1,
        patience: Any = 200.0,
        rtol: Any = 1e-10,
        atol: Any = 1e-10,
        solver: Explicit | None = None,
        max_steps: int = 10_000_000,
    ):
        """Check it, and set the scales."""
        if direction not in (1, -1):
            raise ValueError(
                f"Argument `direction` must be 1 or -1, but is {direction!r}."
            )
        dtype = jnp.result_type(float)
        loops = whole_number("loops", loops)
        check_maker(make_column)
        start = number("start", start)
        check_bounds(bounds, start)
        at = fixed(jnp.asarray(start, dtype))
        step = number("step", step, "positive")
        self.step = fixed(jnp.asarray(step, dtype))
        self.bounds = bounds
        self.direction = direction
        column = made(make_column, at)
        check_scene(column, guess, "guess")
        self.method = method_for(column, solver, rtol, atol, max_steps)
        # what the function closes over, without its derivatives
        self.make = fixed(eqx.filter_closure_convert(make_column, at))
        still, y0 = self.make(at), fixed(float_state(guess))
        first = approximation(still, y0, period, section, loops, patience, self.method)
        z, self.section, self.left = first.z, first.section, first.left
        good = keeps("finite", start) & keeps("positive", step) & _hold(bounds, at)
        self.failure = jnp.where(good, first.failure, ORBIT.invalid)
        settings = settings_of(self.method, period, section, loops, patience)
        self.settings = {**settings, "direction": direction, "step": step}
        one = jnp.ones((), dtype)
        size = jnp.where(at == 0, one, jnp.abs(at))
        self.scale = jnp.stack([one, one, one, jnp.maximum(z[3], 1e-3), size])
        self.first = jnp.concatenate([z, at[None]]) / self.scale

    def correct(self, x0: Any, row: Any, left: Any) -> tuple[Kept, Any, Any, Any]:
        """The point of the branch on the plane through x0 across `row`.

        **Returns:** the point, whether it is one, Newton's iterations, and how many
        steps are left.
        """

        def motion(x, left):
            z, share = x * self.scale, self.method._replace(max_steps=left)
            make = lambda p: self.make(p[0])  # noqa: E731
            return shot_motion(make, z[4:], self.section, z[:4], share)

        def equations(x, flow):
            shot = shot_of(self.section, (x * self.scale)[:4], flow)
            matrix = _matrix(shot) * self.scale[None]
            r = jnp.concatenate([shot.residual, (row @ (x - x0))[None]])
            return r, jnp.concatenate([matrix, row[None]]), shot

        blank = blank_shot(1, x0.dtype)
        found = newton(motion, equations, x0, blank, NEWTON_STEPS, left)
        shot = found.shot
        matrix = _matrix(shot)
        whole = jnp.concatenate([matrix * self.scale[None], row[None]])
        tangent = solve(whole, jnp.eye(5, dtype=x0.dtype)[4])
        tangent = tangent / jnp.sqrt(tangent @ tangent)
        moved = shot.flow.moved[:, :4]
        tests = jnp.stack([tangent[4], *products(moved)])
        point = Kept(found.z, tangent, shot.flow.extent, moved, matrix, tests)
        good = found.converged & jnp.all(jnp.isfinite(tangent))
        return point, good, found.count, found.left

    def follow(
        self, points: int, specials: int, kinds: tuple, stop: bool, most: Any = None
    ) -> March:
        """Walk until `points` are there, or with `stop` until a special one is."""
        dtype = self.first.dtype
        most = points if most is None else most
        empty = Kept(*(jnp.full(s, jnp.nan, dtype) for s in _SHAPES))

        def room(n):
            return jax.tree.map(
                lambda x: jnp.full((n, *x.shape), jnp.nan, dtype), empty
            )

        zero, none = jnp.zeros((), dtype), jnp.zeros((), jnp.int32)
        forward = jnp.zeros(5, dtype).at[4].set(self.direction)
        here = empty._replace(x=self.first, tangent=forward)
        pair = jnp.zeros(2, dtype)
        begin = March(
            here, empty, self.step, none, pair, pair, none, room(points), none,
            room(specials), jnp.zeros(specials, jnp.int32), none,
            self.failure.astype(jnp.int32), none, self.left,
        )  # fmt: skip
        low, high = (jnp.asarray(b, dtype) for b in self.bounds)
        wanted = jnp.asarray(kinds)

        def goes_on(now: March):
            going = (now.outcome == ORBIT.not_computed) & (now.left > 0)
            return going & (now.attempts < 6 * most + 40)

        def attempt(now: March) -> March:
            refining, starting = now.seeks > 0, now.count == 0
            (sa, fa), (sb, fb) = now.low, now.high
            inside = (sa * fb - sb * fa) / jnp.where(fa == fb, 1.0, fb - fa)
            s = jnp.where(refining, inside, jnp.where(starting, zero, now.step))
            base = now.here
            ahead = base.x + s * base.tangent
            point, good, count, left = self.correct(ahead, base.tangent, now.left)
            good &= starting | refining | _straight(point.tangent, base.tangent)

            # walk
            changed = (point.tests * base.tests < 0) & wanted & ~starting
            changed = _real_changes(changed, base.moved, point.moved)
            # one at a time: of two within a step the second would go unnoticed
            crowded = ~refining & (jnp.sum(changed) > 1) & (s > CROWDED)
            good &= ~crowded
            kind = jnp.where(jnp.any(changed), 1 + jnp.argmax(changed), 0)
            kind = jnp.where(good & ~refining & (now.specials < specials), kind, 0)
            kind = kind.astype(jnp.int32)
            walked = good & ~refining & (kind == 0)
            grown = now.step * jnp.where(count <= 4, 1.5, 1.0)
            step = jnp.where(good, jnp.minimum(grown, self.step), 0.4 * now.step)
            step = jnp.where(refining, now.step, step)

            # refine, by the Illinois method
            at = jnp.maximum(now.seeks - 1, 0)
            f = point.tests[at]
            same = f * fb > 0
            new_low = jnp.where(same, jnp.stack([sa, 0.5 * fa]), now.high)
            new_high = jnp.stack([s, f])
            exact = (jnp.abs(s - sb) < EXACT) | (f == 0)
            refined = refining & good & (exact | (now.tries >= REFINEMENTS))
            # where branches cross Newton's method is singular: the chord will do
            crossing = refining & ~good & (now.seeks == SPECIAL.pitchfork) & (left > 0)
            chord = _chord(base, now.beyond)
            found = jax.tree.map(lambda a, b: jnp.where(crossing, b, a), point, chord)
            lost = refining & ~good
            refined |= crossing
            which = jnp.maximum(kind - 1, 0)
            begins = kind > 0
            ends = jnp.stack([jnp.stack([zero, base.tests[which]]),
                              jnp.stack([s, point.tests[which]])])  # fmt: skip
            lower = jnp.where(begins, ends[0], new_low)
            upper = jnp.where(begins, ends[1], new_high)
            real = (now.seeks != SPECIAL.torus) | _circles(found.moved)
            place = jnp.where(refined & real, now.specials, specials)
            special = _put(now.special, place, found)
            kinds_ = now.kind.at[place].set(now.seeks, mode="drop")

            # where to go on from, and whether
            def choose(new, beyond, old):
                kept = jnp.where(refined | lost, beyond, old)
                return jnp.where(walked, new, kept)

            on = walked | refined | lost
            here = jax.tree.map(choose, point, now.beyond, base)
            place = jnp.where(on, now.count, points)
            kept = _put(now.kept, place, here)
            total = now.count + on.astype(jnp.int32)
            number_ = now.specials + (refined & real).astype(jnp.int32)
            value = here.x[4] * self.scale[4]
            outcome = jnp.where(total >= most, ORBIT.found, now.outcome)
            outcome = jnp.where((value < low) | (value > high), ORBIT.beyond, outcome)
            outcome = jnp.where(here.x[1] <= 0, ORBIT.collapsed, outcome)
            outcome = jnp.where(on, outcome, now.outcome)
            outcome = jnp.where(stop & (number_ > 0), ORBIT.found, outcome)
            lost_way = (step < SMALLEST_STEP) | (starting & ~good)
            spent = (left <= 0) & ~good
            outcome = jnp.where(lost_way & ~spent, ORBIT.not_converged, outcome)
            return March(
                here=here,
                beyond=jax.tree.map(
                    lambda a, b: jnp.where(begins, a, b), point, now.beyond
                ),
                step=step,
                seeks=jnp.where(begins, kind, jnp.where(refined | lost, 0, now.seeks)),
                low=lower,
                high=upper,
                tries=jnp.where(refining, now.tries + 1, 0),
                kept=kept,
                count=total,
                special=special,
                kind=kinds_,
                specials=number_,
                outcome=outcome.astype(jnp.int32),
                attempts=now.attempts + 1,
                left=left,
            )

        def some(now: March, max_steps: Any) -> March:
            least = now.left - max_steps
            return lax.while_loop(lambda m: goes_on(m) & (m.left > least), attempt, now)

        end = resumable(begin, some, lambda m: (goes_on(m), self.left - m.left))
        if end is None:
            end = some(begin, begin.left)
        spent = jnp.where(end.left > 0, ORBIT.not_converged, ORBIT.not_integrated)
        unended = end.outcome == ORBIT.not_computed
        outcome = jnp.where(unended, spent, end.outcome).astype(jnp.int32)
        return end._replace(outcome=outcome)


_SHAPES = ((5,), (5,), (3,), (4, 4), (4, 5), (4,))


def check_bounds(bounds: Any, start: Any) -> None:
    """Two numbers, maybe infinite, that increase and hold the start between them."""
    try:
        low, high = bounds
    except (TypeError, ValueError):
        raise ValueError(
            f"Argument `bounds` must be two numbers, but is {bounds!r}."
        ) from None
    known = [float(x) for x in (low, start, high) if is_concrete(x)]
    if not (known == sorted(known) and (len(known) < 2 or known[0] < known[-1])):
        raise ValueError(
            "Argument `bounds` must increase and hold `start`, but is "
            f"{bounds!r} with `start` = {start}."
        )


def _hold(bounds: tuple, start: Any) -> Any:
    """Whether traced bounds increase and hold the start; they may be infinite."""
    low, high = bounds
    if is_concrete(low) and is_concrete(high):
        return True
    return (low <= start) & (start <= high) & (low < high)


def _straight(new: Any, old: Any) -> Any:
    """Whether a branch turns little between two points: in phi2, T, the parameter.

    The rates have kinks where, as the branch goes on, a joint begins to stick at the
    section; angle and period have none.
    """
    new, old = (x[jnp.array([0, 3, 4])] for x in (new, old))
    return new @ old > STRAIGHT * jnp.sqrt((new @ new) * (old @ old))


def _put(kept: Kept, place: Any, point: Kept) -> Kept:
    """The point in its place; none beyond the end."""
    return jax.tree.map(lambda a, x: a.at[place].set(x, mode="drop"), kept, point)


def _matrix(shot: Shot) -> Any:
    """R's derivatives in z and the parameter, (4, 5)."""
    return jnp.concatenate([shot.jacobian, shot.flow.moved[:, 4:]], axis=1)


def _cubic(moved: Any) -> tuple[Any, Any, Any]:
    """b2, b1, b0 of the cubic whose roots are the multipliers other than 1."""
    square = moved @ moved
    t1, t2, t3 = jnp.trace(moved), jnp.trace(square), jnp.trace(square @ moved)
    e2 = (t1 * t1 - t2) / 2
    e3 = (t1**3 - 3 * t1 * t2 + 2 * t3) / 6
    b2 = 1 - t1
    b1 = e2 + b2
    return b2, b1, b1 - e3


def products(moved: Any) -> tuple[Any, Any, Any]:
    """The products over the multipliers: torus, flip, pitchfork."""
    b2, b1, b0 = _cubic(moved)
    return b0 * b0 - b2 * b0 + b1 - 1, 1 - b2 + b1 - b0, 1 + b2 + b1 + b0


def _circles(moved: Any) -> Any:
    """Whether two multipliers whose product is 1 are a complex pair."""
    b2, _, b0 = _cubic(moved)
    return jnp.abs(b0 - b2) < 2


def _chord(low: Kept, high: Kept) -> Kept:
    """Between two points, where the pitchfork's test would vanish if it were linear."""
    at = SPECIAL.pitchfork - 1
    rise = high.tests[at] - low.tests[at]
    share = -low.tests[at] / jnp.where(rise == 0, 1.0, rise)
    return jax.tree.map(lambda a, b: a + share * (b - a), low, high)


def _real_changes(changed: Any, before: Any, after: Any) -> Any:
    """Changes of the tests' signs without those that mean nothing.

    The torus' test vanishes, too, where two real multipliers are reciprocal; that of
    the pitchfork at a fold.
    """
    torus, pitchfork = SPECIAL.torus - 1, SPECIAL.pitchfork - 1
    changed = changed.at[torus].set(
        changed[torus] & (_circles(before) | _circles(after))
    )
    return changed.at[pitchfork].set(changed[pitchfork] & ~changed[0])
