r"""Ends that hang on the error of a step: cells beside another end, followed once more.

A motion that passes close by a threshold ends on one side of it or on the other, and
there errors as small as a step's decide. Such a cell lies beside another end, mostly.
It is followed once more at a finer tolerance. Where it ends alike, and as late, errors
did not matter. Where it ends alike at another time it went another way, by growth of an
error, and other steps may lead elsewhere.
"""

import math
from collections.abc import Callable

import numpy as np
import xarray as xr
from tqdm import tqdm

from ..numerics.rules import number
from ..results import CODE
from ..sweep.once import Program
from ..sweep.progress import shown, stream
from ..sweep.returned import Returned
from .which_cycle import positions

NEEDED = "outcome", "time", "steps", "joint_amplitude"
# By more than this, relative to the larger, two cycles beside each other are two, which
# may meet at a fold, and by more than that, one cell's amplitude or time is another.
JUMP, OFF = 0.2, 0.01
CYCLES = CODE.cycle, CODE.repeats
SETTLED = *CYCLES, CODE.stuck, CODE.rest
ENDED = *SETTLED, CODE.escaped
# What `again` can be.
INSIDE, SAME, OTHER_END, OTHER_TIME, LATE = range(1, 6)
FOLLOWED = SAME, OTHER_END, OTHER_TIME
MEANINGS = "not_asked", "inside", "same", "other_end", "other_time", "late"
SENTENCES = (
    "it was not computed, or has not settled",
    "no other end beside it",
    "followed again it ended alike, and at the same time",
    "followed again it ended otherwise, or did not settle",
    "followed again it ended alike, but at another time",
    "beside another end, but it ended too late to be followed again",
)


def follow_again(
    point: Callable[..., Returned] | Program,
    dataset: xr.Dataset,
    *,
    rtol: float = 1e-8,
    late: float | None = None,
    progress: bool | None = None,
) -> xr.Dataset:
    r"""Follow cells beside another end at a finer tolerance, and mark what is unsure.

    ```python
    def point(q, mu, rtol):
        friction = zj.SetValuedCoulomb(mu, 0.8 * mu, pin_radius=0.05)
        column = zj.uniform_rods(q=q, friction=friction)
        start = zj.State(omega=(0.0, 0.3))
        return zj.settle(column, start, method=zj.Method(rtol=rtol))

    program = zj.Program(point)
    axes = {"q": np.linspace(1, 4, 33), "mu": np.linspace(0.02, 0.4, 17)}
    ds = zj.follow_again(program, zj.sweep(program, rtol=1e-6, **axes))
    unsure = ds.again > 2  # other_end, other_time, late
    ```

    A cell lies beside another end if its next neighbour along an axis has ended
    otherwise, or on a cycle whose amplitude differs by more than a fifth of the larger
    one. Cells that have not settled are no ends, and are not asked. A cell counts as
    the same where its outcome is, the amplitudes of a cycle, and the time at which it
    ended, to 1 %. `benchmarks/a5_certificates.py` counts how many ends
    of a map change at a still finer tolerance, and what was said of these: the page
    *Exact and measured* of the documentation has the numbers.

    **Arguments:**

    - `point`: the point of the sweep, or its `Program`, which is not compiled again.
        One of its parameters is `rtol`, the tolerance of its motions.
    - `dataset`: its sweep over axes at one tolerance, `rtol=1e-6`; in memory, or of a
        store.
    - `rtol`: the finer tolerance. A hundredth of the sweep's takes about twice its
        steps.
    - `late`: cells that ended later are not followed, which would take longest, but
        marked; a time of the dataset. None follows all.
    - `progress`: a bar of points; None shows it on a terminal only.

    **Returns:** the dataset with `again`, a flag variable (`not_asked`, `inside`, where
    no other end lies beside the cell, `same`, `other_end`, `other_time`, `late`), and
    `outcome_again`, how followed cells ended. All other numbers are those of before.

    **Raises:** `ValueError` for a dataset of another point, without a tolerance of its
    own or with samples in place of axes, and for arguments that break a rule.
    """
    own = _tolerance(dataset)
    rtol = float(number("rtol", rtol, "positive"))
    last = math.inf if late is None else float(number("late", late, "positive"))
    if not rtol < own:
        raise ValueError(
            f"Argument `rtol` must be finer than the dataset's, {own:g}, but is "
            f"{rtol:g}."
        )
    program = _program(point, dataset)
    dims = tuple(str(name) for name in dataset["outcome"].dims)
    before = {n: dataset[n].transpose(*dims, ...).values for n in NEEDED}
    beside = _beside_another_end(before)
    again = np.isin(before["outcome"], ENDED).astype(np.int8)  # `INSIDE`, or none
    again[beside] = LATE
    chosen = np.flatnonzero(beside & ~(before["time"] > last))
    # the longest first: the last batches end together
    chosen = chosen[np.argsort(-before["steps"].flat[chosen], kind="stable")]
    places = dict(zip(dims, np.unravel_index(chosen, again.shape), strict=True))
    values = {name: _at(dataset[name], places) for name in program.names}
    values["rtol"] = np.full(chosen.size, rtol)
    with tqdm(
        total=chosen.size, file=stream(), unit="point", disable=not shown(progress)
    ) as bar:
        after = program.at(values, on_batch=lambda count, _: bar.update(count))
    cells = {
        n: x.reshape(again.size, *x.shape[again.ndim :])[chosen]
        for n, x in before.items()
    }
    again.flat[chosen] = _compared(cells, after)
    outcome = np.zeros(again.shape, np.int8)
    outcome.flat[chosen] = after["outcome"]
    about = {
        "long_name": f"how it ended when followed again at {rtol:g}",
        "flag_values": np.arange(len(MEANINGS), dtype=np.int8),
        "flag_meanings": " ".join(MEANINGS),
        "comment": "; ".join(map(": ".join, zip(MEANINGS, SENTENCES, strict=True))),
        "rtol": rtol,
    }
    if late is not None:
        about["late"] = last
    ends = dataset["outcome"].attrs | {"long_name": f"outcome at {rtol:g}"}
    return dataset.assign(
        again=(dims, again, about), outcome_again=(dims, outcome, ends)
    )


