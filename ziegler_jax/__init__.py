"""Flutter of the Ziegler column with dry friction: vectorised maps in JAX."""

from ._cache import configure_cache
from ._cpu import configure_cpu
from ._store import open_sweep
from .audit import RegularisationError, regularisation_error
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
from .critical import critical_load
from .damping import Air, Sum, Viscous
from .friction import ConstantLoad, FollowerLoad, JointReaction, SmoothCoulomb
from .linear import linearise, regime, spectral_abscissa, spectrum, tangent_column
from .observers import Amplitude, EnergyBalance, Mean, Period, StickFraction
from .outcome import CRITICAL, OUTCOME, REGIME
from .sensitivity import sensitivity
from .set_valued import SetValuedCoulomb
from .simulate import Settled, Trajectory, settle, trajectory
from .solvers import Explicit
from .stabilise import stabilise
from .sticking import StickingSet, sticking_set
from .sweep import sweep

__all__ = [
    "CRITICAL",
    "OUTCOME",
    "REGIME",
    "Air",
    "Amplitude",
    "Column",
    "ConstantLoad",
    "EnergyBalance",
    "Explicit",
    "FollowerLoad",
    "JointReaction",
    "Mean",
    "Period",
    "RegularisationError",
    "SetValuedCoulomb",
    "Settled",
    "SmoothCoulomb",
    "State",
    "StickFraction",
    "StickingSet",
    "Sum",
    "Trajectory",
    "Viscous",
    "configure_cache",
    "configure_cpu",
    "critical_load",
    "energy",
    "linearise",
    "open_sweep",
    "point_masses",
    "power",
    "reactions",
    "regime",
    "regularisation_error",
    "sensitivity",
    "settle",
    "spectral_abscissa",
    "spectrum",
    "stabilise",
    "sticking_set",
    "sweep",
    "tangent_column",
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
