"""A small map that sweeps share in tests: cheap lanes of very unlike length."""

import functools

import numpy as np
import xarray as xr

import ziegler_jax as zj

# A small scene with a loop: lanes of very unlike length, four times what a batch takes.


def point(q, mu):
    friction = zj.SmoothCoulomb(mu, pin_radius=0.05, v_smooth=0.05)
    return zj.settle(
        zj.uniform_rods(q, friction=friction),
        zj.State(omega=(0.0, 0.3)),
        windows=zj.Windows(transient=20.0, length=10.0, max_windows=4),
        method=zj.Method(rtol=1e-4, atol=1e-4, max_steps=2000),
        observers=(zj.Period(),),
        certify=False,
    )


Q, MU = np.linspace(1.5, 3.5, 41), np.array([0.05, 0.1, 0.2])
sweep = functools.partial(zj.sweep, point, lanes=zj.Lanes(32), progress=False)


def same(one: xr.Dataset, other: xr.Dataset) -> bool:
    """To the last bit, NaN like NaN."""
    assert set(one.data_vars) == set(other.data_vars)
    return all(
        np.array_equal(
            one[name].transpose(*other[name].dims).values,
            other[name].values,
            equal_nan=one[name].dtype.kind == "f",
        )
        for name in one.data_vars
    )
