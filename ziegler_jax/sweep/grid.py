"""The points of a sweep: its axes, which of them are wanted, and how they are parted.

A grid is cut into blocks, runs of neighbouring points that are kept as one. A block is
a box of the grid, whole along the last axes, a run along one, and a single value along
those in front: in C order its points follow each other.
"""

import difflib
import hashlib
import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from ..results import AXES

# Writing a block costs some 10 ms, computing one seconds; its arrays are about 1 MB.
POINTS_A_BLOCK = 16_384
# Points may be slow, each a search of seconds: a small sweep has parts to keep, too.
# Batches in flight hold some 256 points, so that smaller parts were not kept sooner.
PARTS, FEWEST = 16, 256
UNNAMED = "dim_0"  # the dimension of a DataArray that was given none
AXIS_LABELS = "long_name", "units", "symbol"
LONGEST_NAME = 60  # characters: a file system allows names of 255 bytes
Where = Callable[..., ArrayLike]


# Axes ---------------------------------------------------------------------------------


def axes_of(
    point: Callable[..., object],
    extra: Mapping[str, ArrayLike] | None,
    named: Mapping[str, ArrayLike],
    options: Iterable[str],
) -> xr.Dataset:
    """The axes as coordinates, checked against the function and the rules.

    **Arguments:** `options`: the names of the sweep's own arguments, one of which may
    have been misspelt.

    **Raises:** `ValueError` that names the axis, its value and the rule.
    """
    if not callable(point):
        raise ValueError(f"Argument `point` must be a function, but is {point!r}.")
    if extra is not None and not isinstance(extra, Mapping):
        raise ValueError(f"Argument `axes` must map names to values, but is {extra!r}.")
    twice = set(extra or ()) & set(named)
    if twice:
        raise ValueError(
            f"Axis `{twice.pop()}` must be given once, but is given twice."
        )
    given = {**named, **(extra or {})}
    for name in given:
        check_name("Axis", name)
    if not given:
        raise ValueError("A sweep must have at least one axis, but has none.")
    check_signature(point, [*given], "point", options)
    axes = {name: _axis(name, values) for name, values in given.items()}
    if not any(axis.ndim for axis in axes.values()):
        name, number = next(iter(axes.items()))
        raise ValueError(
            f"A sweep must have at least one axis, but `{name}` is the number "
            f"{number:g}: write `{name}=[{number:g}]`."
        )
    _check_dimensions(axes)
    unnamed = [name for name, axis in axes.items() if axis.dims == (UNNAMED,)]
    if len(unnamed) == 1:  # xarray's name of a dimension that the user named not
        name = unnamed[0]
        axes[name] = axes[name].rename({UNNAMED: name})
        _check_unlike(axes)
    return xr.Dataset(coords={name: axis.variable for name, axis in axes.items()})


def _axis(name: str, values: ArrayLike) -> xr.DataArray:
    """An axis with its dimension, its name, unit and symbol, and places if it has any.

    **Raises:** `ValueError`.
    """
    about = {"long_name": name, "units": "1", "symbol": name}
    if name in AXES:
        about = dict(zip(AXIS_LABELS, AXES[name], strict=True))
    numbers = _numbers(name, values)
    if not isinstance(values, xr.DataArray):
        return xr.DataArray(numbers, dims=[name] * numbers.ndim, attrs=about)
    for key in AXIS_LABELS:
        text = values.attrs.get(key, "-")
        if not isinstance(text, str) or not text:
            raise ValueError(
                f"Attribute `{key}` of axis `{name}` must be a text, but is {text!r}."
            )
    own = {key: values.attrs[key] for key in AXIS_LABELS if key in values.attrs}
    # what else it says of itself is no matter of the sweep, nor of how it is stored
    places = {dim: values.indexes[dim] for dim in values.dims if dim in values.indexes}
    return xr.DataArray(numbers, places, values.dims, attrs=about | own)


def _check_dimensions(axes: Mapping[str, xr.DataArray]) -> None:
    """The rules of axes that share a dimension, and of those that are one's own.

    **Raises:** `ValueError`.
    """
    dims = {name: str(axis.dims[0]) for name, axis in axes.items() if axis.ndim}
    for name, dim in dims.items():
        if dims.get(dim, dim) != dim:
            raise ValueError(
                f"Axis `{name}` must not lie along `{dim}`, which is also the name of "
                f"an axis along `{dims[dim]}`: rename the dimension."
            )
        if dim in axes and not axes[dim].ndim:
            raise ValueError(
                f"Axis `{name}` must not lie along `{dim}`, which is also the name of "
                "a number: rename the dimension."
            )
        check_name("Dimension", axes[name].dims[0])
    for first, name in combinations(dims, 2):
        if dims[first] != dims[name]:
            continue
        try:
            xr.align(axes[first], axes[name], join="exact")
        except ValueError:
            one, two = (_places(axes[n], dims[n]) for n in (first, name))
            raise ValueError(
                f"Axis `{name}` must have the places of axis `{first}` along "
                f"`{dims[name]}`, {one}, but has {two}: `xr.align({first}, {name})` "
                "keeps those that both have."
            ) from None
    _check_unlike(axes)


