"""Throughput of the public `sweep` against plain diffrax and hand-written C++.

The reference work: 8192 uniform-rod columns under q = 2..4 with smoothed friction,
followed to t = 100, the amplitudes of the last 20 observed, tolerances 1e-6. Prints one
JSON line; about a minute. `ratio_cpp` is against a C++ kernel (AVX-512, OpenMP, a lane
refilled as it ends) with the C library's vector functions; `ratio_cpp_tables` against
the same kernel with tanh, exp, sin and cos from tables in registers, the machine's
limit. `--scene frictionless` times the same sweep without friction, to q = 2.5, alone.

    python benchmarks/a0_throughput.py [--no-configure] [--lanes 8192] [--repeats 3]
        [--scene frictionless]
"""

import numpy as np
import ours
from measure import OF_THE_PROCESSOR, arguments, interleaved, paired, report
from peers import cpp, vmapped
from scenes import SCENES, START

import ziegler_jax as zj


def reference(scene):
    def point(q):
        return zj.settle(
            ours.column_of(scene, q),
            zj.State(omega=(0.0, 0.2)),
            windows=zj.Windows(transient=80.0, length=20.0, max_windows=1),
            method=zj.Method(rtol=1e-6, atol=1e-6),
            certify=False,
        )

    return point


# without friction motions above q_cr = 2.5417 end early, turned over
HIGHEST = {"smooth": 4.0, "frictionless": 2.5}


def main():
    options = arguments(
        __doc__, no_configure=False, lanes=8192, repeats=3, scene="smooth"
    )
    scene, high = SCENES[options.scene], HIGHEST[options.scene]
    said = "not called" if options.no_configure else zj.configure_cpu()
    q = np.linspace(2, high, options.lanes)
    found, runs = {}, []

    def sweep():
        found["sweep"] = zj.sweep(reference(scene), q=q, progress=False)
        runs.append(found["sweep"].attrs["run_seconds"])

    def cpp_kernel(plain):
        threads = found["sweep"].attrs["threads"]
        found["cpp"] = cpp.solve(q, threads=threads, plain=plain)

    contestants = {"sweep": sweep}
    if options.scene == "smooth":  # theirs
        work = scene, q, START, 100.0, 1e-6
        for name, stacked in (("naive_stacked", True), ("naive_tuple", False)):
            contestants[name] = lambda s=stacked: vmapped.solve(*work, stacked=s)
        try:
            cpp.library()
            cpp.library(plain=True)
            contestants["cpp_tables"] = lambda: cpp_kernel(plain=False)
            contestants["cpp"] = lambda: cpp_kernel(plain=True)
        except RuntimeError as absent:
            found["absent"] = str(absent)
    seconds = interleaved(contestants, options.repeats)
    # a sweep traces its scene anew: that is told apart, as compiling is
    whole = seconds["sweep"]
    if not OF_THE_PROCESSOR:
        seconds["sweep"] = np.array(runs[-options.repeats :])

    ds = found["sweep"]
    steps = float(ds.steps.sum())
    result = {
        "scene": options.scene,
        "ns_per_lane_step": float(np.median(seconds["sweep"])) / steps * 1e9,
        "useful_step_fraction": ds.attrs["useful_step_fraction"],
        "seconds_with_tracing": float(np.median(whole)),
        "compile_seconds": ds.attrs["compile_seconds"],
        "seconds": {name: float(np.median(s)) for name, s in seconds.items()},
        "configure_cpu": said,
    }
    if options.scene == "smooth":
        result |= against_others(seconds, found, q)
    report("a0_throughput", **result)


def against_others(seconds, found, q):
    """Their times over the sweep's, or the sweep's over theirs, and the same cycles."""
    naive_best = np.minimum(seconds["naive_stacked"], seconds["naive_tuple"])
    ratio, spread = paired(naive_best, seconds["sweep"])
    result = {"ratio_naive": ratio, "ratio_naive_range": spread}
    if "cpp" not in seconds:
        return result | {"ratio_cpp": None, "cpp": found["absent"]}
    for name in ("cpp", "cpp_tables"):
        ratio, spread = paired(seconds["sweep"], seconds[name])
        result |= {f"ratio_{name}": ratio, f"ratio_{name}_range": spread}
    amplitude = np.asarray(found["cpp"][0])
    # below q = 2.3 all lanes are regular: there both must find the same cycles
    regular = q < 2.3
    mine = found["sweep"].joint_amplitude.sel(joint=2).values
    apart = np.abs(amplitude[:, 2] - mine)[regular]
    return result | {"largest_amplitude_difference_to_cpp": float(apart.max())}


if __name__ == "__main__":
    main()
