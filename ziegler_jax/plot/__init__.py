"""Pictures of sweeps, motions and linear results.

Matplotlib is imported with this room only, on the first use of `ziegler_jax.plot`.
"""

from .linear import sensitivity
from .maps import bifurcation_diagram, map
from .motions import time_history
from .style import (
    BLUE,
    GREEN,
    GREY,
    LINE_COLOURS,
    ORANGE,
    PALE_BLUE,
    PALE_ORANGE,
    PURPLE,
    REST_COLOUR,
    SKY,
    VERMILLION,
    YELLOW,
)
from .work_precision import work_precision

__all__ = [
    "BLUE",
    "GREEN",
    "GREY",
    "LINE_COLOURS",
    "ORANGE",
    "PALE_BLUE",
    "PALE_ORANGE",
    "PURPLE",
    "REST_COLOUR",
    "SKY",
    "VERMILLION",
    "YELLOW",
    "bifurcation_diagram",
    "map",
    "sensitivity",
    "time_history",
    "work_precision",
]
