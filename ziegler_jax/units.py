r"""From SI units to the column's own, and results back in seconds and newton metres.

A column is known by its reference mass m (kg), the length l of rod 1 (m) and the spring
of joint 2, k (N m/rad). They make the unit of every result:

| quantity | unit |
|---|---|
| time | $\sqrt{m l^2/k}$ s |
| rate | $\sqrt{k/(m l^2)}$ rad/s |
| torque, energy | k N m |
| force | k/l N |
| joint damping | $\sqrt{k m l^2}$ N m s/rad |
| power | $k\sqrt{k/(m l^2)}$ W |

They scale the frictionless column and change nothing else. With friction they do more:
a pin radius in metres and a transition velocity in m/s become other dimensionless
numbers on another column.
"""

import dataclasses
import math
from collections.abc import Callable, Hashable
from typing import TypedDict, Unpack, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import xarray as xr

from .model.column import Column
from .model.friction import SmoothCoulomb
from .model.loads import AbstractLoad, JointReaction
from .model.rods import Parts, point_masses, uniform_rods
from .motion.trajectory import Trajectory
from .numerics.numbers import (
    Joints,
    OneOrTwo,
    Pair,
    Scalar,
    both,
    is_concrete,
    number,
    number_or_pair,
)
from .results import AbstractResult

# Half of the fall from mu_s to mu_k, in transition velocities: the middle of 1 to 1.5.
HALF_FALL = 1.25
# v_stribeck / v_smooth: the smoothed peak reaches 0.98 of mu_s where mu_s = 1.2 mu_k.
RATIO = 10.0


Mass = tuple[Scalar | None, float]  # in kg, and what it is in m where it is None


class Bodies(TypedDict):
    """Masses in m, and rod 2's length in l."""

    m1: Scalar
    m2: Scalar
    l2: Scalar


