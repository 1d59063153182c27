"""Error against run time, every contestant on the same lanes.

Each scene of `scenes.py`: 4096 columns of neighbouring loads from one start. The error
is the largest difference of the four state values at the end from heyoka's at 1e-16,
as median and 95th percentile over the lanes; the time that of a trajectory, without
compilation, with all cores. Contestants take turns, tolerance by tolerance. Prints one
JSON line a scene, the comparison at equal errors; writes `results/b0_<scene>.json`,
which has each contestant's points, and `.png`. About a minute a scene.

    python benchmarks/b0_work_precision.py [--scenes smooth ...] [--repeats 3]
        [--lanes 4096] [--stiff-lanes 512]
"""

import importlib
import sys
from functools import partial

import numpy as np
import ours
from matplotlib.figure import Figure
from measure import LINES, arguments, paired, report, save
from scenes import LANES, SCENES, START

import ziegler_jax as zj

TOLERANCES = 10.0 ** -np.arange(3, 13)
STIFF_TOLERANCES = 10.0 ** -np.arange(3, 9)
LEVELS = (3e-4, 1e-5, 1e-7, 1e-10)
STIFF_LANES = 512  # their reference, too, is expensive
LIMIT = 20.0  # a contestant that has spent so many seconds tries no finer tolerance


def contestants(scene, lanes):
    """Names, functions (scene, q, start, span, rtol) and lanes; and who is absent."""
    stiff, absent = scene.stiff, {}
    solvers = (*ours.SOLVERS, *(ours.STIFF_SOLVERS if stiff else ()))
    entries = {
        f"ziegler_jax {n}": (partial(ours.run, solver=n), lanes) for n in solvers
    }
    methods = {
        "vmapped": ("Kvaerno5",) if stiff else ("Tsit5", "Dopri8"),
        "per_trajectory": ("LSODA", "Radau") if stiff else ("RK45", "DOP853"),
    }
    for module in ("vmapped", "taylor", "scalar", "per_trajectory", "cpp"):
        try:
            peer = importlib.import_module(f"peers.{module}")
        except (ImportError, OSError) as error:
            absent[module] = str(error)
            continue
        few = min(lanes, getattr(peer, "LANES", lanes))
        if module not in methods:
            entries[peer.NAME] = peer.run, few
        for method in methods.get(module, ()):
            entries[f"{peer.NAME} {method}"] = partial(peer.run, method=method), few
    return entries, absent


