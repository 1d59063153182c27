r"""Branches of cycles: pseudo-arclength continuation, and the points where they change.

With a parameter $\lambda$ as one more unknown, $x = (z, \lambda)$, a branch is a curve
$R(x) = 0$. From a point with unit tangent t the next is sought at a distance s,

$$R(x) = 0, \qquad t \cdot (x - x_0 - s t) = 0,$$

which is regular at folds, where the branch turns back in $\lambda$. On the way test
functions of the multipliers $\mu_i$ other than 1, three of two rods, change sign:

$$t_\lambda \text{ (fold)}, \qquad \prod_{i<j} (\mu_i \mu_j - 1) \text{ (torus)}, \qquad
\prod_i (1 + \mu_i) \text{ (flip)}, \qquad \prod_i (1 - \mu_i) \text{ (pitchfork)}$$

and the zero is found along the arc. A pitchfork's, where another branch crosses and
Newton's method is singular, may be that of the step's chord; but where the column and
the cycle are their own mirror images, $y(T/2) = -y_0$, that is solved in place of R. Of
this half map the multipliers are $\nu_i$, $\mu_i = \nu_i^2$, a fold has the
multiplier 1, too, and a pitchfork, $\prod_i (1 + \nu_i) = 0$, is a regular point.
Lengths on the arc: rad for the state, the first cycle's period for T, the first value
for $\lambda$.

Source: H. B. Keller (1977); Y. A. Kuznetsov, Elements of Applied Bifurcation Theory
(2004), chapter 10.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float, Int, Shaped

from ..model.chain_of_rods import AbstractChain
from ..model.column import State
from ..motion.implicit import fixed, lost
from ..motion.observers import JOINT_AMPLITUDE, ROD_AMPLITUDE
from ..motion.options import Method, recorded
from ..motion.section import Coordinate, SectionPlane
from ..numerics.numbers import Option, Scalar, is_concrete
from ..numerics.rules import whole_number
from ..results import (
    CODE,
    ORBITS,
    RATE,
    SPECIALS,
    TIME,
    AbstractResult,
    Settings,
    Variable,
    quantity,
)
from ..runtime import requires_x64
from .branch_point import TESTS, Arc, BranchPoint, Continuation, codes_of
from .march import ContinuationState, Walk
from .periodic_orbit import PeriodicOrbit, attracts, multipliers
from .shooting import of_each, start_of

ALONG = ("point",)


class CyclePoints(AbstractResult):
    """Cycles along a branch, arrays with the points in front; NaN where there is none.

    `parameter` (n,); `phi`, `omega` (n, r) of r rods: where they pass the section;
    `period`; `rod_amplitude`, `joint_amplitude` (n, r); `monodromy` (n, 2r, 2r); `kind`
    (n,): what happens there, `CODE`s.
    """

    parameter: Float[Array, "*lanes n"] = eqx.field(
        metadata=quantity("parameter", dims=ALONG)
    )
    phi: Float[Array, "*lanes n r"] = eqx.field(
        metadata=quantity("angle on the section", "rad", (*ALONG, "rod"))
    )
    omega: Float[Array, "*lanes n r"] = eqx.field(
        metadata=quantity("rate on the section", RATE, (*ALONG, "rod"))
    )
    period: Float[Array, "*lanes n"] = eqx.field(
        metadata=quantity("period of the orbit", TIME, ALONG)
    )
    rod_amplitude: Float[Array, "*lanes n r"] = eqx.field(
        metadata={"quantity": ROD_AMPLITUDE._replace(dims=(*ALONG, "rod"))}
    )
    joint_amplitude: Float[Array, "*lanes n r"] = eqx.field(
        metadata={"quantity": JOINT_AMPLITUDE._replace(dims=(*ALONG, "joint"))}
    )
    monodromy: Float[Array, "*lanes n s s"]
    kind: Int[Array, "*lanes n"] = eqx.field(
        metadata=quantity("what happens at the point", dims=ALONG, codes=SPECIALS)
    )
    settings: Settings = eqx.field(static=True, default=())
    # of the section, whose level is in each state
    coordinate: Coordinate = eqx.field(static=True, default="phi1")
    rising: bool = eqx.field(static=True, default=True)

    DERIVED: ClassVar[Mapping[str, Variable]] = {
        "largest_multiplier": Variable(
            None, "largest modulus of a Floquet multiplier but the trivial one",
            dims=ALONG,
        ),
        "stable": Variable(None, "whether the orbit attracts", dims=ALONG),
    }  # fmt: skip

    @property
    def multipliers(self) -> Complex[Array, "*lanes n s"]:
        """Floquet multipliers (n, 2r), the trivial one first."""
        return multipliers(self.monodromy)

    @property
    def largest_multiplier(self) -> Float[Array, "*lanes n"]:
        """The largest modulus of the others, (n,)."""
        return jnp.abs(self.multipliers)[..., 1]

    @property
    def stable(self) -> Bool[Array, "*lanes n"]:
        """Whether the others lie inside the unit circle, (n,)."""
        return attracts(self.monodromy)


def first_of(
    points: CyclePoints, kind: str
) -> tuple[PeriodicOrbit, Float[Array, ""], Bool[Array, ""]]:
    """The cycle at the first point of this kind, its parameter, whether there is one.

    How well it closes is not known; derivatives are left out.

    **Raises:** `ValueError` for points of more than one branch.
    """
    if jnp.ndim(points.period) != 1:
        raise ValueError(
            "Argument `start` must be the points of one branch, but holds branches of "
            f"shape {jnp.shape(points.period)[:-1]}: take one, or `jax.vmap` over them."
        )
    mine = jnp.asarray(points.kind) == CODE[kind]
    first = jnp.argmax(mine)
    point = fixed(jax.tree.map(lambda x: jnp.asarray(x)[first], points))
    phi, omega = tuple(point.phi), tuple(point.omega)
    place = SectionPlane(points.coordinate).place(len(phi))
    level = (*phi, *omega)[place]
    none = jnp.zeros((), jnp.int32)
    outcome = jnp.where(jnp.any(mine), CODE.found, CODE.beyond)
    orbit = PeriodicOrbit(
        state=State(phi, omega),
        section=SectionPlane(points.coordinate, level, points.rising),
        period=point.period,
        rod_amplitude=point.rod_amplitude,
        joint_amplitude=point.joint_amplitude,
        monodromy=point.monodromy,
        residual=jnp.full((), jnp.nan),
        iterations=none,
        steps=none,
        outcome=outcome.astype(jnp.int8),
        settings=points.settings,
    )
    return orbit, point.parameter, jnp.any(mine)


class Branch(AbstractResult):
    """A branch of cycles.

    `points`: `CyclePoints` in order along the arc; `count` of them; `special`: the
    `CyclePoints` where the branch changes; `outcome`: a `CODE`, `found` if all
    points asked for are there, else why the branch ends; `ends` (1,), or (2,) where it
    was followed both ways: the same of each end, first where it set out downwards;
    `symmetric`: whether each cycle is its own mirror image, half a period later;
    `steps` of all motions. In a dataset the points are named as in `CyclePoints`, the
    special ones `special_...`.
    """

    points: CyclePoints
    special: CyclePoints
    count: Int[Array, "*lanes"] = eqx.field(metadata=quantity("points of the branch"))
    outcome: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("why the branch ended", codes=ORBITS)
    )
    ends: Int[Array, "*lanes w"] = eqx.field(
        metadata=quantity("how the branch ends", dims=("end",), codes=ORBITS)
    )
    symmetric: Bool[Array, "*lanes"] = eqx.field(
        metadata=quantity("whether the cycles are their own mirror images")
    )
    steps: Int[Array, "*lanes"] = eqx.field(metadata=quantity("attempted steps"))
    settings: Settings = eqx.field(static=True)

    def variables(self) -> dict[str, Variable]:
        """All numbers with their names, units and dimensions."""
        named = self.points.variables()
        named.pop("kind")  # nothing special
        for name, variable in self.special.variables().items():
            dims = ("special_point", *variable.dims[1:])
            named[f"special_{name}"] = variable._replace(dims=dims)
        return named | super().variables()


@requires_x64
def continue_cycle(
    make_column: Callable[[Scalar], AbstractChain],
    orbit: PeriodicOrbit,
    parameter: Scalar,
    *,
    arc: Arc = Arc(),
    max_special_points: int = 4,
    method: Method = Method(),
) -> Branch:
    r"""Follow a cycle as a parameter moves, through folds, stable or not.

    ```python
    orbit = zj.periodic_orbit(make_column(2.0), settled.final)
    branch = zj.continue_cycle(make_column, orbit, 2.0, arc=zj.Arc(direction=-1))
    ```

    **Arguments:**

    - `make_column`: a function of the parameter, e.g. `lambda q: uniform_rods(q, ...)`;
        it gives columns or chains, all of as many rods as the orbit.
    - `orbit`: a cycle at this value of the `parameter`, as `periodic_orbit` finds it;
        where it found none, the branch ends for the same reason.
    - `arc`: how to follow it, see `Arc`; `zj.Arc("both")`: both ways from the cycle,
        and the points stand from one end of the branch to the other.
    - `max_special_points`: how many there is room for, in each direction.
    - `method`: an explicit one; its step budget is that of all motions of the branch
        together in one direction, which ends as `not_integrated` where it is spent.

    **Returns:** `Branch`. Cycles that are their own mirror images, of a column that is,
    are followed over half their period. With set-valued friction it may end as
    `not_converged` before its cycle ends: begin once more beyond, at a cycle that
    `settle` finds there.

    **Derivatives:** NaN: where its points lie on the arc is a matter of the steps. Of a
    cycle take those of `periodic_orbit`, of a special point those of `bifurcation` or
    `bifurcation_curve`, which may begin at a branch.

    **Raises:** `ValueError` for arguments that break a rule.
    """
    specials = whole_number("max_special_points", max_special_points)
    problem = Continuation("continue_cycle", make_column, orbit, parameter, arc, method)

    def walk(direction: Scalar) -> ContinuationState:
        return Walk(problem.heading(direction), specials, (True,) * 4, False).follow()

    scene = problem.live, orbit, parameter, arc
    if problem.arc.direction == "both":
        ways = fixed(jax.vmap(walk)(jnp.array([-1.0, 1.0], problem.first.dtype)))
    else:
        ways = jax.tree.map(lambda a: a[None], fixed(walk(problem.direction)))
    way = along_arc(ways)
    ordinary = jnp.zeros(way.points.modes.shape, jnp.int32)
    ends = ways.outcome.astype(jnp.int8)
    return Branch(
        points=lost(cycle_points(problem, way.points, ordinary), scene),
        special=lost(cycle_points(problem, way.special, way.kind), scene),
        count=jnp.maximum(jnp.sum(ways.filled) - ends.size + 1, 0).astype(jnp.int32),
        outcome=jnp.where(ends[0] == CODE.found, ends[-1], ends[0]),
        ends=ends,
        symmetric=problem.symmetric,
        steps=problem.spent + jnp.sum(problem.left - ways.left, dtype=jnp.int32),
        settings=settings_of(problem),
    )


class InOrder(NamedTuple):
    """Points in their order along the arc, those that are none in the end."""

    points: BranchPoint
    special: BranchPoint
    kind: Int[Array, " room"]


def along_arc(ways: ContinuationState) -> InOrder:
    """One way as it is, or two from the same point as one, the first one backwards."""
    if ways.filled.size == 1:
        ends = ways.points, ways.special, ways.kind
        return InOrder(*jax.tree.map(lambda a: a[0], ends))
    behind, most = ways.filled[0], ways.points.modes.shape[1]
    place = jnp.arange(2 * most - 1, dtype=behind.dtype)

    def points(both: Float[Array, "2 n *dims"]) -> Float[Array, " m *dims"]:
        back = both[0].at[behind - 1 - place].get(mode="fill", fill_value=jnp.nan)
        # the point at which both begin stands once
        on = both[1].at[place - behind + 1].get(mode="fill", fill_value=jnp.nan)
        here = (place < behind).reshape(-1, *[1] * (both.ndim - 2))
        return jnp.where(here, back, on)

    kinds = jnp.concatenate([ways.kind[0, ::-1], ways.kind[1]])
    order = jnp.argsort(kinds == 0, stable=True)

    def special(both: Shaped[Array, "2 n *dims"]) -> Shaped[Array, " m *dims"]:
        return jnp.concatenate([both[0, ::-1], both[1]])[order]

    return InOrder(
        jax.tree.map(points, ways.points),
        jax.tree.map(special, ways.special),
        kinds[order],
    )


def settings_of(problem: Continuation, **more: Option) -> Settings:
    """How a branch was followed, for the record."""
    arc = problem.arc
    bounds = " to ".join(f"{x:g}" if is_concrete(x) else "?" for x in arc.bounds)
    return recorded(
        **problem.method.settings(),
        direction=arc.direction,
        step=arc.step,
        points=arc.points,
        error=arc.error,
        bounds=bounds,
        **problem.section.settings(),
        **more,
    )


def cycle_points(
    problem: Continuation, cycles: BranchPoint, kind: Int[Array, " n"]
) -> CyclePoints:
    """The points of a branch in their own units."""
    x = cycles.x * problem.scale[None]
    y, n = start_of(problem.section, x[:, :-1]), problem.rods
    rods, joints = of_each(cycles.extent)
    return CyclePoints(
        parameter=x[:, -1],
        phi=y[:, :n],
        omega=y[:, n:],
        period=problem.turns * x[:, -2],
        rod_amplitude=rods,
        joint_amplitude=joints,
        monodromy=problem.whole(cycles.moved),
        kind=codes_of(kind, TESTS),
        settings=settings_of(problem),
        coordinate=problem.section.coordinate,
        rising=problem.section.rising,
    )
