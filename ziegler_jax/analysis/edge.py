r"""Edge states: what lies between rest and flutter.

The motion from a threshold stays on the stable manifold of a saddle: of an unstable
cycle, or of an unstable equilibrium $f(y_e) = 0$, at which joints may slip that come to
rest there. Newton's method finds either from where the motion was nearest to it.

Source: J. D. Skufca, J. A. Yorke, B. Eckhardt, Phys. Rev. Lett. 96 (2006) 174101.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..model.column import Column, State
from ..model.state import PhasePoint
from ..motion.implicit import fixed
from ..results import CODE
from .manifold import Middle
from .periodic_orbit import periodic_orbit

MOST_STEPS = 20  # of Newton's method to an equilibrium
NEAR = 0.1  # of the motion's size: it has drawn near to that equilibrium
BALANCED = 1e-9  # the accelerations left of it, over the motion's size


class Edge(NamedTuple):
    """An edge state."""

    code: Int[Array, ""]
    y: Float[Array, "4"]  # the equilibrium, or where the cycle passes phi1 = 0 upwards
    period: Float[Array, ""]
    multiplier: Float[Array, ""]  # the largest modulus of a cycle's multipliers
    amplitude: Float[Array, "2"]  # the largest angles of the joints
    steps: Int[Array, ""]


def edge_state(
    column: Column, middle: Middle, size: Float[Array, ""], known: Bool[Array, ""]
) -> Edge:
    """The edge state near a motion on a threshold, from its nearest point."""
    known = known & middle.reached
    y = jnp.where(known, fixed(middle.y), jnp.nan)
    orbit = periodic_orbit(column, State((y[0], y[1]), (y[2], y[3])))
    others = jnp.abs(orbit.multipliers[1:])
    cycles = (orbit.outcome == CODE.found) & (jnp.sum(others > 1) == 1)
    rest, rests = _equilibrium(column, y, fixed(middle.modes), fixed(size))
    code = jnp.where(cycles, CODE.saddle_cycle, CODE.unknown)
    code = jnp.where(rests, CODE.equilibrium, code)
    code = jnp.where(known, code, CODE.no_threshold).astype(jnp.int8)
    nan, on_cycle = jnp.nan, code == CODE.saddle_cycle
    at_rest = jnp.abs(jnp.stack([rest[0], rest[1] - rest[0]]))
    amplitude = jnp.where(on_cycle, orbit.joint_amplitude, nan)
    return Edge(
        code=code,
        y=jnp.where(rests, rest, jnp.where(on_cycle, jnp.stack(orbit.state.y), nan)),
        period=jnp.where(on_cycle, orbit.period, nan),
        multiplier=jnp.where(on_cycle, others[0], nan),
        amplitude=jnp.where(rests, at_rest, amplitude),
        steps=orbit.steps,
    )


def _equilibrium(
    column: Column,
    y: Float[Array, "4"],
    modes: Float[Array, "2"],
    size: Float[Array, ""],
) -> tuple[Float[Array, "4"], Bool[Array, ""]]:
    """The unstable equilibrium near a state, and whether there is one."""

    def field(column: Column, y: Float[Array, "4"]) -> Float[Array, "4"]:
        system = column.system()
        if system.sticks:
            system = system.in_modes(tuple(modes))
        return jnp.stack(system.field(jnp.zeros((), y.dtype), PhasePoint(y)))

    def accelerations(column, angles):
        return field(column, jnp.concatenate([angles, jnp.zeros_like(angles)]))[2:]

    def step(column, angles):
        # a joint that sticks has no equation of its own: the shortest step
        still = fixed(column)
        jacobian = jax.jacfwd(lambda x: accelerations(still, x))(fixed(angles))
        bad = ~jnp.all(jnp.isfinite(jacobian))
        inverse = jnp.linalg.pinv(jnp.where(bad, 1.0, jacobian), rtol=1e-9)
        return angles - jnp.where(bad, jnp.nan, inverse) @ accelerations(column, angles)

    still = fixed(column)
    angles = jax.lax.fori_loop(0, MOST_STEPS, lambda _, x: step(still, x), y[:2])
    angles = step(column, angles)  # with the derivative in the column's numbers
    rest = jnp.concatenate([angles, jnp.zeros_like(angles)])
    left = jnp.max(jnp.abs(accelerations(still, fixed(angles))))
    apart = jnp.max(jnp.abs(fixed(rest) - y))
    jacobian = jax.jacfwd(lambda y: field(still, y))(fixed(rest))
    bad = ~jnp.all(jnp.isfinite(jacobian))
    growth = jnp.linalg.eigvals(jnp.where(bad, 0.0, jacobian)).real
    unstable = jnp.max(growth) > 1e-6
    return rest, (left < BALANCED * size) & (apart < NEAR * size) & unstable
