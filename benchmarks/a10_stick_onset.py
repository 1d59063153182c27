"""Is the curve on which a joint begins to stick the contour of its stick fraction?

Uniform rods with set-valued friction, equal torques tau in both joints: the curve by
`bifurcation_curve`, and the boundary of the cells in which joint 2 sticks for a part of
the time, by `refine` of a map of long motions, each with its own kick. Distances are
shares of the ranges of both axes. Prints one JSON line.

    python benchmarks/a10_stick_onset.py [--cells 17] [--width 1e-5]
"""

import argparse
import json

import jax
import numpy as np
from measure import commit, rounded
from ours import dry
from scipy.spatial import cKDTree

import ziegler_jax as zj

Q, TAU = (1.8, 2.6), (0.008, 0.04)
NEAR = 2.5, 0.023  # a cycle near the curve
KICK = zj.State(omega=(0.0, 3.0))
# cycles that attract slowly stick for a while in a window: only closed ones tell
METHOD = zj.Method(rtol=1e-9, atol=1e-9)


def point(q, tau):
    observers = (zj.StickFraction(),)
    options = {"observers": observers, "certify": True, "method": METHOD}
    settled = zj.settle(dry(q, tau), KICK, **options)
    return {"outcome": settled.outcome, "sticks": settled.stick_fraction[1] > 0}


@jax.jit
def curve():
    q, tau = NEAR
    settled = zj.settle(dry(q, tau), KICK, certify=False)
    orbit = zj.periodic_orbit(dry(q, tau), settled.final)
    course = zj.Course(points=400, first=Q, second=TAU)
    return zj.bifurcation_curve(
        dry, "sticking_2", orbit, first=q, second=tau, course=course
    ).points


def shares(q, tau):
    """Places as shares of the ranges."""
    return np.stack([(q - Q[0]) / np.ptp(Q), (tau - TAU[0]) / np.ptp(TAU)], -1)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cells", type=int, default=17)
    parser.add_argument("--width", type=float, default=1e-5)
    options = parser.parse_args()
    zj.configure_cpu()
    axes = {
        "q": np.linspace(*Q, options.cells),
        "tau": np.linspace(*TAU, options.cells),
    }
    coarse = zj.sweep(point, axes=axes, progress=False)
    ds = zj.refine(
        point, coarse, "sticks", width=options.width, levels=2, progress=False
    )
    contour = shares(ds.boundary_q.values, ds.boundary_tau.values)
    with jax.enable_x64(True):
        points = jax.tree.map(np.asarray, curve())
    good = np.isfinite(points.first)
    line = shares(points.first[good], points.second[good])
    # along the curve its points lie apart: distances are to the pieces between them
    dense = np.concatenate(
        [line[:-1] + s * np.diff(line, axis=0) for s in np.linspace(0, 1, 200)]
    )
    apart, _ = cKDTree(dense).query(contour)
    back, _ = cKDTree(contour).query(line)
    result = {
        "benchmark": "a10_stick_onset",
        "commit": commit(),
        "lanes": int(coarse.outcome.size + ds.attrs["refine_points"]),
        "outcomes": {
            zj.CODE(c).name: int((coarse.outcome == c).sum())
            for c in np.unique(coarse.outcome)
        },
        "points": int(good.sum()),
        "residual": float(points.residual[good].max()),
        "vertices": len(contour),
        "width": options.width,
        "contour_to_curve": np.quantile(apart, [0.5, 0.9, 0.99, 1]).tolist(),
        "curve_to_contour": np.quantile(back, [0.5, 0.9, 0.99, 1]).tolist(),
    }
    print(json.dumps(rounded(result)))


if __name__ == "__main__":
    main()
