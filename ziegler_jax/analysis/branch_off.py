r"""The branch that crosses at a flip or a pitchfork: its first cycle.

At a flip a multiplier of a cycle is -1: beside it lies a cycle that closes after two of
its periods. At a pitchfork one more multiplier is 1: a cycle that is its own mirror
image loses that symmetry, and two cycles leave it, each the other's image. Over k
turns (2 or 1) the shooting problem $R(z, \lambda) = 0$ is singular there, and the null
vector v of $R_z$, which the monodromy matrix tells, is the direction of the other
branch: its parameter moves with the square of the distance alone. So a cycle of it, at
a distance d, is sought on

$$R(z, \lambda) = 0, \qquad v \cdot (z - z_0) = d,$$

from $z_0 + d\,v$ on. Half a period later the cycle at the crossing is back at its
start, or at the mirror image of that, and the other one is not.

Source: H. B. Keller (1977); Y. A. Kuznetsov, Elements of Applied Bifurcation Theory
(2004), sections 10.2 and 10.3.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..model.chain_of_rods import AbstractChain
from ..model.column import State
from ..motion.implicit import fixed, lost
from ..motion.options import Method, recorded
from ..motion.trajectory import trajectory
from ..numerics.eigenvalues import eigenvalues
from ..numerics.numbers import Scalar
from ..numerics.rules import choice, keeps, number
from ..results import (
    CODE,
    OFFSHOOTS,
    AbstractResult,
    Settings,
    Variable,
    quantity,
)
from ..runtime import requires_x64
from .branch_point import Arc, Continuation
from .continuation import Branch, CyclePoints, first_of
from .periodic_orbit import PeriodicOrbit
from .shooting import of_each, start_of

TURNS = {"flip": 2, "pitchfork": 1}
# Of a point that is known to some four digits: by how much a multiplier may be off, and
# half a period may miss the start, or its mirror image.
NEAR, MIRRORED = 0.02, 1e-3


class Offshoot(AbstractResult):
    """A cycle of the branch that crosses another.

    `orbit`: the cycle, a `PeriodicOrbit`; `parameter`: where it is one; `outcome`: a
    `CODE`, unless that is `found` both are NaN; `steps` of all motions. In a dataset
    the orbit's numbers are named as in `PeriodicOrbit`.
    """

    orbit: PeriodicOrbit
    parameter: Float[Array, "*lanes"] = eqx.field(metadata=quantity("parameter"))
    steps: Int[Array, "*lanes"] = eqx.field(metadata=quantity("attempted steps"))
    outcome: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("how the search for the orbit ended", codes=OFFSHOOTS)
    )
    settings: Settings = eqx.field(static=True)

    def variables(self) -> dict[str, Variable]:
        """All numbers with their names, units and dimensions."""
        return self.orbit.variables() | super().variables()


@requires_x64
def branch_off(
    make_column: Callable[[Scalar], AbstractChain],
    kind: Literal["flip", "pitchfork"],
    start: Branch | CyclePoints,
    *,
    distance: Scalar = 0.02,
    side: Literal[1, -1] = 1,
    method: Method = Method(),
) -> Offshoot:
    r"""A cycle of the branch that leaves another at a flip or a pitchfork.

    ```python
    branch = zj.continue_cycle(make_column, orbit, 3.3, arc=zj.Arc(points=20))
    doubled = zj.branch_off(make_column, "flip", branch)
    arc = zj.Arc("both", points=20)
    other = zj.continue_cycle(make_column, doubled.orbit, doubled.parameter, arc=arc)
    ```

    **Arguments:**

    - `make_column`: a function of the parameter, as of `continue_cycle`.
    - `kind`: `"flip"`, where a cycle of twice the period leaves, or `"pitchfork"`,
        where two cycles leave that are no mirror images of themselves.
    - `start`: a branch, or points such as `branch.special`, whose first one of this
        kind is taken.
    - `distance`: how far from it the cycle is sought, as on the arc: in rad, and in
        $\sqrt{k/(m l^2)}$ for the rates.
    - `side`: 1 or -1. From a pitchfork one cycle leaves to each side, from a flip the
        same one to both.
    - `method`: an explicit one; its step budget is that of all motions together.

    **Returns:** `Offshoot`. The `outcome` is `no_start` where there is no such point,
    or none whose multiplier and, at a pitchfork, whose symmetry say so; `not_converged`
    where no other cycle is found at this distance; `not_integrated` where the budget
    is spent; `invalid` where numbers break a rule or the point's are not finite.

    **Derivatives:** NaN: how far from the crossing it lies is a matter of the distance.
    Ask `periodic_orbit` for those of the cycle at a parameter.

    **Raises:** `ValueError` for arguments that break a rule.
    """
    choice("kind", kind, tuple(TURNS))
    points = start.special if isinstance(start, Branch) else start
    if not isinstance(points, CyclePoints):
        raise ValueError(
            f"Argument `start` must be a `Branch` or `CyclePoints`, but is {start!r}."
        )
    whole = isinstance(side, int | np.integer) and not isinstance(side, bool)
    if not whole or side not in (1, -1):
        raise ValueError(f"Argument `side` must be 1 or -1, but is {side!r}.")
    apart = fixed(number("distance", distance, "positive"))
    once, parameter, there = first_of(points, kind)
    longer = eqx.tree_at(lambda o: o.period, once, TURNS[kind] * once.period)
    scene = make_column, longer, parameter
    problem = Continuation("branch_off", *scene, Arc(), method)
    known = jnp.all(jnp.isfinite(once.monodromy)) & (once.period > 0)
    good = known & keeps("positive", apart) & (problem.failure == 0)
    x0 = jnp.where(good, problem.first, jnp.nan)
    across, is_one = _across(kind, once)
    budget = problem.method.budget
    ahead = x0 + side * apart * across
    point, closed, tries, left = problem.correct(ahead, across, budget)
    x = fixed(jnp.where(closed, point.x, jnp.nan))
    # the cycle at the crossing, and the other: what they are after half of their turn
    turn = jax.vmap(partial(_turn, problem, left))
    turned = turn(jnp.stack([x0 * problem.scale, x * problem.scale]))
    image = turned.start if kind == "flip" else -turned.start
    off = jnp.max(jnp.abs(turned.half - image), axis=1)
    residual = jnp.max(jnp.abs(turned.end - turned.start), axis=1)[1]
    is_one &= off[0] < MIRRORED
    another = off[1] > apart / 2 + 10 * residual
    outcome = jnp.where(closed & another, CODE.found, CODE.not_converged)
    spent = (left <= 0) & ~closed | closed & ~turned.arrived[1]
    outcome = jnp.where(spent, CODE.not_integrated, outcome)
    outcome = jnp.where(is_one, outcome, CODE.no_start)
    outcome = jnp.where(good, outcome, CODE.invalid)
    outcome = jnp.where(there, outcome, CODE.no_start).astype(jnp.int8)
    options = {"kind": kind, "distance": distance, "side": int(side)}
    section = problem.section.settings()
    settings = recorded(**problem.method.settings(), **section, **options)
    mark = jnp.where(outcome == CODE.found, 1.0, jnp.nan)
    x, extent = x * problem.scale * mark, point.extent * mark
    y, n = start_of(problem.section, x[:-1]) * mark, problem.rods
    rods, joints = of_each(extent)
    steps = budget - left + jnp.sum(turned.steps, dtype=jnp.int32)
    closes = jnp.where(outcome == CODE.found, CODE.found, CODE.not_converged)
    orbit = PeriodicOrbit(
        state=State(tuple(y[:n]), tuple(y[n:])),
        section=problem.section,
        period=x[-2],
        rod_amplitude=rods,
        joint_amplitude=joints,
        monodromy=point.moved * mark,
        residual=residual * mark,
        iterations=tries,
        steps=steps,
        outcome=closes.astype(jnp.int8),
        settings=settings,
    )
    offshoot = Offshoot(
        orbit=orbit, parameter=x[-1], steps=steps, outcome=outcome, settings=settings
    )
    return lost(offshoot, (problem.live, points, distance))


class Turn(NamedTuple):
    """A cycle, as a motion: where it begins, is after half a period, and ends."""

    start: Float[Array, "*n s"]
    half: Float[Array, "*n s"]
    end: Float[Array, "*n s"]
    arrived: Bool[Array, "*n"]
    steps: Int[Array, "*n"]


def _turn(problem: Continuation, left: Int[Array, ""], z: Float[Array, " m"]) -> Turn:
    """The motion from the section; of two each has half of the steps that are left."""
    y, n = start_of(problem.section, z[:-1]), problem.rods
    start, column = State(tuple(y[:n]), tuple(y[n:])), problem.make(z[-1])
    ts = z[-2] * jnp.array([0.0, 0.5, 1.0])
    method = problem.method.at_most(jnp.maximum(left // 2, 1))
    course = trajectory(column, start, ts, method=method)
    half, end = jnp.concatenate([course.phi, course.omega], axis=-1)[1:]
    return Turn(y, half, end, course.outcome == CODE.complete, course.steps)


def _across(
    kind: str, cycle: PeriodicOrbit
) -> tuple[Float[Array, " m"], Bool[Array, ""]]:
    r"""The unit vector of the section along which the other branch leaves.

    With the monodromy M, $M f = f$ along the motion and $M v = \mp v$ across it.

    **Returns:** v, and whether M has such a multiplier.
    """
    moved, rods = cycle.monodromy, len(cycle.state.phi)
    i = cycle.section.place(rods)
    known = jnp.all(jnp.isfinite(moved))
    one = jnp.eye(2 * rods, dtype=moved.dtype)

    def null(matrix: Float[Array, "s s"]) -> Float[Array, "s s"]:
        """Right singular vectors, that of the smallest singular value last."""
        return jnp.linalg.svd(jnp.where(known, matrix, one))[2]

    along = null(moved - one)
    first, second = along[-1], null(moved + one)[-1] if kind == "flip" else along[-2]
    v = first * second[i] - second * first[i]
    v = v / jnp.sqrt(v @ v)
    # which of the two signs is a matter of the library's: the same side everywhere
    v = v * jnp.sign(v[jnp.argmax(jnp.abs(v))])
    v = v[jnp.asarray(cycle.section.free(rods))]
    across = jnp.concatenate([jnp.where(known, v, jnp.nan), jnp.zeros(2, v.dtype)])
    values = eigenvalues(jnp.where(known, moved, 2.0 * one))
    off = jnp.abs(values + 1) if kind == "flip" else jnp.sort(jnp.abs(values - 1))[1:]
    return across, jnp.min(off) < NEAR
