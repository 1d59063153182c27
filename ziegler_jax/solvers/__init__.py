"""Methods, and the lane solvers that run them for thousands of lanes under vmap."""

from .control import ACCEPTED, ControlState, Signals, StepControl, Verdict
from .explicit import Explicit
from .fold import AbstractFold, Observed, Step
from .loop import LaneLoop
from .rosenbrock import Rosenbrock
from .stickslip import StickSlip, StickSlipState
from .taylor import Taylor, TaylorSlip, TaylorStepControl

__all__ = [
    "ACCEPTED",
    "AbstractFold",
    "ControlState",
    "Explicit",
    "LaneLoop",
    "Observed",
    "TaylorStepControl",
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
