r"""Which cycle a cell has: one label wherever a cycle moves continuously over a map.

Where a column has several attracting cycles, the start decides between them. Each, on
its own, moves continuously with the parameters: of two cells beside each other with the
same cycle, period T and joint amplitudes A differ by little,

$$d = \max\left(\frac{|T - T'|}{\min(T, T')}, \frac{\max_j |A_j - A_j'|}{\max_j
(A_j, A_j')}\right),$$

or by as much as lines through the two cells before and behind them say; two cycles
differ by more. Over the starts a cycle does not move at all: cells on a line along one
axis whose numbers agree to `SAME` have the same one, however far from each other. The
labels are the connected parts of all such pairs.
"""

from collections.abc import Iterator
from itertools import product

import numpy as np
import xarray as xr
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..numerics.rules import instance, number, whole_number
from ..results import CODE

NEEDED = ("outcome", "period", "joint_amplitude")
SAME = 1e-4  # relative: of one cycle from other starts it was 1.9e-5 at most


def label_cycles(
    dataset: xr.Dataset, *, jump: float = 0.05, reach: int = 3
) -> xr.Dataset:
    r"""Number the cycles of a map, so that one cycle has one number all over it.

    ```python
    ds = zj.label_cycles(zj.sweep(point, q=q, kick=kick))
    zj.plot.map(ds, "cycle_label", "q", "kick")
    ```

    Labels are made from period and amplitudes, see `maps/which_cycle.py`. A cycle and
    its mirror image have the same, and one label. So have two cycles that are joined
    within the map around a cusp, where their folds meet. At a flip the period doubles:
    there another label begins. Of 7007 certified cells of a map of load and kick, in
    which two cycles attract, all had the label given by hand
    (`tests/maps/test_which_cycle.py`).

    **Arguments:**

    - `dataset`: a sweep of `settle` with certificates, over axes that rise or fall.
    - `jump`: the least $d$ between two cycles. It must exceed the differences between
        successive changes of one cycle, which are largest beside its fold; else one
        cycle gets several labels. It must be less than the distance of two cycles; else
        they get one label. A finer grid leaves more room between the two.
    - `reach`: the number of cells along an axis over which a pair is compared; cells
        between them may be at rest, undecided or on another cycle.

    **Returns:** the dataset with `cycle_label`, integers: 0 where no cycle is
    certified, 1 for the cycle of the most cells, and so on.

    **Raises:** `ValueError` for a dataset without these numbers, with samples in place
    of axes, and for arguments that break a rule.
    """
    instance("dataset", dataset, xr.Dataset)
    if missing := [name for name in NEEDED if name not in dataset]:
        raise ValueError(
            "Argument `dataset` must be a sweep of `settle`, but has no "
            f"{', '.join(f'`{name}`' for name in missing)}."
        )
    if "joint" not in dataset.joint_amplitude.dims:
        raise ValueError(
            "Argument `dataset` must have the amplitudes of both joints, but has one: "
            "label the cycles before a joint is chosen."
        )
    jump = float(number("jump", jump, "positive"))
    reach = whole_number("reach", reach)
    dims = tuple(str(name) for name in dataset.outcome.dims)
    places_of = [positions(dataset, name) for name in dims]
    cycles = np.asarray(dataset.outcome.values == CODE.cycle)
    period = dataset.period.transpose(*dims).values
    amplitude = dataset.joint_amplitude.transpose(*dims, "joint").values
    numbers = np.concatenate([period[..., None], amplitude], axis=-1)
    cycles &= np.all(np.isfinite(numbers), axis=-1)
    places = np.arange(cycles.size).reshape(cycles.shape)
    pairs = [np.empty((2, 0), int)]
    for axis, x in enumerate(places_of):
        lines = (np.moveaxis(a, axis, 0) for a in (numbers, cycles, places))
        values, there, mine = (
            a.reshape(x.size, -1, *a.shape[cycles.ndim :]) for a in lines
        )
        pairs += _near(x, values, there, mine, jump, reach)
        pairs += _alike(values, there, mine)
    label = _labels(np.concatenate(pairs, axis=1), cycles)
    words = ["no_cycle", *(f"cycle_{i}" for i in range(1, label.max(initial=0) + 1))]
    about = {
        "long_name": "which cycle",
        "flag_values": np.arange(len(words), dtype=label.dtype),
        "flag_meanings": " ".join(words),
        "jump": jump,
        "reach": reach,
    }
    return dataset.assign(cycle_label=xr.DataArray(label, dims=dims, attrs=about))


