r"""How a threshold moves with the scene, from the tangents of the motion on it.

The motion from a threshold $x^*(p)$ stays on the stable manifold of a saddle, an
unstable cycle say. Near that every small difference is soon the unstable direction
alone, $\partial y/\partial x \to a\,e^{\lambda t} v$, $\partial y/\partial p \to b\,
e^{\lambda t} v$ but for what does not grow: the shift of the saddle and its phase. A
change of both that stays on the manifold has no part along v,

$$\frac{dx^*}{dp} = -\frac ba = -\lim \frac{\partial_x y \cdot \partial_p y}
{\partial_x y \cdot \partial_x y},$$

and the ratio is followed until the ends of the search's last interval have parted. By a
cycle the largest part that does not grow is that along the motion itself, of its phase,
which shifts for as long: there both tangents are taken across the flow. By an
equilibrium the motion leaves along v, and little of the tangents lies across: they are
taken as they are, unless the looks across agree better. What else does not grow is a
share $c / |\partial_x y|$ of the ratio, and goes out with a look ten times earlier,

$$r = \frac{L_2 r_2 - L_1 r_1}{L_2 - L_1}, \qquad L = |\partial_x y|.$$

The tangents pass through stick and slip by saltation.

Source: J. Palis, Topology 8 (1969) 385-404, on how differences turn near a saddle.
"""

from collections.abc import Callable
from functools import reduce
from operator import and_
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..model.chain_of_rods import AbstractChain
from ..model.column import Column, State
from ..model.state import PhasePoint
from ..motion.checks import float_state
from ..motion.implicit import fixed, implicit, moving
from ..motion.integrate import Motion, follow
from ..motion.options import Method
from ..motion.variational import Make, Variational, Varied, varied
from ..numerics.materialise import tree_where
from ..numerics.numbers import Scalar
from ..results import CODE
from ..solvers import AbstractFold

PARTED = 0.1  # of the largest state: the ends of the last interval have parted
DECADE = 10.0  # of growth from one look at the ratio to the next
CERTAIN = 0.05  # of the largest relative derivative: the looks may differ by so much
# By so much of themselves may the numbers that a line moves change over the last
# interval: 2 % of the derivatives are wrong.
WIDE = 1.5e-3
FAR = 0.1  # and by so much the phase may shift the ratio
ACROSS = 0.1  # of a tangent lies across the flow: it does not leave along that
CLEARLY = 0.1  # of the change across: with less the tangents themselves are sure


class Ratio(NamedTuple):
    """The ratio of the tangents, and how long the one along the search's line is."""

    row: Float[Array, " k"]
    length: Float[Array, ""]


class Look(NamedTuple):
    """At the tangents themselves, and at their parts across the flow."""

    whole: Ratio
    across: Ratio

    @property
    def length(self) -> Float[Array, ""]:
        """Of the tangent itself."""
        return self.whole.length


def _ratio(moved: Float[Array, "4 k"], along: Float[Array, " k"]) -> Ratio:
    tangent = moved @ along
    square = tangent @ tangent
    return Ratio(
        -(tangent @ moved) / jnp.where(square > 0, square, 1.0), jnp.sqrt(square)
    )


class ManifoldSlopeState(NamedTuple):
    """The running numbers of `ManifoldSlope`."""

    varied: Varied
    best: Look  # where the tangent was longest
    when: Float[Array, ""]
    mark: Look  # a decade of growth ago at most
    earlier: Look  # one more
    largest: Float[Array, ""]  # state so far
    middle: "Middle"
    outcome: Int[Array, ""]


class Middle(NamedTuple):
    """Where half of the growth was over, that is where the motion was nearest."""

    reached: Bool[Array, ""]
    y: Float[Array, " s"]
    modes: Float[Array, " joints"]  # of set-valued friction, else 1


class ManifoldSlope(AbstractFold[ManifoldSlopeState]):
    """The ratio of tangents along a motion, until it can get no better."""

    inner: Variational
    along: Float[Array, " k"]  # the search's line
    width: Scalar
    window: Scalar

    def expand(self, system, y0, order, token, state):
        """The series of a step, and of what these ask for."""
        return self.inner.expand(system, y0, order, token, state.varied)

    def allowed(self, motion, along, rtol, atol):
        """As these allow."""
        return self.inner.allowed(motion, along, rtol, atol)

    def advance(self, solver, t0, t1, y0, system, first, state):
        """A step with the Jacobian that these ask for."""
        ends = t0, t1, y0
        return self.inner.advance(solver, *ends, system, first, state.varied)

    def init(self, system, t0, y0):
        """Before the first step."""
        varied = self.inner.init(system, t0, y0)
        zero = jnp.asarray(0.0 * y0[0])
        blank = Ratio(jnp.zeros_like(self.along), zero)
        look = Look(blank, blank)
        runs = jnp.asarray(CODE.not_computed, jnp.int32)
        start = Middle(
            jnp.asarray(False), jnp.stack(y0), jnp.ones(system.joints) + zero
        )
        return ManifoldSlopeState(
            varied, look, t0 + zero, look, look, zero, start, runs
        )

    def step(self, system, state, step):
        """Look at the ratio; at an end where it has grown enough, or grows no more."""
        varied, *_ = self.inner.step(system, state.varied, step)
        flow, moved = jnp.stack(step.f1), jnp.stack(varied.y)
        speed = flow @ flow
        part = (flow @ moved) / jnp.where(speed > 0, speed, 1.0)
        now = Look(
            _ratio(moved, self.along),
            _ratio(moved - flow[:, None] * part[None], self.along),
        )
        # where an event ends a step the flow is another one behind it
        quiet = step.event[0] == 0 if step.event else True
        longer = quiet & (now.length > state.best.length)
        further = quiet & (now.length > DECADE * state.mark.length)
        size = jnp.sqrt(sum((y * y for y in step.y1), 0.0 * step.t1))
        best = tree_where(longer, now, state.best)
        after = ManifoldSlopeState(
            varied=varied,
            best=best,
            when=jnp.where(longer, step.t1, state.when),
            mark=tree_where(further, now, state.mark),
            earlier=tree_where(further, state.mark, state.earlier),
            largest=jnp.maximum(size, state.largest),
            middle=state.middle,
            outcome=state.outcome,
        )
        half = now.length**2 * self.width > PARTED * after.largest
        modes = step.event[1] if step.event else (1.0,) * system.joints
        middle = Middle(half, jnp.stack(step.y1), jnp.stack(modes) + 0.0 * now.length)
        middle = tree_where(half & ~state.middle.reached, middle, state.middle)
        after = after._replace(middle=middle)
        over = now.length * self.width > PARTED * after.largest
        over |= step.t1 > 2 * after.when + self.window
        if step.modes:
            assert step.event
            over |= reduce(and_, (m == 0 for m in step.event[1]))
        outcome = jnp.where(over, CODE.complete, after.outcome).astype(jnp.int32)
        return after._replace(outcome=outcome), jnp.inf, over


