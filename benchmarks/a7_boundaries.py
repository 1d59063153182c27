"""Are refined boundaries those of a fine grid?

The main job's map at mu_s = mu_k: `refine` from 33 x 33 cells, and a grid of 1024 x
1024 lanes. Of the grid's edges between unlike labels, by their labels, the share that
lies within one of its cells of the lines; and the share of its points with another
label than the refined cell in which they lie, where all corners are alike, against the
bound that `refine` states. Prints one JSON line.

    python benchmarks/a7_boundaries.py [--coarse 33] [--grid 1024] [--levels 4]
"""

import time
from collections import Counter

import numpy as np
from measure import arguments, commit, report
from scipy.spatial import cKDTree

import ziegler_jax as zj
from ziegler_jax.__main__ import MU_RANGE, Q_RANGE, point


def section(q, mu):
    return point(q, mu, mu)


def grid(n):
    q, mu = np.linspace(*Q_RANGE, n), np.linspace(*MU_RANGE, n)
    return zj.sweep(section, q=q, mu=mu, progress=False)


def points_of_lines(ds, n):
    """Points along the lines, at most a quarter apart, in cells of the fine grid."""
    spans = (("q", Q_RANGE), ("mu", MU_RANGE))
    columns = [
        (ds[f"boundary_{name}"].values - low) / (high - low) * (n - 1)
        for name, (low, high) in spans
    ]
    vertices, line = np.stack(columns, -1), ds.boundary_line.values
    points = [vertices]
    for a, b in zip(
        vertices[:-1][np.diff(line) == 0],
        vertices[1:][np.diff(line) == 0],
        strict=True,
    ):
        shares = np.linspace(0, 1, int(4 * np.hypot(*(b - a))) + 2)[:, None]
        points.append(a + shares * (b - a))
    return np.concatenate(points)


def unlike_edges(labels):
    """The middles of edges between unlike points, and both labels, smaller first."""
    places, pairs = [], []
    for axis in (0, 1):
        one, other = (np.delete(labels, end, axis) for end in (-1, 0))
        unlike = one != other
        places.append(np.argwhere(unlike) + 0.5 * np.eye(2)[axis])
        pairs.append(np.sort(np.stack([one, other], -1)[unlike], axis=-1))
    return np.concatenate(places), np.concatenate(pairs)


def mislabelled(ds, fine):
    """The share of points with another label than all computed ones around them."""
    n = fine.shape[0]
    known = np.stack([ds.refined_q.values, ds.refined_mu.values], -1)
    coarse = np.stack([v.ravel() for v in np.meshgrid(ds.q, ds.mu, indexing="ij")], -1)
    scale = np.array([np.ptp(Q_RANGE), np.ptp(MU_RANGE)])
    places = np.concatenate([coarse, known]) / scale
    labels = np.concatenate([ds.outcome.values.ravel(), ds.refined_outcome.values])
    i, j = (v.ravel() for v in np.meshgrid(range(n), range(n), indexing="ij"))
    here = np.stack([np.linspace(*Q_RANGE, n)[i], np.linspace(*MU_RANGE, n)[j]], -1)
    _, nearest = cKDTree(places).query(here / scale, k=4)
    alike = (labels[nearest] == labels[nearest[:, :1]]).all(axis=1)
    return float((alike & (labels[nearest[:, 0]] != fine.ravel())).mean())


def main():
    options = arguments(__doc__, coarse=33, grid=1024, levels=4)
    zj.configure_cpu()
    coarse = grid(options.coarse)
    start = time.perf_counter()
    ds = zj.refine(section, coarse, width=1e-6, levels=options.levels, progress=False)
    seconds = time.perf_counter() - start
    fine = grid(options.grid).outcome.values
    places, pairs = unlike_edges(fine)
    apart, _ = cKDTree(points_of_lines(ds, options.grid)).query(places, p=np.inf)
    names = np.array(
        [" ".join(zj.CODE(c).name for c in pair) for pair in pairs.tolist()]
    )
    edges, near = Counter(names.tolist()), Counter(names[apart <= 1].tolist())
    report(
        "a7_boundaries",
        about=lambda: {"commit": commit()},
        lanes=options.coarse**2 + ds.attrs["refine_points"],
        seconds=seconds,
        edges=dict(edges),
        within_a_cell={name: near[name] / count for name, count in edges.items()},
        mislabelled=mislabelled(ds, fine),
        missed_area=ds.attrs["refine_missed_area"],
        exponents=ds.pair_exponent.values.tolist(),
    )


if __name__ == "__main__":
    main()
