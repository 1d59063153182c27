"""A motion under the watch of `settle`, from its start to its verdict."""

from typing import Any

from ..context import overridden_solver
from ..model.column import Column, State
from ..numerics.numbers import keeps, number, whole_number
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
    with_amplitude,
)
from .windows import Rest, Windows


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
            span=number("window", window, "positive"),
            most=whole_number("max_windows", max_windows),
            rtol_settle=number("rtol_settle", rtol_settle, "positive"),
            escape=number("escape", escape, "positive"),
            rest=Rest(rate_cut_of(column, rate_cut), at_once=strict),
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
            first_stop=watch.first_stop(),
            end=watch.last_stop(),
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
            "window": watch.span,
            "max_windows": watch.most,
            "max_steps": self.method.max_steps,
            "rtol_settle": watch.rtol_settle,
            "escape": watch.escape,
            "rate_cut": watch.rest.setting(),
            **(self.column.friction.settings() if self.column.friction else {}),
        }
