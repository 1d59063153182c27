r"""Periodic orbits: shooting, Floquet multipliers, derivatives.

A cycle starts on the section $\phi_1 = s$ and closes after its period T:

$$R(z, p) = y(T; y_0, p) - y_0 = 0, \qquad z = (\phi_2, \omega_1, \omega_2, T).$$

Newton's method solves it, with the derivatives of the flow from the variational
equations; whether the cycle is stable makes no difference to it. The multipliers are
the eigenvalues of the monodromy matrix $\partial y(T)/\partial y_0$. One is 1, along
the motion; the cycle attracts where the others lie inside the unit circle. Where
friction is no jump, their product is $\exp \int_0^T \mathrm{div} f\,dt$. A joint that
sticks makes one zero.
"""

from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp

from ..context import plain
from ..model.column import Column, State
from ..motion.integrate import Method
from ..motion.observers import TIME, Amplitude, Extent
from ..motion.scene import (
    check_scene,
    explicit_method,
    float_state,
    recorded,
    tolerances,
    valid_scene,
)
from ..motion.variational import Flow
from ..numerics.numbers import keeps, number, whole_number
from ..results import ORBIT, Variable
from ..runtime import own_flags
from ..solvers import Explicit
from .implicit import fixed, undifferentiated
from .shooting import (
    SHORTEST,
    attached,
    blank_shot,
    closing,
    first_return,
    newton,
    shot_motion,
    shot_of,
    solve,
    start_of,
)

AT_REST = 1e-8  # a motion that starts no faster is none


class PeriodicOrbit(eqx.Module):
    r"""A periodic orbit, or the reason why there is none.

    `state`: on the section; `period`; `amplitude.rod`, `amplitude.joint` (2,): the
    largest angles; `monodromy` (4, 4); `residual`: by how much the orbit does not
    close; `iterations` of Newton's method; `steps` of all motions; `outcome`, a code of
    `ORBIT`. Unless that is `found`, all numbers of the orbit and their derivatives are
    NaN.
    """

    state: State
    period: Any
    amplitude: Extent
    monodromy: Any
    residual: Any
    iterations: Any
    steps: Any
    outcome: Any
    settings: tuple[tuple[str, Any], ...] = eqx.field(static=True)

    @property
    def multipliers(self) -> Any:
        """The Floquet multipliers, (4,) complex.

        The one nearest to 1, which belongs to the motion itself, stands first; then
        the others by falling modulus. They have no derivatives here (`ValueError`).
        """
        return multipliers(self.monodromy)

    @property
    def stable(self) -> Any:
        """Whether all multipliers but the first lie inside the unit circle."""
        return attracts(self.monodromy)

    def variables(self) -> dict[str, Variable]:
        """The numbers as a sweep labels them."""
        moduli = jnp.abs(self.multipliers)
        named = {"period": Variable(self.period, "period of the orbit", TIME)}
        named |= Amplitude().variables(self.amplitude)
        named |= {
            "largest_multiplier": Variable(
                moduli[1], "largest modulus of a Floquet multiplier but the trivial one"
            ),
            "stable": Variable(self.stable, "whether the orbit attracts"),
            "steps": Variable(self.steps, "attempted steps"),
            "outcome": Variable(
                self.outcome, "how the search for the orbit ended", codes=ORBIT
            ),
        }
        return named

    def attributes(self) -> dict[str, Any]:
        """How it was computed: the options that are the same at every point."""
        return dict(self.settings)


