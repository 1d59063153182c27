r"""From SI units to the column's own, and results back in seconds and newton metres.

A column is known by its reference mass m (kg), the length l of rod 1 (m) and the spring
of joint 2, k (N m/rad). They make the unit of every result:

| quantity | unit |
|---|---|
| time | $\sqrt{m l^2/k}$ s |
| rate | $\sqrt{k/(m l^2)}$ rad/s |
| torque, energy | k N m |
| force, and the load q = F l/k | k/l N |
| joint damping | $\sqrt{k m l^2}$ N m s/rad |
| power | $k\sqrt{k/(m l^2)}$ W |

They scale the frictionless column and change nothing else. With friction they do more:
a pin radius in metres and a transition velocity in m/s become other dimensionless
numbers on another column.
"""

import math
from collections.abc import Callable
from typing import TypedDict, Unpack, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import xarray as xr

from ..model.column import Column, State
from ..model.damping import Viscous
from ..model.friction import SmoothCoulomb
from ..model.loads import AbstractLoad, ConstantLoad, JointReaction
from ..model.rods import Parts, point_masses, uniform_rods
from ..model.set_valued import SetValuedCoulomb
from ..motion.options import Windows
from ..motion.trajectory import Trajectory
from ..numerics.numbers import (
    Joints,
    OneOrTwo,
    Pair,
    Scalar,
    Two,
    both,
    is_concrete,
    number,
    number_or_pair,
    pair,
)
from ..results import AbstractResult
from .restored import Scales, restored_dataset, restored_motion

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


class PureWindows(TypedDict, total=False):
    """What of `Windows` is neither a time nor a rate."""

    max_windows: int | None
    agreement: Scalar | None
    escape: Scalar | None


