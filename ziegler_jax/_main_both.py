"""Where the main job's maps of both friction laws differ.

A cell differs where a motion has another outcome under one law than under the other.
"""

from collections import Counter
from typing import NamedTuple

import numpy as np
import xarray as xr

from .maps.follow_again import ENDED
from .results import CODE

# the outcomes of which each pair has a colour of its own
_ENDS = (CODE.cycle, CODE.stuck, CODE.unsettled)
PAIRS = tuple((end, end) for end in _ENDS)
PAIRS += tuple((a, b) for a in _ENDS for b in _ENDS if a != b)
BINS = 10  # of mu_k / mu_s; where both are equal they are a bin of their own


def ends_of_both(smoothed: xr.Dataset, dry: xr.Dataset) -> xr.Dataset:
    """Which outcome each law has in each cell of two maps of one grid.

    **Returns:** over (q, mu_s, mu_k) `outcome`, the smoothed law's, `dry`, the other's,
    `ends`, a flag variable of pairs of them, `computed` under both laws, and `differ`.
    """
    dims = ("q", "mu_s", "mu_k")
    one, other = (ds["outcome"].transpose(*dims).values for ds in (smoothed, dry))
    computed = (one != CODE.not_computed) & (other != CODE.not_computed)
    ends = np.where(computed, len(PAIRS) + 1, 0).astype(np.int8)
    names = ["not_computed"]
    for flag, (a, b) in enumerate(PAIRS, 1):
        ends[computed & (one == a) & (other == b)] = flag
        alike, unlike = f"both_{a.name}", f"smoothed_{a.name},_dry_{b.name}"
        names.append(alike if a == b else unlike)
    flags = {
        "flag_values": np.arange(len(PAIRS) + 2),
        "flag_meanings": " ".join([*names, "otherwise"]),
    }
    numbers = {
        "outcome": (dims, one),
        "dry": (dims, other),
        "ends": (dims, ends, flags),
        "computed": (dims, computed),
        "differ": (dims, computed & (one != other)),
    }
    return xr.Dataset(numbers, {name: smoothed[name] for name in dims})


class Shares(NamedTuple):
    """What share of cells differs over mu_k / mu_s: its mean in each bin, the shares.

    `settled`: of those in which both motions have settled, on unlike ends.
    """

    ratio: np.ndarray
    differ: np.ndarray
    settled: np.ndarray


def shares_over_ratio(ends: xr.Dataset) -> Shares:
    """How the share of cells that differ goes with mu_k / mu_s; bins of cells."""
    ratio = (ends["mu_k"] / ends["mu_s"]).broadcast_like(ends["ends"])
    names = {name: ends[name] for name in ("differ", "outcome", "dry", "computed")}
    cells = xr.Dataset({"ratio": ratio, **names}).stack(cell=ends["ends"].dims)
    cells = cells.isel(cell=cells["computed"].values)
    ratio, differ, one, other = (
        cells[name].values for name in ("ratio", "differ", "outcome", "dry")
    )
    settled = differ & np.isin(one, ENDED) & np.isin(other, ENDED)
    _, which = np.unique(np.floor(BINS * np.minimum(ratio, 1)), return_inverse=True)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(which, values) / np.bincount(which)

    return Shares(mean(ratio), mean(differ), mean(settled))


def counted(number: int) -> str:
    """A count with its thousands apart."""
    return f"{number:,}".replace(",", " ")


def summary_of_both(ends: xr.Dataset) -> str:
    """How many cells differ, and which outcome each law has there."""
    differ, total = ends["differ"].values, int(ends["computed"].sum())
    unlike = int(differ.sum())
    lines = [
        f"The outcomes of both laws differ in {counted(unlike)} of {counted(total)} "
        f"cells, {unlike / total:.1%}:"
    ]
    pairs = zip(ends["outcome"].values[differ], ends["dry"].values[differ], strict=True)
    for (a, b), n in Counter(pairs).most_common():
        words = f"smoothed {CODE(a).name}, dry {CODE(b).name}"
        lines.append(f"  {counted(n):>10s} {n / total:6.1%}  {words}")
    return "\n".join(lines)
