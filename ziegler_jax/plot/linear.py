"""Pictures of linear results."""

from typing import cast

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.container import BarContainer

from .style import BLUE, VERMILLION

_SYMBOLS = {
    "kappa": r"$\kappa$",
    "follower": r"$\eta$",
    "eta": r"$\eta$",
    "l2": r"$l_2$",
    "m1": r"$m_1$",
    "m2": r"$m_2$",
    "damping.c1": r"$c_1$",
    "damping.c2": r"$c_2$",
    "damping.e1": r"$e_1$",
    "damping.e2": r"$e_2$",
}


def sensitivity(table: xr.Dataset, ax: Axes | None = None) -> Axes:
    """Bars of the elasticities, the largest on top.

    **Arguments:** `table`: what `sensitivity` returned; `ax`: matplotlib axes, made if
    None.

    **Returns:** the axes.
    """
    if ax is None:
        _, ax = plt.subplots(figsize=(6, 0.4 * table.parameter.size + 1.4))
    order = np.argsort(np.nan_to_num(np.abs(table.elasticity.values)))
    names = [str(name) for name in table.parameter.values[order]]
    bars = table.elasticity.values[order]
    # blue raises the load, vermillion lowers it: told apart by the side of zero as well
    ax.barh(names, np.nan_to_num(bars), color=np.where(bars >= 0, BLUE, VERMILLION))
    ax.set_yticks(range(len(names)), [_SYMBOLS.get(n, n) for n in names])
    ax.bar_label(
        cast(BarContainer, ax.containers[-1]),
        ["undefined" if np.isnan(x) else f"{x:+.2f}" for x in bars],
        padding=3,
    )
    ax.margins(x=0.16)
    ax.axvline(0, color="0.2", lw=0.8)
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel(r"elasticity $(p/q_{cr})\,dq_{cr}/dp$")
    name = "q_{cr}" if table.kind == "flutter" else f"q_\\mathrm{{{table.kind}}}"
    ax.set_title(f"What moves ${name}$ = {table.q_cr:.4f}", loc="left")
    return ax
