r"""The same points by other methods or laws, and how far their numbers are apart.

$$\Delta x = x(\text{variant}) - x(\text{reference})$$

A difference is the error of a variant where the reference is much nearer to the truth:
a finer tolerance, a law that is not smoothed. It is an estimate, point by point, and
not a bound.
"""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Collection, Mapping

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from ..numerics.rules import whole_number
from .grid import Grid, axes_of
from .pool import Lanes
from .returned import Returned
from .sweep import sweep

REFERENCE = "reference"
QUANTILES = (0.5, 0.95, 1.0)
SEED = 0  # the same sample in every run
# numbers that say what a lane cost, and not what its motion is
COSTS = {"steps", "shot_steps", "windows"}


def compare(
    point: Callable[..., Returned],
    variants: Mapping[str, Mapping[str, object]],
    *,
    reference: Mapping[str, object] | None = None,
    where: Callable[..., ArrayLike] | None = None,
    sample: int | None = None,
    repeats: int = 1,
    lanes: Lanes = Lanes(),
    progress: bool | None = None,
    axes: Mapping[str, ArrayLike] | None = None,
    **named_axes: ArrayLike,
) -> xr.Dataset:
    r"""Compute the same points several times, by other methods or other laws.

    The point takes the varied part as an argument:

    ```python
    def point(q, mu, method=zj.Method()):
        friction = zj.SmoothCoulomb(mu, pin_radius=0.1, v_smooth=0.05)
        column = zj.uniform_rods(q=q, friction=friction)
        return zj.settle(column, zj.State(omega=(0.0, 0.2)), method=method)

    plane = {"q": np.linspace(1, 4, 32), "mu": np.linspace(0.02, 0.4, 16)}
    fine = {"method": zj.Method(rtol=1e-9)}
    ds = zj.compare(point, {"usual": {}}, reference=fine, sample=64, **plane)
    ds.joint_amplitude_difference  # of each point; its quantiles beside it
    ```

    **Arguments:**

    - `point`: as in `sweep`; a parameter with a default need be no axis.
    - `variants`: by name, the further arguments of `point` beside its axes; `{}` leaves
        its defaults.
    - `reference`: the further arguments of the reference; None leaves the defaults.
    - `where`, `lanes`, `progress`, `axes`, `named_axes`: as in `sweep`.
    - `sample`: the number of points to draw at random, the same ones in every call;
        None computes all.
    - `repeats`: how often each variant is run, in turns, for `seconds_a_point`.

    **Returns:** a Dataset over `variant`, the reference first, and the axes:

    - the variables of `point`;
    - for each number $x$ `x_difference`, signed, in the unit of x: NaN where one of the
        two has no number;
    - `x_difference_quantiles` over `variant` and `quantile` (0.5, 0.95 and 1): of
        $|\Delta x|$ over all points, and all rods or joints of each;
    - for a point with codes `changed`: 1 where one of them (an outcome) differs from
        the reference's, else 0; and its mean `changed_share`;
    - over `variant` the `seconds_a_point` of the clock without compiling, a median over
        the repeats, and `compile_seconds`.

    It has the attributes in which all variants agree.

    **Raises:** `ValueError` as `sweep`, and for arguments that break a rule.
    """
    calls = _calls(point, variants, reference)
    options = inspect.signature(compare).parameters
    grid = Grid(axes_of(calls[REFERENCE], axes, named_axes, options))
    for name, call in calls.items():
        _check_apart(name, call.keywords, grid.names)
    whole_number("repeats", repeats)
    mask = np.ones(grid.shape, bool) if where is None else grid.box.chosen(where)
    if sample is not None:
        whole_number("sample", sample)
        mask = drawn(mask, sample)

    def run(call: functools.partial) -> xr.Dataset:
        return sweep(
            call,
            where=lambda **_: mask,
            lanes=lanes,
            progress=progress,
            axes={**(axes or {}), **named_axes},
        )

    turns = [[run(call) for call in calls.values()] for _ in range(repeats)]
    together = _joined(dict(zip(calls, turns[0], strict=True)))
    seconds = [[one.attrs["run_seconds"] for one in turn] for turn in turns]
    compiling = [one.attrs["compile_seconds"] for one in turns[0]]
    together["seconds_a_point"] = _cost(
        np.median(seconds, axis=0) / mask.sum(), "run time a point"
    )
    together["compile_seconds"] = _cost(compiling, "time to compile")
    return _with_differences(together, mask)


