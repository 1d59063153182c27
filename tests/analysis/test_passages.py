"""Passages that come in pairs within a step are seen: just below the top of a swing."""

import jax
import numpy as np
import pytest
import scipy.signal
from models import flow

import ziegler_jax as zj

SHARES = np.array([0.9, 0.99, 0.999, 0.9999, 0.999999])
TOLERANCES = np.array([1e-4, 1e-6, 1e-9])
KICK = zj.State(omega=(0.0, 0.5))
TIMES = {"points": 60, "transient": 300.0, "max_time": 100.0}

LAWS = {
    "viscous": {"damping": zj.Viscous(0.05, 0.05)},
    "dry": {"friction": zj.SetValuedCoulomb(0.26, pin_radius=0.1)},
    "smoothed": {"friction": zj.SmoothCoulomb(0.26, pin_radius=0.1, v_smooth=0.05)},
}


def sections(law, plane, falling=False, **times):
    """Of lanes of levels and tolerances."""
    column = zj.uniform_rods(2.6, **LAWS[law])

    def passages(level, rtol):
        section = zj.SectionPlane(plane, level, rising=not falling)
        return zj.poincare(
            column, KICK, section=section, method=zj.Method(rtol=rtol), **TIMES | times
        )

    return jax.jit(jax.vmap(passages))


@pytest.mark.parametrize("rod", [1, 2])
@pytest.mark.parametrize("law", LAWS)
def test_all_passages_below_the_top_of_an_angle(law, rod):
    """The tops are where the rate falls through zero; rates pass alone.

    With friction, at loose tolerances, two programs' roundings become two motions,
    whose tops differ by the tolerance: then levels next to the top say nothing, and of
    the others one passage may lie on the other side of an end of the time.
    """
    at_top = sections(law, f"omega{rod}", falling=True)(
        np.zeros(len(TOLERANCES)), TOLERANCES
    )
    tops = [row[:n, rod - 1] for row, n in zip(at_top.phi, at_top.count, strict=True)]
    tops = [row[row > 0.5 * row.max()] for row in map(np.asarray, tops)]
    assert all(15 <= len(row) <= 21 for row in tops)
    levels = np.stack([SHARES * row.min() for row in tops])
    rtol = np.broadcast_to(TOLERANCES[:, None], levels.shape)
    found = sections(law, f"phi{rod}")(levels.ravel(), rtol.ravel())
    same = (
        np.asarray(found.steps).reshape(levels.shape)
        == np.asarray(at_top.steps)[:, None]
    )
    alike = same | (TOLERANCES[:, None] < 1e-5)
    assert law != "viscous" or alike.all()
    expected = np.array([[len(row)] * len(SHARES) for row in tops])
    off = np.abs(np.asarray(found.count).reshape(levels.shape) - expected)
    assert off[alike].max() == 0
    assert off[:, SHARES <= 0.99].max() <= 1


def test_all_passages_below_the_top_of_a_rate():
    """The tops are another code's, of a motion that has settled on its cycle."""
    about = (2.6, 0.0, 1.0, 0.05, 0.05)
    settled = flow((0, 0, 0, 0.5), 300.0, about, 1e-10).y[:, -1]
    ts = np.linspace(0.0, 10.0, 100_001)  # more than a period
    top = flow(settled, 10.0, about, 1e-10, t_eval=ts).y[3].max()
    all_passages_below(top, sections("viscous", "omega2"), {1e-4: SHARES[:4]})


# Of smoothed friction at 1e-4: a step that spans the layer is itself off by up to
# 0.03 in the rate (scipy over the same steps), at 1e-5 by 5e-4: one top lies 5 % lower.
@pytest.mark.parametrize(
    ("law", "loose"),
    [("dry", {1e-4: SHARES[:3]}), ("smoothed", {1e-4: [0.5, 0.9]})],
)
def test_all_passages_below_the_top_of_a_rate_with_friction(law, loose):
    """The tops are those of steps a hundred times as many."""
    column, ts = zj.uniform_rods(2.6, **LAWS[law]), np.linspace(300.0, 314.0, 14_001)
    method = zj.Method(rtol=1e-9)

    @jax.jit
    def rates(ts):
        return zj.trajectory(column, KICK, ts, method=method).omega[1:, 1]

    rate = np.asarray(rates(np.concatenate([[0.0], ts])))
    # from bottom to bottom: no passage lies at an end
    first, second = ts[scipy.signal.argrelmin(rate, order=2000)[0]][:2]
    times = {"transient": first, "max_time": 15 * (second - first)}
    all_passages_below(rate.max(), sections(law, "omega2", **times), loose)


def all_passages_below(top, run, loose):
    """As many as below half of the top; at loose tolerances not to its last digits."""
    half, fine = run(np.repeat(0.5 * top, 2), TOLERANCES[[0, 2]]).count
    assert half == fine > 14  # one in each period
    # a rate's course is O(h^5) from its own
    for rtol, shares in (loose | {1e-6: SHARES[:4], 1e-9: SHARES}).items():
        count = run(np.asarray(shares) * top, np.full(len(shares), rtol)).count
        np.testing.assert_array_equal(count, fine, f"{rtol}")
