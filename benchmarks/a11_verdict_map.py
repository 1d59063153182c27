"""How narrow are the boundaries of a map of kinds of motion?

The scene of figures/verdict_map.py, uniform rods with set-valued friction: `refine` by
kind from 64 x 64 points. For each pair of kinds that meet: the widths of the
boundary as shares of the ranges, and the uncertainty exponent (1 where halving finds a
line, near 0 where the two are mixed throughout). Prints one JSON line.

    python benchmarks/a11_verdict_map.py [--width 1e-4] [--max-points 60000]
"""

import argparse
import json

import numpy as np
from measure import commit, rounded

import ziegler_jax as zj


def point(q, mu_k):
    friction = zj.SetValuedCoulomb(4 * mu_k, mu_k, pin_radius=0.1)
    column = zj.uniform_rods(q, friction=friction)
    windows, start = zj.Windows(escape=60.0), zj.State(omega=(0.0, 0.3))
    return zj.settle(column, start, windows=windows, exponents=2)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--points", type=int, default=64, help="along each axis")
    parser.add_argument("--width", type=float, default=1e-4)
    parser.add_argument("--max-points", type=int, default=60_000)
    options = parser.parse_args()
    zj.configure_cpu()
    q, mu_k = (
        np.linspace(1, 7, options.points),
        np.linspace(0.005, 0.26, options.points),
    )
    coarse = zj.sweep(point, q=q, mu_k=mu_k, progress=False)
    ds = zj.refine(
        point,
        coarse,
        "kind",
        width=options.width,
        levels=2,
        max_points=options.max_points,
        progress=False,
    )
    sides, widths = ds.boundary_kind.values, ds.boundary_width.values
    pairs = {}
    for pair, exponent in zip(
        ds.pair_kind.values, ds.pair_exponent.values, strict=True
    ):
        mine = (np.sort(sides, axis=1) == np.sort(pair)).all(axis=1)
        pairs[" ".join(zj.CODE(int(code)).name for code in pair)] = {
            "exponent": float(exponent),
            "vertices": int(mine.sum()),
            "within_width": float((widths[mine] <= options.width).mean()),
            "widths": np.quantile(widths[mine], [0, 0.5, 0.9, 1]).tolist(),
        }
    result = {
        "benchmark": "a11_verdict_map",
        "commit": commit(),
        "lanes": options.points**2 + ds.attrs["refine_points"],
        "width": options.width,
        "complete": ds.attrs["refine_complete"],
        "missed_area": ds.attrs["refine_missed_area"],
        "pairs": pairs,
    }
    print(json.dumps(rounded(result)))


if __name__ == "__main__":
    main()
