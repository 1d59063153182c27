"""Flutter of the Ziegler column with dry friction: vectorised maps in JAX."""

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
from .outcome import CRITICAL, OUTCOME, REGIME
from .sensitivity import sensitivity
from .stabilise import stabilise

__all__ = [
    "CRITICAL",
    "OUTCOME",
    "REGIME",
    "Air",
    "Column",
    "ConstantLoad",
    "FollowerLoad",
    "JointReaction",
    "SmoothCoulomb",
    "State",
    "Sum",
    "Viscous",
    "critical_load",
    "energy",
    "linearise",
    "point_masses",
    "power",
    "reactions",
    "regime",
    "sensitivity",
    "spectral_abscissa",
    "spectrum",
    "stabilise",
    "tangent_column",
    "uniform_rods",
    "vector_field",
]