def race(scene, lanes, repeats):
    """The error and the times of each contestant at each tolerance."""
    from reference import reference  # which needs heyoka

    loads = scene.loads(lanes)
    truth = reference(scene, loads, START)
    entries, absent = contestants(scene, lanes)
    results, spent = {name: [] for name in entries}, dict.fromkeys(entries, 0.0)
    for tol in STIFF_TOLERANCES if scene.stiff else TOLERANCES:
        times = {}
        for turn in range(repeats):
            for name, (run, few) in entries.items():
                if spent[name] > LIMIT or (turn and name not in times):
                    continue
                if turn and few < lanes:
                    continue  # per-trajectory loops: once is enough, and slow
                some = slice(None, None, lanes // few)
                try:
                    states, seconds = run(
                        scene, loads[some], START, scene.span, float(tol)
                    )
                except NotImplementedError:
                    continue
                spent[name] += seconds
                print(f"{name}, {tol:g}: {seconds:.3g} s", file=sys.stderr, flush=True)
                times.setdefault(name, []).append(seconds / few)
                if not turn:
                    apart = np.abs(states - truth.states[some])[truth.keep[some]]
                    apart = np.nan_to_num(apart.max(axis=1), nan=np.inf)
                    median, p95 = np.quantile(apart, (0.5, 0.95), method="lower")
                    entry = {"median": median, "p95": p95, "lanes": few}
                    results[name].append({"tolerance": float(tol), **entry})
        for name, seconds in times.items():
            results[name][-1]["microseconds"] = [s * 1e6 for s in seconds]
    about = {
        "span": scene.span,
        "lanes": lanes,
        "reference": "heyoka 1e-16",
        "codes_apart": truth.codes_apart,
        "left_out": int((~truth.keep).sum()),
        "largest_magnification_kept": float(truth.magnification[truth.keep].max()),
        "absent": absent,
    }
    return about, results


def cost_at(entries, level, which="median"):
    """Microseconds at an error, a list a round: interpolated in both logarithms.

    NaN where the contestant does not reach it; its coarsest run where that is better.
    """
    errors = np.array([e[which] for e in entries])
    rounds = min(len(e["microseconds"]) for e in entries)
    costs = np.array([e["microseconds"][:rounds] for e in entries])
    reached = np.flatnonzero(errors <= level)
    if not reached.size:
        return np.full(rounds, np.nan)
    last = reached[0]
    if last == 0 or not np.isfinite(errors[last - 1]):
        return costs[last]
    above, below = np.log(errors[last - 1]), np.log(max(errors[last], 1e-300))
    share = (above - np.log(level)) / (above - below)
    low, high = np.log(costs[last - 1]), np.log(costs[last])
    between = np.exp(low + share * (high - low))
    # a finer tolerance that costs less is the one to take
    return np.minimum(between, costs[reached].min(axis=0))


def compare(results):
    """At each level: our cheapest solver, and everyone's time over its."""
    table = {}
    for which in ("median", "p95"):
        for level in LEVELS:
            costs = {n: cost_at(e, level, which) for n, e in results.items() if e}
            ours = {n: c for n, c in costs.items() if n.startswith("ziegler_jax")}
            reach = [n for n in ours if np.isfinite(ours[n]).all()]
            if not reach:
                continue
            best = min(reach, key=lambda n: float(np.median(ours[n])))
            row = {"ours": best, "microseconds": float(np.median(ours[best]))}
            for name, cost in costs.items():
                if name not in ours:
                    rounds = min(len(cost), len(ours[best]))
                    ratio, spread = paired(cost[:rounds], ours[best][:rounds])
                    row[name] = {"ratio": ratio, "range": spread}
            table[f"{which} {level:g}"] = row
    return table


def draw(about, results, path):
    """Log-log, one line a contestant: ours thick and filled, theirs thin and open."""
    markers = "os^DvPX*<>"
    figure = Figure(figsize=(8.3, 5.0), layout="constrained")
    ax = figure.subplots()
    mine = [n for n in results if n.startswith("ziegler_jax") and results[n]]
    theirs = [n for n in results if n not in mine and results[n]]
    codes = list(dict.fromkeys(name.split()[0] for name in theirs))
    for i, name in enumerate([*mine, *theirs]):
        entries = [e for e in results[name] if np.isfinite(e["median"])]
        x = [np.median(e["microseconds"]) for e in entries]
        y = [max(e["median"], 1e-16) for e in entries]
        own = name in mine
        j = i if own else codes.index(name.split()[0])  # a code has one colour
        colour = LINES[j % len(LINES)]
        marker = markers[(i if own else i - len(mine)) % len(markers)]
        ax.plot(
            x, y, ("-" if own else ":") + marker, color=colour,
            mfc=colour if own else "white", lw=2.5 if own else 1, ms=5 if own else 6,
            label=name if len(x) > 1 else f"{name}, at 1e-6",
        )  # fmt: skip
    clock = "processor time / cores" if about["clock"] == "cpu" else "wall time"
    ax.set(
        xscale="log",
        yscale="log",
        xlabel=rf"{clock} of a trajectory, {about['cores']} cores ($\mu$s)",
        ylabel=r"median error of the final state $(\varphi_i, \dot\varphi_i)$",
        title=f"{about['scene']}: {about['lanes']} loads q, to t = {about['span']:g}",
    )
    ax.grid(alpha=0.3)
    ax.legend(loc="center left", bbox_to_anchor=(1, 0.5), fontsize=8.5, frameon=False)
    figure.savefig(path, dpi=130)


def main():
    options = arguments(
        __doc__, scenes=("smooth",), lanes=LANES, stiff_lanes=STIFF_LANES, repeats=3
    )
    zj.configure_cpu()
    for name in options.scenes:
        scene = SCENES[name]
        lanes = options.stiff_lanes if scene.stiff else options.lanes
        about, results = race(scene, lanes, options.repeats)
        result = {"scene": name, **about, "at_equal_error": compare(results)}
        line = report("b0_work_precision", **result)
        draw(line, results, save(f"b0_{name}", {**line, "contestants": results}))


if __name__ == "__main__":
    main()
