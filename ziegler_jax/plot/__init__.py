"""Pictures of sweeps, motions, cycles and linear results.

Matplotlib is imported with this room only, on the first use of `ziegler_jax.plot`.
"""

from .animation import animate
from .branches import branch
from .linear import sensitivity
from .maps import bifurcation_diagram, map, up_down
from .motions import time_history
from .page import page
from .sections import section, spectrum
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
    "animate",
    "bifurcation_diagram",
    "branch",
    "map",
    "page",
    "section",
    "sensitivity",
    "spectrum",
    "time_history",
    "up_down",
]
