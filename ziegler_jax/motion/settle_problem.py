"""A motion under the watch of `settle`, from its start to its verdict."""

from typing import Any

from ..context import overridden_solver
from ..model.column import Column, State
from ..numerics.numbers import keeps, number
from ..results import OUTCOME
from .integrate import Method, Motion
from .observers import AbstractObserver
from .scene import (
    check_scene,
    float_state,
    method_of,
    rate_cut_of,
    tolerances,
    usual_method,
    valid_scene,
    whole_number,
    with_amplitude,
)
from .windows import Windows, first_stop, last_stop


class Settling(Motion):
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
        solver: Any,
        escape: Any,
        rate_cut: Any,
        max_steps: int,
        strict: bool = False,
    ):
        """Check the scene and set up the watch."""
        check_scene(column, start)
        y0 = float_state(start)
        rtol, atol = tolerances(rtol, atol)
        solver = overridden_solver(solver)
        solver = method_of(solver, column, usual_method(column))
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
        valid = valid_scene(column, y0) & watch.valid() & keeps("positive", rtol, atol)
        super().__init__(
            column,
            y0,
            watch,
            Method(solver, rtol, atol, whole_number("max_steps", max_steps)),
            valid=valid,
            first_stop=first_stop(watch.transient, watch.window),
            end=last_stop(watch.transient, watch.window, watch.max_windows),
            at_end=OUTCOME.unsettled,
        )

    def settings(self) -> dict[str, Any]:
        """The options, for the record."""
        watch = self.watch
        return {
            "solver": self.method.solver.name,
            "rtol": self.method.rtol,
            "atol": self.method.atol,
            "transient": watch.transient,
            "window": watch.window,
            "max_windows": watch.max_windows,
            "max_steps": self.method.max_steps,
            "rtol_settle": watch.rtol_settle,
            "escape": watch.escape,
            "rate_cut": "by modes" if watch.by_modes else watch.rate_cut,
            **(self.column.friction.settings() if self.column.friction else {}),
        }
