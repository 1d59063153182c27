r"""Options as values: how a motion is integrated, and how long it is followed.

None in a value is the default of the question that it is given to. All of these stand
in the tables of this file, and what was used in the attributes of a result.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, Self, cast

import diffrax as dfx
import equinox as eqx
import numpy as np

from ..numerics.no_number import refused
from ..numerics.numbers import Count, Option, Scalar
from ..numerics.rules import instance, number, whole_number
from ..results import RATE, TIME, Settings
from ..solvers import Explicit, Rosenbrock, Taylor

Solver = Explicit | Rosenbrock | Taylor
NO_SLOPE = (
    "Arguments `rtol` and `atol` have no derivatives, but one in them was asked for: "
    "what a tolerance changes is an error, no smooth function of it. Compare two "
    "tolerances; one that follows a parameter goes through `jax.lax.stop_gradient`."
)
# whose numbers are those of a motion's steps
OF_STEPS = {"settle", "sweep_up_down", "trajectory", "poincare"}


class AbstractOptions(eqx.Module):
    """Options that belong together."""

    def otherwise(self, **defaults: Scalar | None) -> Self:
        """These, and for None the defaults."""
        given = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        absent = {name: defaults[name] for name, x in given.items() if x is None}
        return type(self)(**{**given, **absent}) if absent else self

    def __repr__(self) -> str:
        """The options that are not None."""
        given = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        named = (f"{name}={x}" for name, x in given.items() if x is not None)
        return f"{type(self).__name__}({', '.join(named)})"


def _option(
    read: Callable[..., object], *how: str, static: bool = False
) -> Any:  # a field
    """A field that is None, or what `read(*how)` makes of it, checked."""
    name, rule = how[:1], how[1:]

    def convert(x: object) -> object:
        return None if x is None else read(*name, x, *rule)

    return eqx.field(default=None, converter=convert, static=static)


def _several(name: str, x: int) -> int:
    count = whole_number(name, x)
    if count < 2:
        raise ValueError(
            f"Argument `{name}` must be at least 2, for an error, but is {count}."
        )
    return count


def solver_of(solver: Solver | dfx.AbstractERK) -> Solver:
    """A method as motions take it.

    **Raises:** `ValueError` for what is none.
    """
    if isinstance(solver, dfx.AbstractERK) and hasattr(solver, "tableau"):
        return Explicit(solver)
    if not isinstance(solver, Solver):
        raise ValueError(
            "Argument `solver` must be an explicit method of diffrax such as "
            "`diffrax.Dopri8()`, `Explicit(...)`, `Rosenbrock()`, `Taylor()` or None, "
            f"but is {solver!r}."
        )
    return solver


class Method(AbstractOptions):
    r"""How a motion is integrated.

    **Arguments:** None is the default of each question, see the table.

    - `solver`: an explicit method of diffrax, e.g. `diffrax.Dopri8()`, or one of its
        tableaus, `Explicit(tableau)`; `Rosenbrock()` for stiff columns (`is_stiff`
        says which are); `Taylor()` for set-valued friction.
    - `rtol`: the relative tolerance of each step; `atol`: the absolute one, in rad and
        $\sqrt{k/(m l^2)}$; None is `rtol`.
    - `max_steps`: the step budget of the question, or of each of its motions.

    | question | solver | rtol | max_steps |
    |---|---|---|---|
    | `settle` | Tsit5, set-valued Taylor8 | 1e-6 | 1000000 |
    | `sweep_up_down` | Tsit5, set-valued Taylor8 | 1e-6 | 1000000 (a motion) |
    | `threshold` | Tsit5 | 1e-8 | 3000000 (a motion) |
    | `flutter_onset`, `critical_kick` | Tsit5 | 1e-8 | 3000000 (a motion) |
    | `least_kick` | Tsit5, set-valued Taylor8 | 1e-8 | 1000000 (a motion) |
    | `trajectory` | Dopri8, set-valued Taylor8 | 1e-8 | 1000000 |
    | `periodic_orbit` | Dopri8, set-valued Tsit5 | 1e-10 | 100000 |
    | `continue_cycle`, `bifurcation` | Dopri8, set-valued Tsit5 | 1e-10 | 10000000 |
    | `branch_off` | Dopri8, set-valued Tsit5 | 1e-10 | 10000000 |
    | `bifurcation_curve` | Dopri8, set-valued Tsit5 | 1e-10 | 10000000 |
    | `lyapunov_exponents` | Tsit5, set-valued Taylor8 | 1e-8 | 10000000 |
    | `poincare` | Tsit5 | 1e-9 | 10000000 |

    Tsit5 takes the place of Taylor8 with the load `JointReaction()`, and with a damping
    law or forces of your own. Orbits, branches and curves take `Taylor()` where it is
    named: at the same tolerance its orbits are some thirty times nearer, run as long,
    and compile half as long again.

    **Raises:** `ValueError` for another solver, and numbers that break a rule; and by
    `settle`, `sweep_up_down`, `trajectory` and `poincare` where a derivative in a
    tolerance is taken. The result of a search (an orbit, a threshold, a least kick)
    does not depend on the tolerance.
    """

    units: ClassVar = {"solver": "1", "rtol": "1", "atol": "rad", "max_steps": "1"}

    solver: Solver | None
    rtol: Scalar | None
    atol: Scalar | None
    max_steps: Count | None  # also what is left of it, where motions share it

    def __init__(
        self,
        solver: Solver | dfx.AbstractERK | None = None,
        rtol: Scalar | None = None,
        atol: Scalar | None = None,
        max_steps: Count | None = None,
    ):
        """Check and keep them."""
        self.solver = None if solver is None else solver_of(solver)
        self.rtol = None if rtol is None else number("rtol", rtol, "positive")
        self.atol = None if atol is None else number("atol", atol, "positive")
        if max_steps is not None:
            max_steps = whole_number("max_steps", cast(int, max_steps))
        self.max_steps = max_steps

    @property
    def tolerances(self) -> tuple[Scalar, Scalar]:
        """Relative and absolute, of a method that is complete."""
        assert self.rtol is not None and self.atol is not None
        return self.rtol, self.atol

    @property
    def budget(self) -> Count:
        """Steps, of a method that is complete."""
        assert self.max_steps is not None
        return self.max_steps

    @property
    def variational(self) -> Explicit | Taylor:
        """The solver of a method that carries tangents along."""
        assert isinstance(self.solver, Explicit | Taylor)
        return self.solver

    def at_most(self, steps: Count) -> Method:
        """The same within another budget, which may be traced."""
        return eqx.tree_at(
            lambda m: m.max_steps, self, steps, is_leaf=lambda x: x is None
        )

    def settings(self) -> dict[str, Option]:
        """For the record."""
        return {
            "solver": getattr(self.solver, "name", None),
            "rtol": self.rtol,
            "atol": self.atol,
            "max_steps": self.max_steps,
        }


class Windows(AbstractOptions):
    r"""How long a motion is followed, and when it has settled.

    After a transient, windows follow each other until two consecutive ones agree in
    each joint's swing, $|S_j - S_j'| \le$ `agreement` $S_j$ + `atol` (see `settle`).
    Where cycles are certified, windows are not compared. A motion is then followed up
    to `transient + length * max_windows`, and `agreement` is refused.

    **Arguments:** None is the default of each question, see the table; times in
    $\sqrt{m l^2/k}$.

    - `transient`: before the first window.
    - `length` of a window, of which there are at most `max_windows`.
    - `agreement`: as above, where windows are compared.
    - `escape`: a rod's angle in rad beyond which a motion ends as `escaped`.
    - `rate_cut`: the joint rate below which a joint rests, if the remaining motion
        decays. None is that of the friction law (`v_smooth`; with set-valued friction a
        joint that sticks rests); without friction 1e-6. Rates below 100 atol count as
        below it: the error of the steps keeps a decayed motion at such rates.

    | question | transient | length | max_windows | agreement | escape |
    |---|---|---|---|---|---|
    | `settle` | 100 | 40 | 40 | 2e-4 | pi |
    | `sweep_up_down` | 0 | 40 | 100 | 2e-4 | pi |
    | `threshold`, `flutter_onset`, `critical_kick` | 0 | 40 | 1000 | none | pi |
    | `least_kick` | 0 | 40 | 200 | none | pi |

    **Raises:** `ValueError` for numbers that break a rule.
    """

    units: ClassVar = {
        "transient": TIME,
        "length": TIME,
        "agreement": "1",
        "escape": "rad",
        "rate_cut": RATE,
    }

    transient: Scalar | None = _option(number, "transient", "nonnegative")
    length: Scalar | None = _option(number, "length", "positive")
    max_windows: int | None = _option(whole_number, "max_windows", static=True)
    agreement: Scalar | None = _option(number, "agreement", "positive")
    escape: Scalar | None = _option(number, "escape", "positive")
    rate_cut: Scalar | None = _option(number, "rate_cut", "positive")

    @property
    def spans(self) -> tuple[Scalar, Scalar, int]:
        """Transient, length and how many, of complete ones."""
        transient, length, most = self.transient, self.length, self.max_windows
        assert transient is not None and length is not None and most is not None
        return transient, length, most

    @property
    def bound(self) -> Scalar:
        """The angle beyond which a rod has turned over, of complete ones."""
        assert self.escape is not None
        return self.escape

    def settings(self) -> dict[str, Option]:
        """Complete ones for the record, but for the cut, which may be by modes."""
        agreed = {} if self.agreement is None else {"agreement": self.agreement}
        return {
            "transient": self.transient,
            "window_length": self.length,
            "max_windows": self.max_windows,
            **agreed,
            "escape": self.escape,
        }


class Spans(AbstractOptions):
    r"""Over which spans of time rates of growth are taken.

    **Arguments:** None is the question's own; times in $\sqrt{m l^2/k}$.

    - `transient`: before the first span.
    - `length` of a span, and their `count`, at least 2.
    - `escape`: a rod's angle in rad beyond which a motion ends as `escaped`.

    | question | transient | length | count | escape |
    |---|---|---|---|---|
    | `lyapunov_exponents` | 200 | 50 | 20 | pi |

    **Raises:** `ValueError` for numbers that break a rule.
    """

    units: ClassVar = {"transient": TIME, "length": TIME, "escape": "rad"}

    transient: Scalar | None = _option(number, "transient", "nonnegative")
    length: Scalar | None = _option(number, "length", "positive")
    count: int | None = _option(_several, "count", static=True)
    escape: Scalar | None = _option(number, "escape", "positive")


# question: tolerance, step budget
_METHODS = {
    "settle": (1e-6, 1_000_000),
    "sweep_up_down": (1e-6, 1_000_000),
    "threshold": (1e-8, 3_000_000),
    "least_kick": (1e-8, 1_000_000),
    "trajectory": (1e-8, 1_000_000),
    "periodic_orbit": (1e-10, 100_000),
    "continue_cycle": (1e-10, 10_000_000),
    "branch_off": (1e-10, 10_000_000),
    "bifurcation": (1e-10, 10_000_000),
    "bifurcation_curve": (1e-10, 10_000_000),
    "lyapunov_exponents": (1e-8, 10_000_000),
    "poincare": (1e-9, 10_000_000),
}
# question: transient, length, max_windows, agreement
_WINDOWS = {
    "settle": (100.0, 40.0, 40, 2e-4),
    "sweep_up_down": (0.0, 40.0, 100, 2e-4),
    "threshold": (0.0, 40.0, 1000, None),  # cycles are certified
    "least_kick": (0.0, 40.0, 200, None),
}
_SPANS = {"lyapunov_exponents": (200.0, 50.0, 20)}


def complete(question: str, method: Method, solver: Solver) -> Method:
    """A question's method, complete."""
    rtol, max_steps = _METHODS[question]
    rtol = np.float64(rtol) if method.rtol is None else method.rtol
    atol = rtol if method.atol is None else method.atol
    if question in OF_STEPS:
        rtol, atol = refused(NO_SLOPE, (rtol, atol))
    budget = max_steps if method.max_steps is None else method.max_steps
    return Method(solver, rtol, atol).at_most(budget)


def windows_for(question: str, windows: Windows, rate_cut: Scalar | None) -> Windows:
    """A question's windows, complete; `rate_cut` may be None: by modes."""
    instance("windows", windows, Windows)
    transient, length, count, agreement = _WINDOWS[question]
    return windows.otherwise(
        transient=transient,
        length=length,
        max_windows=count,
        agreement=agreement,
        escape=np.pi,
        rate_cut=rate_cut,
    )


def spans_for(question: str, spans: Spans) -> Spans:
    """A question's spans, complete."""
    instance("spans", spans, Spans)
    transient, length, count = _SPANS[question]
    return spans.otherwise(
        transient=transient, length=length, count=count, escape=np.pi
    )


def recorded(**options: Option) -> Settings:
    """Options for the record; what differs from point to point says so."""
    record = []
    for name, value in options.items():
        if isinstance(value, np.floating):
            value = float(value)
        elif not isinstance(value, (int, float, str)):
            value = "set at each point"
        record.append((name, value))
    return tuple(record)
