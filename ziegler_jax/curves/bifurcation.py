r"""One bifurcation of cycles, as a value of a parameter, with its derivatives.

A cycle is followed as the parameter $\lambda$ moves (`analysis/continuation.py`) to the
first fold, flip, torus or pitchfork on its way. There the equations F = 0 of
`degeneracy` hold: the cycle's own, R = 0, and those of its null vectors, in the cycle
z, $\lambda$ and these vectors, together u; in all numbers p of the column

$$F_u\,du = -F_p\,dp.$$

What F has of second derivatives, along the null vectors, are central differences (see
`steady/jets.py`), good to some four digits. Of a fold, $d\lambda$ has none: with the
row w that annuls $R_z$, $d\lambda = -w \cdot R_p\,dp / (w \cdot R_\lambda)$.

A cycle that is its own mirror image is followed over half its period: at a pitchfork
the return to the mirror image flips, and Newton's method is regular.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import ClassVar, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..analysis.branch_point import TESTS, Arc, BranchPoint, Continuation, codes_of
from ..analysis.continuation import CyclePoints, cycle_points, settings_of
from ..analysis.march import Walk
from ..analysis.periodic_orbit import PeriodicOrbit
from ..analysis.shooting import start_of
from ..model.chain_of_rods import AbstractChain
from ..motion.implicit import fixed, implicit, moving, solve
from ..motion.options import Method
from ..numerics.numbers import Scalar
from ..numerics.rules import choice
from ..results import (
    CODE,
    ORBITS,
    TIME,
    AbstractResult,
    Settings,
    Variable,
    quantity,
)
from ..runtime import requires_x64
from ..steady.jets import Bundle, carried_extent, carried_monodromy, follow_bundle
from .degeneracy import AbstractDegeneracy, Fold, closing_of
from .start import DEGENERACIES

OfCycles = Literal["fold", "flip", "torus", "pitchfork"]


class Bifurcation(AbstractResult):
    """Where a cycle bifurcates, as a value of the parameter.

    `parameter`; `cycle`: `CyclePoints` of one, there; `outcome`: a `CODE`, unless that
    is `found`, parameter and cycle are NaN; `steps` of all motions.
    """

    parameter: Float[Array, "*lanes"] = eqx.field(
        metadata=quantity("parameter at the bifurcation")
    )
    cycle: CyclePoints
    steps: Int[Array, "*lanes"] = eqx.field(metadata=quantity("attempted steps"))
    outcome: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("how the search for the bifurcation ended", codes=ORBITS)
    )
    settings: Settings = eqx.field(static=True)

    DERIVED: ClassVar[Mapping[str, Variable]] = {
        "period": Variable(None, "period at the bifurcation", TIME)
    }

    @property
    def period(self) -> Float[Array, "*lanes"]:
        """The period there."""
        return self.cycle.period[0]


@requires_x64
def bifurcation(
    make_column: Callable[[Scalar], AbstractChain],
    kind: OfCycles,
    orbit: PeriodicOrbit,
    parameter: Scalar,
    *,
    arc: Arc = Arc(),
    method: Method = Method(),
) -> Bifurcation:
    r"""The value of a parameter at which a cycle folds, flips, or bifurcates otherwise.

    ```python
    def fold_of(mu):  # its derivative: jax.grad(fold_of)
        def make_column(q):
            law = zj.SmoothCoulomb(mu, pin_radius=0.1, v_smooth=0.1)
            return zj.uniform_rods(q, friction=law, damping=zj.Viscous(0.02, 0.02))

        settled = zj.settle(make_column(2.8), zj.State(omega=(0.0, 0.6)))
        orbit = zj.periodic_orbit(make_column(2.8), settled.final)
        return zj.bifurcation(make_column, "fold", orbit, 2.8).parameter
    ```

    It is the first of its kind on the way along the branch on which `orbit` lies. The
    branch may fold again, and others may have folds at lower loads, where the column
    then still flutters after some kick: with set-valued friction at tau = 0.1 one
    branch folds at q = 1.57105, 1.71105 and 1.61206, and the orbit decides which is
    found. The lowest of a branch is the least `special.parameter` of `continue_cycle`.

    **Arguments:** as `continue_cycle`, and

    - `kind`: `"fold"`, where two cycles meet; `"flip"`, where a multiplier is -1 and
        the period doubles; `"torus"`, where a complex pair passes the unit circle;
        `"pitchfork"`, where a cycle that is its own mirror image loses that symmetry.
        Other cycles end as `not_converged` there.

    **Returns:** `Bifurcation`.

    **Derivatives:** of `parameter` and `cycle`, forward and reverse, first order, in
    every number that `make_column` was made from. Those of a fold's parameter are as
    good as the motions; all others have second derivatives in them, central
    differences, good to some four digits. On the orbit and the `parameter` where the
    way begins they do not depend.

    **Raises:** `ValueError` for arguments that break a rule.

    Source: G. Moore, A. Spence, SIAM J. Numer. Anal. 17 (1980) 567-576.
    """
    choice("kind", kind, get_args(OfCycles))
    sought, scene = CODE[kind], (make_column, orbit, parameter)
    problem = Continuation("bifurcation", *scene, arc, method)
    if sought is CODE.pitchfork:  # other cycles have no symmetry to lose
        lost = (problem.failure == 0) & ~problem.symmetric
        problem.failure = jnp.where(lost, CODE.not_converged, problem.failure)
    walk = Walk(problem, 1, [code is sought for code in TESTS], True)
    end = fixed(walk.follow())
    there = end.special
    is_there = codes_of(end.kind[0], TESTS) == sought
    moves = _moves(problem, DEGENERACIES[kind](), make_column, there)
    x = there.x.at[0].add(moves / problem.scale)
    z = x[0] * problem.scale
    y0, column = start_of(problem.section, z[:-1]), make_column(z[-1])
    extent = carried_extent(column, y0, z[-2], problem.method)
    bends = carried_monodromy(column, y0, z[-2], problem.method)
    there = there._replace(
        x=x,
        extent=there.extent.at[0].add(extent),
        moved=there.moved.at[0].add(problem.sign * bends),
    )
    ordinary = jnp.zeros_like(end.kind)
    cycle = cycle_points(problem, there, ordinary)
    code = jnp.where(is_there, CODE[kind], CODE.ordinary).astype(cycle.kind.dtype)
    return Bifurcation(
        parameter=z[-1] * jnp.where(is_there, 1.0, jnp.nan),
        cycle=eqx.tree_at(lambda c: c.kind, cycle, code[None]),
        steps=problem.method.budget - end.left,
        outcome=jnp.where(is_there, CODE.found, end.outcome).astype(jnp.int8),
        settings=settings_of(problem, kind=kind),
    )


def _moves(
    problem: Continuation,
    degeneracy: AbstractDegeneracy,
    make_column: Callable[[Scalar], AbstractChain],
    there: BranchPoint,
) -> Float[Array, " m"]:
    """Zeros that carry the derivatives of the first point's cycle and its parameter."""
    z, scale, s = there.x[0] * problem.scale, problem.scale, 2 * problem.rods
    dtype, places = z.dtype, jnp.array([*problem.section.free(problem.rods), s])
    # R in (y0, T), and how these move with z
    closing = there.moved[0] - jnp.eye(s, dtype=dtype)
    closing = jnp.concatenate([closing, there.matrix[0][:, s - 1 : s]], axis=1)
    of_z = jnp.zeros((s + 1, s), dtype).at[places, jnp.arange(s)].set(scale[:s])
    extra = degeneracy.begin(closing, of_z)
    p, make = moving(make_column(fixed(z[s])), dtype)
    if not p.size:
        return jnp.zeros(s + 1, dtype)

    def leaves(x):
        return moving(problem.make(x), dtype)[0]

    line = jax.jvp(leaves, (z[s],), (jnp.ones_like(z[s]),))[1]
    # how (y0, T, p) move with z, the parameter and p
    n = s + 1  # y0 and T, or z and the parameter
    basis = jnp.zeros((n + p.size, n + p.size), dtype)
    basis = basis.at[:n, :s].set(of_z).at[n:, s].set(line * scale[s])
    basis = basis.at[n:, n:].set(jnp.eye(p.size, dtype=dtype))

    def slope(
        p: Float[Array, " p"],
        y0: Float[Array, " s"],
        span: Float[Array, ""],
        extra: Float[Array, " e"],
        basis: Float[Array, "a a"],
        sign: Float[Array, ""],
        method: Method,
    ) -> Float[Array, "n p"]:
        a = jnp.concatenate([y0, span[None], p])
        directions = degeneracy.directions(extra, basis)
        jet = follow_bundle(Bundle(make, a, directions, method, numbers=s), sign)
        closing = closing_of(jet) @ basis
        block = degeneracy.block(jet, extra, extra, basis)
        none = jnp.zeros((s, extra.size), dtype)
        in_u = jnp.block([[closing[:, :n], none], [block.in_x[:, :n], block.in_extra]])
        in_p = jnp.concatenate([closing[:, n:], block.in_x[:, n:]])
        moves = -solve(in_u, in_p)[:n] * scale[:, None]
        # second derivatives know no other modes; a fold's parameter has none
        good = jnp.full(n, jet.arrived & ~jet.mixed)
        if isinstance(degeneracy, Fold):
            good = good.at[s].set(jet.arrived)
        return moves * jnp.where(good, 1.0, jnp.nan)[:, None]

    y0 = start_of(problem.section, z[:s])
    known = z[s - 1], extra, basis, jnp.asarray(problem.sign)
    return implicit((n,), slope, p, y0, *known, problem.method)
