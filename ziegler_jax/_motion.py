"""One motion under a watch, from its start to its verdict, in one go or in legs."""

from typing import Any, NamedTuple

import diffrax as dfx
import jax
import jax.numpy as jnp

from ._scene import (
    check_scene,
    float_state,
    outcome_of,
    prepared,
    rate_cut_of,
    tolerances,
    valid_scene,
    whole_number,
    with_amplitude,
)
from ._types import Vector4, number
from ._windows import Windows
from .column import Column, State, vector_field
from .observers import AbstractObserver
from .outcome import OUTCOME
from .set_valued import SetValuedCoulomb
from .solvers import Explicit, LandingControl, Observed, StepControl, StickSlip

FIRST_STEP = 0.01


class Run(NamedTuple):
    """Where a motion is: what a leg hands to the next."""

    solver: Any
    control: Any
    steps: Any
    outcome: Any  # `not_computed` while it runs

    @property
    def y(self) -> Vector4:
        """The state."""
        return self.solver.y

    @property
    def running(self) -> Any:
        """Whether the motion has no verdict yet."""
        return self.outcome == OUTCOME.not_computed


class Motion:
    """A column and the watch over its motion, by the options of `settle`."""

    def __init__(
        self,
        column: Column,
        start: State,
        *,
        transient: Any,
        window: Any,
        max_windows: int,
        rtol_settle: Any,
        observers: tuple[AbstractObserver, ...],
        rtol: Any,
        atol: Any,
        solver: Explicit | None,
        escape: Any,
        rate_cut: Any,
        max_steps: int,
        strict: bool = False,
    ):
        """Check the scene and choose the machine that its friction needs."""
        check_scene(column, start)
        self.column, self.start = column, start
        self.watch = watch = Windows(
            transient=number("transient", transient, "nonnegative"),
            window=number("window", window, "positive"),
            max_windows=whole_number("max_windows", max_windows),
            rtol_settle=number("rtol_settle", rtol_settle, "positive"),
            escape=number("escape", escape, "positive"),
            rate_cut=rate_cut_of(column, rate_cut),
            observers=with_amplitude(observers, column),
            strict=strict,
        )
        self.rtol, self.atol = tolerances(rtol, atol)
        self.method = Explicit() if solver is None else solver
        self.max_steps = whole_number("max_steps", max_steps)
        self.args = prepared(column)
        self.solver, self.control = machine(
            column, self.method, watch, self.rtol, self.atol
        )
        self.terms = dfx.ODETerm(vector_field)

    def begin(self) -> Run:
        """The motion before its first step."""
        y0 = float_state(self.start)
        zero = jnp.zeros((), y0[0].dtype)
        good = valid_scene(self.column, y0) & self.watch.valid()
        good &= (self.rtol > 0) & (self.atol > 0)
        invalid = jnp.where(good, OUTCOME.not_computed, OUTCOME.invalid)
        return Run(
            solver=self.solver.init(self.terms, zero, zero, y0, self.args),
            control=self.control.start(zero, FIRST_STEP, self.watch.first_stop()),
            steps=jnp.zeros((), jnp.int32),
            outcome=invalid.astype(jnp.int32),
        )

    def settings(self) -> dict[str, Any]:
        """The options, for the record."""
        watch = self.watch
        return {
            "solver": self.method.name,
            "rtol": self.rtol,
            "atol": self.atol,
            "transient": watch.transient,
            "window": watch.window,
            "max_windows": watch.max_windows,
            "rtol_settle": watch.rtol_settle,
            "escape": watch.escape,
            "rate_cut": "by modes" if watch.by_modes else watch.rate_cut,
            **_rule(self.column),
        }

    def advance(self, run: Run, quota: Any = None) -> Run:
        """The motion after at most `quota` more steps; None: at its end."""
        watch = self.watch
        left = self.max_steps - run.steps
        left = left if quota is None else jnp.minimum(left, quota)
        # the watch ends a motion before this; one that has ended does not move
        end = watch.transient + watch.window * (watch.max_windows + 1)
        t = run.control.t
        solution = dfx.diffeqsolve(
            self.terms,
            self.solver,
            t0=t,
            t1=jnp.where(run.running, jnp.zeros_like(t) + end, t),
            # t + (t_next - t) is t_next to the last bit as soon as t >= t_next / 2
            # (Sterbenz), and a leg is many steps long: a pause changes nothing
            dt0=run.control.t_next - t,
            y0=run.solver.y,
            args=self.args,
            stepsize_controller=self.control,
            solver_state=run.solver,
            controller_state=run.control._replace(left=left.astype(jnp.int32)),
            saveat=dfx.SaveAt(solver_state=True, controller_state=True),
            max_steps=None,  # the controller counts
            throw=False,
            adjoint=dfx.ForwardMode(),
        )
        after: Any = solution.solver_state
        steps = run.steps + solution.stats["num_steps"]
        watched = after.folded
        spent = (watched.outcome == OUTCOME.not_computed) & (steps >= self.max_steps)
        ended = jnp.where(spent, OUTCOME.budget_spent, watched.outcome)
        if isinstance(self.solver, StickSlip):
            ended = unless_chattering(self.solver, after, ended)
        ended = outcome_of(solution.result, after.slope, ended)
        outcome = jnp.where(run.running, ended, run.outcome)
        return Run(after, solution.controller_state, steps, outcome)


def machine(column: Column, solver: Explicit, fold: Any, rtol: Any, atol: Any) -> Any:
    """The observing solver and the controller that the friction law needs."""
    if isinstance(column.friction, SetValuedCoulomb):
        control = LandingControl(rtol, atol)  # pyright: ignore[reportCallIssue]
        return StickSlip(solver, fold, atol), control
    control = StepControl(rtol, atol)  # pyright: ignore[reportCallIssue]
    return Observed(solver, fold), control


def unless_chattering(solver: StickSlip, state: Any, otherwise: Any) -> jax.Array:
    """`chattering` where events follow each other without time between."""
    return jnp.where(solver.chatters(state), OUTCOME.chattering, otherwise)


def _rule(column: Column) -> dict[str, str]:
    """The name of the friction law's rule, where it has one."""
    law = column.friction
    return {"release": law.release} if isinstance(law, SetValuedCoulomb) else {}
