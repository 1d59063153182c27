r"""Shooting: where a motion returns, and Newton's method."""

from collections.abc import Callable
from typing import Generic, NamedTuple, Protocol, TypeVar, TypeVarTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int

from ..model.state import PhasePoint
from ..model.system import System
from ..motion.implicit import solve
from ..motion.integrate import Motion, Run, follow
from ..motion.observation import Watching
from ..motion.options import Method
from ..motion.section import SectionPlane, passage
from ..motion.sequence import Followed, run_in_sequence
from ..motion.variational import Flow, Make, Parameters, Varied, flow_of, varied_motion
from ..numerics.numbers import Count, Flag, Scalar
from ..results import CODE
from ..solvers import AbstractFold, Explicit

TOLERANCE = 1e-8  # of the last Newton step; what is left is its square, and rounding
LARGEST_MOVE = 0.3  # of a Newton step: more is cut
SHORTEST = 1e-3  # a period below it is none
# by how much a symmetric cycle may miss its mirror image: a wrong yes would lead away
# from a pitchfork's other branch, a wrong no costs a longer motion
MIRRORED = 1e-5


# how many passages there were, when the first and the last was, and where
Passed = tuple[Scalar, Scalar, Scalar, PhasePoint]
Unknowns = Float[Array, " n"]
Extra = TypeVarTuple("Extra")


class Passages(AbstractFold[Passed]):
    """Passages through a section, until `returns` returns are over."""

    section: SectionPlane
    returns: int

    def init(self, system, t0, y0):
        """No passages: number, time of the first, time and place of the last."""
        del system
        zero = 0.0 * y0[0]
        return zero, t0 + zero, t0 + zero, y0

    def outcome(self, state):
        """`complete` once they are over."""
        over = jnp.where(state[0] > self.returns, CODE.complete, CODE.not_computed)
        return over.astype(jnp.int32)

    def step(self, system, state, step):
        """Count the step's passage."""
        del system
        count, first, last, where = state
        crossing = passage(self.section, step)
        there = crossing.there
        first = jnp.where(there & (count == 0), crossing.time, first)
        last = jnp.where(there, crossing.time, last)
        pairs = zip(crossing.y, where, strict=True)
        where = PhasePoint(jnp.where(there, a, b) for a, b in pairs)
        count = count + jnp.where(there, 1.0, 0.0)
        return (count, first, last, where), jnp.inf, count > self.returns


def first_return(
    system: System,
    start: PhasePoint,
    section: SectionPlane,
    returns: int,
    max_time: Scalar,
    method: Method,
) -> tuple[Unknowns, Bool[Array, ""], Int[Array, ""]]:
    """Where a motion from `start` closes roughly: z, whether it does in time, steps."""
    y0 = PhasePoint(lax.stop_gradient(jnp.asarray(x)) for x in start)
    span = jnp.asarray(max_time, jnp.result_type(y0[0]))
    run = follow(Motion(system, y0, Passages(section, returns), method, end=span))
    count, first, last, place = run.folded
    free = section.free(system.joints)
    z = jnp.stack([*(place[i] for i in free), last - first])
    return z, jnp.asarray(count > returns), run.steps


class Counted(Protocol):
    """The last trial of Newton's method."""

    @property
    def steps(self) -> Int[Array, ""]:
        """The steps of its motions."""
        ...


Tried = TypeVar("Tried", bound=Counted)


class Found(NamedTuple, Generic[Tried]):
    """Where Newton's method ended."""

    z: Unknowns
    move: Unknowns  # the last step
    size: Float[Array, ""]  # and its largest component before it was cut
    iterations: Int[Array, ""]
    shot: Tried  # the last one
    left: Int[Array, ""]  # of the steps
    residual: Float[Array, ""]  # the largest equation's, before the last step

    @property
    def converged(self) -> Bool[Array, ""]:
        """Whether it ended where it should."""
        return self.size <= TOLERANCE


