r"""Branches of cycles: pseudo-arclength continuation, and the points where they change.

With a parameter $\lambda$ as a fifth unknown, $x = (z, \lambda)$, a branch is a curve
$R(x) = 0$. From a point with unit tangent t the next is sought at a distance s,

$$R(x) = 0, \qquad t \cdot (x - x_0 - s t) = 0,$$

which is regular at folds, where the branch turns back in $\lambda$. On the way test
functions of the three multipliers $\mu_i$ other than 1 change sign:

$$t_\lambda \text{ (fold)}, \qquad \prod_{i<j} (\mu_i \mu_j - 1) \text{ (torus)}, \qquad
\prod_i (1 + \mu_i) \text{ (flip)}, \qquad \prod_i (1 - \mu_i) \text{ (pitchfork)}$$

and the zero is found along the arc. Lengths on the arc: rad for the state, the first
cycle's period for T, the first value for $\lambda$.

Source: H. B. Keller (1977); Y. A. Kuznetsov, Elements of Applied Bifurcation Theory
(2004), chapter 10.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ._scene import check_scene, float_state, valid_scene, whole_number
from ._shooting import (
    TOLERANCE,
    Shot,
    attached,
    blank_shot,
    fixed,
    newton,
    shoot,
    solve,
    undifferentiated,
)
from ._types import number
from ._variables import Variable
from ._variational import Flow
from .column import Column, State
from .cycle import approximation, method_for, multipliers
from .observers import TIME, Extent
from .outcome import ORBIT, SPECIAL
from .solvers import Explicit

SMALLEST_STEP = 1e-6  # on the arc
STRAIGHT = 0.9  # the cosine of the largest turn between two points
NEWTON_STEPS = 10  # more say that the step was too long
REFINEMENTS = 30  # of a special point, by the Illinois method; some eight are needed
EXACT = 1e-10  # on the arc, of a special point


class Points(eqx.Module):
    """Cycles along a branch, arrays with the points in front; NaN where there is none.

    `parameter`; `state` (phi and omega: two arrays each); `period`; `amplitude` (rod
    and joint: (n, 2)); `monodromy` (n, 4, 4).
    """

    parameter: Any
    state: State
    period: Any
    amplitude: Extent
    monodromy: Any

    @property
    def multipliers(self) -> Any:
        """Floquet multipliers (n, 4), the trivial one first."""
        return multipliers(self.monodromy)

    @property
    def stable(self) -> Any:
        """Whether the others lie inside the unit circle, (n,)."""
        return jnp.all(jnp.abs(self.multipliers[..., 1:]) < 1, axis=-1)


class Branch(eqx.Module):
    """A branch of cycles.

    `points`: `Points` in order along the arc; `count` of them; `special`: the `Points`
    where the branch changes, with `kind`, codes of `SPECIAL`; `outcome`: a code of
    `ORBIT`, `found` if all points asked for are there, else why the branch ends.
    """

    points: Points
    count: Any
    special: Points
    kind: Any
    outcome: Any


class CycleFold(eqx.Module):
    """The fold at which two cycles meet, as a value of the parameter.

    `value` carries derivatives; `cycle`: `Points` of one, without; `outcome`: a code
    of `ORBIT`. Unless that is `found`, all numbers are NaN.
    """

    value: Any
    cycle: Points
    outcome: Any

    def variables(self) -> dict[str, Variable]:
        """The numbers as a sweep labels them."""
        return {
            "fold": Variable(self.value, "parameter at the fold of cycles"),
            "period": Variable(self.cycle.period[0], "period at the fold", TIME),
            "outcome": Variable(
                self.outcome, "how the search for the fold ended", codes=ORBIT
            ),
        }


def continue_cycle(
    make_column: Callable[[Any], Column],
    guess: State,
    start: Any,
    *,
    direction: int = 1,
    points: int = 100,
    specials: int = 4,
    step: Any = 0.1,
    bounds: tuple[Any, Any] = (-jnp.inf, jnp.inf),
    **options: Any,
) -> Branch:
    r"""Follow a cycle as a parameter moves, through folds, stable or not.

    **Arguments:**

    - `make_column`: a function of the parameter, e.g. `lambda q: uniform_rods(q, ...)`.
    - `guess`: a state near the cycle at the parameter `start`; see `periodic_orbit`.
    - `direction`: 1 or -1, in which the parameter moves at first.
    - `points`: how many there is room for; `specials`: how many special points.
    - `step`: the longest step on the arc.
    - `bounds`: the branch ends where the parameter leaves them.
    - `options`: `period`, `section`, `loops`, `patience`, `rtol`, `atol`, `solver`,
        `max_steps` of `periodic_orbit`.

    **Returns:** `Branch`, without derivatives.

    **Raises:** `ValueError` for arguments that break a rule.
    """
    road = _Road(make_column, guess, start, direction, step, bounds, **options)
    points, specials = whole_number("points", points), whole_number("specials", specials)
    end = fixed(road.follow(points, specials, (True,) * 4, False))
    return Branch(
        road.points(end.kept), end.count, road.points(end.special), end.kind, end.outcome
    )


def cycle_fold(
    make_column: Callable[[Any], Column],
    guess: State,
    start: Any,
    *,
    direction: int = -1,
    max_points: int = 200,
    step: Any = 0.1,
    bounds: tuple[Any, Any] = (-jnp.inf, jnp.inf),
    **options: Any,
) -> CycleFold:
    r"""The fold at which a cycle, followed from `start`, meets another and vanishes.

    With friction that is the load below which no kick makes the column flutter.

    **Arguments:** as `continue_cycle`; `max_points` on the way.

    **Returns:** `CycleFold`.

    **Derivatives:** of `value`, forward and reverse, first order, in every number that
    `make_column` was made from: at the fold a row w annuls the Jacobian in z, so that
    $d\lambda = -w \cdot R_p\,dp / (w \cdot R_\lambda)$.
    """
    road = _Road(make_column, guess, start, direction, step, bounds, **options)
    most = whole_number("max_points", max_points)
    end = fixed(road.follow(1, 1, (True, False, False, False), True, most))
    z, matrix = end.special.x[0] * road.scale, end.special.matrix[0]
    found = end.kind[0] == SPECIAL.fold
    # the row that annuls R_z, with 1 for R_lambda; the tangent there annuls from right
    bordered = jnp.zeros((5, 5), z.dtype).at[:4, :4].set(matrix[:, :4].T)
    right = end.special.tangent[0, :4] * road.scale[:4]
    bordered = bordered.at[:4, 4].set(right).at[4, :4].set(matrix[:, 4])
    row = solve(bordered, jnp.eye(5, dtype=z.dtype)[4])[:4]
    y0 = jnp.concatenate([road.section[None], z[:3]])
    column = make_column(fixed(z[4]))
    change = attached(1, column, y0, z[3], road.method, _fold_moves, row)[0]
    mark = jnp.where(found, 1.0, jnp.nan).astype(z.dtype)
    points = road.points(end.special)
    outcome = jnp.where(found, ORBIT.found, end.outcome)
    return CycleFold((z[4] + change) * mark, points, outcome.astype(jnp.int8))


def _fold_moves(seen: Flow, row: Any) -> Any:
    """Derivatives of the fold's parameter in the n others, (1, n)."""
    return -(row @ seen.moved[:, 4:])[None]