def _places(axis: xr.DataArray, dim: str) -> str:
    """Where the values of an axis lie, for a sentence."""
    if dim not in axis.indexes:
        return f"{axis.size} without coordinates"
    values = axis.indexes[dim].tolist()
    return f"{values[:3]}{'...' if len(values) > 3 else ''} ({axis.size})"


def _check_unlike(axes: Mapping[str, xr.DataArray]) -> None:
    """Refuse values that come twice along a dimension of their own.

    They could not be chosen by `sel`.

    **Raises:** `ValueError`.
    """
    dims = {str(dim) for axis in axes.values() for dim in axis.dims}
    for name in axes.keys() & dims:
        unlike, counts = np.unique(axes[name], return_counts=True)
        if unlike.size < axes[name].size:
            raise ValueError(
                f"Axis `{name}` must have each value once, but has "
                f"{unlike[counts.argmax()]:.17g} {counts.max()} times: write "
                f"`np.unique({name})`."
            )


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


def _numbers(name: str, values: ArrayLike) -> np.ndarray:
    """The values of a parameter.

    **Raises:** `ValueError`.
    """
    try:
        kind = np.asarray(values).dtype.kind
        if kind not in "iuf" or np.ma.isMaskedArray(values):
            raise TypeError
        numbers = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"Axis `{name}` must be real numbers, but is {values!r}."
        ) from None
    if numbers.ndim > 1:
        raise ValueError(
            f"Axis `{name}` must have one dimension, or be a number, but has shape "
            f"{numbers.shape}."
        )
    if numbers.size == 0:
        raise ValueError(f"Axis `{name}` must have values, but is empty.")
    bad = np.flatnonzero(~np.isfinite(numbers))
    if bad.size:
        place = f" at index {bad[0]}" if numbers.ndim else ""
        raise ValueError(
            f"Axis `{name}` must be finite, but is {numbers.flat[bad[0]]}{place}."
        )
    return numbers


def check_signature(
    function: Callable[..., object],
    names: Sequence[str],
    what: str,
    options: Iterable[str] = (),
) -> None:
    """Refuse axes that a function does not take, and parameters that are no axes.

    **Raises:** `ValueError`.
    """
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


# Boxes of points ----------------------------------------------------------------------


