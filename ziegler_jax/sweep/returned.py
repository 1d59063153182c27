"""The results of a point: named numbers, and the rules that they keep."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

import jax
import numpy as np
from numpy.typing import ArrayLike

from ..results import REGIMES, AbstractResult, Variable, checked, counted
from .grid import check_name

# what a `point` returns: an entry, or a dict of entries
Number = jax.typing.ArrayLike | Variable
Entry = Number | AbstractResult
Returned = Entry | Mapping[str, Entry]
# Names that scenes give codes which come without a result: flag variables.
FLAGS = {"regime": REGIMES}


class Labelled(NamedTuple):
    """The results of a point, with all that a dataset of them needs."""

    variables: dict[str, Variable]
    coordinates: dict[str, Sequence[object]]
    attributes: dict[str, object]


def labelled(result: Returned) -> Labelled:
    """The results of a `point` as named variables.

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
    """Results fit for a dataset: axes with names, each of one size, none empty."""
    known = {**counted(returned.variables), **returned.coordinates}
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
