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

from collections.abc import Callable, Mapping
from functools import partial
from typing import ClassVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..context import plain
from ..model.column import Column, State, energy
from ..motion.implicit import fixed, fixed_direction
from ..motion.options import Method, Windows, recorded
from ..motion.scene import check_scene
from ..motion.sequence import run_in_sequence
from ..numerics.numbers import (
    Scalar,
    Two,
    Vector4,
    choice,
    instance,
    is_concrete,
    pair,
    whole_number,
)
from ..results import (
    EDGE,
    KICK,
    OUTCOME,
    RATE,
    TIME,
    AbstractResult,
    Settings,
    Variable,
    quantity,
)
from ..solvers import Explicit
from ..steady.certified import CertifiedMotion
from ..steady.lane import Certifying
from ..steady.oddness import is_odd
from .edge import edge_state
from .kick_search import CHECK, POLLS, SCREEN, Descent, Plan, sphere
from .threshold import Place, carried, manifold_at

Norm = Callable[[Column, Vector4], Scalar]
FREE = {"rates": (2, 3), "angles": (0, 1), "both": (0, 1, 2, 3)}
COUNTS = {2: 24, 4: 96}  # of rays, by the numbers that are free
TURNS = 4  # of the march: how many of its looks at a batch make one of the sequence
RENORMALISED = 6  # times: a norm is a square but for the cosine in the energy
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
        if not 1e-12 <= width <= 1e-2:
            raise ValueError(
                f"Argument `width` must be from 1e-12 to 1e-2, but is {width!r}."
            )
        self.width = float(width)


class LeastKick(AbstractResult):
    r"""The least kick that starts flutter, and what lies between it and rest.

    `energy`: of the start, by the norm; NaN where there is none. `width`: of the
    interval of energies that holds it, along its own ray. `ray` (4,): the start over
    $\sqrt{2 E}$. `misalignment`: the angle between the gradient of the norm and the
    normal of the stable manifold, in the norm; large where the least kick stands on an
    edge of the manifold, NaN where the normal is not known.

    The edge state, a code of `EDGE`, with where it is (`edge_state` (4,): an
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
        metadata=quantity("what lies between rest and flutter", codes=EDGE)
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
        metadata=quantity("how the first undecided motion ended", codes=OUTCOME)
    )
    steps: Int[Array, "*lanes"] = eqx.field(metadata=quantity("attempted steps"))
    outcome: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("how the search ended", codes=KICK)
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
        return fixed_direction(jnp.sqrt(2 * self.energy)[..., None] * self.ray)


@plain
def least_kick(
    column: Column,
    bracket: Two,
    *,
    directions: Directions = Directions(),  # noqa: B008, a value
    norm: Norm = energy,
    windows: Windows = Windows(),  # noqa: B008
    method: Method = Method(),  # noqa: B008
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

    ds = zj.sweep(point, q=[1.8, 2.1], tau=[0.02])
    ```

    **Arguments:**

    - `column`: the scene.
    - `bracket`: the least and the largest energy (in k) that is tried.
    - `directions`: see `Directions`.
    - `norm`: what is least, a function of the column and the four numbers of the start,
        as `energy` is (kinetic and elastic, in k): positive, and of the second order in
        them, e.g. `lambda column, y: y[2] ** 2 + y[3] ** 2`.
    - `windows`: of each motion, as in `settle`. Most of the time goes into certificates
        of flutter; where a motion beyond an angle is known to flutter, `escape` saves
        them.
    - `method`: of each motion. Tangents take an explicit method, Tsit5 where this is
        none, with the same tolerances.

    **Returns:** `LeastKick`. `found` says that no neighbour of the start, at any
    distance down to $\sqrt{\mathrm{width}}$ in the norm, has a lower threshold; that no
    other minimum is lower, so far as one of the directions leads to it.

    **Derivatives:** of `energy`, forward and reverse, first order, in every number of
    the column: at a minimum those along its ray (J. M. Danskin, 1967), see
    `flutter_onset`. They are NaN unless the outcome is `found`, where `misalignment`
    is above 0.05, an edge of the manifold that may move along, and where tangents
    disagree.

    **Raises:** `ValueError` for arguments that break a rule.

    Source: R. R. Kerswell, C. C. T. Pringle, A. P. Willis, Rep. Prog. Phys. 77 (2014)
    085901, on minimal seeds.
    """
    problem = _Problem(column, norm, directions, windows, method)
    least, largest = problem.sizes(bracket)
    plan = problem.plan(least, largest)
    first = plan.begin(jnp.isfinite(largest) & (least < largest) & problem.positive)

    def update(search: Descent, motion: CertifiedMotion, run: Certifying) -> Descent:
        del motion
        return plan.after(search, run.outcome)

    def running(search: Descent):
        return search.outcome == KICK.not_computed

    def motion(search: Descent) -> CertifiedMotion:
        screen = jnp.where(search.phase == CHECK, jnp.inf, search.screen)
        return problem.motion(search.c, search.r, screen)

    begun = motion(first)
    at_once = TURNS * begun.at_once
    search, steps = run_in_sequence(motion, update, running, first, at_once)
    return problem.result(search, steps, begun)


