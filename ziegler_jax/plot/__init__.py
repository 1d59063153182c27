"""Pictures of sweeps, motions, cycles and linear results.

Matplotlib is imported with this room only, on the first use of `ziegler_jax.plot`.
"""

from .animation import animate
from .branches import branch
from .maps import bifurcation_diagram, map, up_down
from .motions import time_history
from .page import page
from .sections import section, spectrum
from .sketch import sketch

__all__ = [
    "animate",
    "bifurcation_diagram",
    "branch",
    "map",
    "page",
    "section",
    "sketch",
    "spectrum",
    "time_history",
    "up_down",
]
