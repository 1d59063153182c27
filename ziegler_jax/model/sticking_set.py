r"""The sticking set: angles at which friction holds the column.

With set-valued friction the equilibrium is not a point. Both joints stick at rest
wherever the torques that hold them fit,

$$|\lambda_2| = |D + q\,l_2 \sin((1 - \eta)\phi_2)| \le \tau_{s,2}, \qquad
|\lambda_1| = |q \sin(\phi_1 - \eta\phi_2) - \kappa\phi_1
+ q\,l_2\sin((1 - \eta)\phi_2)| \le \tau_{s,1}.$$

For a load along rod 2 ($\eta = 1$) that is a parallelogram with two curved sides,
$|D| \le \tau_{s,2}$, $|\kappa\phi_1 - q \sin D| \le \tau_{s,1}$, of the area
$4\tau_{s,1}\tau_{s,2}/\kappa$ at every q.
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..numerics.numbers import Pair, Scalar
from ..runtime import requires_x64
from .chain import holding_torques
from .column import Column, check_autonomous, refuse_si
from .state import PhasePoint

Angle = Float[Array, "..."] | float  # many at once, or one


class StickingSet(eqx.Module):
    """The states of rest in which both joints of a column stick."""

    column: Column

    @property
    def static(self) -> Pair:
        """The static torques of both joints."""
        law, normal = self.column.system().coulomb, (1.0, 1.0)
        friction = self.column.friction
        if friction is not None and friction.on_reactions:
            load = friction.load_law()
            assert load is not None
            normal = load.at_rest((self.column.q, self.column.q))
        one, two = (s * n for s, n in zip(law.static, normal, strict=True))
        return one, two

    def torques(self, phi1: Angle, phi2: Angle) -> Pair:
        """The torques that hold both joints at these angles."""
        zero = jnp.zeros_like(jnp.asarray(phi1, jnp.result_type(float)))
        balance = self.column.system().balance(PhasePoint((phi1, phi2, zero, zero)))
        one, two = holding_torques(balance.mass, balance.right, (zero, zero))
        return one, two

    def contains(self, phi1: Angle, phi2: Angle) -> Bool[Array, "..."]:
        """Whether the column rests at these angles; arrays of one shape."""
        torques = self.torques(phi1, phi2)
        one, two = (
            jnp.abs(torque) <= most
            for torque, most in zip(torques, self.static, strict=True)
        )
        return one & two

    @property
    def corners(self) -> Float[Array, "4 2"]:
        r"""The four corners, (4, 2): $\phi_1, \phi_2$ in turn round the set.

        **Raises:** `ValueError` unless the load follows ($\eta = 1$), and acts alone.
        """
        self._needs_following("corners")
        t1, t2 = self.static
        rows = []
        for s1, s2 in ((1, 1), (1, -1), (-1, -1), (-1, 1)):
            phi1 = (self.column.q * jnp.sin(s2 * t2) + s1 * t1) / self.column.kappa
            rows.append(jnp.stack([phi1, phi1 - s2 * t2]))
        return jnp.stack(rows)

    @property
    def area(self) -> Scalar:
        r"""$4\tau_{s,1}\tau_{s,2}/\kappa$, in rad^2, for a following load."""
        self._needs_following("area")
        t1, t2 = self.static
        return 4 * t1 * t2 / self.column.kappa

    def _needs_following(self, what: str) -> None:
        if not self.column.follower_only:
            raise ValueError(
                f"`{what}` of a sticking set must be asked of a column on which its "
                "load alone acts, but that has rest angles, other forces or a "
                "foundation; `contains` holds for any."
            )
        if not self.column.tangential:
            raise ValueError(
                f"`{what}` of a sticking set must be asked of a load that follows, "
                f"`follower` = 1, but that is {self.column.follower!r}; `contains` "
                "holds for any."
            )


@requires_x64
def sticking_set(column: Column) -> StickingSet:
    """The set of angles at which the column rests, held by friction alone.

    **Arguments:** `column`, with `SetValuedCoulomb` friction.

    **Returns:** `StickingSet`: `contains(phi1, phi2)`, `torques(phi1, phi2)`,
    `corners`, `area`.

    **Raises:** `ValueError` for another friction law.
    """
    check_sticks(column)
    return StickingSet(column)


def check_sticks(column: Column) -> None:
    """Refuse what is no column with set-valued friction."""
    if not isinstance(column, Column) or not column.sticks:
        raise ValueError(
            "Argument `column` must be a `Column` with `SetValuedCoulomb` friction, "
            f"but is {column!r}."
        )
    check_autonomous("sticking_set", column)
    refuse_si(column)