def _tolerance(dataset: xr.Dataset) -> float:
    """The one tolerance of a sweep of motions that settle, over axes.

    **Raises:** `ValueError`.
    """
    there = getattr(dataset, "variables", ())
    missing = [name for name in (*NEEDED, "rtol") if name not in there]
    if missing:
        raise ValueError(
            "Argument `dataset` must be a sweep of `settle` whose point takes `rtol`, "
            f"with `rtol=1e-6` beside its axes, but has no `{missing[0]}`."
        )
    dims = dataset["outcome"].dims
    if not dims or {*dataset["joint_amplitude"].dims} != {*dims, "joint"}:
        raise ValueError(
            "Argument `dataset` must be over axes and have the amplitudes of all "
            "joints along `joint`, but `joint_amplitude` has the dimensions "
            f"{', '.join(map(str, dataset['joint_amplitude'].dims)) or 'none'}."
        )
    for name in dims:
        positions(dataset, str(name))
    if dataset["rtol"].ndim:
        raise ValueError(
            "Argument `dataset` must have one tolerance, a number, but its `rtol` has "
            f"values along `{dataset['rtol'].dims[0]}`."
        )
    return float(number("dataset.rtol", dataset["rtol"].values, "positive"))


def _program(point: Callable[..., Returned] | Program, dataset: xr.Dataset) -> Program:
    """The program of a dataset's point.

    **Raises:** `ValueError` where it is another.
    """
    names = str(dataset.attrs.get("scene_axes", "rtol")).split(", ")
    program = point if isinstance(point, Program) else Program(point, names=names)
    missing = [n for n in program.names if n not in dataset.coords]
    if "rtol" not in program.names or missing:
        raise ValueError(
            "Argument `dataset` must be a sweep of this `point` over its parameters, "
            f"`rtol` among them, but these are {', '.join(program.names)}, and the "
            f"dataset has {', '.join(map(str, dataset.coords))}."
        )
    if dataset.attrs.get("scene_digest") != program.digest:
        raise ValueError(
            "Argument `dataset` must be a sweep of this `point`, but its "
            f"`scene_digest` is {dataset.attrs.get('scene_digest')!r}, not "
            f"{program.digest!r}."
        )
    return program


def _beside_another_end(numbers: dict[str, np.ndarray]) -> np.ndarray:
    """Which cells have ended beside one that has ended otherwise."""
    outcome, amplitude = numbers["outcome"], numbers["joint_amplitude"]
    ended, beside = np.isin(outcome, ENDED), np.zeros(outcome.shape, bool)
    moves = np.isin(outcome, CYCLES)
    for axis in range(outcome.ndim):
        a, b = (
            tuple(part if i == axis else slice(None) for i in range(outcome.ndim))
            for part in (slice(None, -1), slice(1, None))
        )
        unlike = moves[a] & moves[b] & _apart(amplitude[a], amplitude[b], JUMP)
        unlike |= ended[a] & ended[b] & (outcome[a] != outcome[b])
        beside[a] |= unlike
        beside[b] |= unlike
    return beside


def _apart(one: np.ndarray, other: np.ndarray, by: float) -> np.ndarray:
    """Whether amplitudes differ by more than this share of the largest joint's."""
    largest = np.maximum(one, other).max(axis=-1)
    return ~(np.abs(one - other).max(axis=-1) <= by * largest)  # NaN does


def _compared(
    before: dict[str, np.ndarray], after: dict[str, np.ndarray]
) -> np.ndarray:
    """What `again` is of cells by their numbers at both tolerances."""
    end = before["outcome"] != after["outcome"]
    moves = np.isin(after["outcome"], CYCLES)  # what creeps to rest hardly does
    end |= moves & _apart(before["joint_amplitude"], after["joint_amplitude"], OFF)
    alike = np.abs(before["time"] - after["time"]) <= OFF * before["time"]
    return np.select([end, ~alike], [OTHER_END, OTHER_TIME], SAME)


def _at(parameter: xr.DataArray, places: dict[str, np.ndarray]) -> np.ndarray:
    """A parameter's values at cells, by their places along each dimension."""
    if parameter.ndim:
        return parameter.values[places[str(parameter.dims[0])]]
    return np.full(next(iter(places.values())).size, parameter.values)