@plain
def periodic_orbit(
    column: Column,
    guess: State,
    *,
    period: Any = None,
    section: Any = 0.0,
    loops: int = 1,
    patience: Any = 200.0,
    rtol: Any = 1e-10,
    atol: Any = 1e-10,
    solver: Explicit | None = None,
    max_iterations: int = 20,
    max_steps: int = 100_000,
) -> PeriodicOrbit:
    r"""The periodic orbit near a guess, stable or not, with its multipliers.

    **Arguments:** (times in $\sqrt{m l^2/k}$)

    - `column`: with any damping and friction law, set-valued friction included.
    - `guess`: a state near the orbit, e.g. `settle(...).final`. Without a `period` the
        motion from there is followed until it passes the section $\phi_1$ = `section`
        upwards and has come back `loops` times, `patience` at most: the first
        approximation.
    - `period`: the orbit's, roughly; then `guess` itself is the first approximation,
        and its $\phi_1$ the section. For unstable orbits.
    - `rtol`, `atol`: tolerances of each step.
    - `solver`: `Explicit(tableau)`; None is Dopri8, with set-valued friction Tsit5.
    - `max_iterations` of Newton's method.
    - `max_steps`: the step budget of the whole search, the first return and all periods
        that Newton's method tries together; where it is spent the search ends as
        `not_integrated`. Derivatives follow the orbit once more, with another one.

    **Returns:** `PeriodicOrbit`. With set-valued friction the derivatives pass through
    every change of modes by its saltation matrix.

    **Derivatives:** of `state`, `period` and `amplitude`, forward and reverse, first
    order, in every leaf of the column, by the implicit function theorem: those of this
    orbit, at this section. Where it repels (`stable` is False, as of every orbit inside
    chaos) they say nothing of long motions nearby.

    **Raises:** `ValueError` for arguments that break a rule.

    Source: Y. A. Kuznetsov, Elements of Applied Bifurcation Theory (2004), section
    10.2; R. Leine, H. Nijmeijer (2004), chapter 8.
    """
    check_scene(column, guess, "guess")
    method = method_for(column, solver, rtol, atol, max_steps)
    loops = whole_number("loops", loops)
    still = fixed(column)
    start = fixed(float_state(guess))
    first = approximation(still, start, period, section, loops, patience, method)
    at = first.section

    def shot(z, left):
        share = method._replace(max_steps=left)
        return shot_motion(lambda p: still, jnp.zeros(0, z.dtype), at, z, share, False)

    def equations(z, flow):
        shot = shot_of(at, z, flow)
        return shot.residual, shot.jacobian, shot

    iterations = whole_number("max_iterations", max_iterations)
    blank = blank_shot(0, first.z.dtype)
    found = newton(shot, equations, first.z, blank, iterations, first.left)
    z, seen = found.z, found.shot.flow
    y0 = start_of(at, z)
    # the last shot was from just before the last step of Newton's
    extent = seen.extent + seen.extent_moved[:, 1:] @ found.move[:3]
    spent = (found.left <= 0) & ~found.converged
    at_rest = jnp.max(jnp.abs(seen.slope)) < AT_REST
    outcome = jnp.where(at_rest, ORBIT.collapsed, ORBIT.found)
    converged = found.converged & (z[3] > SHORTEST)
    outcome = jnp.where(converged, outcome, ORBIT.not_converged)
    outcome = jnp.where(seen.arrived & ~spent, outcome, ORBIT.not_integrated)
    outcome = jnp.where(first.failure == 0, outcome, first.failure)
    mark = jnp.where(outcome == ORBIT.found, 1.0, jnp.nan).astype(z.dtype)
    span = jnp.maximum(z[3], SHORTEST)
    change = attached(7, column, y0 * mark, span, method, _moves)
    z, extent = z + change[:4], extent + change[4:]
    z, extent = z * mark, extent * mark
    return PeriodicOrbit(
        state=State((at * mark, z[0]), (z[1], z[2])),
        period=z[3],
        amplitude=Extent(extent[:2], extent[jnp.array([0, 2])]),
        monodromy=seen.moved * fixed(mark),
        residual=jnp.max(jnp.abs(found.shot.residual)) * fixed(mark),
        iterations=found.count,
        steps=method.max_steps - found.left,
        outcome=outcome.astype(jnp.int8),
        settings=recorded(
            **settings_of(method, period, section, loops, patience),
            max_iterations=iterations,
        ),
    )