def positions(dataset: xr.Dataset, name: str) -> np.ndarray:
    """The places of cells along an axis.

    **Raises:** `ValueError` where it has no order.
    """
    x = dataset[name].values if name in dataset.coords else None
    if x is not None and np.issubdtype(x.dtype, np.number):
        steps = np.diff(x.astype(float))
        if np.all(steps > 0) or np.all(steps < 0):
            return x.astype(float)
    raise ValueError(
        f"Argument `dataset` must have axes of numbers that rise or fall, but `{name}` "
        "is none: its cells have no neighbours."
    )


def _near(
    x: np.ndarray,
    values: np.ndarray,
    there: np.ndarray,
    places: np.ndarray,
    jump: float,
    reach: int,
) -> Iterator[np.ndarray]:
    """Pairs of cells along the first axis between which a cycle moves continuously."""
    slopes = np.diff(values, axis=0) / np.diff(x).reshape(-1, 1, 1)
    for far in range(1, min(reach, x.size - 1) + 1):
        low, high = values[:-far], values[far:]
        both = there[:-far] & there[far:]
        linked = _distance(low, high) <= jump
        if x.size > far + 2:  # lines through the cells before and behind
            gap = (x[far:] - x[:-far]).reshape(-1, 1, 1)[1:-1]
            ahead = low[1:-1] + gap * slopes[: -far - 1]
            back = high[1:-1] - gap * slopes[far + 1 :]
            steep = there[: -far - 2] & there[far + 2 :]
            steep &= _distance(ahead, high[1:-1]) <= jump
            steep &= _distance(back, low[1:-1]) <= jump
            linked[1:-1] |= steep
        linked &= both
        yield np.stack([places[:-far][linked], places[far:][linked]])


def _distance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """By how much cycles differ, relative; see above."""
    with np.errstate(invalid="ignore", divide="ignore"):
        times, sizes = (np.abs(x) for x in (one[..., 0], one[..., 1:]))
        others = np.abs(other[..., 1:])
        period = np.abs(one[..., 0] - other[..., 0]) / np.minimum(times, other[..., 0])
        size = np.maximum(sizes.max(axis=-1), others.max(axis=-1))
        amplitude = np.abs(one[..., 1:] - other[..., 1:]).max(axis=-1) / size
        return np.maximum(period, amplitude)


def _alike(
    values: np.ndarray, there: np.ndarray, places: np.ndarray
) -> Iterator[np.ndarray]:
    """Pairs of cells along the first axis with the same cycle, wherever they are.

    Each with the first cell in its box of a grid over the numbers; there are as many
    grids, shifted by halves, as it takes for near ones to be in one box of one.
    """
    own, line = np.nonzero(there)
    period, *amplitudes = values[own, line].T
    size = np.maximum(*amplitudes)
    unlike = (amplitudes[0] - amplitudes[1]) / size
    boxes = np.column_stack([np.log(period), np.log(size), unlike]) / (2 * SAME)
    for shift in product((0.0, 0.5), repeat=3):
        keys = np.column_stack([line, np.floor(boxes + shift)])
        _, first, which = np.unique(
            keys, axis=0, return_index=True, return_inverse=True
        )
        cells = places[own, line]
        yield np.stack([cells[first][which.ravel()], cells])


def _labels(pairs: np.ndarray, cycles: np.ndarray) -> np.ndarray:
    """Connected parts of the pairs, the largest first."""
    ones = np.ones(pairs.shape[1], bool)
    graph = coo_array((ones, tuple(pairs)), shape=(cycles.size, cycles.size))
    _, parts = connected_components(graph, directed=False)
    mine = parts[cycles.ravel()]
    names, inverse, counts = np.unique(mine, return_inverse=True, return_counts=True)
    rank = np.empty(names.size, int)
    rank[np.argsort(-counts, kind="stable")] = np.arange(1, names.size + 1)
    label = np.zeros(cycles.shape, np.int32)
    label[cycles] = rank[inverse.ravel()]
    return label
