"""Flutter of the Ziegler column with dry friction: vectorised maps in JAX."""

from importlib import metadata

from .analysis.branch_off import Offshoot, branch_off
from .analysis.branch_point import Arc
from .analysis.continuation import (
    Branch,
    CyclePoints,
    continue_cycle,
)
from .analysis.hysteresis import UpDownSweep, sweep_up_down
from .analysis.least_kick import Directions, LeastKick, least_kick
from .analysis.lyapunov import Exponents, lyapunov_exponents
from .analysis.periodic_orbit import PeriodicOrbit, periodic_orbit
from .analysis.poincare import PoincareSection, poincare
from .analysis.threshold import (
    Search,
    Threshold,
    critical_kick,
    flutter_onset,
    threshold,
)
from .curves.bifurcation import Bifurcation, bifurcation
from .curves.bifurcations import BifurcationCurve, BifurcationPoints
from .curves.course import Course
from .curves.curve import bifurcation_curve
from .linear.critical_load import critical_load
from .linear.sensitivity import sensitivity
from .linear.spectrum import (
    linearise,
    regime,
    spectral_abscissa,
    spectrum,
    tangent_column,
)
from .linear.stabilise import stabilise
from .maps.follow_again import follow_again
from .maps.merge import merge
from .maps.refine import refine
from .maps.which_cycle import label_cycles
from .model.chain_of_rods import Chain
from .model.column import (
    Column,
    State,
    energy,
    power,
    reactions,
    vector_field,
)
from .model.damping import AbstractDamping, Air, Sum, Viscous
from .model.forces import (
    AbstractForce,
    AbstractLoadHistory,
    DeadLoad,
    FollowerForces,
    Gravity,
    LoadHistory,
)
from .model.friction import (
    AbstractFriction,
    AbstractRateFriction,
    SmoothCoulomb,
)
from .model.loads import (
    AbstractNormalLoad,
    ConstantLoad,
    FollowerLoad,
    JointReaction,
    LoadSum,
)
from .model.rods import beck, leipholz, pflueger, point_masses, uniform_rods
from .model.set_valued import SetValuedCoulomb
from .model.state import PhasePoint
from .model.sticking_set import StickingSet, sticking_set
from .model.system import System
from .motion.observers import (
    AbstractObserver,
    Amplitude,
    EnergyBalance,
    Mean,
    Period,
    StickFraction,
)
from .motion.options import Method, Spans, Windows
from .motion.section import SectionPlane
from .motion.stiffness import is_stiff
from .motion.trajectory import Trajectory, trajectory
from .results import CODE, Variable
from .runtime import configure_cache, configure_cpu
from .solvers import Explicit, Rosenbrock, Taylor, tableaus
from .steady.growth import Growth
from .steady.settle import Settled, settle
from .sweep.compare import compare
from .sweep.once import Program
from .sweep.pool import Lanes
from .sweep.store import Store, open_sweep
from .sweep.sweep import sweep
from .units.si import SI

__version__ = metadata.version("ziegler_jax")

__all__ = [
    "CODE",
    "SI",
    "AbstractDamping",
    "AbstractForce",
    "AbstractFriction",
    "AbstractLoadHistory",
    "AbstractNormalLoad",
    "AbstractObserver",
    "AbstractRateFriction",
    "Air",
    "Amplitude",
    "Arc",
    "BifurcationCurve",
    "BifurcationPoints",
    "Bifurcation",
    "Branch",
    "Chain",
    "Column",
    "ConstantLoad",
    "Course",
    "CyclePoints",
    "DeadLoad",
    "Directions",
    "EnergyBalance",
    "Explicit",
    "Exponents",
    "FollowerForces",
    "FollowerLoad",
    "Gravity",
    "Growth",
    "JointReaction",
    "LoadHistory",
    "LoadSum",
    "Lanes",
    "LeastKick",
    "Mean",
    "Method",
    "Offshoot",
    "Period",
    "PeriodicOrbit",
    "PhasePoint",
    "PoincareSection",
    "Program",
    "Rosenbrock",
    "Search",
    "SectionPlane",
    "SetValuedCoulomb",
    "Settled",
    "SmoothCoulomb",
    "Spans",
    "State",
    "StickFraction",
    "StickingSet",
    "Store",
    "Sum",
    "System",
    "Taylor",
    "Threshold",
    "Trajectory",
    "UpDownSweep",
    "Variable",
    "Viscous",
    "Windows",
    "beck",
    "bifurcation",
    "bifurcation_curve",
    "branch_off",
    "compare",
    "configure_cache",
    "configure_cpu",
    "continue_cycle",
    "critical_kick",
    "critical_load",
    "energy",
    "flutter_onset",
    "follow_again",
    "is_stiff",
    "label_cycles",
    "least_kick",
    "leipholz",
    "linearise",
    "lyapunov_exponents",
    "merge",
    "open_sweep",
    "periodic_orbit",
    "pflueger",
    "poincare",
    "point_masses",
    "power",
    "reactions",
    "refine",
    "regime",
    "sensitivity",
    "settle",
    "spectral_abscissa",
    "spectrum",
    "stabilise",
    "sticking_set",
    "sweep",
    "sweep_up_down",
    "tableaus",
    "tangent_column",
    "threshold",
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


def __dir__() -> list[str]:
    """The public names, `plot` among them."""
    return sorted({*__all__, "plot", "__version__"})
