"""Lane solvers: diffrax solvers that run fast for thousands of lanes under vmap."""

from .control import ControlState, Signals, StepControl, Verdict
from .explicit import Explicit
from .fold import AbstractFold, Observed, Step
from .loop import LaneLoop
from .rosenbrock import Rosenbrock
from .stickslip import StickSlip, StickSlipState
from .taylor import Reached, Taylor, TaylorSlip

__all__ = [
    "AbstractFold",
    "ControlState",
    "Explicit",
    "LaneLoop",
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
    "Verdict",
]
