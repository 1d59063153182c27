"""From a cell to its motion."""

import subprocess
import sys
import textwrap

import numpy as np
import pytest
import xarray as xr

import ziegler_jax as zj

pytestmark = pytest.mark.usefixtures("optimised")  # bits, as users get them

RADIUS = 0.1
UNITS = zj.SI(m=0.1, l=0.2, k=0.5)


def point(q, mu):
    friction = zj.SetValuedCoulomb(mu, pin_radius=RADIUS)
    column = zj.uniform_rods(q=q, friction=friction)
    method = zj.Method(rtol=1e-9)
    return zj.settle(column, zj.State(omega=(0, 0.3)), method=method)


@pytest.fixture(scope="module")
def ds():
    return zj.sweep(point, q=[1.0, 2.0, 2.6], mu=[0.1, 0.3], progress=False)


def directly(q, mu, ts):
    column = zj.uniform_rods(q=q, friction=zj.SetValuedCoulomb(mu, pin_radius=RADIUS))
    start = zj.State(omega=(0, 0.3))
    return zj.trajectory(column, start, ts, method=zj.Method(rtol=1e-9))


def test_a_cells_motion_is_that_of_its_column_and_start(ds):
    ts = np.linspace(0, 30, 4001)
    motion = zj.motion(ds, q=2.55, mu=0.12, ts=ts)  # the nearest: 2.6, 0.1
    assert np.array_equal(motion.phi, directly(2.6, 0.1, ts).phi)
    column, start = zj.scene(ds.sel(mu=0.1), q=2.6)
    assert float(column.q) == 2.6 and [float(x) for x in start.y] == [0, 0, 0, 0.3]


def test_it_ends_when_the_cells_own_ended_and_is_as_large(ds):
    motion = zj.motion(ds, q=1.0, mu=0.3)
    cell = ds.sel(q=1.0, mu=0.3)
    assert cell.outcome == zj.OUTCOME.stuck
    assert float(motion.ts[-1]) == min(float(cell.time), 200)
    # it has come to rest where the cell says that it rests; both end to 1e-9
    rest = np.abs(motion.phi[-1, 1] - motion.phi[-1, 0])
    assert abs(rest - float(cell.joint_amplitude.sel(joint=2))) < 1e-7


def test_samples_are_cells_too(refuses):
    q = xr.DataArray([2.0, 2.6, 1.0], dims="sample")
    mu = xr.DataArray([0.1, 0.2, 0.3], dims="sample")
    ds = zj.sweep(point, q=q, mu=mu, progress=False)
    column, _ = zj.scene(ds, sample=1)
    assert float(column.q) == 2.6 and float(column.friction.mu_s) == 0.2
    refuses(lambda: zj.scene(ds, sample=3), "`sample`", "0 to 2", "3")


def in_newtons(F, omega2):  # noqa: N803
    column = UNITS.uniform_rods(F=F)
    motion = zj.trajectory(column, zj.State(omega=(0, omega2)), [0.0, 1.0])
    return {"time": zj.Variable(motion.ts[1] * 30, "time", "sqrt(m l^2/k)")}


def test_a_restored_map_has_the_same_cells():
    about = {"long_name": "follower load", "units": "N", "symbol": "$F$"}
    force = xr.DataArray([4.0, 6.5], attrs=about)
    ds = zj.sweep(in_newtons, F=force, omega2=[0.2, 0.4], progress=False)
    assert ds.F.attrs == about  # of an axis of one's own
    si = UNITS.restore(ds)
    assert si.F.equals(ds.F) and si.omega2.attrs["units"] == "rad/s"
    second = float(si.omega2[1])
    column, start = zj.scene(si, F=6.5, omega2=second)
    assert float(column.q) == pytest.approx(6.5 * 0.2 / 0.5, abs=1e-12)
    assert float(start.omega[1]) == pytest.approx(0.4, abs=1e-12)
    motion = zj.motion(si, F=6.5, omega2=second)  # in the column's units, to 30
    assert float(motion.ts[-1]) == pytest.approx(30.0, rel=1e-12)
    assert float(si.time[0, 0]) == pytest.approx(30 * UNITS.time, rel=1e-12)


def test_a_store_of_another_process_knows_its_function(tmp_path):
    (tmp_path / "mine.py").write_text(
        textwrap.dedent("""
        import ziegler_jax as zj
        KAPPA = 0.1
        def point(q, c):
            column = zj.uniform_rods(q, kappa=KAPPA, damping=zj.Viscous(c, c))
            return zj.trajectory(column, zj.State(omega=(0, 0.3)), [0.0, 1.0])
        """)
    )
    write = """
        import mine, ziegler_jax as zj
        zj.sweep(mine.point, q=[2.6], c=[0.1, 0.2], store="s", progress=False)
        """
    read = """
        import sys, ziegler_jax as zj
        ds = zj.open_sweep("s")
        assert "mine" not in sys.modules
        column, _ = zj.scene(ds, q=2.6, c=0.2)
        assert float(column.damping.c1) == 0.2
        sys.modules["mine"].KAPPA = 0.2
        try:
            zj.scene(ds, q=2.6, c=0.2)
        except ValueError as error:
            assert "numbers around it" in str(error) and "0.2" in str(error)
        else:
            raise AssertionError
        """
    for script in (write, read):
        script = [sys.executable, "-c", textwrap.dedent(script)]
        subprocess.run(script, cwd=tmp_path, check=True)


def test_what_is_no_cell_is_refused(ds, refuses):
    refuses(lambda: zj.scene(ds, q=9.0, mu=0.1), "`q`", "1 to 2.6", "9")
    refuses(lambda: zj.scene(ds, q=2.6), "`mu`", "must be given")
    refuses(lambda: zj.scene(ds, q=2.6, mu=0.1, c=1), "`c`", "mu, q")
    refuses(lambda: zj.scene(ds.drop_attrs(), q=2.6, mu=0.1), "`scene`")
    elsewhere = ds.assign_attrs(scene="def point(q, mu): ...", scene_function="no:f")
    refuses(lambda: zj.scene(elsewhere, q=2.6, mu=0.1), "`point`", "no.f")
    refuses(
        lambda: zj.scene(elsewhere, q=2.6, mu=0.1, point=point), "`point`", "source"
    )

    def load(kappa):
        return zj.critical_load(zj.uniform_rods(1.0, kappa=kappa))

    linear = zj.sweep(load, kappa=[1.0, 2.0], progress=False)
    refuses(lambda: zj.scene(linear, kappa=1.0), "follows the motion of one column")
