"""Results back in SI units."""

import dataclasses
from collections.abc import Callable, Hashable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Shaped

from ..motion.trajectory import Trajectory
from ..numerics.numbers import Scalar, is_concrete
from ..results import (
    TIME,
    AbstractDescribed,
    AbstractResult,
    Settings,
    Variable,
    without_values,
)
from .known import PURE, UNITS, Powers, Unit, size

Size = Callable[[Powers], Scalar]  # of a unit, in SI
# In a dataset `m` is the metre, on an axis of the scene's own.
READ = {name: unit for name, unit in UNITS.items() if name != "m"}
OPTIONS = ("options_in", "the column's own units, not SI")


class Restored(AbstractDescribed):
    r"""A result in SI units: each of its numbers is an attribute, and printed.

    Where the result has a `period` (s), there is its `frequency` (Hz) beside it,
    $f = 1/T$: cycles a second. (A `CriticalLoad` has the angular frequency of the
    swing at the onset, in rad/s.)
    """

    numbers: dict[str, Shaped[Array, "..."]]
    quantities: tuple[tuple[str, Variable], ...] = eqx.field(static=True)
    result: AbstractResult  # in the column's own units
    scales: tuple[Scalar, Scalar, Scalar]  # m, l and k
    settings: Settings = eqx.field(static=True)

    def to_dataset(self) -> xr.Dataset:
        """The numbers as a sweep labels them, in SI units.

        **Raises:** `ValueError` for results of several scales, as under `jax.vmap`.
        """
        if any(jnp.ndim(scale) for scale in self.scales):
            raise ValueError(
                "A dataset is in one set of units, but m, l and k of this result are "
                f"of shape {jnp.shape(self.scales[0])}: take one result, or its "
                "attributes."
            )
        return restored_dataset(
            self.result.to_dataset(), lambda powers: size(powers, self.scales)
        )

    def __repr__(self) -> str:
        """The numbers with their units, and what the codes mean."""
        kind = f"{type(self.result).__name__} in SI units"
        return super().__repr__().replace(type(self).__name__, kind, 1)


def restored_result(
    result: AbstractResult, scales: tuple[Scalar, Scalar, Scalar]
) -> Restored:
    """A result in SI units, where m, l and k are these.

    **Raises:** `ValueError` for a number in a unit that is not known, and for a result
    that is in SI units.
    """
    if isinstance(result, Restored):
        raise ValueError(
            "Argument `result` must be in the column's own units, but is a result in "
            "SI units, which `restore` has made."
        )
    named = {}
    for name, variable in result.variables().items():
        unit = _unit_of(name, variable.units)
        if unit is not None:
            value = jnp.asarray(variable.value) * size(unit.powers, scales)
            variable = variable._replace(value=value, units=unit.name)
        named[name] = variable
        if name == "period" and unit is not None:
            value = 1 / jnp.asarray(variable.value)
            named["frequency"] = variable._replace(
                value=value, long_name=_frequency_of(variable.long_name), units="Hz"
            )
    numbers = {name: variable.value for name, variable in named.items()}
    settings = (*result.settings, OPTIONS)
    return Restored(
        numbers=numbers,
        quantities=without_values(named),
        result=result,
        scales=scales,
        settings=settings,
    )


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

    A `period` has its `frequency` (Hz) beside it.

    **Raises:** `ValueError` for a variable in a unit that is not known.
    """

    def restored(name: Hashable, values: xr.DataArray) -> xr.DataArray:
        units = str(values.attrs.get("units", ""))
        if units not in READ and name in dataset.coords:
            return values  # an axis of the scene's own, in its own unit
        unit = _unit_of(name, units)
        if unit is None:
            return values
        factor = float(size(unit.powers))
        # `plot.page` needs the factor: a cell's scene is in the column's own units
        about = {**values.attrs, "units": unit.name, "si_unit": factor}
        if about.get("symbol") == "$q$" and unit.name == "N":
            about["symbol"] = "$F$"
        return (values * factor).assign_attrs(about)

    # without the old coordinates, which each variable still carries
    data = {n: restored(n, v).variable for n, v in dataset.data_vars.items()}
    coords = {n: restored(n, v).variable for n, v in dataset.coords.items()}
    period = data.get("period")
    if period is not None and period.attrs.get("units") == UNITS[TIME].name:
        data["frequency"] = _frequency(period)
    return xr.Dataset(data, coords, {**dataset.attrs, **dict([OPTIONS])})


def _frequency(period: xr.Variable) -> xr.Variable:
    """The frequency of cycles of this period (s)."""
    meaning = _frequency_of(str(period.attrs.get("long_name", "period")))
    about = {"long_name": meaning, "units": "Hz"}
    return xr.Variable(period.dims, 1 / np.asarray(period), about)


def _frequency_of(meaning: str) -> str:
    """The meaning of the reciprocal of a period with this meaning."""
    if "period" in meaning:
        return meaning.replace("period", "frequency", 1)
    return f"frequency, of a {meaning}"


def _unit_of(name: Hashable, units: str) -> Unit | None:
    """The unit of a number, None of a pure one.

    **Raises:** `ValueError` for one that is not known.
    """
    if units in ("", *PURE):
        return None
    if units not in READ:
        raise ValueError(
            f"Variable `{name}` of the result must be in one of {', '.join(READ)}, rad "
            f"or 1, but is in {units}."
        )
    return READ[units]
