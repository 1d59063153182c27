"""A map on a Dask cluster: blocks of it are tasks of its workers."""

import numpy as np
from distributed import Client, LocalCluster

import ziegler_jax as zj


def point(kappa, c):
    return zj.critical_load(zj.uniform_rods(kappa=kappa, damping=zj.Viscous(c, c)))


def main():
    """What the workers, which import this file, must not run."""
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(**options) as cluster, Client(cluster) as client:
        kappa, c = np.linspace(0.5, 3, 50), np.linspace(0.01, 0.1, 40)
        ds = zj.sweep(point, kappa=kappa, c=c, client=client, store="dask.zarr")
    ds.pipe(zj.plot.map, "q_cr", x="kappa", y="c").figure.savefig("dask.png")


if __name__ == "__main__":
    main()