def _moves(seen: Flow) -> Any:
    """Derivatives of z and of the largest angles in the n parameters, (7, n)."""
    jacobian = closing(seen.moved[:, :4], seen.slope)
    z = -solve(jacobian, seen.moved[:, 4:])
    extent = seen.extent_moved[:, 1:4] @ z[:3] + seen.extent_moved[:, 4:]
    return jnp.concatenate([z, extent])


def multipliers(monodromy: Any) -> Any:
    """Eigenvalues (..., 4): the one nearest to 1, then by falling modulus."""
    with own_flags():
        return _multipliers(undifferentiated(monodromy))


def attracts(monodromy: Any) -> Any:
    """Whether all multipliers but the first lie inside the unit circle."""
    with own_flags():
        others = _multipliers(undifferentiated(monodromy))[..., 1:]
        return jnp.all(jnp.abs(others) < 1, axis=-1)


def _multipliers(monodromy: Any) -> Any:
    bad = ~jnp.all(jnp.isfinite(monodromy), axis=(-1, -2), keepdims=True)
    eye = jnp.broadcast_to(jnp.eye(4, dtype=monodromy.dtype), monodromy.shape)
    values = jnp.linalg.eigvals(jnp.where(bad, eye, monodromy))
    off = jnp.abs(values - 1)
    trivial = off == jnp.min(off, axis=-1, keepdims=True)
    order = jnp.argsort(-jnp.where(trivial, jnp.inf, jnp.abs(values)), axis=-1)
    values = jnp.take_along_axis(values, order, axis=-1)
    return jnp.where(bad[..., 0], jnp.nan, values)


def method_for(
    column: Column, solver: Explicit | None, rtol: Any, atol: Any, max_steps: int
) -> Method:
    """The method of a periodic orbit's motions."""
    rtol, atol = tolerances(rtol, atol)
    usual = Explicit() if column.sticks else Explicit(dfx.Dopri8.tableau)
    return Method(
        explicit_method(solver, usual), rtol, atol, whole_number("max_steps", max_steps)
    )


class Approximation(NamedTuple):
    """Where Newton's method begins, NaN if it cannot, and what that has cost."""

    z: Any
    section: Any
    failure: Any  # a code of `ORBIT`; 0 if there is none
    left: Any  # of the step budget


def approximation(
    column: Column,
    start: Any,
    period: Any,
    section: Any,
    loops: int,
    patience: Any,
    method: Method,
) -> Approximation:
    """The first approximation: the guess, or where its motion returns."""
    dtype = start[0].dtype
    valid = valid_scene(column, start)
    valid &= keeps("positive", method.rtol, method.atol, period)
    left, failure = jnp.asarray(method.max_steps, jnp.int32), 0
    if period is not None:
        at, period = start[0], number("period", period, "positive")
        z = jnp.stack([*start[1:], jnp.asarray(period, dtype)])
    else:
        section = number("section", section)
        patience = number("patience", patience, "positive")
        valid &= keeps("finite", section) & keeps("positive", patience)
        at = fixed(jnp.asarray(section, dtype))
        # only as good as Newton's method needs
        rough = method._replace(solver=Explicit(), rtol=1e-6, atol=1e-6)
        span = jnp.where(valid, patience, 0.0)
        z, back, steps = first_return(column, start, at, loops, span, rough)
        left = left - steps
        late = jnp.where(left > 0, ORBIT.no_return, ORBIT.not_integrated)
        failure = jnp.where(back, 0, late)
    failure = jnp.where(valid, failure, ORBIT.invalid)
    return Approximation(jnp.where(failure == 0, z, jnp.nan), at, failure, left)


def settings_of(
    method: Method, period: Any, section: Any, loops: int, patience: Any
) -> dict[str, Any]:
    """The options of a periodic orbit, for the record."""
    first = {"period": period}
    if period is None:
        first = {"section": section, "patience": patience}
    first = {name: number(name, x) for name, x in first.items()}
    if period is None:
        first["loops"] = loops
    return {
        "solver": method.solver.name,
        "rtol": method.rtol,
        "atol": method.atol,
        **first,
        "max_steps": method.max_steps,
    }
