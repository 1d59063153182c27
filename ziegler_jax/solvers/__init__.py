"""Lane solvers: diffrax solvers that run fast for thousands of lanes under vmap."""

from .control import ControlState, Signals, StepControl, Verdict
from .explicit import Explicit
from .fold import AbstractFold, Observed, Step
from .rosenbrock import Rosenbrock
from .stickslip import StickSlip, StickSlipState
from .taylor import Reached, Taylor, TaylorSlip
from .turns import AsManyTurns, Lane, Turns, UntilNoneMoves

__all__ = [
    "AbstractFold",
    "AsManyTurns",
    "ControlState",
    "Explicit",
    "Lane",
    "Observed",
    "Reached",
    "Rosenbrock",
    "Signals",
    "Step",
    "StepControl",
    "StickSlip",
    "StickSlipState",
    "Taylor",
    "TaylorSlip",
    "Turns",
    "UntilNoneMoves",
    "Verdict",
]
