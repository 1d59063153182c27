"""Every block of code in a docstring runs as it stands, and does what is said of it."""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp

import ziegler_jax as zj

PACKAGE = Path(zj.__file__).parent
BLOCK = re.compile(r"^( *)```python\n(.*?)^ *```$", re.M | re.S)
KICK, HARD = zj.State(omega=(0.0, 0.3)), zj.State(omega=(0.0, 1.0))


def blocks():
    """The code of all docstrings, by file and number."""
    code_of = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        for i, match in enumerate(BLOCK.finditer(path.read_text())):
            indent, code = match.groups()
            name = f"{path.relative_to(PACKAGE).as_posix()} {i}"
            code_of[name] = re.sub(f"^{indent}", "", code, flags=re.M)
    return code_of


BLOCKS = blocks()


def make_column(q):
    law = zj.SetValuedCoulomb(0.026, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    return zj.uniform_rods(q, friction=law)


def column(q, v):
    law = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=v)
    return zj.uniform_rods(q, friction=law)


def cell(q, mu):
    law = zj.SmoothCoulomb(mu + 0.01, pin_radius=0.1, v_smooth=0.05)
    windows = zj.Windows(transient=5.0, length=5.0, max_windows=1)
    return zj.settle(
        zj.uniform_rods(q, friction=law), KICK, windows=windows, certify=False
    )


