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
from .continuation import Branch, CycleFold, Points, continue_cycle, cycle_fold
from .critical import critical_load
from .cycle import PeriodicOrbit, periodic_orbit
from .damping import Air, Sum, Viscous
from .friction import ConstantLoad, FollowerLoad, JointReaction, SmoothCoulomb
from .linear import linearise, regime, spectral_abscissa, spectrum, tangent_column
from .lyapunov import Exponents, lyapunov_exponents
from .observers import Amplitude, EnergyBalance, Mean, Period, StickFraction
from .onset import Onset, critical_kick, flutter_onset
from .outcome import CRITICAL, ONSET, ORBIT, OUTCOME, REGIME, SPECIAL, VERDICT
from .poincare import Section, poincare
from .precision import work_precision
from .quasi_static import UpDown, sweep_up_down
from .sensitivity import sensitivity
from .set_valued import SetValuedCoulomb
from .si import SI
from .simulate import Settled, Trajectory, settle, trajectory
from .solvers import Explicit, Rosenbrock, Taylor
from .stabilise import stabilise
from .sticking import StickingSet, sticking_set
from .stiffness import is_stiff
from .sweep import sweep
from .verdict import Verdict, verdict

__all__ = [
    "CRITICAL",
    "ONSET",
    "ORBIT",
    "OUTCOME",
    "REGIME",
    "SI",
    "SPECIAL",
    "VERDICT",
    "Air",
    "Amplitude",
    "Branch",
    "Column",
    "ConstantLoad",
    "CycleFold",
    "EnergyBalance",
    "Explicit",
    "Exponents",
    "FollowerLoad",
    "JointReaction",
    "Mean",
    "Onset",
    "Period",
    "PeriodicOrbit",
    "Points",
    "RegularisationError",
    "Rosenbrock",
    "Section",
    "SetValuedCoulomb",
    "Settled",
    "SmoothCoulomb",
    "State",
    "StickFraction",
    "StickingSet",
    "Sum",
    "Taylor",
    "Trajectory",
    "UpDown",
    "Verdict",
    "Viscous",
    "configure_cache",
    "configure_cpu",
    "continue_cycle",
    "critical_kick",
    "critical_load",
    "cycle_fold",
    "energy",
    "flutter_onset",
    "is_stiff",
    "linearise",
    "lyapunov_exponents",
    "open_sweep",
    "periodic_orbit",
    "poincare",
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
    "sweep_up_down",
    "tangent_column",
    "trajectory",
    "uniform_rods",
    "vector_field",
    "verdict",
    "work_precision",
]


def __getattr__(name: str):
    """`ziegler_jax.plot`, with matplotlib, only where it is used."""
    if name == "plot":
        import importlib

        return importlib.import_module(".plot", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
