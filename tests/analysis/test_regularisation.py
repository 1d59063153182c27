"""The smoothed law held against the set-valued one."""

import jax.numpy as jnp
import numpy as np

import ziegler_jax as zj


def scene(q, tau, kick, v_smooth):
    friction = zj.SetValuedCoulomb(tau, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    column = zj.uniform_rods(q, friction=friction)
    start = zj.State(omega=(0.0, kick))
    return zj.regularisation_error(
        column,
        start,
        v_smooth,
        windows=zj.Windows(transient=400.0),
        method=zj.Method(rtol=1e-8, atol=1e-8),
    )


def points(i):
    """Three smoothings of a cycle; a kick that only the smoothed law lets grow."""
    v_smooth = jnp.asarray([0.1, 0.03, 0.01, 0.05])[i.astype(int)]
    cycle = i < 3
    q, tau = jnp.where(cycle, 2.6, 1.8), jnp.where(cycle, 0.026, 0.01)
    return scene(q, tau, jnp.where(cycle, 0.2, 1e-6), v_smooth)


def test_smoothing_errs_in_amplitude_and_in_verdict():
    ds = zj.sweep(points, i=np.arange(4.0), progress=False)
    knee = ds.joint_amplitude_error.sel(joint=2).values[:3]
    # by another code, to five digits: smoothed, and set-valued
    known = np.array([0.63443, 0.63214, 0.63133]) - 0.63105
    np.testing.assert_allclose(knee, known, atol=2e-5)
    assert ds.rod_amplitude_error.sel(rod=1).values[:3].max() < 0
    assert ds.wrong_verdict.values.tolist() == [0.0, 0.0, 0.0, 1.0]
    assert ds.set_valued_outcome.values[3] == zj.OUTCOME.stuck


def test_another_law_is_refused(refuses):
    friction = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.1)
    column = zj.uniform_rods(1.0, friction=friction)
    refuses(
        lambda: zj.regularisation_error(column, zj.State(), 0.1),
        "`column`",
        "SetValuedCoulomb",
    )