class SI(eqx.Module):
    r"""A column's units.

    ```python
    units = zj.SI(m=1.0, l=1.0, k=10.0)
    column = units.uniform_rods(F=26.0)  # newtons: q = 2.6
    start = zj.State(omega=(0, 2.0 * units.time))  # 2 rad/s
    motion = zj.trajectory(column, start, ts / units.time)
    motion = units.restore(motion)  # seconds, rad/s
    end = units.restore(zj.settle(column, start))
    end.period  # seconds
    ```

    **Arguments:** `m` (kg), `l` (m), `k` (N m/rad), positive.

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
        return self.l * (self.m / self.k) ** 0.5

    @property
    def force(self) -> Scalar:
        """The unit of force, k/l, in newtons; q = F / force."""
        return self.k / self.l

    def uniform_rods(
        self,
        F: Scalar,  # noqa: N803
        *,
        m1: Scalar | None = None,
        m2: Scalar | None = None,
        l2: Scalar | None = None,
        **parts: Unpack[Parts],
    ) -> Column:
        r"""`uniform_rods` in SI units: $q = F l/k$.

        **Arguments:**

        - `F`: the follower load in N.
        - `m1`, `m2`: the rods' masses in kg; None is m.
        - `l2`: the length of rod 2 in m; None is l. That of rod 1 is l.
        - `parts`: `kappa`, `follower`, `damping`, `friction` of `Column`, in its units.

        **Raises:** `ValueError` where a concrete number breaks its rule.
        """
        rods = self._bodies(m1=(m1, 1.0), m2=(m2, 1.0), l2=l2)
        return uniform_rods(self._load(F), **rods, **parts)

    def point_masses(
        self,
        F: Scalar,  # noqa: N803
        *,
        m1: Scalar | None = None,
        m2: Scalar | None = None,
        l2: Scalar | None = None,
        **parts: Unpack[Parts],
    ) -> Column:
        r"""`point_masses` in SI units: $q = F l/k$.

        **Arguments:** as `uniform_rods`, with `m1` at the knee, None for Ziegler's 2 m,
        and `m2` at the tip, None for m, in kg.

        **Raises:** as `uniform_rods`.
        """
        rods = self._bodies(m1=(m1, 2.0), m2=(m2, 1.0), l2=l2)
        return point_masses(q=self._load(F), **rods, **parts)

    def joint_friction(
        self,
        mu_s: Joints,
        mu_k: Joints,
        *,
        pin_radius: Joints,
        transition_velocity: Joints,
        v_smooth: Scalar | None = None,
        load: AbstractLoad | None = None,
    ) -> SmoothCoulomb:
        r"""The `SmoothCoulomb` of a multibody program's joint friction.

        Such a program (Adams: `FRICTION`) takes two coefficients, the pin's radius R
        (m) and the stiction transition velocity v (m/s), a velocity *of the pin's
        surface*: joint rates are compared with v / R (rad/s). It distinguishes static
        friction up to v, a passage from v to 1.5 v (a cubic step, whose middle is at
        1.25 v) and dynamic friction beyond; its normal force is the joint's reaction
        (N). Here

        $$\rho = R/l, \qquad v_{stribeck} = \frac{1.25}{\sqrt{\ln 2}}\,\frac{v}{R}
        \sqrt{m l^2/k}, \qquad \frac{1.25}{\sqrt{\ln 2}} \approx 1.50,$$

        so that half of the fall from mu_s to mu_k is done at 1.25 v, as there:
        $\exp(-(1.25/1.50)^2) = 1/2$. Below v
        the program holds the joint by a small spring (its creep), which this law does
        not have: `v_smooth` stands for it and belongs to no datum of the program.

        **Arguments:** one number for both joints, or one a joint:

        - `mu_s`, `mu_k`: `MU_STATIC`, `MU_DYNAMIC`.
        - `pin_radius`: `PIN_RADIUS`, in m. Its default in Adams is one unit of length,
            1 m or 1 mm by the model's units: torques a thousand times apart.
        - `transition_velocity`: `STICTION_TRANSITION_VELOCITY`, in m/s. Its default is
            0.1 units of length a unit of time.

        and for both joints:

        - `v_smooth`: in $\sqrt{k/(m l^2)}$; None is a tenth of v_stribeck, of the
            smaller one where joints differ.
        - `load`: in k/l; None is `JointReaction()`. A constant torque
            (`FRICTION_TORQUE_PRELOAD`) alone is `ConstantLoad`; axial and bending
            reactions are none in the plane.

        **Raises:** `ValueError` as `SmoothCoulomb`, and for a radius or velocity that
        is not positive.
        """
        radius = number_or_pair("pin_radius", pin_radius, "positive")
        factor = HALF_FALL / math.log(2.0) ** 0.5
        rate = self.transition_rate(radius, transition_velocity)
        v_stribeck = _each(lambda x: factor * x, rate)
        if v_smooth is None:
            v_smooth = _smaller(*both(v_stribeck)) / RATIO
        return SmoothCoulomb(
            mu_s,
            mu_k,
            pin_radius=_each(lambda x: x / self.l, radius),
            v_stribeck=v_stribeck,
            v_smooth=v_smooth,
            load=JointReaction() if load is None else load,
        )

    def transition_rate(
        self, pin_radius: Joints, transition_velocity: Joints
    ) -> OneOrTwo:
        r"""The joint rate v / R at which static friction ends, in $\sqrt{k/(m l^2)}$.

        Which regimes a run enters: with this as `rate_cut`, `StickFraction` is the
        share of static friction; with 1.5 times this, all but dynamic friction.

        **Arguments:** the pin's radius in m, the velocity of its surface in m/s; one
        number each, or one a joint.

        **Returns:** a number, or a pair where an argument is one.
        """
        radius = number_or_pair("pin_radius", pin_radius, "positive")
        velocity = number_or_pair(
            "transition_velocity", transition_velocity, "positive"
        )
        return _each(lambda v, r: v / r * self.time, velocity, radius)

    def restore(
        self, result: Trajectory | xr.Dataset | AbstractResult
    ) -> Trajectory | xr.Dataset:
        """The same result in SI units.

        **Arguments:** `result`: a `Trajectory`; a dataset of `sweep`, whose variables
        and coordinates are converted by their `units`; or another result of the
        library (`settle`, `periodic_orbit`, ...) outside a sweep. Angles and pure
        numbers, q among them, stay as they are, and so do axes in units of their own.

        **Returns:** a `Trajectory`, else an `xarray.Dataset` with the names and units
        of a sweep; axes of `jax.vmap` are its dimensions `lane_1`, `lane_2`, ...

        **Raises:** `ValueError` for anything else, and for a unit that is not known.
        """
        if isinstance(result, Trajectory):
            return self._motion(result)
        if isinstance(result, xr.Dataset):
            return self._dataset(result)
        if isinstance(result, AbstractResult):
            return self._dataset(result.to_dataset())
        raise ValueError(
            "Argument `result` must be a `Trajectory`, an `xarray.Dataset` or a result "
            f"of the library with named numbers, but is {type(result).__name__}."
        )

    def _load(self, force: Scalar) -> Scalar:
        return number("F", force) / self.force

    def _bodies(self, *, m1: Mass, m2: Mass, l2: Scalar | None) -> Bodies:
        """Masses in m, where None is the number beside it, and rod 2's length in l."""
        bodies = {
            name: usual if mass is None else number(name, mass, "positive") / self.m
            for name, (mass, usual) in {"m1": m1, "m2": m2}.items()
        }
        length = 1.0 if l2 is None else number("l2", l2, "positive") / self.l
        return cast(Bodies, {**bodies, "l2": length})

    def _motion(self, motion: Trajectory) -> Trajectory:
        events = motion.events
        if events is not None:
            events = eqx.tree_at(lambda e: e.times, events, events.times * self.time)
        times = motion.times
        return dataclasses.replace(
            motion,
            ts=motion.ts * self.time,
            omega=motion.omega / self.time,
            events=events,
            times=times and tuple(float(t * self.time) for t in times),
        )

    def _dataset(self, dataset: xr.Dataset) -> xr.Dataset:
        units = {
            "sqrt(m l^2/k)": (self.time, "s"),
            "sqrt(k/(m l^2))": (1 / self.time, "rad/s"),
            "sqrt(k m l^2)": (self.k * self.time, "N m s"),
            "k sqrt(k/(m l^2))": (self.k / self.time, "W"),
            "k/l": (self.force, "N"),
            "k": (self.k, "N m"),
            "l": (self.l, "m"),
        }

        def restored(name: Hashable, values: xr.DataArray) -> xr.DataArray:
            unit = values.attrs.get("units", "1")
            if unit in ("1", "rad"):
                return values
            if unit not in units and name in dataset.coords:
                return values  # an axis of the scene's own, in its own unit
            if unit not in units:
                raise ValueError(
                    f"Variable `{name}` of the dataset must be in one of "
                    f"{', '.join(units)}, rad or 1, but is in {unit}."
                )
            factor, name_si = units[unit]
            about = {**values.attrs, "units": name_si}
            if name in dataset.coords:  # for `motion`: scenes are in the old unit
                about["si_unit"] = float(factor)
            return (values * float(factor)).assign_attrs(about)

        # without the old coordinates, which each variable still carries
        data = {n: restored(n, v).variable for n, v in dataset.data_vars.items()}
        coords = {n: restored(n, v).variable for n, v in dataset.coords.items()}
        return xr.Dataset(data, coords, dataset.attrs)


def _each(function: Callable[..., Scalar], *values: OneOrTwo) -> OneOrTwo:
    """A function of numbers; a pair, one a joint, where any of them is a pair."""
    if not any(isinstance(x, tuple) for x in values):
        return function(*values)
    pairs = zip(*map(both, values), strict=True)
    return cast(Pair, tuple(function(*x) for x in pairs))


def _smaller(x: Scalar, y: Scalar) -> Scalar:
    """The smaller number, in NumPy's where both are known."""
    known = is_concrete(x) and is_concrete(y)
    return cast(float, np.minimum(x, y)) if known else jnp.minimum(x, y)
