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

import math
from typing import Any

import equinox as eqx
import xarray as xr

from ._types import number
from .column import Column, uniform_rods
from .friction import AbstractLoad, JointReaction, SmoothCoulomb
from .simulate import Trajectory

# Half of the fall from mu_s to mu_k, in transition velocities: the middle of 1 to 1.5.
HALF_FALL = 1.25
# v_stribeck / v_smooth: the smoothed peak reaches 0.98 of mu_s where mu_s = 1.2 mu_k.
RATIO = 10.0


class SI(eqx.Module):
    r"""A column's units.

    ```python
    units = zj.SI(m=1.0, l=1.0, k=10.0)
    column = units.uniform_rods(F=26.0)  # newtons: q = 2.6
    start = zj.State(omega=(0, 2.0 * units.time))  # 2 rad/s
    motion = zj.trajectory(column, start, ts / units.time)
    motion = units.restore(motion)  # seconds, rad/s
    ```

    **Arguments:** `m` (kg), `l` (m), `k` (N m/rad), positive.

    **Raises:** `ValueError` where a concrete number breaks its rule.
    """

    m: Any
    l: Any  # noqa: E741 - the field's name for it
    k: Any

    def __init__(self, m: Any, l: Any, k: Any):  # noqa: E741
        """Keep the three numbers."""
        self.m = number("m", m, "positive")
        self.l = number("l", l, "positive")
        self.k = number("k", k, "positive")

    @property
    def time(self) -> Any:
        r"""The unit of time, $\sqrt{m l^2/k}$, in seconds."""
        return self.l * (self.m / self.k) ** 0.5

    @property
    def force(self) -> Any:
        """The unit of force, k/l, in newtons; q = F / force."""
        return self.k / self.l

    def uniform_rods(self, F: Any, **parts: Any) -> Column:  # noqa: N803
        """`uniform_rods` under the load F in newtons; `parts` as there."""
        return uniform_rods(q=F / self.force, **parts)

    def joint_friction(
        self,
        mu_s: Any,
        mu_k: Any,
        *,
        pin_radius: Any,
        transition_velocity: Any,
        v_smooth: Any = None,
        load: AbstractLoad | None = None,
    ) -> SmoothCoulomb:
        r"""The `SmoothCoulomb` of a multibody program's joint friction.

        Such a program (Adams: `FRICTION`) takes two coefficients, the pin's radius R
        and the stiction transition velocity v, a velocity *of the pin's surface*:
        joint rates are compared with v / R. It distinguishes static friction up to v,
        a passage from v to 1.5 v and dynamic friction beyond; its normal force is the
        joint's reaction. Here

        $$\rho = R/l, \qquad v_{stribeck} = \frac{1.25}{\sqrt{\ln 2}}\,\frac{v}{R}
        \sqrt{m l^2/k},$$

        so that half of the fall from mu_s to mu_k is done at 1.25 v, as there. Below v
        the program holds the joint by a small spring (its creep), which this law does
        not have: `v_smooth` stands for it and belongs to no datum of the program.

        **Arguments:**

        - `mu_s`, `mu_k`: `MU_STATIC`, `MU_DYNAMIC`.
        - `pin_radius`: `PIN_RADIUS`, in m. Its default in Adams is one unit of length,
            1 m or 1 mm by the model's units: torques a thousand times apart.
        - `transition_velocity`: `STICTION_TRANSITION_VELOCITY`, in m/s. Its default is
            0.1 units of length a second.
        - `v_smooth`: in $\sqrt{k/(m l^2)}$; None is a tenth of v_stribeck.
        - `load`: None is `JointReaction()`. A constant torque (`TORQUE_PRELOAD`) alone
            is `ConstantLoad`; axial and bending reactions are none in the plane.

        **Raises:** `ValueError` as `SmoothCoulomb`, and for a radius that is not
        positive.
        """
        rate = self.transition_rate(pin_radius, transition_velocity)
        v_stribeck = HALF_FALL / math.log(2.0) ** 0.5 * rate
        return SmoothCoulomb(
            mu_s,
            mu_k,
            pin_radius=pin_radius / self.l,
            v_stribeck=v_stribeck,
            v_smooth=v_stribeck / RATIO if v_smooth is None else v_smooth,
            load=JointReaction() if load is None else load,
        )

    def transition_rate(self, pin_radius: Any, transition_velocity: Any) -> Any:
        r"""The joint rate v / R at which static friction ends, in $\sqrt{k/(m l^2)}$.

        Which regimes a run enters: with this as `rate_cut`, `StickFraction` is the
        share of static friction; with 1.5 times this, all but dynamic friction.

        **Arguments:** the pin's radius in m, the velocity of its surface in m/s.
        """
        radius = number("pin_radius", pin_radius, "positive")
        velocity = number("transition_velocity", transition_velocity, "positive")
        return velocity / radius * self.time

    def restore(self, result: Any) -> Any:
        """The same result in SI units.

        **Arguments:** `result`: a `Trajectory`, or a dataset of `sweep`, whose
        variables and coordinates are converted by their `units`; angles and pure
        numbers, q among them, stay as they are.

        **Raises:** `ValueError` for anything else, and for a unit that is not known.
        """
        if isinstance(result, Trajectory):
            return self._motion(result)
        if isinstance(result, xr.Dataset):
            return self._dataset(result)
        raise ValueError(
            "Argument `result` must be a `Trajectory` or an `xarray.Dataset`, but is "
            f"{type(result).__name__}."
        )

    def _motion(self, motion: Trajectory) -> Trajectory:
        events = motion.events
        if events is not None:
            events = eqx.tree_at(lambda e: e.times, events, events.times * self.time)
        return Trajectory(
            ts=motion.ts * self.time,
            phi=motion.phi,
            omega=motion.omega / self.time,
            steps=motion.steps,
            outcome=motion.outcome,
            events=events,
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

        def restored(name: Any, values: xr.DataArray) -> xr.DataArray:
            unit = values.attrs.get("units", "1")
            if unit in ("1", "rad"):
                return values
            if unit not in units:
                raise ValueError(
                    f"Variable `{name}` of the dataset must be in one of "
                    f"{', '.join(units)}, rad or 1, but is in {unit}."
                )
            factor, name_si = units[unit]
            return (values * float(factor)).assign_attrs(
                {**values.attrs, "units": name_si}
            )

        # without the old coordinates, which each variable still carries
        data = {n: restored(n, v).variable for n, v in dataset.data_vars.items()}
        coords = {n: restored(n, v).variable for n, v in dataset.coords.items()}
        return xr.Dataset(data, coords, dataset.attrs)
