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
from .damping import Viscous
from .friction import ConstantLoad, FollowerLoad, JointReaction, SmoothCoulomb
from .outcome import OUTCOME, REGIME

__all__ = [
    "OUTCOME",
    "REGIME",
    "Column",
    "ConstantLoad",
    "FollowerLoad",
    "JointReaction",
    "SmoothCoulomb",
    "State",
    "Viscous",
    "energy",
    "point_masses",
    "power",
    "reactions",
    "uniform_rods",
    "vector_field",
]
