"""How a motion ended, as a result has it."""

from typing import Protocol, TypedDict, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..model.column import State
from ..model.state import PhasePoint
from ..numerics.numbers import Flag, Scalar
from ..results import CODE

Tree = TypeVar("Tree")  # a pytree of numbers


def outcome_of(
    vanished: Flag, last_slope: PhasePoint, otherwise: Int[Array, ""]
) -> Int[Array, ""]:
    """The code of a lane: that its steps have vanished, and why, or otherwise."""
    finite = True
    for slope in jax.tree.leaves(last_slope):
        finite &= jnp.isfinite(slope)
    reason = jnp.where(finite, CODE.step_vanished, CODE.not_finite)
    return jnp.where(vanished, reason, otherwise)


class Ending(TypedDict):
    """Where, when and how a motion ended."""

    final: State
    time: Float[Array, ""]
    steps: Int[Array, ""]
    outcome: Int[Array, ""]


class Ended(Protocol):
    """The parts of a motion's `Run` that say how it ended."""

    @property
    def y(self) -> PhasePoint:
        """The state."""
        ...

    @property
    def time(self) -> Scalar:
        """How far it has come."""
        ...

    @property
    def steps(self) -> Int[Array, ""]:
        """Attempted steps."""
        ...

    @property
    def outcome(self) -> Int[Array, ""]:
        """A `CODE`."""
        ...


def ending(run: Ended) -> Ending:
    """Where, when and how a motion ended, as a result has it."""
    return {
        "final": State(run.y.phi, run.y.omega),
        "time": jnp.asarray(run.time),
        "steps": run.steps,
        "outcome": run.outcome.astype(jnp.int8),
    }


def nan_where(failed: Flag, values: Tree) -> Tree:
    """Values, NaN where a motion failed, and so are their derivatives."""
    mark = jnp.where(failed, jnp.nan, 1.0)
    return jax.tree.map(lambda x: x * mark.astype(x.dtype), values)
