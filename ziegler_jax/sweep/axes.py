"""The axes of a sweep, and the rules that its names and values keep."""

import difflib
import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
import xarray as xr

LONGEST_NAME = 60  # characters: a file system allows names of 255 bytes


def checked_axes(
    point: Callable, extra: Any, named: Mapping[str, Any], options: Iterable[str]
) -> dict[str, np.ndarray]:
    """The axes by name, checked against the function and the rules.

    **Arguments:** `options`: the names of the sweep's own arguments, one of which may
    have been misspelt.

    **Raises:** `ValueError` that names the axis, its value and the rule.
    """
    if not callable(point):
        raise ValueError(f"Argument `point` must be a function, but is {point!r}.")
    if extra is not None and not isinstance(extra, Mapping):
        raise ValueError(f"Argument `axes` must map names to values, but is {extra!r}.")
    extra = dict(extra or {})
    twice = set(extra) & set(named)
    if twice:
        raise ValueError(
            f"Axis `{twice.pop()}` must be given once, but is given twice."
        )
    given = {**named, **extra}
    for name in given:
        check_name("Axis", name)
    if not given:
        raise ValueError("A sweep must have at least one axis, but has none.")
    check_signature(point, list(given), "point", options)
    _check_dimensions(given)
    return {name: _values(name, values) for name, values in given.items()}


def check_name(what: str, name: Any) -> None:
    """The one rule for names of axes and results, which become names of files.

    **Raises:** `ValueError`.
    """
    good = isinstance(name, str) and name.isidentifier() and len(name) <= LONGEST_NAME
    if not good:
        raise ValueError(
            f"{what} {name!r} must have a name of letters, digits and underscores, "
            f"{LONGEST_NAME} characters at most, that begins with no digit."
        )


def _values(name: str, values: Any) -> np.ndarray:
    """The values of an axis."""
    try:
        kind = np.asarray(values).dtype.kind
        if kind not in "iuf" or np.ma.isMaskedArray(values):
            raise TypeError
        values = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"Axis `{name}` must be real numbers, but is {values!r}."
        ) from None
    if values.ndim == 0:
        raise ValueError(
            f"Axis `{name}` must have one dimension, but is the number {values:g}: "
            f"write `{name}=[{values:g}]`."
        )
    if values.ndim != 1:
        raise ValueError(
            f"Axis `{name}` must have one dimension, but has shape {values.shape}."
        )
    if values.size == 0:
        raise ValueError(f"Axis `{name}` must have values, but is empty.")
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise ValueError(
            f"Axis `{name}` must be finite, but is {values[bad[0]]} at index {bad[0]}."
        )
    unlike, counts = np.unique(values, return_counts=True)
    if unlike.size < values.size:
        twice = unlike[counts.argmax()]
        raise ValueError(
            f"Axis `{name}` must have each value once, but has {twice:.17g} "
            f"{counts.max()} times: write `np.unique({name})`."
        )
    return values


def _check_dimensions(given: Mapping[str, Any]) -> None:
    """Refuse DataArrays that share a dimension: they would be taken as a product."""
    owner: dict[Any, str] = {}
    for name, values in given.items():
        for dim in values.dims if isinstance(values, xr.DataArray) else ():
            if dim in owner:
                raise ValueError(
                    f"Axis `{name}` must have a dimension of its own, but shares "
                    f"`{dim}` with axis `{owner[dim]}`: for pairs of values sweep over "
                    "their number, and take them from tables by `jnp.asarray(table)"
                    "[i.astype(int)]` in `point`."
                )
            owner[dim] = name


def check_signature(
    function: Callable, names: list[str], what: str, options: Iterable[str] = ()
) -> None:
    """Refuse axes that a function does not take, and parameters that are no axes."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return  # a callable that hides its parameters: the call itself will tell
    takes_any = any(p.kind is p.VAR_KEYWORD for p in parameters)
    by_name = [
        p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)
    ]
    known = {p.name for p in by_name}
    for name in names:
        if name in known or takes_any:
            continue
        close = difflib.get_close_matches(name, [*known, *options], 1)
        meant = f"; did you mean `{close[0]}`?" if close else "."
        raise ValueError(
            f"Axis `{name}` must be a parameter of `{what}`, which takes "
            f"{', '.join(sorted(known)) or 'no parameters by name'}{meant}"
        )
    for p in by_name:
        if p.default is p.empty and p.name not in names:
            raise ValueError(
                f"Parameter `{p.name}` of `{what}` must be an axis of the sweep, whose "
                f"axes are {', '.join(names) or 'none'}."
            )
