r"""Growth rates of tangents, by which an unsettled motion is named.

A motion that neither rests nor approaches a cycle by the horizon may be on a torus,
chaotic, or slow. Its two largest Lyapunov exponents, measured after the horizon,
decide:

- *chaotic*: $\lambda_1 >$ `ZERO`, $\lambda_1 > 1/T$ after T in all, and by more than
    three standard errors. No finite time shows whether chaos lasts: of 58 such columns
    with viscous damping whose rods turn over 16 ended on a cycle or at rest between
    t = 800 and 37 000 (`benchmarks/a13_certified_truth.py kinds`);
- *periodic*: $\lambda_1$ is zero, $|\lambda| \le$ `ZERO` and $|\lambda| \le 1/T + 3$
    standard errors, and $\lambda_2$ negative beyond that: a cycle of more returns than
    are certified, or one that is approached slowly;
- *quasi-periodic*: both are zero, and in the last windows no passage of $\phi_1 = 0$,
    rising, came back to within `NEAR` of the first there.

All only if the largest angles of both halves of the time are within a tenth of each
other, else it is a transient, and the last two only if the rates $\omega_1$ of the
passages fill the same band in both, to a tenth of its width: a slow approach to another
cycle or to rest looks alike but for that. Where no step's end dissipates, no motion
attracts: *conservative*.
"""

from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from ..model.state import PhasePoint
from ..model.system import System
from ..motion.ending import nan_where
from ..motion.integrate import Motion
from ..motion.options import Method
from ..motion.section import Passage, SectionPlane, passage
from ..motion.spans import AbstractSpans, SpanState
from ..motion.tangents import AbstractGrowth, TangentFrame, in_logs, unit_tangents
from ..numerics.materialise import if_any_lane, tree_where
from ..numerics.numbers import Count, Flag, Numbers, Pair, Scalar
from ..results import CODE, RATE, Variable
from ..solvers import Explicit, Taylor

SURE = 3.0  # standard errors
ZERO = 0.01  # a rate: growth that is not exponential leaves ln T / T, 0.005 at 1600
NEAR = 1e-3  # of a point: a passage this near another is on its way to a cycle
DRIFT = 0.1  # of the largest angle: what changes more is a transient
LAST = 4  # windows in which passages come back, if they do: some 40 returns
PLANE = SectionPlane()
EXPONENTS = Variable(None, "Lyapunov exponent", RATE, ("exponent",))
ERRORS = Variable(None, "standard error of the exponent", RATE, ("exponent",))


class GrowthSums(NamedTuple):
    """Tangents, and the rates at which they grow, from block to block."""

    tangents: TangentFrame
    mean: tuple[Scalar, ...]  # of the blocks so far
    squares: tuple[Scalar, ...]  # of the deviations from it, their sums


def no_growth(system: System, y: PhasePoint, count: int) -> GrowthSums:
    """Unit tangents that have not grown."""
    zero = (0.0 * y[0],) * count
    return GrowthSums(unit_tangents(system, y, count), zero, zero)


def with_block(
    growth: GrowthSums, blocks: Int[Array, ""], block: Scalar, ended: Flag
) -> GrowthSums:
    """One block more where it has ended (Welford's update); the transient's is lost.

    **Arguments:** `blocks`: how many there are with it; `block`: its length.
    """
    tangents = in_logs(growth.tangents, ended)
    counted = ended & (blocks > 0)
    count = blocks.astype(jnp.result_type(tangents.logs[0]))
    means, squares = [], []
    rows = zip(tangents.logs, growth.mean, growth.squares, strict=True)
    for log, mean, square in rows:
        rate = log / block
        # two infinities that agree do not differ
        off = jnp.where(rate == mean, 0.0, rate - mean)
        new = mean + off / jnp.where(counted, count, 1.0)
        still = jnp.where(rate == new, 0.0, rate - new)
        means.append(jnp.where(counted, new, mean))
        squares.append(jnp.where(counted, square + off * still, square))
    logs = tuple(jnp.where(ended, 0.0, x) for x in tangents.logs)
    return GrowthSums(tangents._replace(logs=logs), tuple(means), tuple(squares))


