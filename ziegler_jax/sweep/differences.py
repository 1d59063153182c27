"""How far two computations of the same points are apart, as quantiles."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from ..results import OUTCOME

QUANTILES = (0.5, 0.95, 1.0)
SEED = 0  # the same points in every run
# Of the main job's map a quarter settles later than this, and among that was every
# point whose end was seen to change with the tolerance.
LATE = 120.0
LISTED = 100  # points whose outcome changed


def drawn(valid: np.ndarray, count: int, first: np.ndarray | None = None) -> np.ndarray:
    """At random `count` (at least one, at most all) of the valid points, as a mask.

    Those that are `first` before all others.
    """
    random = np.random.default_rng(SEED)
    first = np.zeros_like(valid) if first is None else first
    among = [np.flatnonzero(valid & first), np.flatnonzero(valid & ~first)]
    order = np.concatenate([random.permutation(part) for part in among])
    mask = np.zeros(valid.shape, bool)
    mask.flat[order[: max(count, 1)]] = True
    return mask


def settled_late(dataset: xr.Dataset, shape: tuple[int, ...]) -> np.ndarray | None:
    """Which points settled so late that their end may depend on the steps.

    **Arguments:** `shape`: that of the grid.

    **Returns:** a mask, or None where points are no motions with certificates.
    """
    needed = ("outcome", "time", "undecided")
    if not all(n in dataset and dataset[n].shape == shape for n in needed):
        return None
    ends = [OUTCOME.cycle, OUTCOME.repeats, OUTCOME.stuck, OUTCOME.rest]
    settled = dataset["outcome"].isin(ends)
    return (settled & (dataset["time"] > LATE)).values


def checked_share(audit: float) -> float:
    """A share above 0 and up to 1, or a `ValueError`."""
    number = isinstance(audit, (int, float, np.number)) and not isinstance(audit, bool)
    if not number or not 0 < audit <= 1:
        raise ValueError(
            f"Argument `audit` must be a share above 0 and up to 1, but is {audit!r}."
        )
    return float(audit)


def differences(
    one: xr.DataArray, other: xr.DataArray, sample: np.ndarray
) -> np.ndarray:
    """The sizes of the differences at the sampled points; NaN where one has none."""
    apart = np.abs(np.asarray(one, float) - np.asarray(other, float))
    return apart[sample].ravel()


def quantiles(apart: np.ndarray) -> list[float]:
    """`QUANTILES` of what both computations have; NaN if they have nothing."""
    apart = apart[np.isfinite(apart)]
    if not apart.size:
        return [float("nan")] * len(QUANTILES)
    return [float(x) for x in np.quantile(apart, QUANTILES)]


def changed(one: xr.Dataset, other: xr.Dataset, sample: np.ndarray) -> np.ndarray:
    """The sampled points at which a code (an outcome) differs, as a mask of all."""
    differ = np.zeros(sample.sum(), bool)
    for name in coded(one):
        apart = (one[name].values != other[name].values)[sample]
        differ |= apart.reshape(len(differ), -1).any(axis=1)
    mask = np.zeros(sample.shape, bool)
    mask[sample] = differ
    return mask


def values_at(dataset: xr.Dataset, dims: Sequence[str], mask: np.ndarray) -> list[str]:
    """Where some points of a grid lie, the first `LISTED`: `"q = 1.5, mu = 0.1"`."""
    axes = [c for c in dataset.coords.values() if {*c.dims} and {*c.dims} <= {*dims}]
    texts = []
    for place in np.argwhere(mask)[:LISTED].tolist():
        here = dict(zip(dims, place, strict=True))
        values = [(c.name, c.isel({d: here[str(d)] for d in c.dims})) for c in axes]
        texts.append(", ".join(f"{name} = {float(v)}" for name, v in values))
    return texts


def coded(dataset: xr.Dataset) -> list[str]:
    """The flag variables."""
    return [str(n) for n in dataset.data_vars if "flag_values" in dataset[n].attrs]


def measured(dataset: xr.Dataset) -> list[str]:
    """The variables that are numbers of the motion: neither codes nor costs."""
    leave = {*coded(dataset), "steps", "shot_steps", "windows", "growth", "sensitive"}
    return [str(n) for n in dataset.data_vars if n not in leave]


def audit_attributes(
    dataset: xr.Dataset, finer: xr.Dataset, dims: Sequence[str], sample: np.ndarray
) -> None:
    """Write what the audit found into the attributes of `dataset`."""
    for name in measured(dataset):
        apart = differences(dataset[name], finer[name], sample)
        dataset[name].attrs["audit_quantiles"] = list(QUANTILES)
        dataset[name].attrs["audit_differences"] = quantiles(apart)
    dataset.attrs["audit_points"] = int(sample.sum())
    late = settled_late(dataset, sample.shape)
    dataset.attrs["audit_late_points"] = 0 if late is None else int(late[sample].sum())
    apart = changed(dataset, finer, sample)
    share = float(apart.sum() / sample.sum())
    dataset.attrs["audit_changed_outcomes"] = round(share, 6)
    dataset.attrs["audit_changed_at"] = values_at(dataset, dims, apart)
