"""Flutter of the Ziegler column with dry friction: vectorised maps in JAX."""

from ._cpu import configure_cpu
from .column import (
    Column,
    State,
    energy,
    point_masses,
    power,
    reactions,
    uniform_rods,
    vector_field,
)
from .damping import Viscous
from .friction import ConstantLoad, FollowerLoad, JointReaction, SmoothCoulomb
from .observers import Amplitude, EnergyBalance, Mean, Period, StickFraction
from .outcome import OUTCOME, REGIME
from .simulate import Settled, Trajectory, settle, trajectory
from .solvers import Explicit
from .sweep import sweep

__all__ = [
    "OUTCOME",
    "REGIME",
    "Amplitude",
    "Column",
    "ConstantLoad",
    "EnergyBalance",
    "Explicit",
    "FollowerLoad",
    "JointReaction",
    "Mean",
    "Period",
    "Settled",
    "SmoothCoulomb",
    "State",
    "StickFraction",
    "Trajectory",
    "Viscous",
    "configure_cpu",
    "energy",
    "point_masses",
    "power",
    "reactions",
    "settle",
    "sweep",
    "trajectory",
    "uniform_rods",
    "vector_field",
]


def __getattr__(name: str):
    """`ziegler_jax.plot`, with matplotlib, only where it is used."""
    if name == "plot":
        import importlib

        return importlib.import_module(".plot", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