class _Problem:
    """What is searched for, and how."""

    def __init__(
        self,
        column: Column,
        norm: Norm,
        directions: Directions,
        windows: Windows,
        method: Method,
    ):
        """Check it."""
        check_scene(column, State())
        instance("directions", directions, Directions)
        instance("windows", windows, Windows)
        instance("method", method, Method)
        if not callable(norm):
            raise ValueError(
                "Argument `norm` must be a function of a column and four numbers, "
                f"but is {norm!r}."
            )
        self.column, self.norm, self.directions = column, norm, directions
        self.windows, self.method = fixed((windows, method))
        self.escape = np.pi if windows.escape is None else self.windows.escape
        self.free = FREE[directions.free]
        self.odd = is_odd(fixed(column))
        dtype = jnp.result_type(float)
        # columns of the basis are orthonormal in the norm at rest
        square = jax.hessian(partial(self._norm_of, fixed(column)))(jnp.zeros(4, dtype))
        part = square[np.ix_(self.free, self.free)]
        factor = jnp.linalg.cholesky(part)
        self.positive = jnp.all(jnp.isfinite(factor))
        factor = jnp.where(self.positive, factor, jnp.eye(len(self.free), dtype=dtype))
        inverse = jnp.linalg.inv(factor).T
        self.basis = jnp.zeros((4, len(self.free)), dtype).at[self.free, :].set(inverse)
        self.square = part

    def _norm_of(self, column: Column, y: Float[Array, "4"]) -> Scalar:
        return self.norm(column, (y[0], y[1], y[2], y[3]))

    def sizes(self, bracket: Two) -> tuple[Float[Array, ""], Float[Array, ""]]:
        r"""The least and the largest $\sqrt{2 E}$."""
        least, largest = fixed(pair("bracket", bracket, "nonnegative"))
        if is_concrete(least) and is_concrete(largest) and not least < largest:
            raise ValueError(
                f"Argument `bracket` must increase, but is ({least:g}, {largest:g})."
            )
        dtype = jnp.result_type(float)
        both = (jnp.sqrt(2 * jnp.asarray(x, dtype)) for x in (least, largest))
        least, largest = both
        return least, largest

    def plan(self, least: Float[Array, ""], largest: Float[Array, ""]) -> Plan:
        """The search's."""
        how, k = self.directions, len(self.free)
        rays, polls = sphere(how.count, k), sphere(POLLS, k, 0.25)
        odd = jnp.asarray(self.odd)
        return Plan(least, largest, odd, how.scan, how.width, rays, polls)

    def on_ray(
        self, column: Column, c: Float[Array, " k"], r: Scalar
    ) -> Float[Array, "4"]:
        """The start on a ray whose norm is r^2 / 2."""
        y = r * (self.basis @ c)
        for _ in range(RENORMALISED):
            now = 2 * self._norm_of(column, y)
            y = y * jnp.where(now > 0, r / jnp.sqrt(jnp.where(now > 0, now, 1.0)), 1.0)
        return y

    def motion(
        self, c: Float[Array, " k"], r: Scalar, screen: Scalar
    ) -> CertifiedMotion:
        """The motion from a place on a ray; beyond `screen` sizes it has moved."""
        column = fixed(self.column)
        y = self.on_ray(column, c, r)
        start = State((y[0], y[1]), (y[2], y[3]))
        four = cast(Vector4, tuple(y[i] for i in range(4)))
        size = jnp.sqrt(2 * jnp.maximum(energy(column, four), 0.0))
        limit = jnp.where(size > 0, screen * size, jnp.inf)
        limit = jnp.minimum(limit, self.escape)
        windows = eqx.tree_at(
            lambda w: w.escape, self.windows, limit, is_leaf=lambda x: x is None
        )
        given = windows, None, self.method, self.odd
        return CertifiedMotion(column, start, "least_kick", *given)

    def result(
        self, search: Descent, steps: Int[Array, ""], motion: CertifiedMotion
    ) -> LeastKick:
        """What it amounts to."""
        best, still = fixed(search.best), fixed(self.column)
        named = (search.outcome == KICK.found) | (search.outcome == KICK.undecided)
        named &= jnp.isfinite(best.high)
        r = jnp.where(named, (best.low + best.high) / 2, 1.0)
        width = jnp.where(named, best.high - best.low, 1.0)
        found = search.outcome == KICK.found
        solver = motion.method.solver
        tangent = solver if isinstance(solver, Explicit) else Explicit()
        method = Method(tangent, motion.method.rtol, motion.method.atol)
        method = method.at_most(motion.method.max_steps)

        def scene(r: Scalar) -> tuple[Column, State]:
            y = self.on_ray(self.column, best.c, r)
            return self.column, State((y[0], y[1]), (y[2], y[3]))

        y, line = jax.jvp(
            partial(self.on_ray, still, best.c), (r,), (jnp.ones_like(r),)
        )
        place = Place(line, width, found, motion.last, motion.horizon)
        normal, middle, followed = manifold_at(still, y, place, method)
        misalignment = self._angle(y, normal)
        edge = edge_state(self.column, middle, jnp.max(jnp.abs(y)), found)
        smooth = found & (misalignment < SMOOTH)
        change = carried(scene, r, width, smooth, motion.last, motion.horizon, method)
        mark = jnp.where(named, 1.0, jnp.nan)
        how = self.directions
        return LeastKick(
            energy=(r + change) ** 2 / 2 * mark,
            width=r * width * mark,
            ray=y / r * mark,
            misalignment=misalignment,
            edge=edge.code,
            edge_state=edge.y,
            edge_period=edge.period,
            edge_multiplier=edge.multiplier,
            edge_amplitude=edge.amplitude,
            motions=search.motions,
            undecided=search.undecided,
            obstacle=search.obstacle.astype(jnp.int8),
            steps=steps + followed + edge.steps,
            outcome=search.outcome.astype(jnp.int8),
            settings=recorded(
                **{**motion.settings(), "escape": self.escape, "screen": SCREEN},
                directions=how.free,
                count=how.count,
                scan=how.scan,
                relative_width=how.width,
                norm=getattr(self.norm, "__name__", "own"),
            ),
        )

    def _angle(
        self, y: Float[Array, "4"], normal: Float[Array, "4"]
    ) -> Float[Array, ""]:
        """Between the norm's gradient and the normal, among what is free, in the norm.

        A covector g has the coordinates basis^T g, orthonormal at rest.
        """
        slope = jax.grad(partial(self._norm_of, fixed(self.column)))(y)
        a, b = slope @ self.basis, normal @ self.basis
        cosine = a @ b / jnp.sqrt((a @ a) * (b @ b))
        across = jnp.linalg.norm(a / jnp.linalg.norm(a) - b / jnp.linalg.norm(b))
        return jnp.where(cosine > 0, 2 * jnp.arcsin(jnp.minimum(across / 2, 1)), jnp.pi)