class Place(NamedTuple):
    """A threshold."""

    line: Float[
        Array, " k"
    ]  # how the scene's numbers change along the line that was searched
    width: Float[Array, ""]  # of the interval that holds the threshold
    known: Bool[Array, ""]  # whether there is one
    window: Scalar
    patience: Scalar  # the longest time to follow its motion


def carried(
    scene: Callable[[Scalar], tuple[AbstractChain, State]],
    x: Float[Array, ""],
    width: Float[Array, ""],
    known: Bool[Array, ""],
    window: Scalar,
    patience: Scalar,
    method: Method,
) -> Float[Array, ""]:
    """A zero that carries the derivative of the threshold x in the numbers of `scene`.

    It is NaN where no threshold is `known` well enough, or tangents disagree.
    """
    x, width = fixed((x, width))
    dtype = jnp.result_type(float)
    column = scene(x)[0]
    (_, make), size = moving(column, dtype), 2 * column.joints

    def numbers(x):
        column, start = scene(x)
        y0 = jnp.stack(float_state(start))
        return jnp.concatenate([y0, moving(column, dtype)[0]])

    def slope(numbers, place):
        """The threshold's derivatives in the start's numbers and the column's."""
        motion = _motion(make, numbers, size, place, method)
        after = motion.advance(motion.begin()).folded
        return _certain_row(numbers, place, after)

    at, line = jax.jvp(numbers, (x,), (jnp.ones_like(x),))
    # sizes count as they move: a load that hardly does vouches for no kick
    moves, sizes = fixed((line, line * at))
    known &= width * (moves @ moves) <= WIDE * jnp.sqrt(sizes @ sizes)
    return implicit((), slope, at, Place(line, width, known, window, patience))


def _motion(
    make: Make, numbers: Float[Array, " k"], size: int, place: Place, method: Method
) -> Motion[ManifoldSlopeState]:
    """`numbers`: the start's, so many, and the column's."""
    vary = numbers.size > size
    system, inner = varied(make, numbers[size:], method.variational, vary)
    fold = ManifoldSlope(inner, place.line, place.width, place.window)
    y0 = PhasePoint(numbers[i] for i in range(size))
    span = jnp.where(place.known, place.patience, 0.0).astype(numbers.dtype)
    return Motion(system, y0, fold, method, end=span)


def _certain_row(
    numbers: Float[Array, " k"], place: Place, after: ManifoldSlopeState
) -> Float[Array, " k"]:
    """The ratio at its best; NaN where it is not known well enough."""
    best, before, sizes = after.best, after.earlier, jnp.abs(numbers)

    def largest(row):
        return jnp.max(jnp.abs(row) * sizes)

    change = _left(before.whole, best.whole)
    change_across = _left(before.across, best.across)
    left, left_across = largest(change), largest(change_across)
    by_cycle = best.across.length > ACROSS * best.whole.length
    by_cycle |= left_across < left
    change = jnp.where(by_cycle, change_across, change)
    row = jnp.where(by_cycle, best.across.row, best.whole.row) + change
    # the phase's part, ten times what is left without it, where the cycle is near
    phase = largest(best.whole.row - best.across.row)
    phase = jnp.where(by_cycle | (left > CLEARLY * left_across), phase, 0.0)
    certain = largest(change) < CERTAIN * largest(row)
    certain &= phase < FAR * largest(row)
    certain &= place.known & (before.length > 0)
    return jnp.where(certain, row, jnp.nan)


def _left(early: Ratio, late: Ratio) -> Float[Array, " k"]:
    """What is left in the later ratio of what does not grow."""
    share = early.length / jnp.where(late.length > 0, late.length, 1.0)
    return (late.row - early.row) * share / jnp.where(share < 1, 1 - share, 1.0)


def manifold_at(
    column: Column, y0: Float[Array, "4"], place: Place, method: Method
) -> tuple[Float[Array, "4"], Middle, Int[Array, ""]]:
    r"""Of the stable manifold at a threshold its normal n, and what it leads to.

    **Arguments:** `place`, its line as `y0` changes along the search's line, so that
    $n \cdot \mathrm{line} = 1$.

    **Returns:** n, NaN where it is not known; where the motion was nearest to the
    saddle; steps.
    """
    motion = _motion(lambda _: column, y0, y0.size, place, method)
    run = follow(motion)
    return -_certain_row(y0, place, run.folded), run.folded.middle, run.steps
