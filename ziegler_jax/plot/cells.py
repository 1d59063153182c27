"""The motion of one cell of a map: its column and start, followed as the map was."""

import inspect
import re
from collections.abc import Callable, Mapping
from typing import NamedTuple

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from ..model.chain_of_rods import AbstractChain
from ..model.state import State
from ..motion.checks import scene_at
from ..motion.options import Method, Solver
from ..motion.trajectory import Trajectory, trajectory
from ..results import CODE, DIMENSIONS
from ..solvers import Explicit, Rosenbrock, Taylor, tableaus

Cell = Callable[..., tuple[AbstractChain, State]]
LONGEST, SAMPLES = 200.0, 4001  # of the motion that is shown
SAME = 0.01  # of an amplitude: what the map and the motion may differ by

# those of diffrax by their names in a dataset's attributes; others are not looked up
_OF_DIFFRAX = (dfx.Bosh3, dfx.Dopri5, dfx.Dopri8, dfx.Heun, dfx.Ralston, dfx.Tsit5)


class Followed(NamedTuple):
    """A cell's column, its motion, and where that ends otherwise than the cell."""

    column: AbstractChain
    motion: Trajectory
    note: str


def followed(dataset: xr.Dataset, cell: Cell, place: Mapping[str, int]) -> Followed:
    """The motion of the cell at these places along the axes.

    It is followed to the time at which the map's own motion ended, at most to 200 (100
    where the dataset does not know it), by the method in the dataset's attributes.

    **Raises:** `ValueError` for a `cell` that is not the map's, and as `trajectory`.
    """
    here = dataset.isel(place)
    with jax.enable_x64(True):
        column, start = scene_of(here, cell)
        end = in_own_unit(here.get("time", xr.DataArray(np.nan)))
        last = min(end, LONGEST) if end > 0 else LONGEST / 2
        ts = np.linspace(0.0, last, SAMPLES)
        motion = trajectory(column, start, ts, method=method_of(dataset.attrs))
    return Followed(column, motion, _note(here, motion, end))


def scene_of(here: xr.Dataset, cell: Cell) -> tuple[AbstractChain, State]:
    """What `cell` gives at this place, called with the coordinates that it names.

    **Raises:** `ValueError`.
    """
    if not callable(cell):
        raise ValueError(
            "Argument `cell` must be a function of the map's axes that gives a column "
            f"and a start, but is {cell!r}."
        )
    values = {}
    for name, parameter in inspect.signature(cell).parameters.items():
        if name in here.coords and here[name].ndim == 0:
            values[name] = jnp.asarray(in_own_unit(here[name]))
        elif parameter.default is parameter.empty:
            single = [n for n, c in here.coords.items() if c.ndim == 0]
            axes = ", ".join(f"`{n}`" for n in single if n not in DIMENSIONS)
            raise ValueError(
                f"Argument `cell` must be a function of the map's axes, which are "
                f"{axes}, but has a parameter `{name}`."
            )
    return scene_at(cell, **values)


def method_of(attributes: Mapping[str, object]) -> Method:
    """The method that a dataset's attributes name.

    A tolerance that was set point by point, and a solver of one's own, are not known
    there: those of `trajectory` then stand in.
    """
    rtol, atol = (
        value if isinstance(value, float) and value > 0 else None
        for value in (attributes.get("rtol"), attributes.get("atol"))
    )
    return Method(_solver(str(attributes.get("solver", ""))), rtol, atol)


def _solver(name: str) -> Solver | None:
    """The method of this name, None where none has it."""
    if order := re.fullmatch(r"Taylor(\d{1,2})", name):
        return Taylor(int(order[1]))
    if name == Rosenbrock.name:
        return Rosenbrock()
    if name in tableaus.ALL:
        return Explicit(*tableaus.ALL[name])
    by_name = {kind.__name__: kind for kind in _OF_DIFFRAX}
    return Explicit(by_name[name]()) if name in by_name else None


