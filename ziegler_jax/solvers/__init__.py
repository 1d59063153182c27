"""Lane solvers: diffrax solvers that run fast for thousands of lanes under vmap."""

from .control import ControlState, GoingOn, Signals, StepControl
from .explicit import Explicit
from .landing import LandingControl, LandingSignals
from .observed import AbstractFold, Observed, Step
from .stickslip import StickSlip, StickSlipState

__all__ = [
    "AbstractFold",
    "ControlState",
    "Explicit",
    "GoingOn",
    "LandingControl",
    "LandingSignals",
    "Observed",
    "Signals",
    "Step",
    "StepControl",
    "StickSlip",
    "StickSlipState",
]
