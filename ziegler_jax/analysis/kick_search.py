r"""The search for the least kick: rays, their thresholds, and steps from ray to ray.

A ray is a point c of a unit sphere, a place on it a size r, the start there the kick in
the direction c with the energy $r^2 / 2$. One motion says whether it flutters. A search
goes along the rays of a table in turn, outwards as far as a little beyond the best
threshold so far, and descends from each that flutters:

1. the interval between a size that rests and one that flutters is halved;
2. neighbours of the ray, h away, are tried at the size at which the ray itself rests.
    One that flutters there has a lower threshold and takes its place, and its own
    interval is looked for downwards. If none does, h is halved.

A descent that reaches the ray of the best, or cannot get below it, is given up. A last
descent starts at the best, with finer steps. So far a motion whose angle exceeds
`SCREEN` times the size of its start counts as flutter, without a certificate. The
motion at the upper end of the last interval is then followed until it has one; should
it come to rest after all, the search begins again without that screen.

A verdict is a single bit, so jumps and edges of the threshold, which sticking causes,
do no harm; the error in the energy is of the second order in the last h.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..model.column import Column, State
from ..motion.implicit import fixed
from ..numerics.materialise import tree_where
from ..numerics.numbers import Flag, Numbers, Scalar
from ..results import CODE
from .threshold import MOVES, NONE, verdict_of

RAY, HALVE, POLL, DOWN, CHECK = range(5)  # what the present motion is for
MARGIN = 1.25  # how far beyond the best threshold a ray is followed
FIRST, LEAST_STEP = 0.2, 0.02  # h: at first, and where a descent is given up
FINE = 0.05  # at first in the last descent
ROUGH = 0.02  # the widest interval, relative, from which neighbours are tried
SCREEN = 4.0  # of 41 335 motions that come to rest none came to 3, three to 2
NOTHING = 1e-6  # of the largest size: a threshold below it is none
POLLS = 256  # directions in the table of neighbours

Point = Float[Array, " k"]
Norm = Callable[[Column, Numbers], Scalar]
CORRECTIONS = 5  # of a size: the energy is a square but for a cosine


class Rays:
    """Starts by direction and size, in a norm.

    **Arguments:** `norm`, of the second order in the start; `free`: which of its four
    numbers differ from zero.
    """

    def __init__(self, column: Column, norm: Norm, free: tuple[int, ...]):
        """Make a basis of starts that is orthonormal at rest."""
        self.column, self.norm = column, norm
        k, dtype = len(free), jnp.result_type(float)
        measure = partial(self.measure, fixed(column))
        returned: list[object] = []
        jax.eval_shape(lambda y: returned.append(measure(y)), jnp.zeros(4, dtype))
        usual = () if isinstance(returned[0], (int, float)) else None
        shape = getattr(returned[0], "shape", usual)
        if shape != ():
            what = f"shape {shape}" if shape else repr(returned[0])
            raise ValueError(
                f"Argument `norm` must return one number, but returns {what}."
            )
        square = jax.hessian(measure)(jnp.zeros(4, dtype))[np.ix_(free, free)]
        factor = jnp.linalg.cholesky(square)
        self.positive = jnp.all(jnp.isfinite(factor))
        factor = jnp.where(self.positive, factor, jnp.eye(k, dtype=dtype))
        inverse = jnp.linalg.inv(factor).T
        self.basis = jnp.zeros((4, k), dtype).at[free, :].set(inverse)

    def measure(self, column: Column, y: Float[Array, "4"]) -> Scalar:
        """The norm of a start."""
        return self.norm(column, state_of(y).y)

    def at(self, column: Column, c: Point, r: Scalar) -> Float[Array, "4"]:
        """The start on a ray whose norm is r^2 / 2."""
        y, wanted = r * (self.basis @ c), r * r / 2
        for _ in range(CORRECTIONS):
            now, slope = jax.jvp(partial(self.measure, column), (y,), (y,))
            # Newton's method in logarithms: a square needs no correction
            there = (now > 0) & (slope > 0)
            now, slope = (jnp.where(there, x, 1.0) for x in (now, slope))
            share = jnp.where(there, wanted / now, 1.0)
            y = y * share ** (now / slope)
        return y

    def angle(
        self, y: Float[Array, "4"], normal: Float[Array, "4"]
    ) -> Float[Array, ""]:
        """Between the norm's gradient and a normal, in the norm, of what is free."""
        gradient = jax.grad(partial(self.measure, fixed(self.column)))(y)
        # a covector's coordinates in the basis
        a, b = (g @ self.basis for g in (gradient, normal))
        across = jnp.linalg.norm(a / jnp.linalg.norm(a) - b / jnp.linalg.norm(b))
        return 2 * jnp.arcsin(jnp.minimum(across / 2, 1.0))


