"""A sweep on two Dask workers of this machine against one on two threads.

A million points of a short settled motion; each worker compiles in a first round that
is not counted. Threads take their turn while the cluster's processes are stopped and
no client is open: an idle worker or scheduler costs 3 to 4 % of a core, which is a part
of what Dask costs. Workers do not sample their own stacks (`--profile` lets them: some
1.5 % of a core each). `idle` is the share of the workers' time between two blocks.
Prints one JSON line; some two minutes on two cores.

    python benchmarks/s1_dask.py [--points 1000000] [--repeats 2] [--profile]
"""

import argparse
import json
import logging
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from distributed import Client
from measure import interleaved, machine, paired, rounded

import ziegler_jax as zj

WORKERS = 2
LOG = logging.getLogger("ziegler_jax.sweep")
CLUSTER = """
import sys
import dask
from distributed import LocalCluster

if __name__ == "__main__":
    dask.config.set({"distributed.worker.profile.enabled": sys.argv[1] == "True"})
    cluster = LocalCluster(n_workers=2, threads_per_worker=1, processes=True,
                           dashboard_address=None, host="127.0.0.1")
    with cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()  # until the benchmark ends
"""


class Kept(logging.Handler):
    """How long each block took, as the sweep says."""

    def __init__(self):
        """None yet."""
        super().__init__()
        self.seconds = []

    def emit(self, record):
        """Take one."""
        self.seconds.append(json.loads(record.getMessage())["seconds"])


def point(q, copy):
    friction = zj.SmoothCoulomb(0.1, pin_radius=0.05, v_smooth=0.05)
    start = zj.State(omega=(0.0, 0.3 + 0 * copy))
    return zj.settle(
        zj.uniform_rods(q, friction=friction),
        start,
        windows=zj.Windows(transient=20.0, length=10.0, max_windows=2),
        method=zj.Method(rtol=1e-4, atol=1e-4),
        certify=False,
    )


class Cluster:
    """A scheduler and two workers, in processes that can be stopped as a group."""

    def __init__(self, folder, profile):
        """Started, and stopped until a client opens."""
        script = Path(folder) / "cluster.py"
        script.write_text(CLUSTER)
        self.process = subprocess.Popen(
            [sys.executable, script, str(profile)], start_new_session=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            text=True, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        )  # fmt: skip
        self.address = self.process.stdout.readline().strip()
        self.signal(signal.SIGSTOP)

    def signal(self, number):
        """To all of its processes."""
        os.killpg(self.process.pid, number)

    @contextmanager
    def client(self):
        """While it is open the cluster runs."""
        self.signal(signal.SIGCONT)
        try:
            with Client(self.address) as client:
                client.wait_for_workers(WORKERS, timeout=60)
                yield client
        finally:
            self.signal(signal.SIGSTOP)

    def close(self):
        """End it."""
        self.signal(signal.SIGCONT)
        self.process.stdin.close()
        try:
            self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.signal(signal.SIGKILL)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--points", type=float, default=1e6)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--profile", action="store_true")
    options = parser.parse_args()
    LOG.setLevel("INFO")
    zj.configure_cpu()  # before the workers start: they inherit it
    q, copies = np.linspace(1.5, 3.5, 1000), np.arange(options.points // 1000)
    found, seconds, idle = {}, {}, {}

    def sweep(name, **more):
        start = time.perf_counter()
        found[name] = zj.sweep(point, q=q, copy=copies, progress=False, **more)
        seconds.setdefault(name, []).append(time.perf_counter() - start)

    with tempfile.TemporaryDirectory() as folder:
        store = {"store": zj.Store(Path(folder) / "map.zarr", overwrite=True)}
        cluster = Cluster(folder, options.profile)

        def on_cluster(name, **more):
            blocks = Kept()
            LOG.addHandler(blocks)
            with cluster.client() as client:
                sweep(name, client=client, **more)
            LOG.removeHandler(blocks)
            busy = sum(blocks.seconds) / WORKERS
            idle.setdefault(name, []).append(1 - busy / seconds[name][-1])

        try:
            # the first round compiles; connecting is not counted in any
            interleaved(
                {
                    "threads": lambda: sweep(
                        "threads", lanes=zj.Lanes(threads=WORKERS)
                    ),
                    "gathered": lambda: on_cluster("gathered"),
                    "written": lambda: on_cluster("written", **store),
                },
                options.repeats,
            )
        finally:
            cluster.close()
        alike = all(
            found[name][v].values.tobytes() == found["threads"][v].values.tobytes()
            for name in ("gathered", "written")
            for v in found["threads"].variables
        )
    seconds = {name: values[1:] for name, values in seconds.items()}
    ratios = {n: paired(seconds[n], seconds["threads"]) for n in seconds}
    result = {
        "benchmark": "s1_dask",
        "points": found["threads"].attrs["points"],
        "seconds": {name: float(np.median(s)) for name, s in seconds.items()},
        "ratio_gathered": ratios["gathered"][0],
        "ratio_gathered_range": ratios["gathered"][1],
        "ratio_written": ratios["written"][0],
        "ratio_written_range": ratios["written"][1],
        "idle": {name: float(np.median(shares[1:])) for name, shares in idle.items()},
        "useful_steps": {
            name: ds.attrs["useful_step_fraction"] for name, ds in found.items()
        },
        "bit_identical": alike,
        **machine(),
    }
    print(json.dumps(rounded(result)))


if __name__ == "__main__":
    main()
