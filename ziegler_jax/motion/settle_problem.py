"""The integration problem that `settle` poses: column, start, windows, observers."""

from collections.abc import Sequence
from typing import cast

from ..model.column import Column, State
from ..numerics.numbers import Option, Scalar, keeps
from ..results import OUTCOME
from .integrate import Motion
from .observers import AbstractObserver
from .options import Method, Windows, windows_for
from .scene import (
    check_scene,
    float_state,
    method_of,
    rate_cut_of,
    usual_method,
    valid_scene,
    with_amplitude,
)
from .windows import Rest, SettleFold, SpanState, WindowState


class SettleProblem(Motion[SpanState[WindowState]]):
    """A motion that ends when it has settled.

    **Arguments:** those of `settle`; `question`: whose defaults hold; `strict`: for a
    verdict alone, see `SettleFold`.
    """

    def __init__(
        self,
        column: Column,
        start: State,
        question: str,
        windows: Windows,
        observers: Sequence[AbstractObserver],
        method: Method,
        strict: bool = False,
    ):
        """Check the scene and set up the watch."""
        check_scene(column, start)
        y0 = float_state(start)
        method = method_of(question, method, column, usual_method(column))
        windows = windows_for(question, windows, rate_cut_of(column))
        self.watch = watch = SettleFold(
            transient=cast(Scalar, windows.transient),
            span=cast(Scalar, windows.length),
            most=cast(int, windows.max_windows),
            agreement=cast(Scalar, windows.agreement),
            escape=cast(Scalar, windows.escape),
            rest=Rest(windows.rate_cut, at_once=strict),
            observers=with_amplitude(observers, column),
            strict=strict,
        )
        valid = valid_scene(column, y0) & watch.valid()
        super().__init__(
            column,
            y0,
            watch,
            method,
            valid=valid & keeps("positive", method.rtol, method.atol),
            first_stop=watch.first_stop(),
            end=watch.last_stop(),
            at_end=OUTCOME.unsettled,
        )

    def settings(self) -> dict[str, Option]:
        """The options, for the record."""
        watch = self.watch
        return {
            **self.method.settings(),
            "transient": watch.transient,
            "window_length": watch.span,
            "max_windows": watch.most,
            "agreement": watch.agreement,
            "escape": watch.escape,
            "rate_cut": watch.rest.setting(),
            **(self.column.friction.settings() if self.column.friction else {}),
        }
