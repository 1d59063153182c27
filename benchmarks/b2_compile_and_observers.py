"""What else costs: compiling, each observer, a forward derivative, the batch.

The main job's kind of point (`settle` with its defaults on a friction cycle), Tsit5:
seconds to compile with and without `Period`, `StickFraction`, `Mean` and
`EnergyBalance`, and their run time over that of none; a forward derivative with respect
to q over the plain run; the share of useful steps by batch size, with the points in
order and shuffled. Runs take turns. Prints one JSON line a result; writes
`results/b2_costs.json` and `.png`. About a minute and a half.

    python benchmarks/b2_compile_and_observers.py [--repeats 3]
"""

import argparse
import json

import colours
import jax
import matplotlib
import numpy as np
from measure import interleaved, machine, paired, rounded, save

import ziegler_jax as zj

matplotlib.use("agg")
zj.configure_cpu()

Q = np.linspace(2.0, 3.0, 4096)
OBSERVERS = {
    "none": (),
    "Mean": (zj.Mean(),),
    "Period": (zj.Period(),),
    "StickFraction": (zj.StickFraction(),),
    "EnergyBalance": (zj.EnergyBalance(),),
    "all": (zj.Mean(), zj.Period(), zj.StickFraction(), zj.EnergyBalance()),
}
BATCHES = (64, 128, 256, 512)


def settled(q, observers=(), **options):
    friction = zj.SmoothCoulomb(
        0.12, 0.10, pin_radius=0.1, v_stribeck=0.05, v_smooth=0.01
    )
    column = zj.uniform_rods(q, friction=friction)
    start = zj.State(omega=(0.0, 0.3))
    return zj.settle(column, start, observers=observers, **options, certify=False)


def watched(observers):
    return lambda q: settled(q, observers)


def fixed(q):
    """A fixed span: what is differentiated must not end in another window."""
    return settled(q, windows=zj.Windows(80.0, 40.0, 1)).final.phi[1]


def derivative(q):
    value, slope = jax.jvp(fixed, (q,), (jax.numpy.ones_like(q),))
    return {"value": value, "slope": slope}


def sweeps(points, compiled):
    """Sweeps to take turns; the seconds that the first of each took to compile."""

    def runner(name, point):
        def run():
            ds = zj.sweep(point, q=Q, progress=False)
            compiled.setdefault(name, ds.attrs["compile_seconds"])

        return run

    return {name: runner(name, point) for name, point in points.items()}


def draw(result, path):
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(8.3, 3.2), layout="constrained")
    rows = result["observers"]
    names = [row["observer"] for row in rows] + ["derivative in $q$"]
    slope = result["derivative"]
    compiled = [row["compile_seconds"] for row in rows]
    compiled.append(slope["compile_seconds"]["derivative"])
    over = [row["run_over_none"] for row in rows] + [slope["derivative_over_plain"]]
    axes[0].barh(names, compiled, color=colours.SKY)
    axes[0].set(xlabel="compile (s)")
    axes[1].barh(names, over, color=colours.BLUE)
    axes[1].axvline(1.0, color="0.3", lw=0.8)
    axes[1].set(xlabel="run time over that without", yticks=[])
    for order, style in (("in order", "o-"), ("shuffled", "s--")):
        rows = [row for row in result["batches"] if row["order"] == order]
        axes[2].plot(
            [row["batch_size"] for row in rows],
            [row["useful_step_fraction"] for row in rows],
            style,
            label=order,
            color=colours.BLUE if order == "in order" else colours.VERMILLION,
        )
    axes[2].set(xscale="log", xlabel="batch size", ylabel="useful steps", ylim=(0, 1))
    axes[2].set_xticks(BATCHES, [str(b) for b in BATCHES])
    axes[2].minorticks_off()
    axes[2].legend()
    axes[2].grid(alpha=0.3)
    about = f"what observers cost: smoothed friction, {Q.size} loads"
    figure.suptitle(about, fontsize=10)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeats", type=int, default=3)
    repeats = parser.parse_args().repeats
    result = {"benchmark": "b2", **machine(), "observers": [], "batches": []}

    def say(**row):
        print(
            json.dumps(rounded({"benchmark": "b2", "commit": result["commit"], **row})),
            flush=True,
        )
        return row

    compiled = {}
    points = {name: watched(o) for name, o in OBSERVERS.items()}
    seconds = interleaved(sweeps(points, compiled), repeats)
    for name in OBSERVERS:
        ratio, spread = paired(seconds[name], seconds["none"])
        row = say(
            observer=name,
            compile_seconds=compiled[name],
            run_over_none=ratio,
            range=spread,
        )
        result["observers"].append(row)

    pair = {"plain": fixed, "derivative": derivative}
    seconds = interleaved(sweeps(pair, compiled), repeats)
    ratio, spread = paired(seconds["derivative"], seconds["plain"])
    result["derivative"] = say(
        derivative_over_plain=ratio,
        range=spread,
        compile_seconds={name: compiled[name] for name in pair},
    )

    # a shuffled axis: neighbours in a batch are then strangers
    shuffled = np.random.default_rng(0).permutation(Q)
    for batch in BATCHES:
        for order, q in (("in order", Q), ("shuffled", shuffled)):
            ds = zj.sweep(
                points["none"], q=q, lanes=zj.Lanes(batch_size=batch), progress=False
            )
            row = say(
                batch_size=batch,
                order=order,
                useful_step_fraction=ds.attrs["useful_step_fraction"],
                points_per_second=ds.attrs["points_per_second"],
            )
            result["batches"].append(row)
    draw(result, save("b2_costs", result))


if __name__ == "__main__":
    main()
