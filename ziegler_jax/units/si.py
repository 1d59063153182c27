r"""SI units: values in kilograms, metres, newtons, seconds, and results back in them.

A column is known by its reference mass m (kg), the length l of rod 1 (m) and the spring
of joint 2, k (N m/rad). They make the unit of every number:

| quantity | unit |
|---|---|
| time | $\sqrt{m l^2/k}$ s |
| rate | $\sqrt{k/(m l^2)}$ rad/s |
| torque, energy | k N m |
| force, and the load q = F l/k | k/l N |
| inertia | $m l^2$ kg m$^2$ |
| joint damping | $\sqrt{k m l^2}$ N m s/rad |
| drag on a unit of length | $\sqrt{k m}/l^2$ N s/m$^2$ |
| power | $k\sqrt{k/(m l^2)}$ W |

They scale the frictionless column and change nothing else. With friction they do more:
a pin radius in metres and a transition velocity in m/s become other dimensionless
numbers on another column.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import reduce
from typing import TypeVar, cast, overload

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import xarray as xr

from ..model.chain_of_rods import Chain
from ..model.column import Column
from ..model.friction import SmoothCoulomb
from ..model.loads import AbstractNormalLoad, JointReaction
from ..motion.trajectory import Trajectory
from ..numerics.numbers import Joints, Numbers, OneOrEach, Scalar, each, is_concrete
from ..numerics.rules import number, number_or_each
from ..results import TIME, AbstractResult
from .known import UNITS, Powers, size
from .restored import (
    Restored,
    restored_dataset,
    restored_motion,
    restored_result,
)
from .scaled import scaled_chain, scaled_column, scaled_value

# Half of the fall from mu_s to mu_k, in transition velocities: the middle of 1 to 1.5.
HALF_FALL = 1.25
# v_stribeck / v_smooth: the smoothed peak reaches 0.98 of mu_s where mu_s = 1.2 mu_k.
RATIO = 10.0

Value = TypeVar("Value", bound=eqx.Module)


class SI(eqx.Module):
    r"""A column's units.

    ```python
    units = zj.SI(m=0.1, l=0.2, k=0.5)
    friction = zj.SetValuedCoulomb(0.15, pin_radius=0.004)  # metres
    damping = zj.Viscous(1e-4, 1e-4)  # N m s/rad
    rods = {"m1": 0.1, "m2": 0.1, "l1": 0.2, "l2": 0.2}  # kilograms, metres
    column = zj.uniform_rods(6.5, **rods, friction=friction, damping=damping)  # newtons
    column = units.scaled(column)
    start = units.scaled(zj.State(omega=(0.0, 2.0)))  # rad/s
    motion = units.restore(zj.trajectory(column, start, ts / units.time))  # seconds
    windows = units.scaled(zj.Windows(transient=10.0))  # seconds
    end = units.restore(zj.settle(column, start, windows=windows))
    end.time, end.frequency  # seconds, Hz
    ```

    **Arguments:** positive: `m`, the reference mass (kg); `l`, the length of rod 1 (m);
    `k`, the spring of joint 2, between the rods (N m/rad). That of joint 1, at the
    base, is `kappa` times it: a base of 0.8 N m/rad has `kappa=0.8 / k`.

    **Raises:** `ValueError` where a concrete number breaks its rule.
    """

    m: Scalar
    l: Scalar  # noqa: E741 - the field's name for it
    k: Scalar

    def __init__(self, m: Scalar, l: Scalar, k: Scalar):  # noqa: E741
        """Keep the three numbers."""
        self.m = number("m", m, "positive")
        self.l = number("l", l, "positive")
        self.k = number("k", k, "positive")

    @property
    def time(self) -> Scalar:
        r"""The unit of time, $\sqrt{m l^2/k}$, in seconds."""
        return self._size(UNITS[TIME].powers)

    @property
    def force(self) -> Scalar:
        """The unit of force, k/l, in newtons; q = F / force."""
        return self._size(UNITS["k/l"].powers)

    def scaled(self, value: Value) -> Value:
        r"""A value that was written in SI units, in the column's own.

        Each of its numbers is divided by its unit, by the `units` of its class: of
        `Column`, `State`, laws of friction and damping, loads, observers, options.
        Angles, coefficients, counts and tolerances stay as they are. A value that holds
        others is scaled with them: the laws of a column with the column, once.

        A column in SI units has `l1`, the length of rod 1, and is given all its masses
        and lengths: a default of 1 would be a kilogram or a metre. Its stiffness is the
        k of these units. A `Chain` in SI units names its masses and springs; m, l and
        k are any mass, length and spring. `beck` and its like are in the beam's own
        units, whatever these are, and are not scaled.

        **Arguments:** `value`: of a class of the library, or a law or an observer of
        your own whose class has `units`. All numbers in it are in SI units, defaults
        too.

        **Returns:** the same kind of value. Traced numbers are scaled and
        differentiated as others are.

        **Raises:** `ValueError` for a number without a unit, a column without `l1`, a
        chain without masses or springs, and a column whose rod 1 does not have the
        length l; where either is traced the column is `invalid`. Also for results: they
        are `restore`d.
        """
        if not isinstance(value, eqx.Module) or isinstance(value, AbstractResult | SI):
            raise ValueError(
                "Argument `value` must be a column, a state, a law, a load, an "
                f"observer or options, but is {type(value).__name__}."
            )
        if isinstance(value, Column):
            return scaled_column(value, self._size)
        if isinstance(value, Chain):
            return scaled_chain(value, self._size)
        return scaled_value(value, self._size)

    @staticmethod
    def joint_friction(
        mu_s: Joints,
        mu_k: Joints,
        *,
        pin_radius: Joints,
        transition_velocity: Joints,
        v_smooth: Scalar | None = None,
        load: AbstractNormalLoad | None = None,
    ) -> SmoothCoulomb:
        r"""The `SmoothCoulomb` of a multibody program's joint friction.

        Such a program (Adams: `FRICTION`) takes two coefficients, the pin's radius R
        (m) and the stiction transition velocity v (m/s), a velocity *of the pin's
        surface*: joint rates are compared with v / R (rad/s). It distinguishes static
        friction up to v, a passage from v to 1.5 v (a cubic step, whose middle is at
        1.25 v) and dynamic friction beyond; its normal force is the joint's reaction
        (N). Here

        $$v_{stribeck} = \frac{1.25}{\sqrt{\ln 2}}\,\frac{v}{R}, \qquad
        \frac{1.25}{\sqrt{\ln 2}} \approx 1.50,$$

        so that half of the fall from mu_s to mu_k is done at 1.25 v, as there:
        $\exp(-(1.25/1.50)^2) = 1/2$. Below v
        the program holds the joint by a small spring (its creep), which this law does
        not have: `v_smooth` stands for it and belongs to no datum of the program.

        **Arguments:** all in SI units; one number for all joints, or one a joint:

        - `mu_s`, `mu_k`: `MU_STATIC`, `MU_DYNAMIC`.
        - `pin_radius`: `PIN_RADIUS`, in m. Its default in Adams is one unit of length,
            1 m or 1 mm by the model's units: torques a thousand times apart.
        - `transition_velocity`: `STICTION_TRANSITION_VELOCITY`, in m/s. Its default is
            0.1 units of length a unit of time.

        and for all joints:

        - `v_smooth`: in rad/s; None is a tenth of v_stribeck, of the smaller one where
            joints differ.
        - `load`: `ConstantLoad(n)` of n in N, e.g.; None is `JointReaction()`. A
            preload beside the reaction is `ConstantLoad(n) + JointReaction()`, as such
            a program adds them up; axial and bending reactions are none in the plane.

        **Returns:** a law in SI units, as a column in SI units takes it: `scaled`
        scales both at once.

        **Raises:** `ValueError` as `SmoothCoulomb`, and for a radius or velocity that
        is not positive.
        """
        radius = number_or_each("pin_radius", pin_radius, "positive")
        factor = HALF_FALL / math.log(2.0) ** 0.5
        rate = SI.transition_rate(radius, transition_velocity)
        v_stribeck = _each(lambda x: factor * x, rate)
        if v_smooth is None:
            v_smooth = reduce(_smaller, each(v_stribeck, 1)) / RATIO
        return SmoothCoulomb(
            mu_s,
            mu_k,
            pin_radius=radius,
            v_stribeck=v_stribeck,
            v_smooth=v_smooth,
            load=JointReaction() if load is None else load,
        )

    @staticmethod
    def transition_rate(pin_radius: Joints, transition_velocity: Joints) -> OneOrEach:
        r"""The joint rate v / R at which static friction ends, in rad/s.

        It tells which regimes a run enters: with this as `rate_cut`,
        `scaled(StickFraction(rate_cut))` is the share of static friction; with 1.5
        times this, all but dynamic friction.

        **Arguments:** the pin's radius in m, the velocity of its surface in m/s; one
        number each, or one a joint.

        **Returns:** a number, or a tuple where an argument is one.
        """
        radius = number_or_each("pin_radius", pin_radius, "positive")
        velocity = number_or_each(
            "transition_velocity", transition_velocity, "positive"
        )
        return _each(lambda v, r: v / r, velocity, radius)

    @overload  # a `Trajectory` is a result too, which the first line takes
    def restore(  # pyright: ignore[reportOverlappingOverload]
        self, result: Trajectory
    ) -> Trajectory: ...
    @overload
    def restore(self, result: xr.Dataset) -> xr.Dataset: ...
    @overload
    def restore(self, result: AbstractResult) -> Restored: ...
    def restore(
        self, result: Trajectory | xr.Dataset | AbstractResult
    ) -> Trajectory | xr.Dataset | Restored:
        r"""The same result in SI units.

        **Arguments:** `result`: a `Trajectory`; a dataset of `sweep`, whose variables
        and coordinates are converted by their `units`; or another result of the
        library (`settle`, `periodic_orbit`, ...) outside a sweep. Angles, pure
            numbers (a `threshold` over q too) and axes in units of their own stay as
            they are.

        **Returns:** a `Trajectory`; an `xarray.Dataset`; else a result that has the
        same numbers as attributes, prints them with their SI units and what its codes
        mean, and has `to_dataset()`. Where there is a `period` (s), there is a
        `frequency` (Hz) beside it, $f = 1/T$.

        **Raises:** `ValueError` for anything else, and for a unit that is not known.
        """
        if isinstance(result, Trajectory):
            return restored_motion(result, self._size)
        if isinstance(result, xr.Dataset):
            return restored_dataset(result, self._size)
        if isinstance(result, AbstractResult):
            return restored_result(result, (self.m, self.l, self.k))
        raise ValueError(
            "Argument `result` must be a `Trajectory`, an `xarray.Dataset` or a result "
            f"of the library with named numbers, but is {type(result).__name__}."
        )

    def _size(self, powers: Powers) -> Scalar:
        """A unit in SI, by its powers of m, l and k."""
        return size(powers, (self.m, self.l, self.k))


def _each(function: Callable[..., Scalar], *values: OneOrEach) -> OneOrEach:
    """A function of numbers; a tuple, one a joint, where any of them is one."""
    counts = {len(x) for x in values if isinstance(x, tuple)}
    if not counts:
        return function(*cast(Numbers, values))
    n = max(counts)
    return tuple(function(*x) for x in zip(*(each(v, n) for v in values), strict=True))


def _smaller(x: Scalar, y: Scalar) -> Scalar:
    """The smaller number, in NumPy's where both are known."""
    known = is_concrete(x) and is_concrete(y)
    return cast(float, np.minimum(x, y)) if known else jnp.minimum(x, y)
