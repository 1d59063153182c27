"""How wrong a map is: the smoothed friction law held against the set-valued one."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from ..context import plain
from ..model.column import Column, State
from ..model.sticking_set import check_sticks
from ..motion.observers import Period, StickFraction
from ..motion.settle import Settled, settle
from ..numerics.numbers import check_options
from ..results import OUTCOME, Variable


class RegularisationError(eqx.Module):
    """One scene under both laws. Differences are smoothed less set-valued.

    A difference is NaN where a lane failed, or has no such number.
    """

    set_valued: Settled
    smoothed: Settled

    @property
    def rod_amplitude(self) -> Any:
        """The difference of the rods' amplitudes, (2,), in rad."""
        return self.smoothed.amplitude.rod - self.set_valued.amplitude.rod

    @property
    def joint_amplitude(self) -> Any:
        """The difference of the joints' amplitudes, (2,), in rad."""
        return self.smoothed.amplitude.joint - self.set_valued.amplitude.joint

    @property
    def period(self) -> Any:
        """The difference of the periods."""
        return self.smoothed.period - self.set_valued.period

    @property
    def stick_fraction(self) -> Any:
        """The difference of the stick fractions, (2,): of creep against stick."""
        return self.smoothed.stick_fraction - self.set_valued.stick_fraction

    @property
    def wrong_verdict(self) -> Any:
        """1. where one law sticks for good and the other does not; else 0."""
        ended = self.set_valued.outcome, self.smoothed.outcome
        differ = (ended[0] == OUTCOME.stuck) != (ended[1] == OUTCOME.stuck)
        # one that turned over has not stuck; other failures are no verdict
        unknown = False
        for code in ended:
            unknown |= (code < OUTCOME.unsettled) & (code != OUTCOME.escaped)
        wrong = jnp.where(differ, 1.0, 0.0)
        return jnp.where(unknown, jnp.nan, wrong)

    def variables(self) -> dict[str, Variable]:
        """The differences, the verdict and both outcomes, for `sweep`."""
        numbers = {
            "rod_amplitude_error": (self.rod_amplitude, "rad", ("rod",)),
            "joint_amplitude_error": (self.joint_amplitude, "rad", ("joint",)),
            "period_error": (self.period, "sqrt(m l^2/k)", ()),
            "stick_fraction_error": (self.stick_fraction, "1", ("joint",)),
        }
        named = {
            name: Variable(value, f"{name.replace('_', ' ')} of smoothing", unit, dims)
            for name, (value, unit, dims) in numbers.items()
        }
        meaning = "whether only one of both laws sticks for good"
        named["wrong_verdict"] = Variable(self.wrong_verdict, meaning)
        for name, settled in (
            ("outcome_set_valued", self.set_valued),
            ("outcome_smoothed", self.smoothed),
        ):
            meaning = f"how the motion ended, {name.split('_', 1)[1]} law"
            named[name] = Variable(settled.outcome, meaning, codes=OUTCOME)
        return named

    def attributes(self) -> dict[str, Any]:
        """How both were computed."""
        return {**self.smoothed.attributes(), **self.set_valued.attributes()}


@plain
def regularisation_error(
    column: Column, start: State, v_smooth: Any, v_stribeck: Any = None, **options: Any
) -> RegularisationError:
    r"""What smoothing the friction law does to the long run of one scene.

    The smoothed law tends to the set-valued one as $v_{smooth} \to 0$ only with
    $\mu_s = \mu_k$, or as $v_{stribeck} \to 0$ with $v_{smooth}/v_{stribeck} \to 0$;
    else the differences hold the difference of two laws, too.

    **Arguments:**

    - `column`, with `SetValuedCoulomb` friction; `start`.
    - `v_smooth`, `v_stribeck`: of the smoothed law, with the same coefficients, pin
        radius and load. `v_stribeck` where $\mu_k$ differs.
    - `options`: of `settle`, for both; `observers` are `Period()`, `StickFraction()`.

    **Returns:** `RegularisationError`.

    **Raises:** `ValueError` as `settle` and `SmoothCoulomb`, and for another law.
    """
    check_sticks(column)
    law: Any = column.friction
    smooth = law.smoothed(v_smooth, v_stribeck)
    smoothed = eqx.tree_at(lambda c: c.friction, column, smooth)
    check_options("regularisation_error", options, settle)
    options = {"observers": (Period(), StickFraction()), **options}
    return RegularisationError(
        settle(column, start, **options), settle(smoothed, start, **options)
    )
