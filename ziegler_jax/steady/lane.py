"""Where a lane is on its way to a certificate."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from ..model.state import PhasePoint
from ..motion.integrate import Run
from ..motion.observation import Record
from ..motion.spans import SpanState
from ..numerics.materialise import tree_where
from ..numerics.numbers import Flag, Scalar
from ..numerics.resumable import ENDED
from ..results import CODE
from .contraction import contracts, length, size_of
from .exponents import Witness
from .returns import (
    ARRIVED,
    Calm,
    Candidate,
    Lookout,
    Returns,
    ask_no_more,
    follows,
)
from .shots import Attempt, ShotState

MARCH, SHOTS, GROWTH = range(3)  # the phases


class Orbit(NamedTuple):
    """A stable orbit."""

    y: PhasePoint  # where it passes the section
    span: Scalar  # until it closes, for one that is symmetric with signs turned
    residual: Scalar
    record: Record


class Certifying(NamedTuple):
    """Where a lane is."""

    stage: Int[Array, ""]  # the phase that it is in while it runs
    march: Run[Lookout]
    returns: Returns
    shot: Run[ShotState]
    attempt: Attempt
    candidate: Candidate
    orbit: Orbit  # of the candidate; at the end what has been observed
    observing: Int[Array, ""]  # the outcome to come, where a shot only observes
    unstable: Bool[Array, ""]  # whether an unstable orbit was met
    spent: Int[Array, ""]  # steps of all shots that have ended
    outcome: Int[Array, ""]  # `not_computed` while it runs
    growth: Run[SpanState[Witness]] | tuple[()] = ()  # where exponents are asked for

    @property
    def shoots(self) -> Bool[Array, ""]:
        """Whether it is in a shot."""
        return self.stage == SHOTS

    @property
    def grows(self) -> Bool[Array, ""]:
        """Whether its exponents are measured."""
        return self.stage == GROWTH

    @property
    def growing(self) -> Run[SpanState[Witness]]:
        """Where its exponents are."""
        assert self.growth
        return self.growth

    @property
    def watched(self) -> Bool[Array, ""]:
        """Whether what observers have seen is the end of the motion itself."""
        return (self.outcome == self.observing) & ~self.running

    @property
    def y(self) -> PhasePoint:
        """The motion's own state at the end."""
        return tree_where(self.watched, self.orbit.record.y, self.march.y)

    @property
    def time(self) -> Scalar:
        """How far the motion has come."""
        observed = jnp.where(self.watched, self.orbit.span, 0.0)
        return self.march.time + observed

    @property
    def steps(self) -> Int[Array, ""]:
        """Attempted steps, those of shots included."""
        shooting = jnp.where(self.shoots & self.running, self.shot.steps, 0)
        shooting = jnp.maximum(shooting, 0)  # of one to be begun it is -1
        steps = self.march.steps + self.spent + shooting
        if self.growth:
            steps = steps + jnp.maximum(self.growth.steps, 0)
        return steps.astype(jnp.int32)

    @property
    def running(self) -> Bool[Array, ""]:
        """Whether there is no verdict yet."""
        return self.outcome == CODE.not_computed

    @property
    def moves(self) -> Bool[Array, ""]:
        """Whether it has ended and will not come to rest."""
        cycle = (self.outcome == CODE.cycle) | (self.outcome == CODE.escaped)
        unsettled = self.outcome == CODE.unsettled
        return cycle | (unsettled & self.returns.trend.endures)

    @property
    def phase(self) -> Int[Array, ""]:
        """The program that it is in, or `ENDED`."""
        return jnp.where(self.running, self.stage, ENDED).astype(jnp.int32)


def comes_at_once(orbit: Candidate, attempt: Attempt, sticks: bool) -> Flag:
    """Whether the motion contracts towards the orbit from the attempt's start on.

    **Arguments:** `sticks`: whether friction is set-valued.
    """
    was, became = attempt.start - attempt.x, attempt.image - attempt.x
    comes = contracts(orbit.norm, attempt.first_slope)
    comes &= follows(orbit, was, became, 0.0)
    comes &= length(orbit.norm, was) < ARRIVED * size_of(attempt.x)
    if sticks:
        comes &= attempt.first_modes == attempt.modes
    return comes


def checked(lane: Certifying, after: Returns) -> tuple[Returns, Bool[Array, ""]]:
    """After a shot that only checks: whether its events are those of the candidate.

    The orbit's map is that of its own events. Beside an orbit that sticks may lie an
    unstable one that does not, and a motion that passes that one looks as if it drew
    near. What has other events has to follow the orbit's map anew.
    """
    attempt, complete = lane.attempt, lane.shot.outcome == CODE.complete
    anew = after._replace(follows=jnp.zeros_like(after.follows))
    alike = attempt.checks & complete & (attempt.modes == lane.candidate.modes)
    return tree_where(attempt.checks, anew, after), alike


def going_on(lane: Certifying) -> Certifying:
    """A lane whose calm was no rest: calm counts from here."""
    run = lane.march
    zero = 0.0 * run.time
    calm = Calm(run.time, zero, zero) if run.folded.calm else ()
    lookout = run.folded._replace(calm=calm, asks=jnp.zeros_like(run.folded.asks))
    march = run.paused(False, lookout).resumed()
    return lane._replace(march=march, returns=ask_no_more(lane.returns))