class SI(eqx.Module):
    r"""A column's units.

    ```python
    units = zj.SI(m=0.1, l=0.2, k=0.5)
    friction = units.set_valued_coulomb(0.15, pin_radius=0.004)  # metres
    damping = units.viscous(1e-4, 1e-4)  # N m s/rad
    column = units.uniform_rods(F=6.5, friction=friction, damping=damping)  # newtons
    start = units.state(omega=(0.0, 2.0))  # rad/s
    motion = units.restore(zj.trajectory(column, start, ts / units.time))  # seconds
    windows = units.windows(transient=10.0)  # seconds
    end = units.restore(zj.settle(column, start, windows=windows))
    end.time  # seconds
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

    def set_valued_coulomb(
        self,
        mu_s: Joints,
        mu_k: Joints | None = None,
        *,
        pin_radius: Joints,
        load: AbstractLoad | None = None,
    ) -> SetValuedCoulomb:
        r"""`SetValuedCoulomb` on pins of a radius in m: $\rho = R/l$.

        **Arguments:** `load`: see `constant_load`; else as `SetValuedCoulomb`.

        **Raises:** `ValueError` as `SetValuedCoulomb`.
        """
        radius = self._lengths("pin_radius", pin_radius)
        return SetValuedCoulomb(mu_s, mu_k, pin_radius=radius, load=load)

    def smooth_coulomb(
        self,
        mu_s: Joints,
        mu_k: Joints | None = None,
        *,
        pin_radius: Joints,
        v_smooth: Scalar,
        v_stribeck: Joints | None = None,
        load: AbstractLoad | None = None,
    ) -> SmoothCoulomb:
        r"""`SmoothCoulomb` on pins of a radius in m, with joint rates in rad/s.

        **Arguments:** `load`: see `constant_load`; else as `SmoothCoulomb`.

        **Raises:** `ValueError` as `SmoothCoulomb`.
        """
        if v_stribeck is not None:
            fall = number_or_pair("v_stribeck", v_stribeck, "positive")
            v_stribeck = _each(lambda v: v * self.time, fall)
        return SmoothCoulomb(
            mu_s,
            mu_k,
            pin_radius=self._lengths("pin_radius", pin_radius),
            v_smooth=number("v_smooth", v_smooth, "positive") * self.time,
            v_stribeck=v_stribeck,
            load=load,
        )

    def constant_load(self, n: Joints) -> ConstantLoad:
        """`ConstantLoad` of the pins in N; one number, or one a joint."""
        normal = number_or_pair("n", n, "nonnegative")
        return ConstantLoad(_each(lambda x: x / self.force, normal))

    def viscous(self, c1: Scalar, c2: Scalar) -> Viscous:
        r"""`Viscous` joints, with coefficients in N m s/rad, of $\sqrt{k m l^2}$."""
        unit = self.k * self.time
        one, two = number("c1", c1, "nonnegative"), number("c2", c2, "nonnegative")
        return Viscous(one / unit, two / unit)

    def state(self, phi: Two = (0.0, 0.0), omega: Two = (0.0, 0.0)) -> State:
        """A `State` of angles in rad and rates in rad/s."""
        first, second = pair("omega", omega)
        return State(phi, (first * self.time, second * self.time))

    def windows(
        self,
        transient: Scalar | None = None,
        length: Scalar | None = None,
        rate_cut: Scalar | None = None,
        **others: Unpack[PureWindows],
    ) -> Windows:
        """`Windows` of times in s and a rate in rad/s.

        **Arguments:** as `Windows`; None is the question's own.

        **Raises:** `ValueError` as `Windows`.
        """
        rules = {"transient": "nonnegative", "length": "positive"}
        times = {"transient": transient, "length": length}
        for name, time in times.items():
            if time is not None:
                number(name, time, rules[name])
        scaled = {n: t if t is None else t / self.time for n, t in times.items()}
        cut = rate_cut if rate_cut is None else rate_cut * self.time
        return Windows(**scaled, rate_cut=cut, **others)

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

        - `v_smooth`: in rad/s; None is a tenth of v_stribeck, of the smaller one where
            joints differ.
        - `load`: see `constant_load`; None is `JointReaction()`. A constant torque
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
        else:
            v_smooth = v_smooth * self.time
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
        library (`settle`, `periodic_orbit`, ...) outside a sweep. Loads named
        `q` and `q_cr` become newtons; angles, other pure numbers (a `threshold` over q
        too) and axes in units of their own stay as they are.

        **Returns:** a `Trajectory`, else an `xarray.Dataset` with the names and units
        of a sweep; axes of `jax.vmap` are its dimensions `lane_1`, `lane_2`, ...

        **Raises:** `ValueError` for anything else, and for a unit that is not known.
        """
        scales = Scales(self.time, self.force, self.k, self.l)
        if isinstance(result, Trajectory):
            return restored_motion(result, scales)
        if isinstance(result, xr.Dataset):
            return restored_dataset(result, scales)
        if isinstance(result, AbstractResult):
            return restored_dataset(result.to_dataset(), scales)
        raise ValueError(
            "Argument `result` must be a `Trajectory`, an `xarray.Dataset` or a result "
            f"of the library with named numbers, but is {type(result).__name__}."
        )

    def _load(self, force: Scalar) -> Scalar:
        return number("F", force) / self.force

    def _lengths(self, name: str, given: Joints) -> OneOrTwo:
        """Metres in l."""
        known = number_or_pair(name, given, "nonnegative")
        return _each(lambda x: x / self.l, known)

    def _bodies(self, *, m1: Mass, m2: Mass, l2: Scalar | None) -> Bodies:
        """Masses in m, where None is the number beside it, and rod 2's length in l."""
        bodies = {
            name: usual if mass is None else number(name, mass, "positive") / self.m
            for name, (mass, usual) in {"m1": m1, "m2": m2}.items()
        }
        length = 1.0 if l2 is None else number("l2", l2, "positive") / self.l
        return cast(Bodies, {**bodies, "l2": length})


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