def _note(here: xr.Dataset, motion: Trajectory, end: float) -> str:
    """In which way the motion's end differs from the cell's, or nothing."""
    ended = CODE(int(motion.outcome))
    cells = CODE(int(here["outcome"])) if "outcome" in here else None
    last = float(motion.ts[-1])
    if ended is not CODE.complete:
        early = f"The motion shown ended early: {ended.sentence}"
        if cells is None or cells is ended:
            return early
        return f"{early}; the map's cell is {cells.name}: {cells.sentence}"
    if end > last:
        return f"Shown to t = {last:g}; it was followed to t = {end:g}"
    if cells is not None and cells < CODE.unsettled:
        return f"The map's cell is {cells.name}, the motion shown is not."
    if not end > 0 or "joint_amplitude" not in here:
        return ""
    return _unlike(here, motion, end)


def _unlike(here: xr.Dataset, motion: Trajectory, end: float) -> str:
    """Whether the motion is as large at its end as the cell says."""
    last = _observed(here, end)
    if "joint" not in here.coords or last is None:
        return ""
    ts, phi = np.asarray(motion.ts), np.asarray(motion.phi)
    late = phi[ts >= ts[-1] - last]
    shown = np.abs(late - np.pad(late, ((0, 0), (1, 0)))[:, :-1]).max(axis=0)
    joints = np.atleast_1d(here["joint"]).tolist()
    drawn = np.atleast_1d(here["joint_amplitude"]).tolist()
    for joint, one in zip(joints, drawn, strict=True):
        if abs(shown[joint - 1] - one) > SAME * max(abs(one), 1e-3):
            return (
                f"The largest angle of joint {joint} is {one:.4g} in the map, and "
                f"{shown[joint - 1]:.4g} at the end of the motion shown."
            )
    return ""


def _observed(here: xr.Dataset, end: float) -> float | None:
    """For how long before its end the cell's motion was observed; None: not known."""
    if "windows" in here:
        transient, length = (here.attrs.get(n) for n in ("transient", "window_length"))
        windows = int(here["windows"])
        if windows < 0:  # it stuck in the transient
            return 0.0
        if not (isinstance(transient, float) and isinstance(length, float)):
            return None
        within = end - transient - windows * length
        # it ended within a window, or with one
        return within if within > 1e-9 * end else length
    if int(here.get("outcome", CODE.complete)) in (CODE.stuck, CODE.rest):
        return 0.0  # the last state
    period = in_own_unit(here.get("period", xr.DataArray(np.nan)))
    return period if period > 0 else None


def in_own_unit(number: xr.DataArray) -> float:
    """A number in the column's unit, which `SI.restore` may have changed."""
    return float(number) / number.attrs.get("si_unit", 1.0)


def nearest(dataset: xr.Dataset, dim: str, value: float) -> int:
    """The place of the nearest value of an axis, or of a sample by its number.

    **Raises:** `ValueError` for what is beside the map.
    """
    if not isinstance(value, int | float | np.number):
        raise ValueError(f"Argument `{dim}` must be a number, but is {value!r}.")
    if dim not in dataset.indexes:
        size = dataset.sizes[dim]
        if not (isinstance(value, int | np.integer) and 0 <= value < size):
            raise ValueError(
                f"Argument `{dim}` must be a number of 0 to {size - 1}, but is "
                f"{value!r}."
            )
        return int(value)
    values = np.asarray(dataset[dim], float)
    apart = np.abs(values - value)
    place = int(apart.argmin())
    # a cell reaches halfway to its neighbours, and as far beyond the ends
    gaps = np.abs(np.diff(np.sort(values)))
    reach = gaps.max() / 2 if gaps.size else np.inf
    if not apart[place] <= reach * (1 + 1e-9):
        raise ValueError(
            f"Argument `{dim}` must be on the map, which reaches from {values.min():g} "
            f"to {values.max():g}, but is {value:g}."
        )
    return place
