r"""Error against run time, of a user's own map.

On a random sample of the map's points, each solver at each tolerance is held against
the same points at the limit of precision:

$$e = |x(\text{solver}, \text{tolerance}) - x(\text{reference})|.$$
"""

from collections.abc import Callable, Mapping

import diffrax as dfx
import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from ..context import Context, within
from ..motion.options import Method, Solver, solver_of
from ..numerics.numbers import instance, whole_number
from ..solvers import Explicit
from .axes import Returned
from .differences import QUANTILES, changed, differences, drawn, measured, quantiles
from .lanes import Lanes
from .sweep import sweep

TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)


def work_precision(
    point: Callable[..., Returned],
    *,
    tolerances: ArrayLike = TOLERANCES,
    solvers: Mapping[str, Solver | dfx.AbstractERK] | None = None,
    reference: Method = Method(dfx.Dopri8(), rtol=1e-12),  # noqa: B008, a value
    sample: int = 256,
    repeats: int = 3,
    where: Callable[..., ArrayLike] | None = None,
    lanes: Lanes = Lanes(),  # noqa: B008
    axes: Mapping[str, ArrayLike] | None = None,
    **named_axes: ArrayLike,
) -> xr.Dataset:
    """What each tolerance and solver costs on a map of one's own, and how wrong it is.

    ```python
    plane = {"q": np.linspace(1, 4, 128), "mu": np.linspace(0, 0.4, 64)}
    ds = zj.work_precision(point, tolerances=[1e-4, 1e-6, 1e-8], **plane)
    zj.plot.work_precision(ds, "joint_amplitude")
    ```

    The tolerances and solvers replace those that `point` gives to `settle` or
    `trajectory`: rtol is the tolerance, atol keeps its ratio to rtol. Everything else
    (windows, their agreement) stays: where another tolerance ends a lane in another
    window, that is a part of the error. Each pair of solver and tolerance is compiled
    for itself, some seconds each.

    **Arguments:**

    - `point`, `where`, `lanes`, `axes`, `named_axes`: as in `sweep`.
    - `tolerances`: positive numbers.
    - `solvers`: names and solvers; None is Tsit5 and Dopri8. With set-valued friction
        name them, e.g. `{"Taylor8": Taylor()}`, and the reference.
    - `sample`: how many of the map's points, drawn at random, the same ones each time.
    - `repeats`: how often each run is timed, solvers in turns; the median counts.
    - `reference`: the method that errors are measured against: its solver and `rtol`.
        At 1e-12 rounding, 2e-16 of each of some thousand steps, is as large.

    **Returns:** a Dataset over `solver`, `rtol` and `quantile` (0.5, 0.95 and 1):
    for each variable `<variable>_error`, over the points at which both runs have a
    number; over solver and rtol `seconds_a_point` of wall time without
    compilation, `compile_seconds`, `steps` a point where the result counts them, and
    `changed_outcomes`, the share of the points that end in another outcome than the
    reference.

    **Raises:** `ValueError` as `sweep`, and for an argument that breaks a rule.
    """
    tols = _tolerances(tolerances)
    instance("reference", reference, Method)
    solver, rtol = reference.solver, reference.rtol
    rest = reference.atol, reference.max_steps
    if solver is None or rtol is None or rest != (None, None):
        raise ValueError(
            "Argument `reference` must name its solver and its rtol, and nothing else, "
            f"but is {reference!r}."
        )
    for name, number in (("sample", sample), ("repeats", repeats)):
        whole_number(name, number)
    if solvers is None:
        solvers = {"Tsit5": Explicit(), "Dopri8": Explicit(dfx.Dopri8.tableau)}
    if not isinstance(solvers, Mapping) or not solvers:
        raise ValueError(
            f"Argument `solvers` must map names to solvers, but is {solvers!r}."
        )
    solvers = {name: solver_of(solver) for name, solver in solvers.items()}
    chosen: dict[str, np.ndarray] = {}

    def some(**mesh: np.ndarray) -> np.ndarray:
        """The sample, the same in every run."""
        if not chosen:
            shape = np.broadcast_shapes(*(np.shape(m) for m in mesh.values()))
            valid = np.ones(shape, bool)
            if where is not None:
                valid &= np.asarray(where(**mesh))
            chosen["mask"] = drawn(valid, sample)
        return chosen["mask"]

    def run(solver: Solver, tolerance: float) -> xr.Dataset:
        with within(Context(tolerance=tolerance, solver=solver)):
            return sweep(
                point,
                where=some,
                lanes=lanes,
                progress=False,
                axes={**dict(axes or {}), **named_axes},
            )

    exact = run(solver, float(rtol))
    mask, names = chosen["mask"], measured(exact)
    shape = (len(solvers), tols.size)
    errors = {name: np.full((*shape, len(QUANTILES)), np.nan) for name in names}
    cost = {
        name: np.full(shape, np.nan)
        for name in ("seconds_a_point", "compile_seconds", "changed_outcomes")
    }
    if "steps" in exact:
        cost["steps"] = np.full(shape, np.nan)
    seconds = np.empty((repeats, *shape))
    for j, tolerance in enumerate(tols):
        for turn in range(repeats):
            for i, solver in enumerate(solvers.values()):
                dataset = run(solver, float(tolerance))
                seconds[turn, i, j] = dataset.attrs["run_seconds"]
                if turn:
                    continue
                for name in names:
                    apart = differences(dataset[name], exact[name], mask)
                    errors[name][i, j] = quantiles(apart)
                cost["compile_seconds"][i, j] = dataset.attrs["compile_seconds"]
                differ = changed(dataset, exact, mask)
                cost["changed_outcomes"][i, j] = differ[mask].mean()
                if "steps" in cost:
                    cost["steps"][i, j] = np.nanmean(dataset["steps"].values[mask])
    count = int(mask.sum())
    cost["seconds_a_point"] = np.median(seconds, axis=0) / count
    return _dataset(exact, errors, cost, list(solvers), tols, count)


