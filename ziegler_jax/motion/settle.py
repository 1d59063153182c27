"""`settle`: the long-run motion of a column, as numbers."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..model.column import Column, State
from ..results import OUTCOME, AbstractMotionResult, Variable, checked, quantity
from . import not_finite
from .integrate import Run, follow
from .observers import AbstractObserver
from .scene import Solver, ending, nan_where, recorded
from .settle_problem import Settling


class Settled(AbstractMotionResult):
    """The long-run motion of one lane, as numbers.

    Beside the fields, each observer adds an attribute of its name: `amplitude` always,
    and `period`, `stick_fraction`, `mean`, `power` where asked for.
    """

    observed: dict[str, Any]
    drift: Any = eqx.field(
        metadata=quantity("relative change of the amplitudes over the last window")
    )
    windows: Any = eqx.field(metadata=quantity("observed windows"))
    observers: tuple[AbstractObserver, ...]

    def __getattr__(self, name: str) -> Any:
        """What an observer of that name found."""
        observed = self.__dict__.get("observed", {})
        if name in observed:
            return observed[name]
        raise AttributeError(
            f"`settle` did not observe `{name}`: it was asked for "
            f"{', '.join(observed)} only."
        )

    def variables(self) -> dict[str, Variable]:
        """All numbers with their names, units and dimensions, for `sweep`."""
        named: dict[str, Variable] = {}
        for observer in self.observers:
            found = observer.variables(self.observed[observer.name])
            named |= checked(f"the observer `{observer.name}`", found)
        return named | super().variables()


@not_finite.motion
def settle(
    column: Column,
    start: State,
    *,
    transient: Any = 100.0,
    window: Any = 40.0,
    max_windows: int = 40,
    rtol_settle: Any = 2e-4,
    observers: tuple[AbstractObserver, ...] = (),
    rtol: Any = 1e-6,
    atol: Any = 1e-6,
    solver: Solver = None,
    escape: Any = np.pi,
    rate_cut: Any = None,
    max_steps: int = 1_000_000,
) -> Settled:
    r"""Kick the column and wait: what its motion settles to.

    After `transient` time units, windows of length `window` follow each other until
    the amplitudes of two consecutive ones agree,
    $\max_j |A_j - A_j'| \le$ `rtol_settle` $\max_j A_j$ over the largest
    $|\phi_1|, |\phi_2|, |\phi_2 - \phi_1|$, until both joint rates stayed below
    `rate_cut` for a whole window and were no faster than in the window before, or until
    `max_windows` are over. The result is that of the last window.

    **Arguments:** (times in $\sqrt{m l^2/k}$)

    - `column`, `start`: the scene.
    - `transient`, `window`, `max_windows`, `rtol_settle`: as above. With one window
        there is nothing to compare: the outcome is `unsettled` or `stuck`. Near a
        threshold motions decide slowly. Of 10 000 random points of the main job's map
        10 windows leave 7.5 % unsettled and 40 leave 2.4 % for 14 % more steps, where
        `rtol_settle` is 1e-3. Then 1.7 % pass for cycles that a run of 160 windows at
        2e-5 does not confirm within 1 %: most are on their slow way past an unstable
        cycle. At 2e-4 these are 0.9 % (3.2 % unsettled, 13 % more steps), at 5e-5 0.6 %
        (4.0 %, 21 % more again): `benchmarks/a4_settling.py`.
    - `observers`: what to watch beside `Amplitude()`, e.g. `(Period(),
        StickFraction())`. What is not asked for is not in the program.
    - `rtol`, `atol`: tolerances of each step. On friction cycles (q = 2.6,
        $\tau$ = 0.026, v_smooth from 0.3 to 0.003) 1e-6 leaves up to 7e-5 rad in an
        amplitude, 1e-7 6e-6 for 1.4 times the steps.
    - `solver`: `Explicit(tableau)`; `Rosenbrock()` for stiff lanes (`is_stiff` says
        which are); None is Tsit5, with friction the cheapest down to what the default
        tolerances give, an error of 4e-5 after 100 time units
        (`benchmarks/b0_work_precision.py`); from there Calvo7 is, and Dopri8 from 1e-9
        on. With set-valued friction None is `Taylor()`, but Tsit5 with the load
        `JointReaction()`.
    - `escape`: a rod's angle beyond which the lane ends as `escaped`.
    - `rate_cut`: the joint rate below which a joint rests. None is the friction law's
        (`v_smooth`; with set-valued friction what sticks rests); without friction 1e-6.
    - `max_steps`: the step budget.

    **Returns:** `Settled`. Where the outcome is a failure (before `unsettled` in
    `OUTCOME`), observed numbers and `drift` are NaN.

    **Raises:** `ValueError` for arguments that break a rule, and in a 32-bit
    session. `jax.jvp` passes through, `jax.grad` does not (the number of steps is not
    known beforehand).
    """
    motion = Settling(
        column,
        start,
        transient=transient,
        window=window,
        max_windows=max_windows,
        rtol_settle=rtol_settle,
        observers=observers,
        rtol=rtol,
        atol=atol,
        solver=solver,
        escape=escape,
        rate_cut=rate_cut,
        max_steps=max_steps,
    )
    return settled(motion, follow(motion))


def settled(motion: Settling, run: Run) -> Settled:
    """What a motion that has ended amounts to."""
    fold, watch, y1 = motion.watch, run.folded.watch, run.y
    failed = run.outcome < OUTCOME.unsettled
    observed = {
        observer.name: nan_where(
            failed, observer.result(motion.column, state, fold.span, y1)
        )
        for observer, state in zip(fold.observers, watch.observed, strict=True)
    }
    return Settled(
        observed=observed,
        drift=nan_where(failed | ~jnp.isfinite(watch.drift), watch.drift),
        windows=run.folded.spans,
        observers=fold.observers,
        settings=recorded(**motion.settings()),
        **ending(run),
    )
