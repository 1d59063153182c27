"""What a curve of bifurcations is: its points, where it is special, how it ends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
from jaxtyping import Array, Complex, Float, Int

from ..analysis.periodic_orbit import multipliers
from ..motion.observers import JOINT_AMPLITUDE, ROD_AMPLITUDE
from ..results import (
    CURVE_ENDS,
    MEETINGS,
    ORBITS,
    RATE,
    TIME,
    AbstractResult,
    Settings,
    Variable,
    quantity,
)

ALONG = ("point",)


class BifurcationPoints(AbstractResult):
    """Cycles along a curve, arrays with the points in front; NaN where there is none.

    `first`, `second` (n,): the parameters; `phi`, `omega` (n, 2): where they pass the
    section; `period`; `rod_amplitude`, `joint_amplitude` (n, 2); `monodromy` (n, 4, 4);
    `residual` (n,): of the equations the one missed most, NaN at special points;
    `modes` (n,): a number of the sequence of stick and slip, equal where that is;
    `meeting` (n,): `CODE`s; `outcome` (n,): `CODE`s.
    """

    first: Float[Array, "*lanes n"] = eqx.field(
        metadata=quantity("first parameter", dims=ALONG)
    )
    second: Float[Array, "*lanes n"] = eqx.field(
        metadata=quantity("second parameter", dims=ALONG)
    )
    phi: Float[Array, "*lanes n 2"] = eqx.field(
        metadata=quantity("angle on the section", "rad", (*ALONG, "rod"))
    )
    omega: Float[Array, "*lanes n 2"] = eqx.field(
        metadata=quantity("rate on the section", RATE, (*ALONG, "rod"))
    )
    period: Float[Array, "*lanes n"] = eqx.field(
        metadata=quantity("period of the orbit", TIME, ALONG)
    )
    rod_amplitude: Float[Array, "*lanes n 2"] = eqx.field(
        metadata={"quantity": ROD_AMPLITUDE._replace(dims=(*ALONG, "rod"))}
    )
    joint_amplitude: Float[Array, "*lanes n 2"] = eqx.field(
        metadata={"quantity": JOINT_AMPLITUDE._replace(dims=(*ALONG, "joint"))}
    )
    monodromy: Float[Array, "*lanes n 4 4"]
    residual: Float[Array, "*lanes n"] = eqx.field(
        metadata=quantity("by how much the equations are missed", dims=ALONG)
    )
    modes: Float[Array, "*lanes n"] = eqx.field(
        metadata=quantity("number of the sequence of stick and slip", dims=ALONG)
    )
    meeting: Int[Array, "*lanes n"] = eqx.field(
        metadata=quantity("what happens at the point", dims=ALONG, codes=MEETINGS)
    )
    outcome: Int[Array, "*lanes n"] = eqx.field(
        metadata=quantity("how its search ended", dims=ALONG, codes=ORBITS)
    )
    settings: Settings = eqx.field(static=True, default=())

    DERIVED: ClassVar[Mapping[str, Variable]] = {}

    @property
    def multipliers(self) -> Complex[Array, "*lanes n 4"]:
        """Floquet multipliers (n, 4), the trivial one first."""
        return multipliers(self.monodromy)


class BifurcationCurve(AbstractResult):
    """A curve of bifurcations in two parameters.

    `points`: `BifurcationPoints` in order along the curve, from the walk's end at
    falling second parameter to the other, or at the values asked for; `special`: those
    where something happens on the way, and the ends at bounds and where stick and slip
    change (curves that end there in one point meet there); `ends` (2,), `CODE`s;
    `knots` (2,): how many points the walk took in each direction; `outcome`: a `CODE`,
    of the bifurcation from which the curve begins; `steps` of all motions. In a dataset
    the points are named as in `BifurcationPoints`, the special ones `special_...`.
    """

    points: BifurcationPoints
    special: BifurcationPoints
    ends: Int[Array, "*lanes 2"] = eqx.field(
        metadata=quantity("how the curve ends", dims=("direction",), codes=CURVE_ENDS)
    )
    knots: Int[Array, "*lanes 2"] = eqx.field(
        metadata=quantity("points of the walk", dims=("direction",))
    )
    outcome: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("how the search for its beginning ended", codes=ORBITS)
    )
    steps: Int[Array, "*lanes"] = eqx.field(metadata=quantity("attempted steps"))
    settings: Settings = eqx.field(static=True)

    def variables(self) -> dict[str, Variable]:
        """All numbers with their names, units and dimensions."""
        named = self.points.variables()
        named.pop("meeting")  # nothing special
        named["point_outcome"] = named.pop("outcome")
        for name, variable in self.special.variables().items():
            dims = ("special_point", *variable.dims[1:])
            named[f"special_{name}"] = variable._replace(dims=dims)
        return named | super().variables()
