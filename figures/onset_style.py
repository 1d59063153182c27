"""What the figures of onsets share: type size, the friction, where they go."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
matplotlib.rcParams.update(
    {
        "font.size": 12,
        "axes.titlesize": 12,
        "legend.frameon": False,
        "savefig.dpi": 110,
        "savefig.bbox": "tight",
    }
)

import ziegler_jax as zj  # noqa: E402

zj.configure_cpu()
# Okabe and Ito's colours, told apart with any colour vision
BLUE, ORANGE, GREEN, PINK, GREY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "0.45"
SAND = "#E8DCC8"  # where the column comes to rest


def dry(q, mu_s, mu_k=None):
    """Uniform rods with set-valued friction of the torques mu_s and mu_k."""
    load = zj.ConstantLoad(1.0)
    law = zj.SetValuedCoulomb(mu_s, mu_k, pin_radius=1.0, load=load)
    return zj.uniform_rods(q, friction=law)


def save(figure, script: str) -> None:
    """Write the figure beside its script."""
    figure.savefig(Path(script).with_suffix(".png"))
