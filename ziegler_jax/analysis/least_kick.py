r"""The least kick: of all directions of the start the one that starts flutter soonest.

With dry friction rest attracts at every load, and so may a flutter cycle. Between them
lies the stable manifold of an edge state. The least kick is the point of that manifold
that is nearest to the straight column at rest,

$$E^* = \min_{y_0} \{E(y_0) : y_0 \text{ does not come to rest}\},$$

in the norm of the energy, say. There the manifold's normal n is parallel to the norm's
gradient, or the manifold has an edge, as sticking makes them.

Small motions with Coulomb friction are homogeneous in state and torque: $E^* / \tau^2$
is a number of the load alone, from which the geometry departs by a share of $\tau^2$.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import ClassVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..model.chain_of_rods import check_column
from ..model.column import Column, State, check_autonomous, energy
from ..motion.checks import check_takes, check_two_rods
from ..motion.implicit import fixed, lost
from ..motion.options import Method, Windows, recorded
from ..motion.sequence import run_in_sequence
from ..numerics.no_number import refused
from ..numerics.numbers import Scalar, Two, is_concrete
from ..numerics.rules import choice, instance, keeps, number, whole_number
from ..results import (
    CODE,
    EDGES,
    KICKS,
    OUTCOMES,
    RATE,
    TIME,
    AbstractResult,
    Settings,
    Variable,
    quantity,
)
from ..runtime import requires_x64
from ..solvers import Explicit
from ..steady.certified import CertifiedMotion
from ..steady.lane import Certifying
from ..steady.oddness import is_odd
from .edge import edge_state
from .kick_search import (
    CHECK,
    POLLS,
    SCREEN,
    Descent,
    Norm,
    Plan,
    Rays,
    sphere,
    state_of,
)
from .manifold import Place, carried, manifold_at
from .threshold import bracket_of

FREE = {"rates": (2, 3), "angles": (0, 1), "both": (0, 1, 2, 3)}
COUNTS = {2: 24, 4: 96}  # of rays, by the numbers that are free
TURNS = 4  # of the march: how many of its looks at a batch make one of the sequence
NO_DERIVATIVE = (
    "The start of a least kick has no derivatives here: they would need second "
    "variations. Differentiate `energy`, or take differences."
)
SMOOTH = 0.05  # a misalignment above it is an edge


class Directions(eqx.Module):
    r"""Which starts are compared, and how the least of them is searched for.

    **Arguments:**

    - `free`: `"rates"`, `"angles"` (from rest) or `"both"`; the others are zero.
    - `count`: how many directions are followed outwards, each of which may lead to
        a minimum of its own; None is 24, or 96 for `"both"`.
    - `scan`: in how many intervals a direction is scanned; a pair of changes of the
        verdict within one goes unnoticed.
    - `width`: relative, of the last interval of $\sqrt{2 E}$.

    **Raises:** `ValueError` for what breaks a rule.
    """

    units: ClassVar = {"width": "1"}

    free: str = eqx.field(static=True)
    count: int = eqx.field(static=True)
    scan: int = eqx.field(static=True)
    width: float = eqx.field(static=True)

    def __init__(
        self,
        free: str = "rates",
        count: int | None = None,
        scan: int = 8,
        width: float = 1e-6,
    ):
        """Check and keep them."""
        choice("free", free, tuple(FREE))
        self.free = free
        usual = COUNTS[len(FREE[free])]
        self.count = whole_number("count", usual if count is None else count)
        self.scan = whole_number("scan", scan)
        share = number("width", width)
        if not is_concrete(share) or not 1e-12 <= share <= 1e-2:
            raise ValueError(
                f"Argument `width` must be from 1e-12 to 1e-2, but is {width!r}."
            )
        self.width = float(share)


class LeastKick(AbstractResult):
    r"""The least kick that starts flutter, and what lies between it and rest.

    `energy`: of the start, by the norm; NaN where there is none. `width`: of the
    interval of energies that holds it, along its own ray. `ray` (4,): the start over
    $\sqrt{2 E}$. `misalignment`: the angle between the gradient of the norm and the
    normal of the stable manifold, in the norm; large where the least kick stands on an
    edge of the manifold, NaN where the normal is not known.

    The edge state, a `CODE`, with where it is (`edge_state` (4,): an
    equilibrium, or where a cycle passes $\phi_1 = 0$ upwards), `edge_period` and
    `edge_multiplier` of a cycle, and the largest angles of its joints.
    """

    energy: Float[Array, "*lanes"] = eqx.field(
        metadata=quantity("least energy that starts flutter", "k")
    )
    width: Float[Array, "*lanes"] = eqx.field(
        metadata=quantity("width of the last interval of the energy", "k")
    )
    ray: Float[Array, "*lanes 4"]
    misalignment: Float[Array, "*lanes"] = eqx.field(
        metadata=quantity("angle between the energy's gradient and the normal", "rad")
    )
    edge: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("what lies between rest and flutter", codes=EDGES)
    )
    edge_state: Float[Array, "*lanes 4"]
    edge_period: Float[Array, "*lanes"] = eqx.field(
        metadata=quantity("period of the unstable cycle", TIME)
    )
    edge_multiplier: Float[Array, "*lanes"] = eqx.field(
        metadata=quantity("largest modulus of its multipliers")
    )
    edge_amplitude: Float[Array, "*lanes 2"] = eqx.field(
        metadata=quantity("largest joint angles of the edge state", "rad", ("joint",))
    )
    motions: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("motions of the search")
    )
    undecided: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("motions without a verdict")
    )
    obstacle: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("how the first undecided motion ended", codes=OUTCOMES)
    )
    steps: Int[Array, "*lanes"] = eqx.field(metadata=quantity("attempted steps"))
    outcome: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("how the search ended", codes=KICKS)
    )
    settings: Settings = eqx.field(static=True)

    DERIVED: ClassVar[Mapping[str, Variable]] = {
        "angle": Variable(None, "angle of the rods at the start", "rad", ("rod",)),
        "rate": Variable(None, "rate of the rods at the start", RATE, ("rod",)),
    }

    @property
    def start(self) -> State:
        """The least kick itself, in the middle of the last interval."""
        y = self._y
        return State((y[..., 0], y[..., 1]), (y[..., 2], y[..., 3]))

    @property
    def angle(self) -> Float[Array, "*lanes 2"]:
        """Its angles. It has no derivatives here (`ValueError`), `energy` has."""
        return self._y[..., :2]

    @property
    def rate(self) -> Float[Array, "*lanes 2"]:
        """Its rates."""
        return self._y[..., 2:]

    @property
    def _y(self) -> Float[Array, "*lanes 4"]:
        return refused(NO_DERIVATIVE, jnp.sqrt(2 * self.energy)[..., None] * self.ray)


@requires_x64
def least_kick(
    column: Column,
    bracket: Two,
    *,
    directions: Directions = Directions(),
    norm: Norm = energy,
    windows: Windows = Windows(),
    method: Method = Method(),
) -> LeastKick:
    r"""The least kick, over all directions of the start, that starts flutter.

    $$E^* = \min_d E(s(d)\,d),$$

    where s(d) is the critical kick along d, the least multiple that does not come to
    rest (see `critical_kick`).

    ```python
    def point(q, tau):
        law = zj.SetValuedCoulomb(tau, pin_radius=1, load=zj.ConstantLoad(1))
        column = zj.uniform_rods(q, friction=law)
        return zj.least_kick(column, (0, 200 * tau**2))
    ```

    **Arguments:**

    - `column`: a column of two rods.
    - `bracket`: the least and the largest energy (in k) that is tried; with another
        `norm`, its values.
    - `directions`: see `Directions`.
    - `norm`: the quantity to minimise, a function of the column and the four numbers of
        the start, as `energy` (kinetic and elastic, in k): positive, and of the second
        order in them, e.g. `lambda column, y: y[2] ** 2 + y[3] ** 2`.
    - `windows`: of each motion, as in `settle`. Most of the time goes into certificates
        of flutter; where a motion beyond an angle is known to flutter, `escape` saves
        them.
    - `method`: of each motion. Tangents take an explicit method, Tsit5 where this is
        none, with the same tolerances. `atol` is absolute: with torques of 0.001 or
        less take 1e-8 of them.

    **Returns:** `LeastKick`. `found` says that no neighbour that was tried, down to
    $\sqrt{\mathrm{width}}$ of the start's size away, has a lower threshold, and that no
    minimum to which one of the directions leads is lower; from the lower end of the
    last interval no motion was seen to flutter, and the one from the upper end was
    followed until it does, as `flutter_onset` takes it. Where rest itself is unstable,
    as it may be under smoothed friction, it is `moves`. The edge of such friction has
    no corners: where the misalignment is above 0.05, a motion was misjudged, and the
    outcome is `undecided`.

    **Derivatives:** of `energy`, forward and reverse, first order, in every number of
    the column: at a minimum those along its ray (J. M. Danskin, 1967), see
    `threshold`. They are NaN unless the outcome is `found`, where `misalignment`
    is above 0.05, an edge of the manifold that may move along, and where tangents
    disagree. The edge state has the derivatives of `periodic_orbit`. Width, ray and
    misalignment have NaN: their derivatives would need second variations.

    **Raises:** `ValueError` for arguments that break a rule.

    Source: R. R. Kerswell, C. C. T. Pringle, A. P. Willis, Rep. Prog. Phys. 77 (2014)
    085901, on minimal seeds.
    """
    problem = _Problem(column, norm, directions, windows, method)
    plan = problem.plan(bracket)
    valid = jnp.isfinite(plan.largest) & (plan.least < plan.largest)
    valid &= keeps("positive", problem.escape) & problem.rays.positive
    first = plan.begin(valid)

    def update(search: Descent, motion: CertifiedMotion, run: Certifying) -> Descent:
        del motion
        return plan.after(search, run.outcome, run.moves)

    def running(search: Descent):
        return search.outcome == CODE.not_computed

    begun = problem.motion(first)
    at_once = TURNS * begun.at_once
    search, steps = run_in_sequence(problem.motion, update, running, first, at_once)
    return problem.result(search, steps, begun)


class _Problem:
    """The question of a search, and its options."""

    def __init__(
        self,
        column: Column,
        norm: Norm,
        directions: Directions,
        windows: Windows,
        method: Method,
    ):
        """Check it."""
        check_column(column)
        check_two_rods("least_kick", column)
        check_autonomous("least_kick", column)
        if column.system().displaced:
            raise ValueError(
                "Argument `column` must rest upright for `least_kick`, whose kicks are "
                "measured from there, but has rest angles, or forces across it or of "
                "one's own."
            )
        instance("directions", directions, Directions)
        instance("windows", windows, Windows)
        instance("method", method, Method)
        needs = "Argument `norm` must be a function of a column and a start's numbers"
        check_takes(needs, norm, 2)
        self.column, self.directions = column, directions
        self.windows, self.method = fixed((windows, method))
        self.escape = np.pi if windows.escape is None else self.windows.escape
        self.odd = is_odd(fixed(column).system())
        self.rays = Rays(column, norm, FREE[directions.free])

    def plan(self, bracket: Two) -> Plan:
        """The search's."""
        least, most = (jnp.sqrt(2 * x) for x in bracket_of(bracket, "nonnegative"))
        how, k = self.directions, len(FREE[self.directions.free])
        rays, neighbours = sphere(how.count, k), sphere(POLLS, k, 0.25)
        odd = jnp.asarray(self.odd)
        return Plan(least, most, odd, how.scan, how.width, rays, neighbours)

    def motion(self, search: Descent) -> CertifiedMotion:
        """The next motion; a screened one has moved beyond so many times its start."""
        column = fixed(self.column)
        start = state_of(self.rays.at(column, search.c, search.r))
        size = jnp.sqrt(2 * jnp.maximum(energy(column, start.y), 0.0))
        screened = (size > 0) & (search.phase != CHECK)
        limit = jnp.where(screened, search.screen * size, jnp.inf)
        windows = eqx.tree_at(
            lambda w: w.escape,
            self.windows,
            jnp.minimum(limit, cast(Scalar, self.escape)),
            is_leaf=lambda x: x is None,
        )
        given = windows, None, self.method, self.odd
        return CertifiedMotion(column, start, "least_kick", *given)

    def result(
        self, search: Descent, steps: Int[Array, ""], motion: CertifiedMotion
    ) -> LeastKick:
        """The result of a search."""
        best, still = fixed(search.best), fixed(self.column)
        sure = search.outcome == CODE.found
        named = sure | (search.outcome == CODE.undecided)
        named &= jnp.isfinite(best.high)
        r = jnp.where(named, (best.low + best.high) / 2, 1.0)
        width = jnp.where(named, best.high - best.low, 1.0)
        method = _with_tangents(motion.method)

        def scene(r: Scalar) -> tuple[Column, State]:
            return self.column, state_of(self.rays.at(self.column, best.c, r))

        along = partial(self.rays.at, still, best.c)
        y, line = jax.jvp(along, (r,), (jnp.ones_like(r),))
        place = Place(line, width, named, motion.last, motion.horizon)
        normal, middle, followed = manifold_at(still, y, place, method)
        misalignment = self.rays.angle(y, normal)
        edge = edge_state(self.column, middle, jnp.max(jnp.abs(y)), named)
        smooth = sure & (misalignment < SMOOTH)
        # a law without corners has none on its edge: a motion was misjudged
        misled = sure & ~smooth & jnp.isfinite(misalignment) & (not self.column.sticks)
        outcome = jnp.where(misled, CODE.undecided, search.outcome)
        change = carried(scene, r, width, smooth, motion.last, motion.horizon, method)
        mark = jnp.where(named, 1.0, jnp.nan)
        none = partial(lost, inputs=(self.column, self.rays.norm))
        return LeastKick(
            energy=(r + change) ** 2 / 2 * mark,
            width=none(r * width * mark),
            ray=none(y / r * mark),
            misalignment=none(misalignment),
            edge=edge.code,
            edge_state=edge.y,
            edge_period=edge.period,
            edge_multiplier=edge.multiplier,
            edge_amplitude=edge.amplitude,
            motions=search.motions,
            undecided=search.undecided,
            obstacle=search.obstacle.astype(jnp.int8),
            steps=steps + followed + edge.steps,
            outcome=outcome.astype(jnp.int8),
            settings=self._settings(motion),
        )

    def _settings(self, motion: CertifiedMotion) -> Settings:
        how, norm = self.directions, self.rays.norm
        return recorded(
            **{**motion.settings(), "escape": self.escape, "screen": SCREEN},
            directions=how.free,
            count=how.count,
            scan=how.scan,
            relative_width=how.width,
            norm=getattr(norm, "__name__", "own"),
        )


def _with_tangents(method: Method) -> Method:
    """A method that can carry tangents, of the same tolerances."""
    solver = method.solver if isinstance(method.solver, Explicit) else Explicit()
    usual = Method(solver, method.rtol, method.atol)
    return usual.at_most(method.budget)