def state_of(y: Float[Array, "4"]) -> State:
    """Four numbers as a start."""
    return State((y[0], y[1]), (y[2], y[3]))


class Ray(NamedTuple):
    """A direction with an interval of sizes that holds its threshold."""

    c: Point
    low: Float[Array, ""]  # rests
    high: Float[Array, ""]  # flutters; inf: none is known that does


class Descent(NamedTuple):
    """Where a lane is in its search."""

    phase: Int[Array, ""]
    c: Point  # the next motion's ray and size
    r: Float[Array, ""]
    row: Int[Array, ""]  # of the ray in the table
    level: Int[Array, ""]  # of the size along it
    ray: Ray  # the descent's, and the best of those that are over
    best: Ray
    h: Float[Array, ""]
    poll: Int[Array, ""]  # which neighbour
    fails: Int[Array, ""]  # neighbours in a row that rest
    reach: Float[Array, ""]  # how far down the next size is looked for
    fine: Bool[Array, ""]  # whether it is the last descent
    screen: Float[Array, ""]  # of the size at the start; inf: none
    motions: Int[Array, ""]
    undecided: Int[Array, ""]
    obstacle: Int[Array, ""]
    outcome: Int[Array, ""]  # `not_computed` while it runs


class Plan(NamedTuple):
    """The fixed part of a search."""

    least: Float[Array, ""]  # sizes
    largest: Float[Array, ""]
    odd: Bool[Array, ""]
    scan: int
    width: float  # relative, of the last interval
    rays: np.ndarray  # (n, k), points of the sphere
    neighbours: np.ndarray  # (m, k), where k > 2

    def begin(self, valid: Bool[Array, ""]) -> Descent:
        """Before the first motion."""
        zero, none = 0.0 * self.least, jnp.zeros((), jnp.int32)
        c = jnp.asarray(self.rays[0], zero.dtype) + zero
        ray = Ray(c, zero, zero + jnp.inf)
        outcome = jnp.where(valid, CODE.not_computed, CODE.invalid).astype(jnp.int32)
        return Descent(
            phase=none,
            c=c,
            r=self.least,
            row=none,
            level=none,
            ray=ray,
            best=ray,
            h=zero + FIRST,
            poll=none,
            fails=none,
            reach=zero,
            fine=jnp.asarray(False),
            screen=zero + SCREEN,
            motions=none,
            undecided=none,
            obstacle=none,
            outcome=outcome,
        )

    def after(self, now: Descent, outcome: Int[Array, ""], moves: Flag) -> Descent:
        """The search after one more motion."""
        verdict = verdict_of(outcome, moves)
        flutters, open_ = verdict == MOVES, verdict == NONE
        now = now._replace(
            motions=now.motions + 1,
            undecided=now.undecided + open_.astype(jnp.int32),
            obstacle=jnp.where(open_ & (now.undecided == 0), outcome, now.obstacle),
        )
        after = self._along_ray(now, flutters)
        for phase, step in ((HALVE, self._halved), (POLL, self._polled)):
            after = tree_where(now.phase == phase, step(now, flutters), after)
        lowered = self._lowered(now, flutters, open_)
        after = tree_where(now.phase == DOWN, lowered, after)
        after = tree_where(
            now.phase == CHECK, self._checked(now, flutters, open_), after
        )
        # within an interval: what is known of it stands
        gives_up = self._over(now)
        code = jnp.where(now.fine, CODE.undecided, gives_up.outcome).astype(jnp.int32)
        gives_up = gives_up._replace(outcome=code)
        after = tree_where((now.phase == HALVE) & open_, gives_up, after)
        invalid = outcome == CODE.invalid
        code = jnp.where(invalid, CODE.invalid, after.outcome).astype(jnp.int32)
        return after._replace(outcome=code)

    # ---- the four kinds of motion

    def _along_ray(self, now: Descent, flutters: Bool[Array, ""]) -> Descent:
        at_once = flutters & (now.level == 0)
        # the bracket begins within flutter
        outcome = jnp.where(at_once, CODE.moves, now.outcome).astype(jnp.int32)
        now = now._replace(outcome=outcome)
        low = self._size(now, now.level - 1)
        begun = now._replace(ray=Ray(now.c, low, now.r), h=0.0 * now.h + FIRST)
        further = now._replace(level=now.level + 1, r=self._size(now, now.level + 1))
        past = now.level >= self.scan
        rests = tree_where(past, self._next_ray(now), further)
        return tree_where(flutters, self._opened(begun), rests)

    def _halved(self, now: Descent, flutters: Bool[Array, ""]) -> Descent:
        low, high = now.ray.low, now.ray.high
        ray = Ray(
            now.ray.c,
            jnp.where(flutters, low, now.r),
            jnp.where(flutters, now.r, high),
        )
        nothing = ray.high < NOTHING * self.largest
        outcome = jnp.where(nothing, CODE.moves, now.outcome).astype(jnp.int32)
        return self._opened(now._replace(ray=ray, outcome=outcome))

    def _polled(self, now: Descent, flutters: Bool[Array, ""]) -> Descent:
        reach = 2 * self._width(now.h)
        lower = now._replace(
            phase=jnp.full_like(now.phase, DOWN),
            ray=Ray(now.c, 0.0 * now.r, now.r),
            reach=reach,
            r=now.r * (1 - reach),
        )
        fails = now.fails + 1
        many = 2 * (self.rays.shape[1] - 1)
        next_ = self._asking(now._replace(fails=fails, poll=now.poll + 1))
        rests = tree_where(fails < many, next_, self._finer(now))
        return tree_where(flutters, lower, rests)

    def _lowered(
        self, now: Descent, flutters: Bool[Array, ""], open_: Bool[Array, ""]
    ) -> Descent:
        reach = jnp.minimum(2 * now.reach, 0.5)
        high = jnp.where(flutters, now.r, now.ray.high)
        further = now._replace(
            ray=now.ray._replace(high=high), reach=reach, r=now.r * (1 - reach)
        )
        low = self._opened(now._replace(ray=now.ray._replace(low=now.r)))
        return tree_where(flutters | open_, further, low)

    def _checked(
        self, now: Descent, flutters: Bool[Array, ""], open_: Bool[Array, ""]
    ) -> Descent:
        code = jnp.where(flutters, CODE.found, CODE.not_computed)
        code = jnp.where(open_, CODE.undecided, code).astype(jnp.int32)
        again = self.begin(jnp.asarray(True))._replace(
            screen=now.screen + jnp.inf,
            motions=now.motions,
            undecided=now.undecided,
            obstacle=now.obstacle,
        )
        ended = now._replace(outcome=code)
        return tree_where(flutters | open_, ended, again)

    # ---- what follows them

    def _opened(self, now: Descent) -> Descent:
        """Halve the interval, or try neighbours where it is narrow."""
        ray = now.ray
        wide = ray.high - ray.low > self._width(now.h) * ray.high
        halve = now._replace(
            phase=jnp.full_like(now.phase, HALVE), c=ray.c, r=(ray.low + ray.high) / 2
        )
        return tree_where(wide, halve, self._asking(now._replace(fails=0 * now.fails)))

    def _asking(self, now: Descent) -> Descent:
        """The next neighbour, at the size at which the ray itself rests."""
        c = now.ray.c
        if c.size == 2:
            v = jnp.stack([-c[1], c[0]])
        else:
            v = jnp.asarray(self.neighbours, c.dtype)[(now.poll // 2) % POLLS]
            v = v - c * (v @ c)
            v = v / jnp.linalg.norm(v)
        c = c + v * jnp.where(now.poll % 2 == 0, now.h, -now.h)
        return now._replace(
            phase=jnp.full_like(now.phase, POLL),
            c=c / jnp.linalg.norm(c),
            r=now.ray.low,
        )

    def _finer(self, now: Descent) -> Descent:
        """With smaller steps, or done."""
        # a round begins with the first of two opposite neighbours
        now = now._replace(h=now.h / 2, poll=(now.poll // 2 + 1) * 2)
        ray, best = now.ray, now.best
        apart = jnp.linalg.norm(ray.c - best.c)
        other = jnp.linalg.norm(ray.c + best.c)
        apart = jnp.where(self.odd, jnp.minimum(apart, other), apart)
        known = jnp.isfinite(best.high)
        hopeless = known & ((apart < 4 * now.h) | (ray.low * (1 - now.h) > best.high))
        over = jnp.where(now.fine, now.h < self.finest, hopeless | (now.h < LEAST_STEP))
        return tree_where(over, self._over(now), self._opened(now))

    def _over(self, now: Descent) -> Descent:
        """The end of a descent."""
        better = now.fine | (now.ray.high < now.best.high)
        now = now._replace(best=tree_where(better, now.ray, now.best))
        check = now._replace(
            phase=jnp.full_like(now.phase, CHECK), c=now.best.c, r=now.best.high
        )
        return tree_where(now.fine, check, self._next_ray(now))

    def _next_ray(self, now: Descent) -> Descent:
        """The next ray of the table; behind the last one the best, finely."""
        row = now.row + 1
        count = len(self.rays)
        rays = jnp.asarray(self.rays, now.c.dtype)
        last = row >= jnp.where(self.odd, count, 2 * count)
        # where a kick and its opposite differ, both are tried
        place = jnp.where(self.odd, row, row // 2)
        sign = jnp.where(self.odd | (row % 2 == 0), 1.0, -1.0)
        c = sign * rays[jnp.minimum(place, count - 1)]
        known = jnp.isfinite(now.best.high)
        next_ = now._replace(
            phase=jnp.full_like(now.phase, RAY), c=c, row=row, level=0 * now.level
        )
        next_ = next_._replace(r=self._size(next_, next_.level))
        finely = now._replace(ray=now.best, fine=~now.fine, h=0.0 * now.h + FINE)
        rests = jnp.where(now.undecided > 0, CODE.undecided, CODE.rests)
        none = now._replace(outcome=rests.astype(jnp.int32))
        return tree_where(last, tree_where(known, self._opened(finely), none), next_)

    def _size(self, now: Descent, level: Int[Array, ""]) -> Float[Array, ""]:
        """The size of a level along a ray."""
        top = jnp.minimum(MARGIN * now.best.high, self.largest)
        share = jnp.maximum(level, 0) / self.scan
        return self.least + (top - self.least) * share.astype(now.r.dtype)

    def _width(self, h: Float[Array, ""]) -> Float[Array, ""]:
        """How narrow an interval must be for neighbours so far away."""
        return jnp.clip(h * h / 4, self.width, ROUGH)

    @property
    def finest(self) -> float:
        """The last step: what is left of the energy by it is of the last width."""
        return float(np.sqrt(self.width))


def sphere(count: int, k: int, offset: float = 0.5) -> np.ndarray:
    r"""Points (count, k) that cover the unit sphere evenly, however many are taken.

    Multiples of a generalised golden ratio, $x^k = x + 1$; in the plane over half the
    circle, in four dimensions by Hopf's coordinates.

    Source: M. Roberts, The unreasonable effectiveness of quasirandom sequences (2018).
    """
    golden = {2: 1.618033988749895, 4: 1.2207440846057596}[k]
    steps = golden ** -np.arange(1.0, k)
    u = (offset + np.arange(count)[:, None] * steps) % 1.0
    if k == 2:
        angle = np.pi * u[:, 0]
        x = [np.cos(angle), np.sin(angle)]
    else:
        inner, outer = np.sqrt(u[:, 0]), np.sqrt(1 - u[:, 0])
        a, b = 2 * np.pi * u[:, 1], 2 * np.pi * u[:, 2]
        x = [outer * np.sin(a), outer * np.cos(a), inner * np.sin(b), inner * np.cos(b)]
    # a sine's last bit is the processor's own, and a scene's digest would be with it
    x = [part.astype(np.float32).astype(float) for part in x]
    return np.stack(x, -1) / np.sqrt(sum(part * part for part in x))[:, None]
