"""Sobol's indices of what a sweep computes, by SALib."""

import numpy as np
import xarray as xr
from SALib.analyze import sobol as sobol_indices
from SALib.sample import sobol as sobol_points


def samples(points, names):
    """Points of shape (n, d) as parameters of a sweep, zipped along `sample`."""
    rows = zip(names, np.asarray(points).T, strict=True)
    return {name: xr.DataArray(x, dims="sample") for name, x in rows}


def saltelli(names, rows, **problem):
    """A problem of SALib's and Saltelli's samples of it, d + 2 a row."""
    problem = {"num_vars": len(names), "names": list(names), **problem}
    return problem, sobol_points.sample(problem, rows, calc_second_order=False, seed=1)


def indices(problem, values):
    """First-order and total indices, and the rows that have all their values."""
    rows = np.reshape(values, (-1, problem["num_vars"] + 2))
    rows = rows[np.isfinite(rows).all(axis=1)]
    options = {"calc_second_order": False, "seed": 1}
    return sobol_indices.analyze(problem, rows.ravel(), **options), rows
