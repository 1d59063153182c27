r"""Periodic orbits: shooting, Floquet multipliers, derivatives.

A cycle starts on a section, $\phi_1 = s$ say, and closes after its period T:

$$R(z, p) = y(T; y_0, p) - y_0 = 0, \qquad z = (\phi_2, \omega_1, \omega_2, T).$$

Newton's method solves it, with the derivatives of the flow from the variational
equations; whether the cycle is stable makes no difference to it. The multipliers are
the eigenvalues of the monodromy matrix $\partial y(T)/\partial y_0$. One is 1, along
the motion; the cycle attracts where the others lie inside the unit circle. Where
friction is no jump, their product is $\exp \int_0^T \mathrm{div} f\,dt$. A joint that
sticks makes one zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Int, Shaped

from ..model.chain_of_rods import AbstractChain
from ..model.column import State
from ..model.state import PhasePoint
from ..motion.checks import check_scene, float_state, valid_scene
from ..motion.implicit import fixed, implicit, lost, moving, solve
from ..motion.method import tangent_method
from ..motion.observers import JOINT_AMPLITUDE, ROD_AMPLITUDE, AbstractObserver
from ..motion.options import Method, recorded
from ..motion.section import SectionPlane
from ..motion.variational import Flow, flow_of, varied_motion
from ..numerics.eigenvalues import eigenvalues
from ..numerics.numbers import Option, Scalar
from ..numerics.rules import instance, keeps, number, whole_number
from ..results import (
    CODE,
    ORBITS,
    TIME,
    AbstractDescribed,
    Settings,
    Variable,
    quantity,
    without_values,
)
from ..runtime import own_flags, requires_x64
from ..solvers import Explicit
from ..steady.jets import carried_monodromy
from .observed import OneTurn, observation_of
from .shooting import (
    SHORTEST,
    Unknowns,
    blank_shot,
    closing,
    first_return,
    newton,
    of_each,
    shot_motion,
    shot_of,
    start_of,
)

AT_REST = 1e-8  # a motion that starts no faster is none
MOST_TRIES = 20  # of Newton's method


class PeriodicOrbit(AbstractDescribed):
    r"""A periodic orbit, or the reason why there is none.

    `state`: its state on the section; `rod_amplitude`, `joint_amplitude` (n,): the
    largest angles of n rods and joints; `monodromy` (2n, 2n); `residual`: the remainder
    by which the orbit does not close; `steps` of all motions; `outcome`, a `CODE`.
    Unless that is `found`, all numbers of the orbit and their derivatives are NaN.
    Observed variables are attributes, too.
    """

    state: State
    section: SectionPlane  # through `state`
    period: Float[Array, "*lanes"] = eqx.field(
        metadata=quantity("period of the orbit", TIME)
    )
    rod_amplitude: Float[Array, "*lanes n"] = eqx.field(
        metadata={"quantity": ROD_AMPLITUDE}
    )
    joint_amplitude: Float[Array, "*lanes n"] = eqx.field(
        metadata={"quantity": JOINT_AMPLITUDE}
    )
    monodromy: Float[Array, "*lanes s s"]
    residual: Float[Array, "*lanes"] = eqx.field(
        metadata=quantity("by how much it does not close")
    )
    iterations: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("iterations of Newton's method")
    )
    steps: Int[Array, "*lanes"] = eqx.field(metadata=quantity("attempted steps"))
    outcome: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("how the search for the orbit ended", codes=ORBITS)
    )
    settings: Settings = eqx.field(static=True)
    numbers: dict[str, Shaped[Array, "..."]] = eqx.field(default_factory=dict)
    quantities: tuple[tuple[str, Variable], ...] = eqx.field(static=True, default=())

    DERIVED: ClassVar[Mapping[str, Variable]] = {
        "largest_multiplier": Variable(
            None, "largest modulus of a Floquet multiplier but the trivial one"
        ),
        "stable": Variable(None, "whether the orbit attracts"),
    }

    @property
    def multipliers(self) -> Complex[Array, "*lanes s"]:
        """The Floquet multipliers, complex, one a number of the state.

        The one nearest to 1, which belongs to the motion itself, stands first; then
        the others by falling modulus. Of one that is double the derivative is NaN.
        """
        return multipliers(self.monodromy)

    @property
    def stable(self) -> Bool[Array, "*lanes"]:
        """Whether all multipliers but the first lie inside the unit circle."""
        return attracts(self.monodromy)

    @property
    def largest_multiplier(self) -> Float[Array, "*lanes"]:
        """The largest modulus of the others."""
        return jnp.abs(self.multipliers)[..., 1]


_TAKEN = {*PeriodicOrbit.__dataclass_fields__, *vars(PeriodicOrbit)}


@requires_x64
def periodic_orbit(
    column: AbstractChain,
    guess: State,
    *,
    period: Scalar | None = None,
    section: SectionPlane = SectionPlane(),
    returns: int = 1,
    max_time: Scalar = 200.0,
    observers: Sequence[AbstractObserver] = (),
    method: Method = Method(),
) -> PeriodicOrbit:
    r"""The periodic orbit near a guess, stable or not, with its multipliers.

    **Arguments:** (times in $\sqrt{m l^2/k}$)

    - `column`: or chain, with any damping and friction law, set-valued friction
        included.
    - `guess`: a state near the orbit, e.g. `settle(...).final`. Without a `period` the
        motion from there is followed until it passes the `section` and has come back to
        it `returns` times, `max_time` at most: the first approximation.
    - `period`: the orbit's, roughly; then `guess` itself is the first approximation,
        and lies on the section, whatever its `level` and direction. For unstable
        orbits.
    - `section`: the plane on which the orbit begins; its period and its multipliers
        depend on none. A chain that is bent or pushed aside may never pass the default,
        phi1 = 0: give a level that it passes.
    - `observers`: observers of exactly one turn of the orbit beside its amplitude, e.g.
        `(EnergyBalance(),)`; their variables are attributes, as of `settle`.
    - `method`: an explicit one. Its step budget is that of the whole search, the first
        return, all periods that Newton's method tries (20 at most) and that which is
        observed; where it is spent the search ends as `not_integrated`. Derivatives
        follow the orbit once more, with another one.

    **Returns:** `PeriodicOrbit`. With set-valued friction the derivatives pass through
    every change of modes by its saltation matrix.

    **Derivatives:** of `state`, `period`, the amplitudes, `monodromy` and multipliers,
    and of what observers give, forward and reverse, first order, in every leaf of the
    column, in the observers' numbers and in the section's level (with a `period` the
    guess's), by the implicit function theorem: those of this orbit, at this section. On
    the rest of the guess, and on options, it does not depend. The monodromy's are
    central differences, good to some five digits. Where the orbit repels (`stable` is
    False, as of every orbit inside chaos) they say nothing of long motions nearby.
    `residual` is rounding; its derivative is NaN.

    **Raises:** `ValueError` for arguments that break a rule.

    Source: Y. A. Kuznetsov, Elements of Applied Bifurcation Theory (2004), section
    10.2; R. Leine, H. Nijmeijer (2004), chapter 8.
    """
    check_scene(column, guess, "guess")
    method = cycle_method("periodic_orbit", method, column)
    instance("section", section, SectionPlane)
    returns = whole_number("returns", returns)
    observation = observation_of("periodic_orbit", observers, column)
    still = fixed(column)
    start = float_state(guess)
    first = approximation(still, start, period, section, returns, max_time, method)
    at = fixed(first.section)

    def shot(z, left):
        share = method.at_most(left)
        return shot_motion(lambda p: still, jnp.zeros(0, z.dtype), at, z, share, False)

    def equations(z, flow):
        shot = shot_of(at, z, flow)
        return shot.residual, shot.jacobian, shot

    n = column.joints
    blank = blank_shot(0, first.z.dtype, n)
    solution = newton(shot, equations, first.z, blank, MOST_TRIES, first.left)
    z, flow = solution.z, solution.shot.flow
    y0 = start_of(at, z)
    # the last shot was from just before the last step of Newton's
    others = jnp.asarray(at.free(n))
    extent = flow.extent + flow.extent_moved[:, others] @ solution.move[:-1]
    spent = (solution.left <= 0) & ~solution.converged
    at_rest = jnp.max(jnp.abs(flow.slope)) < AT_REST
    outcome = jnp.where(at_rest, CODE.collapsed, CODE.found)
    converged = solution.converged & (z[-1] > SHORTEST)
    outcome = jnp.where(converged, outcome, CODE.not_converged)
    outcome = jnp.where(flow.arrived & ~spent, outcome, CODE.not_integrated)
    outcome = jnp.where(first.failure == 0, outcome, first.failure)
    left, turn, run = solution.left, OneTurn(column, observation), None
    if observation.observers:
        run = turn.follow(y0, z[-1], method.at_most(left), outcome == CODE.found)
        left = left - run.steps
        lost_it = (outcome == CODE.found) & (run.outcome != CODE.complete)
        outcome = jnp.where(lost_it, CODE.not_integrated, outcome)
    mark = jnp.where(outcome == CODE.found, 1.0, jnp.nan).astype(z.dtype)
    span = jnp.maximum(z[-1], SHORTEST)
    change = _carried(column, first.section, y0 * mark, span, method)
    z, extent = z + change[: 2 * n], extent + change[2 * n :]
    z, extent = z * mark, extent * mark
    y = start_of(first.section, z)
    bends = carried_monodromy(column, y, z[-1], method)
    rods, joints = of_each(extent)
    known, named = (column, start, first.section), {}
    if run is not None:
        named = turn.numbers(run, y, z[-1], method, _TAKEN)
    return PeriodicOrbit(
        state=State(tuple(y[i] for i in range(n)), tuple(y[n + i] for i in range(n))),
        section=first.section,
        period=z[-1],
        rod_amplitude=rods,
        joint_amplitude=joints,
        monodromy=(flow.moved + bends) * mark,
        residual=lost(jnp.max(jnp.abs(solution.shot.residual)) * mark, known),
        iterations=solution.iterations,
        steps=method.budget - left,
        outcome=outcome.astype(jnp.int8),
        numbers={name: jnp.asarray(v.value) for name, v in named.items()},
        quantities=without_values(named),
        settings=recorded(
            **method.settings(),
            **_first_approximation(section, returns, max_time, period),
        ),
    )


def _first_approximation(
    section: SectionPlane, returns: int, max_time: Scalar, period: Scalar | None
) -> dict[str, Option]:
    """Its options, for the record."""
    if period is not None:
        plane = {"section": section.coordinate, "level": "the guess's"}
        return {**plane, "period": number("period", period)}
    record = {**section.settings(), "returns": returns}
    return {**record, "max_time": number("max_time", max_time)}


def _carried(
    column: AbstractChain,
    section: SectionPlane,
    y0: Float[Array, " s"],
    span: Float[Array, ""],
    method: Method,
) -> Float[Array, " m"]:
    r"""Zeros that carry the derivatives of z and of the largest angles.

    In the column and the section's level s, with $R_z\,dz = -R_p\,dp - R_s\,ds$.
    """
    p, make = moving(column, y0.dtype)
    numbers = jnp.append(p, jnp.asarray(section.level, y0.dtype))

    def slope(
        numbers: Float[Array, " n"],
        y0: Float[Array, " s"],
        span: Float[Array, ""],
        method: Method,
    ) -> Float[Array, "m n"]:
        motion = varied_motion(make, numbers[:-1], y0, span, method)
        return _moves(section, flow_of(motion.advance(motion.begin())))

    return implicit((2 * y0.size - 1,), slope, numbers, y0, span, method)


def _moves(section: SectionPlane, flow: Flow) -> Float[Array, "m n"]:
    """Derivatives of z and of the largest angles in n - 1 parameters and the level."""
    s = flow.y.size
    at, others = section.place(s // 2), jnp.asarray(section.free(s // 2))
    level = flow.moved[:, at] - jnp.eye(s, dtype=flow.y.dtype)[at]
    by_numbers = jnp.concatenate([flow.moved[:, s:], level[:, None]], axis=1)
    z = -solve(closing(section, flow.moved, flow.slope), by_numbers)
    own = jnp.concatenate([flow.extent_moved[:, s:], flow.extent_moved[:, at, None]], 1)
    return jnp.concatenate([z, flow.extent_moved[:, others] @ z[:-1] + own])


def multipliers(monodromy: Float[Array, "*n s s"]) -> Complex[Array, "*n s"]:
    """Eigenvalues (..., s): the one nearest to 1, then by falling modulus."""
    with own_flags():
        values = eigenvalues(monodromy)
        off = jnp.abs(values - 1)
        trivial = off == jnp.min(off, axis=-1, keepdims=True)
        order = jnp.argsort(-jnp.where(trivial, jnp.inf, jnp.abs(values)), axis=-1)
        return jnp.take_along_axis(values, order, axis=-1)


def attracts(monodromy: Float[Array, "*n s s"]) -> Bool[Array, "*n"]:
    """Whether all multipliers but the first lie inside the unit circle."""
    with own_flags():
        others = multipliers(fixed(monodromy))[..., 1:]
        return jnp.all(jnp.abs(others) < 1, axis=-1)


def cycle_method(question: str, method: Method, column: AbstractChain) -> Method:
    """The method of a cycle's motions."""
    usual = Explicit() if column.sticks else Explicit(dfx.Dopri8.tableau)
    return tangent_method(question, method, column.system(), usual)


class Approximation(NamedTuple):
    """Where Newton's method begins, NaN if it cannot, and what that has cost."""

    z: Unknowns
    section: SectionPlane
    failure: Int[Array, ""]  # a `CODE`; 0 if there is none
    left: Int[Array, ""]  # of the step budget


def approximation(
    column: AbstractChain,
    start: PhasePoint,
    period: Scalar | None,
    section: SectionPlane,
    returns: int,
    max_time: Scalar,
    method: Method,
) -> Approximation:
    """The first approximation: the guess, or where its motion returns."""
    dtype = jnp.result_type(start[0])
    valid = valid_scene(column, start)
    valid &= keeps("positive", method.rtol, method.atol, period)
    left, failure = jnp.asarray(method.max_steps, jnp.int32), 0
    if period is not None:
        n = column.joints
        level, period = start[section.place(n)], number("period", period, "positive")
        free = [fixed(start[i]) for i in section.free(n)]
        z = jnp.stack([*free, fixed(jnp.asarray(period, dtype))])
    else:
        max_time = number("max_time", max_time, "positive")
        valid &= keeps("finite", section.level) & keeps("positive", max_time)
        level = jnp.asarray(section.level, dtype)
        # only as good as Newton's method needs
        rough = Method(Explicit(), 1e-6, 1e-6).at_most(method.budget)
        span = fixed(jnp.where(valid, max_time, 0.0))
        z, back, steps = first_return(
            fixed(column).system(), fixed(start), fixed(section), returns, span, rough
        )
        left = left - steps
        late = jnp.where(left > 0, CODE.no_return, CODE.not_integrated)
        failure = jnp.where(back, 0, late)
    failure = jnp.where(valid, failure, CODE.invalid)
    section = SectionPlane(section.coordinate, level, section.rising)
    return Approximation(jnp.where(failure == 0, z, jnp.nan), section, failure, left)


def check_orbit(name: str, orbit: PeriodicOrbit, rods: int) -> None:
    """Refuse what is not one orbit of so many rods."""
    instance(name, orbit, PeriodicOrbit)
    if len(orbit.state.phi) != rods:
        raise ValueError(
            f"Argument `{name}` must be an orbit of {rods} rods, as the column is, but "
            f"is of {len(orbit.state.phi)}."
        )
    shape = np.shape(orbit.period)
    if shape:
        raise ValueError(
            f"Argument `{name}` must be one `PeriodicOrbit`, but holds orbits of shape "
            f"{shape}: take one, or `jax.vmap` over them."
        )
