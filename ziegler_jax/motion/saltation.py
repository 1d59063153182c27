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
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp

from ..model.column import Column, joint_balance, vector_field
from ..model.set_valued import FrozenCoulomb, in_modes
from ..numerics.numbers import Traced4
from ..solvers import Step
from .observers import joint_rates


def leaves(
    column: Column, dp: Column | None
) -> tuple[Column, Callable[[Column], Column]]:
    """Those numbers of a column that differ, and the column of such numbers.

    **Arguments:** `dp`: the differences in the column's own structure, None for what
    does not differ; None alone: nothing does.
    """
    none = {"is_leaf": lambda x: x is None}
    numbers = jax.tree.map(lambda d, x: d if d is None else x, dp, column, **none)
    return numbers, lambda numbers: eqx.combine(numbers, column)


def saltation(
    column: Column, step: Step, dp: Column | None = None
) -> Callable[[Traced4], Traced4]:
    """What the event on which the step ended makes of a difference dy.

    **Arguments:** `column`: in the modes of the step; `dp`: how its numbers differ.
    """
    assert step.event
    (joint, modes), (numbers, column_of) = step.event, leaves(column, dp)

    def guard(y, numbers):
        here = column_of(numbers)
        law = cast(FrozenCoulomb, here.friction)
        assert law.modes is not None
        each = zip(
            law.modes, law.guard(joint_balance(here, y)), joint_rates(y), strict=True
        )
        one, two = (jnp.where(m == 0, left, u) for m, left, u in each)
        # both at once is not generic: then one is as good as the other
        return jnp.where(joint == 2, two, one)

    _, towards = jax.linearize(guard, step.y1, numbers)
    speed = towards(step.f1, jax.tree.map(jnp.zeros_like, numbers))
    speed = jnp.where(speed == 0, jnp.inf, speed)  # one that grazes does not jump
    after = vector_field(step.t1, step.y1, in_modes(column, modes))

    def jump(dy: Traced4) -> Traced4:
        late = towards(dy, dp) / speed
        parts = zip(dy, step.f1, after, strict=True)
        return cast(Traced4, tuple(d + late * (b - a) for d, a, b in parts))

    return jump