def standard_errors(growth: GrowthSums, blocks: Int[Array, ""]) -> tuple[Scalar, ...]:
    """Standard errors of the means; NaN for fewer than two blocks, 0 for infinity."""
    n = blocks.astype(jnp.result_type(growth.mean[0]))
    pairs = jnp.where(n > 1, n * (n - 1), jnp.nan)
    return tuple(
        jnp.where(jnp.isinf(mean), 0.0, jnp.sqrt(square / pairs))
        for mean, square in zip(growth.mean, growth.squares, strict=True)
    )


class GrowthRates(AbstractSpans[GrowthSums], AbstractGrowth[SpanState[GrowthSums]]):
    """A transient, then blocks of growth."""

    solver: Explicit | Taylor
    rtol: Scalar
    count: int

    def begin(self, system, t0, y0):
        """Unit tangents that have not grown."""
        del t0
        return no_growth(system, y0, self.count)

    def tangents(self, state):
        """The tangents of the blocks."""
        return state.watch.tangents

    def watch(self, system, state, step):
        """Let the tangents grow."""
        tangents, longest = self.advance_frame(system, state, step)
        return state.watch._replace(tangents=tangents), False, longest

    def judge(self, system, state, step, ended):
        """Take the block's rates."""
        del system, step
        growth = with_block(state.watch, state.spans, self.span, ended)
        last = state.spans >= self.most
        return growth, jnp.where(last, CODE.complete, state.outcome)


class Witness(NamedTuple):
    """The quantities by which a motion is named."""

    growth: GrowthSums
    first: PhasePoint  # the first passage of the last spans
    passes: Bool[Array, ""]  # whether there was one
    nearest: Scalar  # of later ones to it, relative
    angles: Numbers  # the largest in each half of the spans
    bands: tuple[Pair, Pair]  # in each half the least and largest omega1 of a passage
    dissipates: Bool[Array, ""]


