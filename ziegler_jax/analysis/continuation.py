r"""Branches of cycles: pseudo-arclength continuation, and the points where they change.

With a parameter $\lambda$ as a fifth unknown, $x = (z, \lambda)$, a branch is a curve
$R(x) = 0$. From a point with unit tangent t the next is sought at a distance s,

$$R(x) = 0, \qquad t \cdot (x - x_0 - s t) = 0,$$

which is regular at folds, where the branch turns back in $\lambda$. On the way test
functions of the three multipliers $\mu_i$ other than 1 change sign:

$$t_\lambda \text{ (fold)}, \qquad \prod_{i<j} (\mu_i \mu_j - 1) \text{ (torus)}, \qquad
\prod_i (1 + \mu_i) \text{ (flip)}, \qquad \prod_i (1 - \mu_i) \text{ (pitchfork)}$$

and the zero is found along the arc; a pitchfork's, where another branch crosses and
Newton's method is singular, may be that of the step's chord. Lengths on
the arc: rad for the state, the first cycle's period for T, the first value for
$\lambda$.

Source: H. B. Keller (1977); Y. A. Kuznetsov, Elements of Applied Bifurcation Theory
(2004), chapter 10.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from ..context import plain
from ..model.column import Column, State
from ..motion.observers import Extent
from ..motion.scene import recorded
from ..motion.variational import Flow
from ..numerics.numbers import check_options, is_concrete, whole_number
from ..results import ORBIT, SPECIAL, TIME, AbstractResult, Variable, quantity
from .implicit import fixed, undifferentiated
from .march import Kept, Road
from .periodic_orbit import attracts, multipliers
from .shooting import attached, solve


class Points(eqx.Module):
    """Cycles along a branch, arrays with the points in front; NaN where there is none.

    `parameter`; `state` (phi and omega: two arrays each); `period`; `amplitude` (rod
    and joint: (n, 2)); `monodromy` (n, 4, 4).
    """

    parameter: Any
    state: State
    period: Any
    amplitude: Extent
    monodromy: Any

    @property
    def multipliers(self) -> Any:
        """Floquet multipliers (n, 4), the trivial one first."""
        return multipliers(self.monodromy)

    @property
    def stable(self) -> Any:
        """Whether the others lie inside the unit circle, (n,)."""
        return attracts(self.monodromy)


class Branch(eqx.Module):
    """A branch of cycles.

    `points`: `Points` in order along the arc; `count` of them; `special`: the `Points`
    where the branch changes, with `kind`, codes of `SPECIAL`; `outcome`: a code of
    `ORBIT`, `found` if all points asked for are there, else why the branch ends;
    `steps` of all motions.
    """

    points: Points
    count: Any
    special: Points
    kind: Any
    outcome: Any
    steps: Any


class CycleFold(AbstractResult):
    """The fold at which two cycles meet, as a value of the parameter.

    `value` carries derivatives; `cycle`: `Points` of one, without; `outcome`: a code
    of `ORBIT`, unless that is `found`, value and cycle are NaN; `steps` of all motions.
    """

    value: Any
    cycle: Points
    steps: Any = eqx.field(metadata=quantity("attempted steps"))
    outcome: Any = eqx.field(
        metadata=quantity("how the search for the fold ended", codes=ORBIT)
    )
    settings: tuple[tuple[str, Any], ...] = eqx.field(static=True)

    def variables(self) -> dict[str, Variable]:
        """The numbers as a sweep labels them."""
        period = self.cycle.period[0]
        return {
            "fold": Variable(self.value, "parameter at the fold of cycles"),
            "period": Variable(period, "period at the fold", TIME),
            **super().variables(),
        }


@plain
def continue_cycle(
    make_column: Callable[[Any], Column],
    guess: State,
    start: Any,
    *,
    direction: int = 1,
    points: int = 100,
    specials: int = 4,
    step: Any = 0.1,
    bounds: tuple[Any, Any] = (-jnp.inf, jnp.inf),
    **options: Any,
) -> Branch:
    r"""Follow a cycle as a parameter moves, through folds, stable or not.

    **Arguments:**

    - `make_column`: a function of the parameter, e.g. `lambda q: uniform_rods(q, ...)`.
    - `guess`: a state near the cycle at the parameter `start`; see `periodic_orbit`.
    - `direction`: 1 or -1, in which the parameter moves at first.
    - `points`: how many there is room for; `specials`: how many special points.
    - `step`: the longest step on the arc. The points lie on the branch; between them
        nothing is known of it. The default can be too coarse where a branch bends
        fast: one that a joint's sticking bends took a single step from q = 1.912 to
        1.639, and the line through its points was off by about 0.05 rad. Choose a
        smaller step near folds, and compare.
    - `bounds`: around `start`; the branch ends where the parameter leaves them.
    - `options`: `period`, `section`, `loops`, `patience`, `rtol`, `atol`, `solver`
        of `periodic_orbit`; `max_steps`, ten million, is the step budget of all
        motions of the branch together, which ends as `not_integrated` where it is
        spent.

    **Returns:** `Branch`, without derivatives.

    **Raises:** `ValueError` for arguments that break a rule.
    """
    check_options("continue_cycle", options, Road.__init__)
    points = whole_number("points", points)
    specials = whole_number("specials", specials)
    road = Road(make_column, guess, start, direction, step, bounds, **options)
    end = fixed(road.follow(points, specials, (True,) * 4, False))
    return Branch(
        _points(road, end.kept),
        end.count,
        _points(road, end.special),
        end.kind,
        end.outcome,
        road.method.max_steps - end.left,
    )


@plain
def cycle_fold(
    make_column: Callable[[Any], Column],
    guess: State,
    start: Any,
    *,
    direction: int = -1,
    max_points: int = 200,
    step: Any = 0.1,
    bounds: tuple[Any, Any] = (-jnp.inf, jnp.inf),
    **options: Any,
) -> CycleFold:
    r"""The fold at which the cycle, followed from `start`, meets another and vanishes.

    It is the fold of the branch on which `guess` lies, and of that branch alone. Other
    branches may have folds at lower loads, where the column then still flutters after
    some kick: with set-valued friction at tau = 0.1 two branches fold, at q = 1.61206
    and at 1.57105, and the guess decides which is found.

    **Arguments:** as `continue_cycle`; `max_points` on the way.

    **Returns:** `CycleFold`.

    **Derivatives:** of `value`, forward and reverse, first order, in every number that
    `make_column` was made from: at the fold a row w annuls the Jacobian in z, so that
    $d\lambda = -w \cdot R_p\,dp / (w \cdot R_\lambda)$.
    """
    check_options("cycle_fold", options, Road.__init__)
    most = whole_number("max_points", max_points)
    road = Road(make_column, guess, start, direction, step, bounds, **options)
    end = fixed(road.follow(1, 1, (True, False, False, False), True, most))
    z, matrix = end.special.x[0] * road.scale, end.special.matrix[0]
    found = end.kind[0] == SPECIAL.fold
    # the row that annuls R_z, with 1 for R_lambda; the tangent there annuls from right
    bordered = jnp.zeros((5, 5), z.dtype).at[:4, :4].set(matrix[:, :4].T)
    right = end.special.tangent[0, :4] * road.scale[:4]
    bordered = bordered.at[:4, 4].set(right).at[4, :4].set(matrix[:, 4])
    row = solve(bordered, jnp.eye(5, dtype=z.dtype)[4])[:4]
    y0 = jnp.concatenate([road.section[None], z[:3]])
    column = make_column(fixed(z[4]))
    change = attached(1, column, y0, z[3], road.method, _fold_moves, row)[0]
    mark = jnp.where(found, 1.0, jnp.nan).astype(z.dtype)
    points = _points(road, end.special)
    outcome = jnp.where(found, ORBIT.found, end.outcome)
    return CycleFold(
        (z[4] + change) * mark,
        points,
        road.method.max_steps - end.left,
        outcome.astype(jnp.int8),
        recorded(
            **road.settings,
            max_points=most,
            bounds=" to ".join(f"{x:g}" if is_concrete(x) else "?" for x in bounds),
        ),
    )


def _fold_moves(seen: Flow, row: Any) -> Any:
    """Derivatives of the fold's parameter in the n others, (1, n)."""
    return -(row @ seen.moved[:, 4:])[None]


def _points(road: Road, kept: Kept) -> Points:
    """The points of a branch in their own units."""
    x = kept.x * road.scale[None]
    at = jnp.broadcast_to(road.section, x.shape[:1]) + 0 * x[:, 0]
    return Points(
        parameter=undifferentiated(x[:, 4]),
        state=_states(at, x),
        period=x[:, 3],
        amplitude=Extent(kept.extent[:, :2], kept.extent[:, jnp.array([0, 2])]),
        monodromy=kept.moved,
    )


def _states(at: Any, x: Any) -> Any:
    """States on the section, arrays instead of numbers."""
    state = State()
    new = ((at, x[:, 0]), (x[:, 1], x[:, 2]))
    return eqx.tree_at(lambda s: (s.phi, s.omega), state, new)