def _tolerances(tolerances: ArrayLike) -> np.ndarray:
    try:
        tols = np.asarray(tolerances, float)
    except (TypeError, ValueError):
        tols = np.empty(0)
    if tols.ndim != 1 or not tols.size or not np.all((tols > 0) & np.isfinite(tols)):
        raise ValueError(
            f"Argument `tolerances` must be positive and finite, but is {tolerances!r}."
        )
    return tols


_COSTS = {
    "seconds_a_point": ("run time a point", "s"),
    "compile_seconds": ("time to compile", "s"),
    "changed_outcomes": ("share of points with another outcome", "1"),
    "steps": ("attempted steps a point", "1"),
}


def _dataset(exact, errors, cost, solvers, tols, count) -> xr.Dataset:
    """Labels for the numbers."""
    dims = ("solver", "rtol")
    data: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]] = {}
    for name, error in errors.items():
        attrs = exact[name].attrs
        about = {"long_name": f"error of {attrs['long_name']}", "units": attrs["units"]}
        data[f"{name}_error"] = ((*dims, "quantile"), error, about)
    for name, values in cost.items():
        meaning, units = _COSTS[name]
        data[name] = (dims, values, {"long_name": meaning, "units": units})
    coords = {
        "solver": solvers,
        "rtol": ("rtol", tols, {"long_name": "tolerance of a step", "units": "1"}),
        "quantile": list(QUANTILES),
    }
    labels = ("jax_version", "jaxlib_version", "diffrax_version", "threads", "scene")
    attributes = {name: exact.attrs[name] for name in labels}
    reference = {
        f"reference_{name}": exact.attrs[name]
        for name in ("solver", "rtol", "atol")
        if name in exact.attrs
    }
    return xr.Dataset(data, coords, {**attributes, **reference, "points": count})
