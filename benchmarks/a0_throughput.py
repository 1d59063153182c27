"""Throughput of the public `sweep` against plain diffrax and hand-written C++.

The reference work: 8192 uniform-rod columns under q = 2..4 with smoothed friction,
followed to t = 100, the amplitudes of the last 20 observed, tolerances 1e-6. Prints one
JSON line; about a minute. `ratio_cpp` is against a C++ kernel (AVX-512, OpenMP, a lane
refilled as it ends) with the C library's vector functions; `ratio_cpp_tables` against
the same kernel with tanh, exp, sin and cos from tables in registers, the machine's
limit.

    python benchmarks/a0_throughput.py [--no-configure] [--repeats 3]
"""

import argparse
import json

import numpy as np
from measure import interleaved, machine, paired, ready, rounded
from peers import cpp, naive

import ziegler_jax as zj


def reference(q):
    friction = zj.SmoothCoulomb(
        0.012,
        0.010,
        pin_radius=1.0,
        v_stribeck=0.05,
        v_smooth=0.01,
        load=zj.ConstantLoad(1.0),
    )
    return zj.settle(
        zj.uniform_rods(q=q, friction=friction),
        zj.State(omega=(0.0, 0.2)),
        windows=zj.Windows(transient=80.0, length=20.0, max_windows=1),
        method=zj.Method(rtol=1e-6, atol=1e-6),
        certify=False,
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--no-configure", action="store_true")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    said = "not called" if options.no_configure else zj.configure_cpu()
    q = np.linspace(2, 4, 8192)
    found, runs = {}, []

    def ours():
        found["sweep"] = zj.sweep(reference, q=q, progress=False)
        runs.append(found["sweep"].attrs["run_seconds"])

    def cpp_kernel(plain):
        threads = found["sweep"].attrs["threads"]
        found["cpp"] = cpp.solve(q, threads=threads, plain=plain)

    contestants = {
        "sweep": ours,
        "naive_stacked": lambda: ready(naive.solve_stacked(q)),
        "naive_tuple": lambda: ready(naive.solve_tuple(q)),
    }
    try:
        cpp.library()
        cpp.library(plain=True)
        contestants["cpp_tables"] = lambda: cpp_kernel(plain=False)
        contestants["cpp"] = lambda: cpp_kernel(plain=True)
    except RuntimeError as absent:
        found["absent"] = str(absent)
    seconds = interleaved(contestants, options.repeats)
    # a sweep traces its scene anew: that is told apart, as compiling is
    whole, seconds["sweep"] = seconds["sweep"], np.array(runs[-options.repeats :])

    ds = found["sweep"]
    steps = float(ds.steps.sum())
    naive_best = np.minimum(seconds["naive_stacked"], seconds["naive_tuple"])
    ratio_naive, range_naive = paired(naive_best, seconds["sweep"])
    result = {
        "benchmark": "a0_throughput",
        "ns_per_lane_step": float(np.median(seconds["sweep"])) / steps * 1e9,
        "ratio_naive": ratio_naive,
        "ratio_naive_range": range_naive,
        "useful_step_fraction": ds.attrs["useful_step_fraction"],
        "seconds_with_tracing": float(np.median(whole)),
        "compile_seconds": ds.attrs["compile_seconds"],
        "seconds": {name: float(np.median(s)) for name, s in seconds.items()},
        "configure_cpu": said,
        **machine(),
    }
    if "cpp" in seconds:
        ratio, spread = paired(seconds["sweep"], seconds["cpp"])
        tables, tables_spread = paired(seconds["sweep"], seconds["cpp_tables"])
        amplitude = np.asarray(found["cpp"][0])
        # below q = 2.3 all lanes are regular: there both must find the same cycles
        regular = q < 2.3
        apart = np.abs(amplitude[:, 2] - ds.joint_amplitude.sel(joint=2).values)
        result |= {
            "ratio_cpp": ratio,
            "ratio_cpp_range": spread,
            "ratio_cpp_tables": tables,
            "ratio_cpp_tables_range": tables_spread,
            "largest_amplitude_difference_to_cpp": float(apart[regular].max()),
        }
    else:
        result |= {"ratio_cpp": None, "cpp": found["absent"]}
    print(json.dumps(rounded(result)))


if __name__ == "__main__":
    main()