class _Kept(NamedTuple):
    """Points of a branch as they are kept, arrays (n, ...)."""

    x: Any  # (5,) scaled
    tangent: Any  # (5,)
    extent: Any  # (3,)
    moved: Any  # (4, 4)
    matrix: Any  # (4, 5) of R in z and the parameter
    tests: Any  # (4,)


class _March(NamedTuple):
    """Where the continuation is."""

    here: _Kept
    beyond: _Kept  # the point behind a special one that is being refined
    step: Any
    seeks: Any  # 0. none, or the code of the special point that is being refined
    low: Any  # its bracket on the arc, two (s, test)
    high: Any
    tries: Any
    kept: _Kept
    count: Any
    special: _Kept
    kind: Any
    specials: Any
    outcome: Any
    attempts: Any


class _Road:
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
        max_steps: int = 100_000,
    ):
        if direction not in (1, -1):
            raise ValueError(f"Argument `direction` must be 1 or -1, but is {direction!r}.")
        dtype = jnp.result_type(float)
        at = fixed(jnp.asarray(number("start", start), dtype))
        self.step = fixed(jnp.asarray(number("step", step, "positive"), dtype))
        self.bounds = bounds
        self.direction = direction
        column = make_column(at)
        check_scene(column, guess)
        self.method = method_for(column, solver, rtol, atol, max_steps)
        # what the function closes over, without its derivatives
        self.make = fixed(eqx.filter_closure_convert(make_column, at))
        still, y0 = self.make(at), fixed(float_state(guess))
        loops = whole_number("loops", loops)
        z, self.section, self.returned = approximation(
            still, y0, period, section, loops, patience, self.method
        )
        self.valid = valid_scene(still, y0)
        one = jnp.ones((), dtype)
        size = jnp.where(at == 0, one, jnp.abs(at))
        self.scale = jnp.stack([one, one, one, jnp.maximum(z[3], 1e-3), size])
        self.first = jnp.concatenate([z, at[None]]) / self.scale

    def points(self, kept: _Kept) -> Points:
        """The points of a branch in their own units."""
        x = kept.x * self.scale[None]
        at = jnp.broadcast_to(self.section, x.shape[:1]) + 0 * x[:, 0]
        return Points(
            parameter=undifferentiated(x[:, 4]),
            state=_states(at, x),
            period=x[:, 3],
            amplitude=Extent(kept.extent[:, :2], kept.extent[:, jnp.array([0, 2])]),
            monodromy=kept.moved,
        )

    def correct(self, x0: Any, row: Any) -> tuple[_Kept, Any, Any]:
        """The point of the branch on the plane through x0 across `row`."""

        def function(x):
            z = x * self.scale
            shot = shoot(
                lambda p: self.make(p[0]), z[4:], self.section, z[:4], self.method
            )
            matrix = _matrix(shot) * self.scale[None]
            r = jnp.concatenate([shot.residual, (row @ (x - x0))[None]])
            return r, jnp.concatenate([matrix, row[None]]), shot

        blank = blank_shot(1, x0.dtype)
        found = newton(function, x0, blank, NEWTON_STEPS)
        shot = found.aux
        matrix = _matrix(shot)
        whole = jnp.concatenate([matrix * self.scale[None], row[None]])
        tangent = solve(whole, jnp.eye(5, dtype=x0.dtype)[4])
        tangent = tangent / jnp.sqrt(tangent @ tangent)
        moved = shot.flow.moved[:, :4]
        tests = jnp.stack([tangent[4], *_tests(moved)])
        point = _Kept(found.z, tangent, shot.flow.extent, moved, matrix, tests)
        good = (found.size <= TOLERANCE) & jnp.all(jnp.isfinite(tangent))
        return point, good, found.count

    def follow(
        self, points: int, specials: int, kinds: tuple, stop: bool, most: Any = None
    ) -> _March:
        """Walk until `points` are there, or with `stop` until a special one is."""
        dtype = self.first.dtype
        most = points if most is None else most
        empty = _Kept(*(jnp.full(s, jnp.nan, dtype) for s in _SHAPES))

        def room(n):
            return jax.tree.map(lambda x: jnp.full((n, *x.shape), jnp.nan, dtype), empty)

        zero, none = jnp.zeros((), dtype), jnp.zeros((), jnp.int32)
        forward = jnp.zeros(5, dtype).at[4].set(self.direction)
        here = empty._replace(x=self.first, tangent=forward)
        invalid = jnp.where(self.returned, ORBIT.not_computed, ORBIT.no_return)
        invalid = jnp.where(self.valid, invalid, ORBIT.invalid)
        pair = jnp.zeros(2, dtype)
        begin = _March(
            here, empty, self.step, none, pair, pair, none, room(points), none,
            room(specials), jnp.zeros(specials, jnp.int32), none,
            invalid.astype(jnp.int32), none,
        )  # fmt: skip
        low, high = (jnp.asarray(b, dtype) for b in self.bounds)
        wanted = jnp.asarray(kinds)

        def goes_on(now: _March):
            return (now.outcome == ORBIT.not_computed) & (now.attempts < 6 * most + 40)

        def attempt(now: _March) -> _March:
            refining, starting = now.seeks > 0, now.count == 0
            (sa, fa), (sb, fb) = now.low, now.high
            inside = (sa * fb - sb * fa) / jnp.where(fa == fb, 1.0, fb - fa)
            s = jnp.where(refining, inside, jnp.where(starting, zero, now.step))
            base = now.here
            point, good, count = self.correct(base.x + s * base.tangent, base.tangent)
            good &= starting | refining | _straight(point.tangent, base.tangent)

            # walk
            changed = (point.tests * base.tests < 0) & wanted & ~starting
            changed = changed.at[3].set(changed[3] & ~changed[0])
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
            which = jnp.maximum(kind - 1, 0)
            begins = kind > 0
            ends = jnp.stack([jnp.stack([zero, base.tests[which]]),
                              jnp.stack([s, point.tests[which]])])  # fmt: skip
            lower = jnp.where(begins, ends[0], new_low)
            upper = jnp.where(begins, ends[1], new_high)
            real = (now.seeks != SPECIAL.torus) | _circles(point.moved)
            place = jnp.where(refined & real, now.specials, specials)
            special = _put(now.special, place, point)
            kinds_ = now.kind.at[place].set(now.seeks, mode="drop")
            lost = refining & ~good

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
            outcome = jnp.where(lost_way, ORBIT.not_converged, outcome)
            return _March(
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
            )

        end = lax.while_loop(goes_on, attempt, begin)
        spent = end.outcome == ORBIT.not_computed
        outcome = jnp.where(spent, ORBIT.not_converged, end.outcome)
        return end._replace(outcome=outcome)


