"""How wrong a map is: the smoothed friction law held against the set-valued one."""

from collections.abc import Mapping
from typing import ClassVar, cast

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..context import plain
from ..model.column import Column, State
from ..model.set_valued import SetValuedCoulomb
from ..model.sticking_set import check_sticks
from ..motion.observers import Period, StickFraction
from ..motion.options import Method, Windows
from ..numerics.numbers import Joints, Scalar
from ..results import OUTCOME, TIME, AbstractResult, Settings, Variable
from ..steady.settle import Settled, settle


def _error(of: str, units: str = "1", *dims: str) -> Variable:
    return Variable(None, f"{of} error of smoothing", units, dims)


class RegularisationError(AbstractResult):
    """One scene under both laws. Errors are smoothed less set-valued.

    An error is NaN where a lane failed, or has no such number.
    """

    set_valued: Settled
    smoothed: Settled

    DERIVED: ClassVar[Mapping[str, Variable]] = {
        "rod_amplitude_error": _error("rod amplitude", "rad", "rod"),
        "joint_amplitude_error": _error("joint amplitude", "rad", "joint"),
        "period_error": _error("period", TIME),
        "stick_fraction_error": _error("stick fraction", "1", "joint"),
        "wrong_verdict": Variable(
            None, "whether only one of both laws sticks for good"
        ),
        "set_valued_outcome": Variable(
            None, "how the motion ended, set-valued law", codes=OUTCOME
        ),
        "smoothed_outcome": Variable(
            None, "how the motion ended, smoothed law", codes=OUTCOME
        ),
    }

    @property
    def settings(self) -> Settings:  # pyright: ignore[reportIncompatibleVariableOverride]
        """How both were computed."""
        both = {"smoothed": self.smoothed, "set_valued": self.set_valued}
        return tuple(
            (f"{law}_{name}", value)
            for law, run in both.items()
            for name, value in run.settings
        )

    @property
    def rod_amplitude_error(self) -> Float[Array, "*lanes 2"]:
        """That of the rods' amplitudes, (2,), in rad."""
        return self.smoothed.rod_amplitude - self.set_valued.rod_amplitude

    @property
    def joint_amplitude_error(self) -> Float[Array, "*lanes 2"]:
        """That of the joints' amplitudes, (2,), in rad."""
        return self.smoothed.joint_amplitude - self.set_valued.joint_amplitude

    @property
    def period_error(self) -> Float[Array, "*lanes"]:
        """That of the period."""
        return self.smoothed.period - self.set_valued.period

    @property
    def stick_fraction_error(self) -> Float[Array, "*lanes 2"]:
        """That of the stick fractions, (2,): of creep against stick."""
        return self.smoothed.stick_fraction - self.set_valued.stick_fraction

    @property
    def set_valued_outcome(self) -> Int[Array, "*lanes"]:
        """A code of `OUTCOME`."""
        return self.set_valued.outcome

    @property
    def smoothed_outcome(self) -> Int[Array, "*lanes"]:
        """A code of `OUTCOME`."""
        return self.smoothed.outcome

    @property
    def wrong_verdict(self) -> Float[Array, "*lanes"]:
        """1. where one law sticks for good and the other does not; else 0."""
        ended = self.set_valued.outcome, self.smoothed.outcome
        differ = (ended[0] == OUTCOME.stuck) != (ended[1] == OUTCOME.stuck)
        # one that turned over has not stuck; other failures are no verdict
        unknown = False
        for code in ended:
            unknown |= (code < OUTCOME.unsettled) & (code != OUTCOME.escaped)
        wrong = jnp.where(differ, 1.0, 0.0)
        return jnp.where(unknown, jnp.nan, wrong)


@plain
def regularisation_error(
    column: Column,
    start: State,
    v_smooth: Scalar,
    v_stribeck: Joints | None = None,
    *,
    windows: Windows = Windows(),  # noqa: B008, a value
    method: Method = Method(),  # noqa: B008
) -> RegularisationError:
    r"""What smoothing the friction law does to the long run of one scene.

    The smoothed law tends to the set-valued one as $v_{smooth} \to 0$ only with
    $\mu_s = \mu_k$, or as $v_{stribeck} \to 0$ with $v_{smooth}/v_{stribeck} \to 0$;
    else the errors hold the difference of two laws, too.

    **Arguments:**

    - `column`, with `SetValuedCoulomb` friction; `start`.
    - `v_smooth`, `v_stribeck`: of the smoothed law, with the same coefficients, pin
        radius and load. `v_stribeck` where $\mu_k$ differs.
    - `windows`, `method`: of `settle`, for both.

    **Returns:** `RegularisationError`.

    **Raises:** `ValueError` as `settle` and `SmoothCoulomb`, and for another law.
    """
    check_sticks(column)
    law = cast(SetValuedCoulomb, column.friction)
    smooth = law.smoothed(v_smooth, v_stribeck)
    smoothed = eqx.tree_at(lambda c: c.friction, column, smooth)
    watched = Period(), StickFraction()

    def run(column: Column) -> Settled:
        return settle(
            column, start, windows=windows, observers=watched, method=method,
            certify=False,
        )  # fmt: skip

    both = run(column), run(smoothed)
    return RegularisationError(*both)  # pyright: ignore[reportCallIssue]