def dry(q, tau):
    law = zj.SetValuedCoulomb(tau, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    return zj.uniform_rods(q, friction=law)


def folding_cell(q, kick):
    load = zj.ConstantLoad(1.0)
    law = zj.SmoothCoulomb(0.1, pin_radius=1.0, v_smooth=0.05, load=load)
    column = zj.uniform_rods(q, friction=law, damping=zj.Viscous(0.002, 0.002))
    return zj.settle(column, zj.State(omega=(0.0, kick)))


def flipping(q):
    law = zj.SetValuedCoulomb(
        (0.0956765, 0.1696786), pin_radius=1.0, load=zj.ConstantLoad(1.0)
    )
    parts = {"damping": zj.Viscous(0.0313048, 0.0971598), "follower": 0.710525}
    return zj.uniform_rods(q, friction=law, kappa=1.128130, **parts)


def before_a_flip():
    near = zj.State((0.0, -2.2795), (2.10147, 4.33986))
    return zj.periodic_orbit(flipping(3.3), near, period=7.00939)


def a_fold():
    """The other cycle's, at q = 1.8614, roughly."""
    unknown = jnp.full((1, 2), jnp.nan)
    return zj.CyclePoints(
        parameter=jnp.array([1.8614]), phi=jnp.array([[0.0, -0.2433]]),
        omega=jnp.array([[0.5440, 0.5440]]), period=jnp.array([8.7495]),
        rod_amplitude=unknown, joint_amplitude=unknown,
        monodromy=jnp.full((1, 4, 4), jnp.nan), kind=jnp.array([zj.CODE.fold]),
        settings=(("section", "phi1 rising"),),
    )  # fmt: skip


def of_a_curve(names):
    ds = names["curve"].to_dataset()
    np.testing.assert_allclose(ds.second, [0.1, 0.2, 0.26], rtol=0, atol=1e-12)
    assert abs(ds.first[0] - 1.61206) < 1e-5 and abs(ds.first[2] - 1.86140) < 1e-5
    assert (ds.point_outcome == zj.CODE.found).all() and ds.residual.max() < 1e-10


def small_map():
    def point(q, mu_s, mu_k):
        law = zj.SmoothCoulomb(
            mu_s, mu_k, pin_radius=0.1, v_smooth=0.05, v_stribeck=0.1
        )
        windows = zj.Windows(transient=5.0, length=5.0, max_windows=1)
        return zj.settle(
            zj.uniform_rods(q, friction=law), KICK, windows=windows, certify=False
        )

    mu = np.array([0.1, 0.12])
    return zj.sweep(point, q=[1.0, 2.0, 3.0], mu_s=mu, mu_k=mu, progress=False)


def both_ways():
    law = zj.SetValuedCoulomb(0.02, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    return zj.sweep_up_down(
        lambda q: zj.uniform_rods(q, friction=law), [1.4, 2.0], kick=KICK
    )


def cycles():
    """A branch of two points, the second unstable; the fold is between them."""
    nan, zeros = np.full(1, np.nan), np.zeros((2, 2))
    about = {"parameter": np.array([1.6, 1.5]), "phi": zeros, "omega": zeros}
    about |= {"period": np.ones(2), "rod_amplitude": zeros, "joint_amplitude": zeros}
    growth = np.stack([np.diag([1, f, 0.1, 0.1]) for f in (0.5, 2.0)])
    points = zj.CyclePoints(**about, monodromy=growth, kind=np.zeros(2, int))
    special = {name: np.repeat(nan, 1) for name in ("parameter", "period")}
    pairs = ("phi", "omega", "rod_amplitude", "joint_amplitude")
    special |= {name: np.full((1, 2), np.nan) for name in pairs}
    special = zj.CyclePoints(**special, monodromy=growth[:1], kind=np.ones(1, int))
    return zj.Branch(points, special, 2, zj.CODE.found, [zj.CODE.found], False, 10, ())


def run(name, **given):
    names = {"zj": zj, "np": np, "jnp": jnp, **given}
    exec(compile(BLOCKS[name], name, "exec"), names)  # noqa: S102
    return names


def of_a_sweep(names):
    assert names["ds"].sizes == {"q": 31, "mu": 11, "joint": 2, "rod": 2}
    assert (names["ds"].outcome == zj.CODE.cycle).any()


def of_a_variable(names):
    ds = zj.sweep(names["point"], q=[1.0, 2.6], progress=False)
    assert ds.growth.dims == ("q", "mode") and ds.growth.sel(q=2.6).max() > 0.2


def of_units(names):
    assert names["end"].to_dataset().time.attrs["units"] == "s"
    assert float(names["motion"].ts[-1]) == pytest.approx(3.0)


def of_a_kick(names):
    ds = zj.sweep(names["point"], q=[2.0], tau=[0.03], progress=False)
    assert ds.outcome.item() == zj.CODE.found


def of_a_wall(names):
    """A spring of 0.2 beside those of the joints: by hand at small angles."""
    inside = zj.linearise(names["column"]).stiffness
    bare = zj.linearise(zj.uniform_rods(2.6)).stiffness
    np.testing.assert_allclose(inside - bare, np.full((2, 2), 0.2), atol=1e-15)


def of_a_pulsation(names):
    assert names["motion"].outcome == zj.CODE.complete
    loads = [zj.power(names["column"], HARD, t).follower for t in (0.0, 0.5)]
    ratio = (1.5 + 0.2 * np.cos(1.5)) / 1.7
    assert HARD.omega[0] == 0 and loads[0] == 0 == loads[1] and ratio < 1


def of_a_line(names):
    ds = zj.sweep(names["point"], angle=[0.6], tau=[0.03], progress=False)
    assert ds.outcome.item() == zj.CODE.found
    assert ds.rises.item() == 1  # rest before, motion after


def of_a_least_kick(names):
    """Traced alone: `test_least_kicks` runs such points."""
    program = zj.Program(names["point"])
    assert program.names == ("q", "tau")
    assert {"energy", "misalignment", "edge_period"} <= set(program.variables)


def of_a_branch(names):
    branch = names["branch"]
    assert branch.points.parameter[0] == 2.0 and branch.points.parameter[1] < 2.0


def of_a_doubled_branch(names):
    periods = [names["doubled"].orbit.period, names["branch"].points.period[0]]
    assert float(periods[0] / periods[1]) == pytest.approx(2.0, rel=1e-2)
    assert np.isfinite(names["other"].points.parameter[:39]).all()


def of_stiff_lanes(names):
    assert names["stiff"].values.any() and not names["stiff"].values.all()
    assert names["ds"].outcome.notnull().all()


def of_samples(names):
    ds = names["ds"]
    assert ds.q_cr.dims == ds.kappa.dims == ("sample",)
    assert 0 < ds.q_cr.std() < ds.q_cr.mean()


def of_a_union(names):
    ds = names["ds"]
    assert ds.q.values.tolist() == [0.5, 1.0, 1.5, 2.0, 3.0]
    assert np.isfinite(ds.q_cr).all() and ds.outcome.dtype.kind == "i"


def of_a_boundary(names):
    ds = names["ds"]
    assert ds.attrs["refine_complete"] and ds.sizes["vertex"] > 20


def of_marks(names):
    unsure, again = names["unsure"], names["ds"].again
    assert 0 < unsure.sum() < (again > 1).sum() < 0.5 * again.size


CASES = {
    "sweep/sweep.py 0": ({}, of_a_sweep),
    "sweep/sweep.py 1": ({"xr": xr}, of_samples),
    "sweep/once.py 0": (
        {"point": cell},
        lambda names: names["results"]["joint_amplitude"].shape == (3, 2),
    ),
    "maps/merge.py 0": ({}, of_a_union),
    "maps/refine.py 0": ({}, of_a_boundary),
    "maps/follow_again.py 0": ({}, of_marks),
    "results.py 0": ({}, of_a_variable),
    "units/si.py 0": ({"ts": np.linspace(0, 3, 7)}, of_units),
    "plot/maps.py 0": ({"ds": small_map}, None),
    "plot/maps.py 1": ({"ds": small_map}, None),
    "plot/maps.py 2": ({"both": both_ways, "branch": cycles}, None),
    "plot/branches.py 0": ({"cycles": cycles}, None),
    "plot/sections.py 0": ({"column": zj.uniform_rods(2.0), "start": KICK}, None),
    "plot/sections.py 1": ({"column": zj.uniform_rods(2.0), "start": KICK}, None),
    "plot/animation.py 0": ({"column": zj.uniform_rods(2.0), "start": KICK}, None),
    "plot/page.py 0": ({}, None),
    "plot/sketch.py 0": ({}, None),
    "analysis/threshold.py 0": ({}, of_a_line),
    "analysis/threshold.py 1": ({}, of_a_kick),
    "analysis/least_kick.py 0": ({}, of_a_least_kick),
    "motion/stiffness.py 0": (
        {
            "column": column,
            "start": KICK,
            "axes": {"q": [2.0, 2.6], "v": [1e-5, 0.1], "progress": False},
        },
        of_stiff_lanes,
    ),
    "analysis/continuation.py 0": (
        {
            "make_column": make_column,
            "settled": lambda: zj.settle(make_column(2.0), HARD, certify=False),
        },
        of_a_branch,
    ),
    "curves/bifurcation.py 0": (
        {},
        # the cycle ends at the fold that a branch of it passes (`test_branches`)
        lambda names: 1.5 < float(jax.jit(names["fold_of"])(0.1)) < 1.6,
    ),
    "maps/which_cycle.py 0": (
        {"point": folding_cell, "q": [1.638, 1.64], "kick": [1.0, 2.0, 2.1, 2.7]},
        lambda names: names["ds"].cycle_label.values.tolist() == [[0, 1, 1, 2]] * 2,
    ),
    "analysis/branch_off.py 0": (
        {"make_column": flipping, "orbit": before_a_flip},
        of_a_doubled_branch,
    ),
    "curves/curve.py 0": ({"make": dry, "fold": a_fold}, of_a_curve),
    "analysis/hysteresis.py 0": (
        {"mu": np.array([0.1, 0.12])},
        lambda names: names["ds"].outcome.dims == ("mu_s", "mu_k", "branch", "q"),
    ),
    "model/forces.py 0": ({}, of_a_wall),
    "model/forces.py 1": ({}, of_a_pulsation),
    "sweep/compare.py 0": (
        {},
        lambda names: int(names["ds"].joint_amplitude_difference.count()) > 200,
    ),
}
LAWS = ("model/damping.py 0", "model/friction.py 0", "motion/observers.py 0")


def test_no_block_is_left_out():
    assert set(BLOCKS) == {*CASES, *LAWS}


@pytest.mark.parametrize("name", CASES)
def test_a_block_runs_as_it_stands(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given, check = CASES[name]
    made = ("ds", "settled", "both", "branch", "cycles", "fold", "orbit")
    names = run(name, **{k: v() if k in made else v for k, v in given.items()})
    if check is not None:
        assert check(names) in (None, True)


# Laws of one's own, against equations written out here --------------------------------

MASS = np.array([[4 / 3, 1 / 2], [1 / 2, 1 / 3]])


def written_out(q, damping, ts):
    """Uniform rods with joint torques -damping(u1, u2), by scipy."""

    def field(_, y):
        phi, w = y[:2], y[2:]
        d = phi[0] - phi[1]
        mass = MASS.copy()
        mass[0, 1] = mass[1, 0] = MASS[0, 1] * np.cos(d)
        g1, g2 = damping(w[0], w[1] - w[0])
        gyro = MASS[0, 1] * np.sin(d)
        right = [
            q * np.sin(d) - phi[0] - d - gyro * w[1] ** 2 - g1 + g2,
            d + gyro * w[0] ** 2 - g2,
        ]
        return np.concatenate([w, np.linalg.solve(mass, right)])

    start = [0.0, 0.0, 0.0, 0.3]
    return solve_ivp(
        field, (0, ts[-1]), start, "DOP853", ts, rtol=1e-12, atol=1e-12
    ).y.T


TS = np.linspace(0, 20, 5)


def end_of(column):
    found = zj.trajectory(column, KICK, TS, method=zj.Method(rtol=1e-10))
    return np.hstack([found.phi, found.omega])


def test_quadratic_damping_moves_the_column_as_its_torques_say():
    column = run("model/damping.py 0")["column"]
    exact = written_out(
        2.6, lambda u1, u2: (0.1 * abs(u1) * u1, 0.1 * abs(u2) * u2), TS
    )
    # measured 3.2e-9
    np.testing.assert_allclose(end_of(column), exact, rtol=0, atol=3e-8)
    # at rest it has no damping: the linear column does not know it
    assert float(zj.critical_load(column).q_cr) == float(
        zj.critical_load(zj.uniform_rods()).q_cr
    )
    found = zj.settle(column, KICK, observers=(zj.EnergyBalance(),), certify=False)
    assert float(found.damping_power) > 0
    # measured 2.1e-6 of it, at 1e-6
    assert abs(found.energy_imbalance) < 2e-5 * abs(found.damping_power)


def test_a_friction_law_of_ones_own_moves_the_column_and_runs_in_a_sweep():
    names = run("model/friction.py 0")
    column = zj.uniform_rods(2.6, friction=names["Root"](0.1, 0.01))
    torque = lambda u: 2.6 * 0.1 * 0.1 * u / np.sqrt(u * u + 1e-4)  # noqa: E731
    exact = written_out(2.6, lambda u1, u2: (torque(u1), torque(u2)), TS)
    # measured 6.2e-11
    np.testing.assert_allclose(end_of(column), exact, rtol=0, atol=1e-9)
    codes = names["ds"].outcome.values
    assert (codes >= zj.CODE.unsettled).all() and len(np.unique(codes)) > 1
    bad = zj.sweep(names["point"], q=[2.6], mu=[-0.1], progress=False)
    assert bad.outcome.item() == zj.CODE.invalid


def test_an_observer_of_ones_own_finds_what_the_motion_shows():
    names = run("motion/observers.py 0")
    ds, q = names["ds"], 2.6
    assert ds.peak_rate.dims == ("q", "joint")
    assert ds.peak_rate.attrs["units"] == "sqrt(k/(m l^2))"
    friction = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.05)
    column = zj.uniform_rods(q, friction=friction)
    end = float(ds.time.sel(q=q))
    ts = np.concatenate([[0.0], np.linspace(end - 40, end, 4001)])
    motion = zj.trajectory(column, KICK, ts)
    w1, w2 = np.asarray(motion.omega[1:]).T
    peaks = np.abs([w1, w2 - w1]).max(axis=1)
    # a step ends beside the peak: measured 3e-4
    np.testing.assert_allclose(ds.peak_rate.sel(q=q), peaks, rtol=3e-3)
