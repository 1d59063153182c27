"""What the figures of linear results share: type size, colours, where they go."""

from pathlib import Path

import jax
import matplotlib

jax.config.update("jax_enable_x64", True)
matplotlib.use("Agg")
matplotlib.rcParams.update(
    {
        "font.size": 13,
        "axes.titlesize": 13,
        "legend.frameon": False,
        "savefig.dpi": 130,
        "savefig.bbox": "tight",
    }
)
# Okabe and Ito's colours, told apart with any colour vision
BLUE, ORANGE, GREEN, PINK, GREY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "0.45"
SEED, ZIEGLER = "uniform rods", "Ziegler's masses"


def save(figure, script: str, **options) -> None:
    """Write the figure beside its script."""
    figure.savefig(Path(script).with_suffix(".png"), **options)
