r"""What a change of modes does to small differences.

Where set-valued friction changes its modes, at a guard $g(y, p) = 0$ with the fields
$f^-$ before and $f^+$ after it, a neighbour passes earlier or later, by $\delta t$, and
a difference jumps:

$$\delta y^+ = \delta y^- + (f^- - f^+)\,\delta t, \qquad \delta t = -\frac{
\partial_y g\,\delta y^- + \partial_p g\,\delta p}{\partial_y g\,f^-}.$$

The guard is the rate of a joint that comes to rest and the constraint torque of one
that breaks loose. In stick a joint's rate is held, and so is its variation: after a
stick phase the map has lost a rank.

Source: P. C. Mueller, Chaos, Solitons & Fractals 5 (1995) 1671-1681; M. di Bernardo et
al., Piecewise-smooth Dynamical Systems (2008), section 2.5; R. I. Leine, H. Nijmeijer,
Dynamics and Bifurcations of Non-smooth Mechanical Systems (2004), chapter 7.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from ..model.chain import joint_angles
from ..model.state import PhasePoint
from ..model.system import System
from .along import leaves
from .fold import Step


def saltation(
    system: System, step: Step, dp: System | None = None
) -> Callable[[PhasePoint], PhasePoint]:
    """What the event on which the step ended makes of a difference dy.

    **Arguments:** `system`: in the modes of the step; `dp`: how its numbers differ.
    """
    assert step.event
    (joint, modes), (numbers, dp, system_of) = step.event, leaves(system, dp)

    def guard(y, numbers):
        here = system_of(numbers)
        guards, rates = here.law.guard(here.balance(y)), joint_angles(y.omega)
        each = zip(here.law.modes, guards, rates, strict=True)
        chosen, *others = (jnp.where(m == 0, left, u) for m, left, u in each)
        # several at once is not generic: then one is as good as the other
        for i, other in enumerate(others, 1):
            chosen = jnp.where(joint == 2**i, other, chosen)
        return chosen

    _, towards = jax.linearize(guard, step.y1, numbers)
    speed = towards(step.f1, jax.tree.map(jnp.zeros_like, numbers))
    speed = jnp.where(speed == 0, jnp.inf, speed)  # one that grazes does not jump
    after = system.in_modes(modes).field(step.t1, step.y1)

    def jump(dy: PhasePoint) -> PhasePoint:
        late = towards(dy, dp) / speed
        parts = zip(dy, step.f1, after, strict=True)
        return PhasePoint(d + late * (b - a) for d, a, b in parts)

    return jump