def newton(
    shot: Callable[[Unknowns, Int[Array, ""]], Followed],
    equations: Callable[..., tuple[Unknowns, Float[Array, "n n"], Tried]],
    z0: Unknowns,
    blank: Tried,
    max_iterations: int,
    left: Count,
    flow: Callable[..., object] = flow_of,
    closed: float = np.inf,
) -> "Found[Tried]":
    """Solve r(z) = 0 by Newton's method, one motion an iteration.

    **Arguments:**

    - `shot`: the motion from z, and at most so many steps.
    - `equations`: r, its Jacobian and the shot, from z and its motion's flow.
    - `z0`: the first approximation. Steps from it are cut to `LARGEST_MOVE`, and NaN
        ends it.
    - `blank`: a shot of the same shape.
    - `left`: how many steps there are for all motions.
    - `flow`: reads a motion's flow from its run.
    - `closed`: how large r may be, at most, where the last step begins.
    """
    # without a first approximation there is nothing to do
    far, none = jnp.max(z0 - z0) + jnp.inf, jnp.zeros((), jnp.int32)
    left = jnp.asarray(left, jnp.int32)
    begin = Found(z0, jnp.zeros_like(z0), far, none, blank, left, far)

    def goes_on(now: Found[Tried]):
        unsettled = (now.size > TOLERANCE) | (now.residual > closed)  # not for NaN
        return unsettled & (now.iterations < max_iterations) & (now.left > 0)

    def improve(now: Found[Tried], motion: Followed, run: Run[Varied]):
        del motion
        r, jacobian, shot = equations(now.z, flow(run))
        move = -solve(jacobian, r)
        size = jnp.max(jnp.abs(move))
        move = move * jnp.minimum(1.0, LARGEST_MOVE / jnp.where(size > 0, size, 1.0))
        left, residual = now.left - shot.steps, jnp.max(jnp.abs(r))
        return Found(now.z + move, move, size, now.iterations + 1, shot, left, residual)

    return run_in_sequence(lambda now: shot(now.z, now.left), improve, goes_on, begin)[
        0
    ]


class Shot(NamedTuple):
    """One period tried: what is left to close, and its derivatives."""

    residual: Float[Array, " s"]
    jacobian: Float[Array, "s s"]  # in z, the free coordinates and T
    flow: Flow

    @property
    def steps(self) -> Int[Array, ""]:
        """The steps of its motion."""
        return self.flow.steps


def shot_motion(
    make: Make,
    parameters: Parameters,
    section: SectionPlane,
    z: Unknowns,
    method: Method,
    vary: bool = True,
) -> Motion[Varied]:
    """The motion from the section for a period."""
    y0, span = start_of(section, z), jnp.maximum(z[-1], SHORTEST)
    return varied_motion(make, parameters, y0, span, method, vary)


def shot_of(section: SectionPlane, z: Unknowns, flow: Flow) -> Shot:
    """The remainder by which such a motion fails to close."""
    residual = jnp.where(flow.arrived, flow.y - start_of(section, z), jnp.nan)
    return Shot(residual, closing(section, flow.moved, flow.slope), flow)


def turned(flow: Flow, sign: Scalar) -> Flow:
    """With the sign -1 seen in the mirror: half a period on is the start's image."""
    y, slope, moved = sign * flow.y, sign * flow.slope, sign * flow.moved
    return flow._replace(y=y, slope=slope, moved=moved)


def is_mirrored(
    system: System, y0: PhasePoint, span: Scalar, budget: Count, valid: Flag
) -> tuple[Bool[Array, ""], Int[Array, ""]]:
    """Whether after the span y0 has come to its mirror image -y0, and the steps."""
    method = Method(Explicit(), 1e-8, 1e-8).at_most(budget)
    run = follow(Motion(system, y0, Watching(), method, end=span, valid=valid))
    start, end = jnp.stack(y0), jnp.stack(run.y)
    near = MIRRORED * jnp.maximum(1.0, jnp.max(jnp.abs(start)))
    off = jnp.max(jnp.abs(end + start))
    return (run.outcome == CODE.complete) & (off < near), run.steps


def start_of(section: SectionPlane, z: Float[Array, "*n s"]) -> Float[Array, "*n s"]:
    """The state (s,) on the section, or states (n, s) of z (n, s)."""
    level = 0.0 * z[..., 0] + section.level
    i = section.place(z.shape[-1] // 2)
    return jnp.concatenate([z[..., :i], level[..., None], z[..., i:-1]], axis=-1)


def of_each(
    extent: Float[Array, "*n a"],
) -> tuple[Float[Array, "*n r"], Float[Array, "*n r"]]:
    """The largest angles of the rods, and of the joints: of the first that of its rod.

    They stand as in a flow: |phi1|, ..., |phin|, |phi2 - phi1|, ...
    """
    n = (extent.shape[-1] + 1) // 2
    joints = jnp.array([0, *range(n, 2 * n - 1)])
    return extent[..., :n], extent[..., joints]


def blank_shot(n: int, dtype: DTypeLike, rods: int = 2) -> Shot:
    """A shot of n parameters that has not been made."""
    s, angles = 2 * rods, 2 * rods - 1

    def none(*shape):
        return jnp.zeros(shape, dtype)

    ends = jnp.asarray(False), jnp.zeros((), jnp.int32), none()
    moved = none(s, s + n), none(angles, s + n)
    return Shot(
        none(s), none(s, s), Flow(none(s), none(s), none(angles), *moved, *ends)
    )


def closing(
    section: SectionPlane, moved: Float[Array, "s k"], slope: Float[Array, " s"]
) -> Float[Array, "s s"]:
    """The Jacobian of the residual in z."""
    s = slope.size
    others = jnp.asarray(section.free(s // 2))
    free = (moved[:, :s] - jnp.eye(s, dtype=moved.dtype))[:, others]
    return jnp.concatenate([free, slope[:, None]], axis=1)