class Box(NamedTuple):
    """A box of points: each parameter's values, and along which axis they lie.

    Those of a parameter that is one number are all alike, along the first axis.
    """

    shape: tuple[int, ...]
    columns: dict[str, tuple[int, np.ndarray]]

    def part(self, region: Sequence[slice]) -> "Box":
        """A part of the box."""
        columns = {n: (i, v[region[i]]) for n, (i, v) in self.columns.items()}
        return Box(tuple(s.stop - s.start for s in region), columns)

    def values(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """The parameters' values at places of the box, in C order."""
        places = np.unravel_index(points, self.shape)
        return {name: v[places[i]] for name, (i, v) in self.columns.items()}

    def chosen(self, where: Where) -> np.ndarray:
        """Which points `where` chooses.

        **Raises:** `ValueError` if it breaks its rules.
        """
        behind = len(self.shape) - 1
        mesh = {
            name: v.reshape(-1, *[1] * (behind - i))  # those in front broadcast
            for name, (i, v) in self.columns.items()
        }
        try:
            valid = np.broadcast_to(np.asarray(where(**mesh)), self.shape)
        except MemoryError:
            raise
        except Exception as error:
            raise ValueError(
                "Argument `where` must work on arrays that broadcast (use `&`, not "
                f"`and`), but raised {type(error).__name__}: {error}"
            ) from error
        if valid.dtype != bool:
            raise ValueError(
                f"Argument `where` must return booleans, but returned {valid.dtype}."
            )
        return valid


class Block(NamedTuple):
    """A part of a grid."""

    number: int
    region: tuple[slice, ...]  # of the grid
    box: Box
    chosen: np.ndarray  # which points are to be computed, in the block's shape

    def ranges(self) -> dict[str, list[float]]:
        """The least and the largest value of each parameter."""
        columns = self.box.columns.items()
        return {n: [float(v.min()), float(v.max())] for n, (_, v) in columns}

    def __str__(self) -> str:
        """Its number and where it lies."""
        spans = [f"{a:.17g} <= {n} <= {b:.17g}" for n, (a, b) in self.ranges().items()]
        return f"block {self.number} ({', '.join(spans)})"


class Grid:
    """The points of a sweep, its blocks, and which of their points are to be computed.

    A small grid is cut into `PARTS`, of `FEWEST` points at least.
    """

    def __init__(
        self,
        axes: xr.Dataset,
        where: Where | np.ndarray | None = None,
        points_a_block: int | None = None,
    ):
        """Cut the grid; ask `where` about every block, unless it is the answer.

        **Arguments:** `axes`: the parameters, as coordinates.

        **Raises:** `ValueError` if `where` breaks its rules or leaves no point.
        """
        self.axes, self.where = axes, where
        self.dims = tuple(
            dict.fromkeys(
                str(dim) for axis in axes.coords.values() for dim in axis.dims
            )
        )
        shape = tuple(axes.sizes[dim] for dim in self.dims)
        columns = {}
        for name, axis in axes.coords.items():
            along = self.dims.index(str(axis.dims[0])) if axis.ndim else 0
            values = axis.values if axis.ndim else np.full(shape[0], axis.values)
            columns[str(name)] = along, values
        self.box = Box(shape, columns)
        part = max(math.prod(shape) // PARTS, FEWEST)
        points = points_a_block or min(part, POINTS_A_BLOCK)
        self.axis, self.chunk = _cut(shape, points)
        self.inner = math.prod(shape[self.axis + 1 :])
        self.run = self.chunk[self.axis] * self.inner  # points a whole block
        self.span = shape[self.axis] * self.inner  # points along the cut axis
        self.along = -(-shape[self.axis] // self.chunk[self.axis])
        self.count = self.along * math.prod(shape[: self.axis])
        self._decide()

    @property
    def shape(self) -> tuple[int, ...]:
        """The points along each dimension."""
        return self.box.shape

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters."""
        return tuple(self.box.columns)

    @property
    def points(self) -> int:
        """How many points are to be computed."""
        return int(self.sizes.sum())

    def missing(self, finished: Callable[[int], bool]) -> dict[int, int]:
        """How many points are to be computed of each block that is not `finished`."""
        blocks = np.flatnonzero(self.sizes).tolist()
        return {n: int(self.sizes[n]) for n in blocks if not finished(n)}

    def _decide(self) -> None:
        """How many points each block has to compute, and a digest of which."""
        if self.where is None:
            sizes = np.full(self.count, self.run)
            short = self.span - (self.along - 1) * self.run
            sizes[self.along - 1 :: self.along] = short
            self.sizes, self.digest = sizes, "all"
            return
        digest = hashlib.sha256()
        self.sizes = np.zeros(self.count, np.int64)
        for number in range(self.count):
            chosen = self.block(number).chosen
            self.sizes[number] = chosen.sum()
            digest.update(np.packbits(chosen).tobytes())
        if not self.sizes.any():
            raise ValueError("Argument `where` must leave a point, but leaves none.")
        if callable(self.where):
            self._check_pointwise(self.where)
        self.digest = digest.hexdigest()

    def _check_pointwise(self, where: Where) -> None:
        """The first and the last point of a block alone are chosen as within it."""
        block = self.block(int(self.sizes.argmax()))
        ends = [slice(0, 1)] * len(self.shape), [*map(_last, block.chosen.shape)]
        for end in ends:
            alone = block.box.part(end)
            if alone.chosen(where).item() != block.chosen[tuple(end)].item():
                here = alone.values(np.array([0])).items()
                values = ", ".join(f"{name} = {v[0]:g}" for name, v in here)
                raise ValueError(
                    "Argument `where` must judge each point by its own values, but "
                    f"judges {values} otherwise when it is alone."
                )

    def block(self, number: int) -> Block:
        """The block of this number, in C order."""
        outer, part = divmod(number, self.along)
        front = np.unravel_index(outer, self.shape[: self.axis])
        first = part * self.chunk[self.axis]
        last = min(first + self.chunk[self.axis], self.shape[self.axis])
        region = (
            *(slice(int(i), int(i) + 1) for i in front),
            slice(first, last),
            *(slice(0, size) for size in self.shape[self.axis + 1 :]),
        )
        box = self.box.part(region)
        if self.where is None:
            chosen = np.ones(box.shape, bool)
        elif callable(self.where):
            chosen = box.chosen(self.where)
        else:
            chosen = self.where[region]
        return Block(number, region, box, chosen)

    def first(self, number: int) -> int:
        """The place of the block's first point in the grid, in C order."""
        outer, part = divmod(number, self.along)
        return outer * self.span + part * self.run

    def number(self, points: np.ndarray) -> np.ndarray:
        """The blocks that hold these points."""
        outer, within = np.divmod(points, self.span)
        return outer * self.along + within // self.run


def _last(size: int) -> slice:
    return slice(size - 1, size)


def _cut(shape: Sequence[int], points: int) -> tuple[int, tuple[int, ...]]:
    """Which axis is cut, and the shape of a whole block of about so many points."""
    inner = 1
    for axis in reversed(range(len(shape))):
        if inner * shape[axis] > points or axis == 0:
            parts = max(1, round(shape[axis] * inner / points))
            run = -(-shape[axis] // min(parts, shape[axis]))
            return axis, (1,) * axis + (run, *shape[axis + 1 :])
        inner *= shape[axis]
    raise AssertionError("a grid has an axis")
