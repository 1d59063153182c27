"""A sweep on two Dask workers of this machine against one on two threads.

A million points of a short settled motion; each worker compiles in a first round that
is not counted. Prints one JSON line; some five minutes on two cores.

    python benchmarks/s1_dask.py [--points 1000000] [--repeats 3]
"""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
from distributed import Client, LocalCluster
from measure import interleaved, machine, paired, rounded

import ziegler_jax as zj


def point(q, copy):
    friction = zj.SmoothCoulomb(0.1, pin_radius=0.05, v_smooth=0.05)
    start = zj.State(omega=(0.0, 0.3 + 0 * copy))
    return zj.settle(
        zj.uniform_rods(q, friction=friction), start,
        transient=20.0, window=10.0, max_windows=2, rtol=1e-4, atol=1e-4,
    )  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--points", type=float, default=1e6)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    zj.configure_cpu()  # before the workers start: they inherit it
    q, copies = np.linspace(1.5, 3.5, 1000), np.arange(options.points // 1000)
    found = {}

    def sweep(name, copies=copies, **more):
        found[name] = zj.sweep(point, q=q, copy=copies, progress=False, **more)

    cluster = LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None,
        host="127.0.0.1",
    )  # fmt: skip
    with cluster, Client(cluster) as client, tempfile.TemporaryDirectory() as folder:
        store = {"store": Path(folder) / "map.zarr", "resume": "overwrite"}
        # the first round of `interleaved` compiles, and is not counted
        seconds = interleaved(
            {
                "threads": lambda: sweep("threads", threads=2),
                "gathered": lambda: sweep("gathered", client=client),
                "written": lambda: sweep("written", client=client, **store),
            },
            options.repeats,
        )
        alike = all(
            found[name][v].values.tobytes() == found["threads"][v].values.tobytes()
            for name in ("gathered", "written")
            for v in found["threads"].variables
        )
    ratios = {n: paired(seconds[n], seconds["threads"]) for n in seconds}
    result = {
        "benchmark": "s1_dask",
        "points": found["threads"].attrs["points"],
        "seconds": {name: float(np.median(s)) for name, s in seconds.items()},
        "ratio_gathered": ratios["gathered"][0],
        "ratio_gathered_range": ratios["gathered"][1],
        "ratio_written": ratios["written"][0],
        "ratio_written_range": ratios["written"][1],
        "bit_identical": alike,
        **machine(),
    }
    print(json.dumps(rounded(result)))


if __name__ == "__main__":
    main()
