"""Where a curve begins: a bifurcation on a branch of cycles, or a point of one."""

from collections.abc import Callable
from typing import Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..analysis.branch_off import MIRRORED
from ..analysis.branch_point import TESTS, Arc, Continuation, codes_of
from ..analysis.continuation import CyclePoints, first_of
from ..analysis.march import Walk
from ..analysis.periodic_orbit import PeriodicOrbit, check_orbit
from ..analysis.shooting import start_of
from ..model.column import Column
from ..motion.implicit import fixed
from ..motion.options import Method
from ..motion.section import SectionPlane
from ..numerics.numbers import Scalar
from ..results import CODE
from ..steady.jets import Bundle, Jet, follow_bundle
from ..steady.oddness import is_odd
from .contact import Dip, Landing
from .degeneracy import (
    AbstractDegeneracy,
    Flip,
    Fold,
    ModesChange,
    Torus,
    closing_of,
)
from .problem import Cycle

Kind = Literal[
    "fold",
    "torus",
    "flip",
    "pitchfork",
    "sticking_1",
    "sticking_2",
    "grazing_1",
    "grazing_2",
]
KINDS = get_args(Kind)
DEGENERACIES = {"fold": Fold, "torus": Torus, "flip": Flip, "pitchfork": Flip}
WATCHED = {"sticking": Landing, "grazing": Dip}


class Beginning(NamedTuple):
    """A cycle near a bifurcation: what is known of it before it is corrected."""

    section: SectionPlane
    z: Float[Array, "4"]
    first: Float[Array, ""]
    monodromy: Float[Array, "4 4"]
    failure: Int[Array, ""]  # a `CODE`, 0 for none
    steps: Int[Array, ""]


def met_on_branch(
    kind: Kind,
    make_column: Callable[[Scalar], Column],
    orbit: PeriodicOrbit,
    first: Scalar,
    arc: Arc,
    method: Method,
) -> Beginning:
    """The first bifurcation of this kind on the orbit's branch."""
    arc = Arc(arc.direction or -1, arc.step, arc.points or 200, arc.bounds, arc.error)
    branch = Continuation("bifurcation", make_column, orbit, first, arc, method)
    kinds = [code is CODE[kind] for code in TESTS]
    end = fixed(Walk(branch, 1, kinds, True).follow())
    x = end.special.x[0] * branch.scale
    there = codes_of(end.kind[0], TESTS) == CODE[kind]
    failure = jnp.where(there, 0, end.outcome).astype(jnp.int32)
    steps = branch.method.budget - end.left
    z, moved = x[:4].at[3].multiply(branch.turns), branch.whole(end.special.moved[0])
    return Beginning(branch.section, z, x[4], moved, failure, steps)


def of_orbit(orbit: PeriodicOrbit, first: Float[Array, ""]) -> Beginning:
    """The cycle itself."""
    orbit = fixed(orbit)
    z = [*(orbit.state.y[i] for i in orbit.section.others), orbit.period]
    failure = jnp.where(orbit.outcome == CODE.found, 0, orbit.outcome)
    none = jnp.zeros((), jnp.int32)
    z = jnp.stack([jnp.asarray(x, first.dtype) for x in z])
    failure = failure.astype(jnp.int32)
    return Beginning(orbit.section, z, first, orbit.monodromy, failure, none)


def of_points(kind: Kind, points: CyclePoints) -> Beginning:
    """The first of the points that is of this kind.

    **Raises:** `ValueError` for points of more than two rods.
    """
    orbit, parameter, _ = first_of(points, kind)
    check_orbit("start", orbit, 2)
    return of_orbit(orbit, parameter)


def cycle_of(
    kind: Kind,
    make: Callable[[Scalar, Scalar], Column],
    begin: Beginning,
    second: Float[Array, ""],
    method: Method,
) -> tuple[Cycle, Float[Array, "4 7"], Int[Array, ""]]:
    """The cycle with its span, half a period where it is symmetric.

    **Returns:** the cycle, the derivative of its closing equations in (y0, T, p), and
    the steps of its shots.
    """
    column = make(begin.first, second)
    y0 = start_of(begin.section, begin.z)
    parameters = jnp.stack([begin.first, second])
    if (
        kind == "flip"
    ):  # of the whole map: a symmetric cycle's own symmetry breaks first
        closing = jnp.zeros((4, 7), y0.dtype)
        closing = closing.at[:, :4].set(begin.monodromy - jnp.eye(4, dtype=y0.dtype))
        whole = jnp.ones((), y0.dtype)
        cycle = Cycle(begin.section, begin.z, whole, parameters, begin.failure)
        return cycle, closing, jnp.zeros((), jnp.int32)

    def make_of(p: Float[Array, "2"]) -> Column:
        return make(p[0], p[1])

    def shot(span: Float[Array, ""], sign: Float[Array, ""]) -> Jet:
        a = jnp.concatenate([y0, span[None], parameters])
        none = jnp.zeros((0, 7), y0.dtype)
        return follow_bundle(Bundle(make_of, a, none, method), sign)

    spans = begin.z[3] * jnp.array([0.5, 1.0], y0.dtype)
    signs = jnp.array([-1.0, 1.0], y0.dtype)
    both = jax.vmap(shot)(spans, signs)
    half, whole = (jax.tree.map(lambda a, i=i: a[i], both) for i in (0, 1))
    off = jnp.max(jnp.abs(half.y - y0))
    symmetric = is_odd(column.system()) & half.arrived
    symmetric &= off < MIRRORED * jnp.maximum(1.0, jnp.max(jnp.abs(y0)))
    failure = begin.failure
    if kind == "pitchfork":
        failure = jnp.where(symmetric | (failure > 0), failure, CODE.beyond)
    jet = jax.tree.map(lambda a, b: jnp.where(symmetric, a, b), half, whole)
    sign = jnp.where(symmetric, -1.0, 1.0).astype(y0.dtype)
    span = jnp.where(symmetric, spans[0], spans[1])
    z = begin.z.at[3].set(span)
    failure = jnp.where(jet.arrived | (failure > 0), failure, CODE.not_integrated)
    cycle = Cycle(begin.section, z, sign, parameters, failure)
    return cycle, closing_of(jet), jet.steps


def degeneracy_of(kind: Kind) -> AbstractDegeneracy:
    """Its equations."""
    if kind in DEGENERACIES:
        return DEGENERACIES[kind]()
    what, joint = kind.split("_")
    return ModesChange(contact=WATCHED[what](int(joint)))
