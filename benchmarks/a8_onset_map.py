"""Is a map of onset loads whole by default, and do its loads part rest from motion?

`flutter_onset` over 20 x 20 static and kinetic coefficients (set-valued, both pins
0.05, load F, kick 0.3, bracket 0.5 to 4, all else by default): how its searches ended.
Then motions at both ends of each last interval by other steps, followed to t = 40 000:
how many rest where they should, and how many move. Last, 20 of the cells where the
verdict changes more than once, each by a scan of 400 loads. Prints one JSON line.

    python benchmarks/a8_onset_map.py
"""

import json

import numpy as np
import xarray as xr
from measure import commit

import ziegler_jax as zj

KICK = zj.State(omega=(0.0, 0.3))
BRACKET, LOADS, DRAWN = (0.5, 4.0), 401, 20
REST = (zj.CODE.stuck, zj.CODE.rest)


def column(q, mu_s, mu_k):
    law = zj.SetValuedCoulomb(mu_s, mu_k, pin_radius=0.05)
    return zj.uniform_rods(q, friction=law)


def onset(mu_s, mu_k):
    return zj.flutter_onset(lambda q: column(q, mu_s, mu_k), KICK, BRACKET)


def followed(windows, **axes):
    """Outcomes of motions by the stepper of stick and slip."""

    def point(q, mu_s, mu_k):
        horizon = zj.Windows(max_windows=windows)
        method = zj.Method(rtol=1e-8, max_steps=4_000_000)
        start = column(q, mu_s, mu_k), KICK
        return zj.settle(*start, windows=horizon, method=method, certify=True)

    return zj.sweep(point, progress=False, **axes).outcome


def main():
    zj.configure_cpu()
    mu = np.linspace(0.02, 0.4, 20)
    below = {"where": lambda mu_s, mu_k: mu_k <= mu_s, "progress": False}
    ds = zj.sweep(onset, mu_s=mu, mu_k=mu, **below)
    codes = ds.outcome.values
    ends = np.unique(codes, return_counts=True)
    line = {
        "benchmark": "a8_onset_map",
        "commit": commit(),
        "searches": {zj.CODE(c).name: int(n) for c, n in zip(*ends, strict=True) if c},
        "run_s": ds.attrs["run_seconds"],
    }

    def cells(chosen):
        along = ds.mu_s.values[chosen[0]], ds.mu_k.values[chosen[1]]
        named = zip(("mu_s", "mu_k"), along, strict=True)
        return {name: xr.DataArray(x, dims="cell") for name, x in named}

    parted = np.where(np.isin(codes, [zj.CODE.found, zj.CODE.repeated]))
    threshold, width, rises = (
        ds[name].values[parted] for name in ("threshold", "width", "rises")
    )
    for name, side, rests in (("resting", -0.4999, True), ("moving", 0.4999, False)):
        q = xr.DataArray(threshold + side * rises * width, dims="cell")
        ends = followed(1000, q=q, **cells(parted))
        line[f"{name}_ends"] = len(ends)
        line[f"{name}_ends_right"] = int((ends.isin(REST) == rests).sum())
    repeated = np.stack(np.where(codes == zj.CODE.repeated))
    drawn = np.random.default_rng(0).permutation(repeated.shape[1])[:DRAWN]
    loads = np.linspace(*BRACKET, LOADS)
    rests = followed(200, q=loads, **cells(repeated[:, drawn])).isin(REST)
    changes = rests.astype(int).diff("q").pipe(np.abs).sum("q")
    line["repeated_drawn"] = len(drawn)
    line["repeated_changes"] = changes.values.tolist()
    print(json.dumps(line))


if __name__ == "__main__":
    main()
