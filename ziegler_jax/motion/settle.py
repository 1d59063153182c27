"""`settle`: the long-run motion of a column, as numbers."""

from collections.abc import Sequence
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Shaped

from ..model.column import Column, State
from ..results import (
    OUTCOME,
    AbstractDescribed,
    AbstractMotionResult,
    Variable,
    checked,
    quantity,
    without_values,
)
from . import not_finite
from .integrate import Run, follow
from .observers import AbstractObserver
from .options import Method, Windows, recorded
from .scene import ending, nan_where
from .settle_problem import SettleProblem
from .windows import SpanState, WindowState


class Settled(AbstractDescribed, AbstractMotionResult[State]):
    """The long-run motion of one lane, as numbers.

    Beside the fields, each observer adds attributes: `rod_amplitude` and
    `joint_amplitude` always, and `period`, `stick_fraction`, `mean_angle`,
    `follower_power`, ... where asked for.
    """

    numbers: dict[str, Shaped[Array, "..."]]
    quantities: tuple[tuple[str, Variable], ...] = eqx.field(static=True)
    drift: Float[Array, "*lanes"] = eqx.field(
        metadata=quantity("relative change of the amplitudes over the last window")
    )
    windows: Int[Array, "*lanes"] = eqx.field(metadata=quantity("observed windows"))


@not_finite.motion
def settle(
    column: Column,
    start: State,
    *,
    windows: Windows = Windows(),  # noqa: B008, a value
    observers: Sequence[AbstractObserver] = (),
    method: Method = Method(),  # noqa: B008
) -> Settled:
    r"""Kick the column and wait: what its motion settles to.

    After a transient, windows follow each other until the amplitudes of two consecutive
    ones agree, $\max_j |A_j - A_j'| \le$ `agreement` $\max_j A_j$ over the largest
    $|\phi_1|, |\phi_2|, |\phi_2 - \phi_1|$, until both joint rates stayed below
    `rate_cut` for a whole window and were no faster than in the window before, or until
    `max_windows` are over. The result is that of the last window.

    **Arguments:**

    - `column`, `start`: the scene.
    - `windows`: as above, see `Windows`. With one window there is nothing to compare:
        the outcome is `unsettled` or `stuck`. Near a threshold motions decide slowly.
        Of 10 000 random points of the main job's map 10 windows leave 7.5 % unsettled
        and 40 leave 2.4 % for 14 % more steps, where `agreement` is 1e-3. Then 1.7 %
        pass for cycles that a run of 160 windows at 2e-5 does not confirm within 1 %:
        most are on their slow way past an unstable cycle. At 2e-4 these are 0.9 %
        (3.2 % unsettled, 13 % more steps), at 5e-5 0.6 % (4.0 %, 21 % more again):
        `benchmarks/a4_settling.py`.
    - `observers`: what to watch beside `Amplitude()`, e.g. `(Period(),
        StickFraction())`. What is not asked for is not in the program.
    - `method`: any, see `Method`. On friction cycles (q = 2.6, $\tau$ = 0.026, v_smooth
        from 0.3 to 0.003) the default tolerance 1e-6 leaves up to 7e-5 rad in an
        amplitude, 1e-7 6e-6 for 1.4 times the steps. With friction the default, Tsit5,
        is the cheapest down to what its tolerance gives, an error of 4e-5 after 100
        time units (`benchmarks/b0_work_precision.py`); from there Calvo7 is, and Dopri8
        from 1e-9 on.

    **Returns:** `Settled`. Where the outcome is a failure (before `unsettled` in
    `OUTCOME`), observed numbers and `drift` are NaN.

    **Raises:** `ValueError` for arguments that break a rule, and in a 32-bit
    session. `jax.jvp` passes through, `jax.grad` does not (the number of steps is not
    known beforehand).
    """
    motion = SettleProblem(column, start, "settle", windows, observers, method)
    return settled(motion, follow(motion))


def settled(motion: SettleProblem, run: Run[SpanState[WindowState]]) -> Settled:
    """What a motion that has ended amounts to."""
    fold, watch, y1 = motion.watch, run.folded.watch, run.y
    failed = run.outcome < OUTCOME.unsettled
    named: dict[str, Variable] = {}
    for observer, state in zip(fold.observers, watch.observed, strict=True):
        whose = f"The result of the observer `{observer.name}`"
        result = observer.result(motion.column, state, fold.span, y1)
        for name, variable in checked(whose, result).items():
            if name in named or name in Settled.__dataclass_fields__:
                raise ValueError(
                    f"{whose} must name its numbers unlike those of `settle` and of "
                    f"other observers, but has `{name}`."
                )
            lost = 0 if variable.codes is not None else jnp.nan
            value = jnp.asarray(variable.value)
            value = jnp.where(failed, jnp.asarray(lost, value.dtype), value)
            named[name] = variable._replace(value=value)
    return Settled(
        numbers={name: cast(jax.Array, v.value) for name, v in named.items()},
        quantities=without_values(named),
        drift=nan_where(failed | ~jnp.isfinite(watch.drift), watch.drift),
        windows=run.folded.spans,
        settings=recorded(**motion.settings()),
        **ending(run),
    )
