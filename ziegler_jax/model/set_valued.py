r"""Set-valued Coulomb friction: joints that truly stick, and when they break loose.

With the joint rates $u_1 = \omega_1$, $u_2 = \omega_2 - \omega_1$ each joint is in one
of three modes. It slips forwards or backwards (+1, -1) with the kinetic torque
$T_i = \pm\tau_{k,i}$ against its sliding, or it sticks (0): then $u_i = 0$ and $T_i$ is
the constraint torque $\lambda_i$ that keeps it so. With the mass matrix
[[a, h], [h, d]], $h = b \cos D$, and the right-hand sides $r_1, r_2$ of the equations
of motion without friction,

$$\lambda_1 = r_1 + T_2 - \frac{h}{d}(r_2 - T_2), \qquad
\lambda_2 = r_2 - \frac{h + d}{a + 2h + d}(r_1 + r_2 - T_1)$$

where the other slips, $\lambda_1 = r_1 + r_2$, $\lambda_2 = r_2$ where both stick. A
joint can stick as long as $|\lambda_i| \le \tau_{s,i}$.
"""

from __future__ import annotations

from typing import ClassVar

import jax

from ..numerics.numbers import Joints, Numbers, OneOrEach, Scalar, each, is_concrete
from ..numerics.rules import Invariants, checked
from .coulomb_torques import CoulombTorques
from .friction import (
    AbstractFriction,
    SmoothCoulomb,
    falls_to_kinetic,
)
from .loads import AbstractNormalLoad, normal_load


class SetValuedCoulomb(AbstractFriction):
    r"""Static and kinetic Coulomb friction with exact stick and slip.

    $$T_i = \tau_{k,i}\,\mathrm{sign}(u_i) \text{ where } u_i \ne 0, \qquad
    |T_i| \le \tau_{s,i} \text{ where } u_i = 0, \qquad \tau_i = \mu_i \rho_i N_i$$

    With $\mu_s = \mu_k$ the law determines every motion. With $\mu_s > \mu_k$, where
    one joint comes to rest or breaks loose while the other rests, more than one pair of
    modes can agree with it. Of all modes that agree, the motion takes those in which
    fewest joints slip (`stick_slip_modes`).

    **Arguments:**

    - `mu_s`, `mu_k`: static and kinetic coefficient, one number or one a joint,
        $\mu_s \ge \mu_k \ge 0$; `mu_k` left out is `mu_s`.
    - `pin_radius`: $\rho = R_{pin}/l$, one number or one a joint.
    - `load`: the normal load, `FollowerLoad()`, `ConstantLoad(n)`, `JointReaction()`,
        or a sum of these.

    **With `JointReaction()`** each pair of modes has its own loads, torques and
    thresholds. In fixed modes the accelerations, and so the reactions, are affine in
    the loads of the joints that slip, $N_i = |R_i^0 + P_{i1} N_1 + P_{i2} N_2|$,
    solved by Newton's method as in `JointReaction`, with its error; while both joints
    stick there is no such equation. New modes are chosen by the same rule,
    a joint's torque against the threshold of the modes in which that torque holds it.
    The loads have one solution where the right-hand side is a contraction, that is
    where the matrix of the lengths $|P_{ij}|$ has its eigenvalues below 1. Where it is
    none (Painleve's paradox of rigid bodies with friction) the accelerations are NaN
    and the motion ends as `not_finite` or `step_vanished`.

    **Raises:** `ValueError` for concrete numbers that break a rule; traced: `invalid`.
    """

    rules: ClassVar = {
        "mu_s": "nonnegative; each",
        "mu_k": "nonnegative; each or none",
        "pin_radius": "nonnegative; each",
    }
    units: ClassVar = {"mu_s": "1", "mu_k": "1", "pin_radius": "l"}
    sticks: ClassVar[bool] = True

    mu_s: OneOrEach
    mu_k: OneOrEach | None
    pin_radius: OneOrEach
    load: AbstractNormalLoad

    def __init__(
        self,
        mu_s: Joints,
        mu_k: Joints | None = None,
        *,
        pin_radius: Joints,
        load: AbstractNormalLoad | None = None,
    ):
        """Check and keep the law's numbers."""
        self.mu_s, self.mu_k, self.pin_radius = checked(
            self.rules, mu_s=mu_s, mu_k=mu_k, pin_radius=pin_radius
        )
        self.load = normal_load(load)
        self.refuse_broken()

    def torques(self, pulls: Numbers) -> CoulombTorques:
        """The most that holds each joint, at rest and in slip."""
        (normal, load), n = self.load.split(pulls), len(pulls)
        lever = [x * r for x, r in zip(normal, each(self.pin_radius, n), strict=True)]
        static, kinetic = (
            tuple(x * mu for x, mu in zip(lever, each(mu, n), strict=True))
            for mu in (self.mu_s, self.mu_s if self.mu_k is None else self.mu_k)
        )
        return CoulombTorques(static=static, kinetic=kinetic, load=load)

    def invariants(self) -> Invariants:
        """That mu_k <= mu_s."""
        return falls_to_kinetic(self.mu_s, self.mu_k)

    def smoothed(
        self, v_smooth: Scalar, v_stribeck: Joints | None = None
    ) -> SmoothCoulomb:
        """The smoothed law with the same coefficients, pin radius and load."""
        mu_k = self.mu_k
        known = all(map(is_concrete, jax.tree.leaves((mu_k, self.mu_s))))
        if mu_k is not None and v_stribeck is None and known:
            mu_k = None if mu_k == self.mu_s else mu_k
        return SmoothCoulomb(
            self.mu_s,
            mu_k,
            pin_radius=self.pin_radius,
            v_smooth=v_smooth,
            v_stribeck=v_stribeck,
            load=self.load,
        )

    def load_law(self) -> AbstractNormalLoad:
        """The normal load."""
        return self.load

    def rate_cut(self) -> Scalar | None:
        """None: a joint sticks or it does not."""
        return None
