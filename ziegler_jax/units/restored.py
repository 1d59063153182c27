"""Results back in SI units."""

import dataclasses
from collections.abc import Callable, Hashable

import equinox as eqx
import xarray as xr

from ..motion.trajectory import Trajectory
from ..numerics.numbers import Scalar, is_concrete
from ..results import TIME
from .known import PURE, UNITS, Powers

Size = Callable[[Powers], Scalar]  # of a unit, in SI
# In a dataset `m` is the metre, on an axis of the scene's own.
READ = {name: unit for name, unit in UNITS.items() if name != "m"}


def restored_motion(motion: Trajectory, size: Size) -> Trajectory:
    """A motion in seconds and rad/s.

    **Raises:** `ValueError` for one that is so already.
    """
    if motion.in_si:
        raise ValueError(
            "Argument `result` must be in the column's own units, but is a motion in "
            "seconds, which `restore` has made."
        )
    second = size(UNITS[TIME].powers)
    events = motion.events
    if events is not None:
        events = eqx.tree_at(lambda e: e.times, events, events.times * second)
    times = motion.times
    return dataclasses.replace(
        motion,
        ts=motion.ts * second,
        omega=motion.omega / second,
        events=events,
        settings=(*motion.settings, ("units", "SI")),
        times=times and _known(times, second),
    )


def _known(times: tuple[float, ...], unit: Scalar) -> tuple[float, ...] | None:
    """In seconds, where the unit is known now."""
    return tuple(float(t * unit) for t in times) if is_concrete(unit) else None


def restored_dataset(dataset: xr.Dataset, size: Size) -> xr.Dataset:
    """A dataset whose variables and coordinates are in SI units.

    **Raises:** `ValueError` for a variable in a unit that is not known.
    """

    def restored(name: Hashable, values: xr.DataArray) -> xr.DataArray:
        unit = str(values.attrs.get("units", ""))
        if unit in ("", *PURE):
            return values
        if unit not in READ and name in dataset.coords:
            return values  # an axis of the scene's own, in its own unit
        if unit not in READ:
            raise ValueError(
                f"Variable `{name}` of the dataset must be in one of "
                f"{', '.join(READ)}, rad or 1, but is in {unit}."
            )
        powers, name_si = READ[unit]
        factor = float(size(powers))
        # `plot.page` needs the factor: a cell's scene is in the column's own units
        about = {**values.attrs, "units": name_si, "si_unit": factor}
        if about.get("symbol") == "$q$" and name_si == "N":
            about["symbol"] = "$F$"
        return (values * factor).assign_attrs(about)

    # without the old coordinates, which each variable still carries
    data = {n: restored(n, v).variable for n, v in dataset.data_vars.items()}
    coords = {n: restored(n, v).variable for n, v in dataset.coords.items()}
    attrs = {**dataset.attrs, "options_in": "the column's own units, not SI"}
    return xr.Dataset(data, coords, attrs)