_SHAPES = ((5,), (5,), (3,), (4, 4), (4, 5), (4,))


def _straight(new: Any, old: Any) -> Any:
    """Whether a branch turns little between two points: in phi2, T, the parameter.

    The rates have kinks where, as the branch goes on, a joint begins to stick at the
    section; angle and period have none.
    """
    new, old = (x[jnp.array([0, 3, 4])] for x in (new, old))
    return new @ old > STRAIGHT * jnp.sqrt((new @ new) * (old @ old))


def _put(kept: _Kept, place: Any, point: _Kept) -> _Kept:
    """The point in its place; none beyond the end."""
    return jax.tree.map(lambda a, x: a.at[place].set(x, mode="drop"), kept, point)


def _states(at: Any, x: Any) -> Any:
    """States on the section, arrays instead of numbers."""
    state = State()
    new = ((at, x[:, 0]), (x[:, 1], x[:, 2]))
    return eqx.tree_at(lambda s: (s.phi, s.omega), state, new)


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


def _tests(moved: Any) -> tuple[Any, Any, Any]:
    """The products over the multipliers: torus, flip, pitchfork."""
    b2, b1, b0 = _cubic(moved)
    return b0 * b0 - b2 * b0 + b1 - 1, 1 - b2 + b1 - b0, 1 + b2 + b1 + b0


def _circles(moved: Any) -> Any:
    """Whether two multipliers whose product is 1 are a complex pair."""
    b2, _, b0 = _cubic(moved)
    return jnp.abs(b0 - b2) < 2
