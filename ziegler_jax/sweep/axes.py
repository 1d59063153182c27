"""The axes of a sweep, what its points return, and the rules that both keep."""

import difflib
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple, TypeGuard, cast

import jax
import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from ..results import DIMENSIONS, REGIMES, AbstractResult, Variable, checked

# what is an option of `Lanes` or `Store`
_OF_LANES = {
    name: f"lanes=zj.Lanes({name}=...)" for name in ("batch_size", "threads")
} | {"overwrite": "store=zj.Store(path, overwrite=True)"}
# what a `point` returns: an entry, or a dict of entries
Number = jax.typing.ArrayLike | Variable
Entry = Number | AbstractResult
Returned = Entry | Mapping[str, Entry]
UNNAMED = "dim_0"  # the dimension of a DataArray that was given none
AXIS_LABELS = ("long_name", "units", "symbol")
LONGEST_NAME = 60  # characters: a file system allows names of 255 bytes


def checked_axes(
    point: Callable[..., Returned],
    extra: Mapping[str, ArrayLike] | None,
    named: Mapping[str, ArrayLike],
    options: Iterable[str],
) -> dict[str, np.ndarray]:
    """The axes by dimension, checked against the function and the rules.

    An axis is an array of numbers, or of records where parameters share a dimension.

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
    return {
        dim: _values(dim, mates[dim]) if [*mates] == [dim] else _records(dim, mates)
        for dim, mates in _by_dimension(given).items()
    }


def own_labels(given: Mapping[str, ArrayLike]) -> dict[str, dict[str, str]]:
    """What DataArrays say of the axes that they are: name, unit and symbol.

    **Raises:** `ValueError` for what is no text.
    """
    labels: dict[str, dict[str, str]] = {}
    for name, values in given.items():
        if not isinstance(values, xr.DataArray):
            continue
        about = {k: v for k, v in values.attrs.items() if k in AXIS_LABELS}
        for key, text in about.items():
            if not isinstance(text, str) or not text:
                raise ValueError(
                    f"Attribute `{key}` of axis `{name}` must be a text, but is "
                    f"{text!r}."
                )
        labels[name] = {str(key): text for key, text in about.items()}
    return labels


def parameters(grid: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The values of each parameter, where some share a dimension."""
    values = {}
    for dim, axis in grid.items():
        names = axis.dtype.names
        values |= {dim: axis} if names is None else {n: axis[n] for n in names}
    return values


def check_name(what: str, name: object) -> None:
    """The one rule for names of axes and results, which become names of files.

    **Raises:** `ValueError`.
    """
    good = isinstance(name, str) and name.isidentifier() and len(name) <= LONGEST_NAME
    if not good:
        raise ValueError(
            f"{what} {name!r} must have a name of letters, digits and underscores, "
            f"{LONGEST_NAME} characters at most, that begins with no digit."
        )


def _by_dimension(given: Mapping[str, ArrayLike]) -> dict[str, dict[str, ArrayLike]]:
    """The parameters that share each dimension, as DataArrays do; else each its own."""
    dims = {
        name: str(values.dims[0]) if _is_labelled(values) else name
        for name, values in given.items()
    }
    for name, dim in dims.items():
        if dim != name and dims.get(dim, dim) != dim:
            raise ValueError(
                f"Axis `{name}` must not lie along `{dim}`, which is also the name of "
                f"an axis along `{dims[dim]}`: rename the dimension."
            )
    mates: dict[str, dict[str, ArrayLike]] = {}
    for name, values in given.items():
        alone = list(dims.values()).count(dims[name]) == 1
        unnamed = dims[name] == UNNAMED and alone
        mates.setdefault(name if unnamed else dims[name], {})[name] = values
    for dim in mates.keys() - given.keys():
        check_name("Dimension", dim)
    return mates


def _is_labelled(values: object) -> TypeGuard[xr.DataArray]:
    return isinstance(values, xr.DataArray) and values.ndim == 1


def _records(dim: str, mates: Mapping[str, ArrayLike]) -> np.ndarray:
    """Values that go together: one record a place along their dimension."""
    columns = {name: _numbers(name, values) for name, values in mates.items()}
    _check_same_places(dim, mates)
    (first, length), *others = [(n, c.size) for n, c in columns.items()]
    for name, size in others:
        if size != length:
            raise ValueError(
                f"Axis `{name}` must be as long as axis `{first}`, with which it "
                f"shares the dimension `{dim}`, but has {size} values, not {length}."
            )
    if dim in columns:
        _check_unlike(dim, columns[dim])
    records = np.empty(length, [(name, np.float64) for name in columns])
    for name, column in columns.items():
        records[name] = column
    return records


def _check_same_places(dim: str, mates: Mapping[str, ArrayLike]) -> None:
    """Refuse DataArrays that go together but have unlike coordinates there."""
    places = {
        name: values.indexes[dim]
        for name, values in mates.items()
        if isinstance(values, xr.DataArray) and dim in values.indexes
    }
    for name, index in places.items():
        first = next(iter(places))
        if not index.equals(places[first]):
            raise ValueError(
                f"Axis `{name}` must have the coordinates of axis `{first}` along "
                f"`{dim}`, but has others: write `xr.align({first}, {name})`."
            )


def _values(name: str, values: ArrayLike) -> np.ndarray:
    """The values of an axis of its own."""
    values = _numbers(name, values)
    _check_unlike(name, values)
    return values


