"""Results back in SI units."""

import dataclasses
from collections.abc import Hashable
from typing import NamedTuple

import equinox as eqx
import xarray as xr

from ..motion.trajectory import Trajectory
from ..numerics.numbers import Scalar, is_concrete

LOAD = " F l/k"  # ends the name of a number that is a load


class Scales(NamedTuple):
    """A column's units: s, N, N m and m."""

    time: Scalar
    force: Scalar
    torque: Scalar
    length: Scalar


def restored_motion(motion: Trajectory, si: Scales) -> Trajectory:
    """A motion in seconds and rad/s.

    **Raises:** `ValueError` for one that is so already.
    """
    if motion.in_si:
        raise ValueError(
            "Argument `result` must be in the column's own units, but is a motion in "
            "seconds, which `restore` has made."
        )
    events = motion.events
    if events is not None:
        events = eqx.tree_at(lambda e: e.times, events, events.times * si.time)
    times = motion.times
    return dataclasses.replace(
        motion,
        ts=motion.ts * si.time,
        omega=motion.omega / si.time,
        events=events,
        settings=(*motion.settings, ("units", "SI")),
        times=times and _known(times, si.time),
    )


def _known(times: tuple[float, ...], unit: Scalar) -> tuple[float, ...] | None:
    """In seconds, where the unit is known now."""
    return tuple(float(t * unit) for t in times) if is_concrete(unit) else None


def restored_dataset(dataset: xr.Dataset, si: Scales) -> xr.Dataset:
    """A dataset whose variables and coordinates are in SI units.

    **Raises:** `ValueError` for a variable in a unit that is not known.
    """
    units = {
        "sqrt(m l^2/k)": (si.time, "s"),
        "sqrt(k/(m l^2))": (1 / si.time, "rad/s"),
        "sqrt(k m l^2)": (si.torque * si.time, "N m s"),
        "k sqrt(k/(m l^2))": (si.torque / si.time, "W"),
        "k/l": (si.force, "N"),
        "k": (si.torque, "N m"),
        "l": (si.length, "m"),
    }

    def restored(name: Hashable, values: xr.DataArray) -> xr.DataArray:
        unit, meaning = (str(values.attrs.get(k, "")) for k in ("units", "long_name"))
        if unit == "1" and meaning.endswith(LOAD):
            unit, about = "k/l", {"long_name": meaning.removesuffix(LOAD)}
            if values.attrs.get("symbol") == "$q$":
                about["symbol"] = "$F$"
            values = values.assign_attrs(about)
        if unit in ("", "1", "rad"):
            return values
        if unit not in units and name in dataset.coords:
            return values  # an axis of the scene's own, in its own unit
        if unit not in units:
            raise ValueError(
                f"Variable `{name}` of the dataset must be in one of "
                f"{', '.join(units)}, rad or 1, but is in {unit}."
            )
        factor, name_si = units[unit]
        # `plot.page` needs the factor: a cell's scene is in the column's own units
        about = {**values.attrs, "units": name_si, "si_unit": float(factor)}
        return (values * float(factor)).assign_attrs(about)

    # without the old coordinates, which each variable still carries
    data = {n: restored(n, v).variable for n, v in dataset.data_vars.items()}
    coords = {n: restored(n, v).variable for n, v in dataset.coords.items()}
    attrs = {**dataset.attrs, "options_in": "the column's own units, not SI"}
    return xr.Dataset(data, coords, attrs)
