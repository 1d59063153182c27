"""Flutter of the Ziegler column with dry friction: vectorised maps in JAX."""

from ._cpu import configure_cpu
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
from .continuation import Branch, CycleFold, Points, continue_cycle, cycle_fold
from .critical import critical_load
from .cycle import PeriodicOrbit, periodic_orbit
from .damping import Air, Sum, Viscous
from .friction import ConstantLoad, FollowerLoad, JointReaction, SmoothCoulomb
from .linear import linearise, regime, spectral_abscissa, spectrum, tangent_column
from .observers import Amplitude, EnergyBalance, Mean, Period, StickFraction
from .outcome import CRITICAL, ORBIT, OUTCOME, REGIME, SPECIAL
from .sensitivity import sensitivity
from .set_valued import SetValuedCoulomb
from .simulate import Settled, Trajectory, settle, trajectory
from .solvers import Explicit
from .stabilise import stabilise
from .sticking import StickingSet, sticking_set
from .sweep import sweep

__all__ = [
    "CRITICAL",
    "ORBIT",
    "OUTCOME",
    "REGIME",
    "SPECIAL",
    "Air",
    "Amplitude",
    "Branch",
    "Column",
    "ConstantLoad",
    "CycleFold",
    "EnergyBalance",
    "Explicit",
    "FollowerLoad",
    "JointReaction",
    "Mean",
    "Period",
    "PeriodicOrbit",
    "Points",
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
    "configure_cpu",
    "continue_cycle",
    "critical_load",
    "cycle_fold",
    "energy",
    "linearise",
    "periodic_orbit",
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