def _check_unlike(name: str, values: np.ndarray) -> None:
    """Refuse values that come twice: they could not be chosen by `sel`."""
    unlike, counts = np.unique(values, return_counts=True)
    if unlike.size < values.size:
        twice = unlike[counts.argmax()]
        raise ValueError(
            f"Axis `{name}` must have each value once, but has {twice:.17g} "
            f"{counts.max()} times: write `np.unique({name})`."
        )


def _numbers(name: str, values: ArrayLike) -> np.ndarray:
    """The values of a parameter."""
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
    return values


def check_signature(
    function: Callable[..., object],
    names: list[str],
    what: str,
    options: Iterable[str] = (),
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
        close = difflib.get_close_matches(name, [*known, *options, *_OF_LANES], 1)
        cure = [_OF_LANES.get(meant, meant) for meant in close]
        meant = f"; did you mean `{cure[0]}`?" if cure else "."
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


# Names that scenes give codes which come without a result: flag variables.
FLAGS = {"regime": REGIMES}


class Labelled(NamedTuple):
    """What a point returned: all that a dataset of it holds."""

    variables: dict[str, Variable]
    coordinates: dict[str, Sequence[object]]
    attributes: dict[str, object]


def labelled(result: Returned) -> Labelled:
    """What a `point` returned, as named variables.

    **Arguments:** `result`: a scalar (its name is `value`), a result of the library, or
    a dict of scalars, `Variable`s and results, whose names then go before those of
    their numbers: `{"up": settle(...)}` gives `up_outcome`.

    **Raises:** `ValueError` that names the entry which is none of these.
    """
    if isinstance(result, AbstractResult):
        named = checked(
            f"`variables()` of `{type(result).__name__}`", result.variables()
        )
        return _of_one_point(Labelled(named, result.coordinates(), result.attributes()))
    entries = result if isinstance(result, dict) else {"value": result}
    if not entries:
        raise ValueError("`point` must return something, but returns an empty dict.")
    union = Labelled({}, {}, {})
    for key, value in entries.items():
        if isinstance(value, AbstractResult):
            part = labelled(value)
            new = {f"{key}_{name}": v for name, v in part.variables.items()}
            attributes = {f"{key}_{name}": v for name, v in part.attributes.items()}
            _agree(union.coordinates, part.coordinates)
            union.coordinates.update(part.coordinates)
            union.attributes.update(attributes)
        else:
            new = {str(key): _variable(str(key), cast(Number, value))}
        twice = union.variables.keys() & new.keys()
        if twice:
            raise ValueError(
                f"`point` must return one number of each name, but returns two "
                f"`{twice.pop()}`."
            )
        union.variables.update(new)
    return _of_one_point(union)


def _of_one_point(returned: Labelled) -> Labelled:
    """What can stand in a dataset: axes with names, each of one size, none empty."""
    known = {**DIMENSIONS, **returned.coordinates}
    sizes = {dim: ("its coordinate", len(values)) for dim, values in known.items()}
    for name, variable in returned.variables.items():
        shape = np.shape(cast(ArrayLike, variable.value))
        if len(shape) != len(variable.dims):
            raise ValueError(
                f"`point` must name the dimensions of an array, but `{name}` has shape "
                f"{shape} and the dimensions {variable.dims}; write "
                f'`zj.Variable({name}, "what it is", dims=("...",))`.'
            )
        for dim, size in zip(variable.dims, shape, strict=True):
            other, expected = sizes.setdefault(dim, (f"`{name}`", size))
            if size != expected:
                raise ValueError(
                    f"`point` must give dimension `{dim}` one size, but `{name}` has "
                    f"{size} values along it and {other} has {expected}: name two "
                    "dimensions."
                )
            if size == 0:
                raise ValueError(
                    f"`point` must return values along each dimension, but `{name}` "
                    f"has none along `{dim}`: leave it out."
                )
    return returned


def _variable(name: str, value: Number) -> Variable:
    """An entry of a dict."""
    given = value if isinstance(value, Variable) else Variable(value, name)
    shape = getattr(given.value, "shape", None)
    if isinstance(given.value, (bool, int, float)):
        shape = ()
    if shape is None:
        raise ValueError(
            "`point` must return a scalar, a result of the library, or a dict of "
            "scalars, `Variable`s and results, but "
            f"`{name}` is a `{type(given.value).__name__}`; return numbers of it, e.g. "
            '`{"phi1": state.phi[0]}`.'
        )
    dims = given.dims
    if not isinstance(dims, tuple) or len(set(dims)) < len(dims):
        raise ValueError(
            f"The dimensions of `{name}` must be a tuple of names unlike each other, "
            f"but are {dims!r}."
        )
    for dim in dims:
        check_name("Dimension", dim)
    codes = FLAGS.get(name) if given.codes is None else given.codes
    return given._replace(codes=codes)


def _agree(one: Mapping[str, object], other: Mapping[str, object]) -> None:
    """Refuse one dimension with two sets of values."""
    for dim in one.keys() & other.keys():
        if one[dim] != other[dim]:
            raise ValueError(
                f"Results of `point` must agree in the dimension `{dim}`, but have "
                "other values along it; return numbers of them instead."
            )


def empty(variable: Variable, shape: tuple[int, ...]) -> np.ndarray:
    """A variable over a grid: NaN for numbers, 0 (`not_computed`) for codes.

    One number in memory, however large the shape: copy it to write to it.
    """
    value = cast(jax.ShapeDtypeStruct, variable.value)
    dtype = np.dtype(value.dtype)
    if dtype.kind in "biu" and variable.codes is None:
        dtype = np.dtype(np.float64)  # so that a missing point can be told from 0
    fill = np.array(np.nan if dtype.kind in "fc" else 0, dtype)
    return np.broadcast_to(fill, shape + tuple(value.shape))
