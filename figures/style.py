"""What the figures share: type size, two columns, where they go."""

from pathlib import Path

import jax
import matplotlib

import ziegler_jax as zj

zj.configure_cpu()
jax.config.update("jax_enable_x64", True)
matplotlib.use("Agg")
matplotlib.rcParams.update(
    {
        "font.size": 12,
        "axes.titlesize": 12,
        "legend.frameon": False,
        "savefig.dpi": 120,
        "savefig.bbox": "tight",
    }
)
SEED, ZIEGLER = "uniform rods", "Ziegler's masses"


def dry(q, mu_s, mu_k=None):
    """Uniform rods with set-valued friction of the torques mu_s and mu_k."""
    load = zj.ConstantLoad(1.0)
    law = zj.SetValuedCoulomb(mu_s, mu_k, pin_radius=1.0, load=load)
    return zj.uniform_rods(q, friction=law)


def save(figure, script: str, **options) -> None:
    """Write the figure beside its script."""
    figure.savefig(Path(script).with_suffix(".png"), **options)