class Naming(AbstractSpans[Witness], AbstractGrowth[SpanState[Witness]]):
    """Exponents and passages of a motion that has not settled."""

    solver: Explicit | Taylor
    rtol: Scalar
    count: int

    def motion(
        self, system: System, y0: PhasePoint, method: Method, left: Count
    ) -> Motion[SpanState[Witness]]:
        """The motion from here on, as finely as its own rtol asks for."""
        rtol, atol = method.tolerances
        finer = Method(self.solver, self.rtol, self.rtol / rtol * atol).at_most(left)
        end, first = self.last_stop(), self.first_stop()
        return Motion(system, y0, self, finer, end=end, first_stop=first)

    def begin(self, system, t0, y0):
        """The watch before its first step."""
        del t0
        zero, no = 0.0 * y0[0], jnp.zeros((), bool)
        no_band = zero + jnp.inf, zero - jnp.inf
        return Witness(
            growth=no_growth(system, y0, self.count),
            first=y0,
            passes=no,
            nearest=zero + jnp.inf,
            angles=(zero, zero),
            bands=(no_band, no_band),
            dissipates=no,
        )

    def tangents(self, state):
        """The tangents of the exponents."""
        return state.watch.growth.tangents

    def watch(self, system, state, step):
        """Let the tangents grow, and look at passages."""
        before, measuring = state.watch, state.spans >= 0
        late, last = (state.spans >= n for n in (self.most // 2, self.most - LAST))
        tangents, longest = self.advance_frame(system, state, step)
        point = passage(PLANE, step)
        there = point.there & measuring
        watch = if_any_lane(
            there,
            lambda watch: tree_where(there, _passed(watch, point, late, last), watch),
            before,
        )
        dissipates = before.dissipates
        _, *losses, _ = system.power(step.y1)
        for loss in (*losses, system.own.dissipated(step.y1.phi, step.y1.omega)):
            if loss is not None:
                dissipates |= measuring & (loss != 0)  # a law may feed as well
        angle = reduce(jnp.maximum, map(jnp.abs, step.y1.phi))
        halves = zip((measuring & ~late, late), before.angles, strict=True)
        watch = watch._replace(
            growth=before.growth._replace(tangents=tangents),
            angles=tuple(
                jnp.where(when, jnp.maximum(peak, angle), peak) for when, peak in halves
            ),
            dissipates=dissipates,
        )
        return watch, False, longest

    def judge(self, system, state, step, ended):
        """Take the span's rates."""
        del system, step
        watch = state.watch
        growth = with_block(watch.growth, state.spans, self.span, ended)
        last = state.spans >= self.most
        watch = watch._replace(growth=growth)
        return watch, jnp.where(last, CODE.complete, state.outcome)


def _passed(
    watch: Witness, point: Passage, late: Bool[Array, ""], last: Bool[Array, ""]
) -> Witness:
    """With one passage more."""
    apart, size = 0.0 * point.time, 0.0 * point.time
    for x, x0 in zip(point.y, watch.first, strict=True):
        apart = jnp.maximum(apart, jnp.abs(x - x0))
        size = jnp.maximum(size, jnp.abs(x0))
    near = jnp.where(watch.passes, apart / size, jnp.inf)
    rate, bands = point.y.omega[0], []
    for (low, high), mine in zip(watch.bands, (~late, late), strict=True):
        low = jnp.where(mine, jnp.minimum(low, rate), low)
        bands.append((low, jnp.where(mine, jnp.maximum(high, rate), high)))
    return watch._replace(
        first=tree_where(watch.passes, watch.first, point.y),
        passes=watch.passes | last,
        nearest=jnp.minimum(watch.nearest, near),
        bands=(bands[0], bands[1]),
    )


def exponent_variables(state: SpanState[Witness], nothing: Flag) -> dict[str, Variable]:
    """The exponents and their errors; NaN where `nothing` was measured."""
    growth = state.watch.growth
    errors = jnp.stack(standard_errors(growth, state.spans))
    return {
        "exponents": EXPONENTS._replace(
            value=nan_where(nothing, jnp.stack(growth.mean))
        ),
        "errors": ERRORS._replace(value=nan_where(nothing, errors)),
    }


def name_of(state: SpanState[Witness], length: Scalar) -> Int[Array, ""]:
    """The kind of a motion by its exponents over spans of a `length`, a `CODE`.

    `not_computed` where none is sure.
    """
    watch, spans = state.watch, state.spans
    growth, time = watch.growth, spans.astype(jnp.result_type(float)) * length
    errors = standard_errors(growth, spans)

    def zero(rate: Scalar, error: Scalar) -> Flag:
        """Not to be told from zero: by one e-fold in all, and by its error."""
        within = jnp.abs(rate) <= 1 / time + SURE * error
        return within & (jnp.abs(rate) <= ZERO)

    first, error = growth.mean[0], errors[0]
    # by more than one e-fold in all: of a time within rounding no rate is known
    chaotic = (first > jnp.maximum(ZERO, 1 / time)) & (first > SURE * error)
    name = jnp.where(chaotic, CODE.chaotic, CODE.not_computed)
    if len(errors) > 1:
        second, other = growth.mean[1], errors[1]
        stays = zero(first, error) & _stays(watch.bands)
        torus = zero(second, other) & (watch.nearest > NEAR)
        name = jnp.where(stays & torus, CODE.quasi_periodic, name)
        cycle = second < -jnp.minimum(1 / time + SURE * other, ZERO)
        name = jnp.where(stays & cycle, CODE.periodic, name)
    early, late = watch.angles
    transient = jnp.abs(late - early) > DRIFT * jnp.maximum(late, early)
    name = jnp.where(transient, CODE.not_computed, name)
    return jnp.where(watch.dissipates, name, CODE.conservative)


def _stays(bands: tuple[Pair, Pair]) -> Bool[Array, ""]:
    """Whether passages of the late half fill the band of the early one.

    Those of a torus or a cycle do. A motion that falls to rest, or nears a cycle
    slowly, has passages that differ as well, but its band moves, or shrinks.
    """
    (low, high), (low_late, high_late) = bands
    moved = jnp.maximum(jnp.abs(low - low_late), jnp.abs(high - high_late))
    return moved <= DRIFT * (high - low) + NEAR * jnp.abs(high)
