r"""The branch that crosses at a flip or a pitchfork: its first cycle.

At a flip a multiplier of a cycle is -1: beside it lies a cycle that closes after two of
its periods. At a pitchfork one more multiplier is 1: a cycle that is its own mirror
image loses that symmetry, and two cycles leave it, each the other's image. Over k
turns (2 or 1) the shooting problem $R(z, \lambda) = 0$ is singular there, and the null
vector v of $R_z$, which the monodromy matrix tells, is the direction of the other
branch: its parameter moves with the square of the distance alone. So a cycle of it, at
a distance d, is sought on

$$R(z, \lambda) = 0, \qquad v \cdot (z - z_0) = d,$$

from $z_0 + d\,v$ on. It is another one if half a period later it is not where the first
branch would be: back at its start, or at the mirror image of that.

Source: H. B. Keller (1977); Y. A. Kuznetsov, Elements of Applied Bifurcation Theory
(2004), sections 10.2 and 10.3.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..model.column import Column, State
from ..motion.implicit import fixed, lost
from ..motion.options import Method, recorded
from ..motion.trajectory import trajectory
from ..numerics.numbers import Scalar
from ..numerics.rules import choice, keeps, number
from ..results import (
    CODE,
    ORBITS,
    AbstractResult,
    Settings,
    Variable,
    quantity,
)
from ..runtime import requires_x64
from .branch_point import Arc, Continuation
from .continuation import Branch, CyclePoints
from .periodic_orbit import PeriodicOrbit
from .shooting import start_of

TURNS = {"flip": 2, "pitchfork": 1}


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
        metadata=quantity("how the search for the orbit ended", codes=ORBITS)
    )
    settings: Settings = eqx.field(static=True)

    def variables(self) -> dict[str, Variable]:
        """All numbers with their names, units and dimensions."""
        return self.orbit.variables() | super().variables()


@requires_x64
def branch_off(
    make_column: Callable[[Scalar], Column],
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
    - `distance`: how far from it the cycle is sought, in rad.
    - `side`: 1 or -1. From a pitchfork one cycle leaves to each side, from a flip the
        same one to both.
    - `method`: an explicit one; its step budget is that of all motions together.

    **Returns:** `Offshoot`. The `outcome` is `beyond` where there is no such point,
    and `not_converged` where no other cycle is found at this distance.

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
    if side not in (1, -1) or isinstance(side, bool):
        raise ValueError(f"Argument `side` must be 1 or -1, but is {side!r}.")
    apart = fixed(number("distance", distance, "positive"))
    once, parameter = fixed(points.first_of(kind))
    longer = eqx.tree_at(lambda o: o.period, once, TURNS[kind] * once.period)
    scene = make_column, longer, parameter
    problem = Continuation("branch_off", *scene, Arc(), method)
    good = (problem.failure == 0) & keeps("positive", apart)
    x0 = jnp.where(good, problem.first, jnp.nan)
    across = _across(kind, once)
    ahead = x0 + side * apart * across
    point, closed, tries, left = problem.correct(ahead, across, problem.method.budget)
    x = fixed(jnp.where(closed, point.x, jnp.nan)) * problem.scale
    y, half, end, steps = _turn(problem, x)
    # half a period later a cycle of the first branch would be
    image = y if kind == "flip" else -y
    closed &= jnp.max(jnp.abs(half - image)) > apart / 2
    outcome = jnp.where(closed, CODE.found, CODE.not_converged)
    outcome = jnp.where(left > 0, outcome, CODE.not_integrated)
    outcome = jnp.where(problem.failure == 0, outcome, problem.failure)
    outcome = jnp.where(keeps("positive", apart), outcome, CODE.invalid)
    outcome = outcome.astype(jnp.int8)
    options = {"kind": kind, "distance": distance, "side": side}
    settings = recorded(**problem.method.settings(), **options)
    mark = jnp.where(outcome == CODE.found, 1.0, jnp.nan)
    y, x, extent = y * mark, x * mark, point.extent * mark
    steps += problem.method.budget - left
    orbit = PeriodicOrbit(
        state=State((y[0], y[1]), (y[2], y[3])),
        section=problem.section,
        period=x[3],
        rod_amplitude=extent[:2],
        joint_amplitude=extent[jnp.array([0, 2])],
        monodromy=point.moved * mark,
        residual=jnp.max(jnp.abs(end - y)),
        iterations=tries,
        steps=steps,
        outcome=outcome,
        settings=settings,
    )
    offshoot = Offshoot(
        orbit=orbit, parameter=x[4], steps=steps, outcome=outcome, settings=settings
    )
    return lost(offshoot, (problem.live, points, distance))


def _turn(
    problem: Continuation, x: Float[Array, "5"]
) -> tuple[Float[Array, "4"], Float[Array, "4"], Float[Array, "4"], Int[Array, ""]]:
    """Where a cycle begins, is after half a period, and ends; steps."""
    y = start_of(problem.section, x[:4])
    start, column = State((y[0], y[1]), (y[2], y[3])), problem.make(x[4])
    ts = x[3] * jnp.array([0.0, 0.5, 1.0])
    course = trajectory(column, start, ts, method=problem.method)
    half, end = jnp.concatenate([course.phi, course.omega], axis=-1)[1:]
    return y, half, end, course.steps


def _across(kind: str, cycle: PeriodicOrbit) -> Float[Array, "5"]:
    r"""The unit vector of the section along which the other branch leaves.

    With the monodromy M, $M f = f$ along the motion and $M v = \mp v$ across it.
    """
    moved, i = cycle.monodromy, cycle.section.index
    known = jnp.all(jnp.isfinite(moved))
    one = jnp.eye(4, dtype=moved.dtype)

    def null(matrix: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
        """Right singular vectors, that of the smallest singular value last."""
        return jnp.linalg.svd(jnp.where(known, matrix, one))[2]

    along = null(moved - one)
    first, second = along[-1], null(moved + one)[-1] if kind == "flip" else along[-2]
    v = first * second[i] - second * first[i]
    v = v / jnp.sqrt(v @ v)
    # which of the two signs is a matter of the library's: the same side everywhere
    v = v * jnp.sign(v[jnp.argmax(jnp.abs(v))])
    v = v[jnp.asarray(cycle.section.others)]
    return jnp.concatenate([jnp.where(known, v, jnp.nan), jnp.zeros(2, v.dtype)])