def _calls(
    point: Callable[..., Returned],
    variants: Mapping[str, Mapping[str, object]],
    reference: Mapping[str, object] | None,
) -> dict[str, functools.partial]:
    """The point with the arguments of each variant, the reference first."""
    if not callable(point):
        raise ValueError(f"Argument `point` must be a function, but is {point!r}.")
    if not isinstance(variants, Mapping) or not variants:
        raise ValueError(
            "Argument `variants` must map names to arguments of `point`, but is "
            f"{variants!r}."
        )
    if REFERENCE in variants:
        raise ValueError(
            f"Argument `variants` must name none `{REFERENCE}`, which is the argument "
            "`reference`."
        )
    calls = {}
    for name, given in {REFERENCE: reference or {}, **variants}.items():
        if not isinstance(name, str) or not isinstance(given, Mapping):
            raise ValueError(
                "A variant must be a name and a mapping of arguments of `point`, but "
                f"is {name!r}: {given!r}."
            )
        try:
            inspect.signature(point).bind_partial(**given)
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"Variant `{name}` must name arguments of `point`, but {error}."
            ) from None
        calls[name] = functools.partial(point, **given)
    return calls


def _check_apart(name: str, given: Mapping[str, object], axes: Collection[str]) -> None:
    """Refuse a variant's arguments that are axes."""
    twice = given.keys() & axes
    if twice:
        raise ValueError(
            f"Variant `{name}` must leave the axes alone, but names `{twice.pop()}`."
        )


def drawn(valid: np.ndarray, count: int) -> np.ndarray:
    """At random `count` of the valid points, at most all of them, as a mask."""
    chosen = np.random.default_rng(SEED).permutation(np.flatnonzero(valid))[:count]
    mask = np.zeros(valid.shape, bool)
    mask.flat[chosen] = True
    return mask


def _joined(runs: Mapping[str, xr.Dataset]) -> xr.Dataset:
    """The runs along one more dimension."""
    names = [*runs[REFERENCE].data_vars]
    for variant, run in runs.items():
        if [*run.data_vars] != names or run.sizes != runs[REFERENCE].sizes:
            raise ValueError(
                f"Variant `{variant}` must return what the reference does, "
                f"{', '.join(map(str, names))}, but returns "
                f"{', '.join(map(str, run.data_vars))}, or arrays of another shape."
            )
    about = {"long_name": "variant of the point"}
    return xr.concat(
        runs.values(),
        xr.Variable("variant", [*runs], about),
        data_vars="all",
        coords="minimal",
        compat="equals",
        join="exact",
        combine_attrs="drop_conflicts",
    )


def _cost(seconds: ArrayLike, what: str) -> tuple:
    return "variant", np.asarray(seconds), {"long_name": what, "units": "s"}


def _with_differences(ds: xr.Dataset, mask: np.ndarray) -> xr.Dataset:
    """The runs, how far the numbers of each are from the reference's, and which end."""
    own = [str(name) for name, x in ds.data_vars.items() if x.ndim > 1]
    coded = [name for name in own if "flag_values" in ds[name].attrs]
    ds = ds.assign_coords(quantile=[*QUANTILES])
    for name in own:
        if name in coded or name in COSTS:
            continue
        apart = (ds[name] - ds[name].sel(variant=REFERENCE, drop=True)).astype(float)
        of = f"{ds[name].attrs['long_name']}, difference from the reference"
        about = {"long_name": of, "units": ds[name].attrs["units"]}
        ds[f"{name}_difference"] = apart.assign_attrs(about)
        sizes = np.abs(apart.values).reshape(ds.sizes["variant"], -1)
        ds[f"{name}_difference_quantiles"] = (
            ("variant", "quantile"),
            [_quantiles(one) for one in sizes],
            {**about, "long_name": f"{of}: its size"},
        )
    if coded:
        differ = np.zeros((ds.sizes["variant"], *mask.shape), bool)
        for name in coded:
            apart = ds[name].values != ds[name].values[:1]
            differ |= apart.reshape(*differ.shape, -1).any(axis=-1)
        about = {"long_name": "whether a code differs", "units": "1"}
        dims = [*ds[coded[0]].dims[: differ.ndim]]
        ds["changed"] = (dims, np.where(mask, differ, np.nan), about)
        share = ds["changed"].mean(dims[1:])
        ds["changed_share"] = share.assign_attrs(about | {"long_name": "their share"})
    return ds


def _quantiles(sizes: np.ndarray) -> list[float]:
    """Quantiles of numbers; NaN where there are none."""
    sizes = sizes[np.isfinite(sizes)]
    if not sizes.size:
        return [math.nan] * len(QUANTILES)
    return [float(x) for x in np.quantile(sizes, QUANTILES)]
