"""Basins, as sweeps over axes of the start: symmetry, and the sticking set."""

import numpy as np

import ziegler_jax as zj


def dry(q, tau=0.2):
    law = zj.SetValuedCoulomb(tau, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    return zj.uniform_rods(q, friction=law)


def test_a_basin_is_symmetric_and_holds_the_sticking_set():
    """(phi, omega) and (-phi, -omega) have the same fate; what can rest, rests."""
    phi1, phi2 = np.linspace(-0.6, 0.6, 7), np.linspace(-0.9, 0.9, 7)
    found = zj.sweep(
        lambda phi1, phi2: zj.settle(
            dry(2.4),
            zj.State((phi1, phi2)),
            windows=zj.Windows(agreement=1e-2),
            certify=False,
        ),
        phi1=phi1,
        phi2=phi2,
        progress=False,
    )
    mirrored = found.isel(phi1=slice(None, None, -1), phi2=slice(None, None, -1))
    np.testing.assert_array_equal(found.outcome, mirrored.outcome)
    reached = set(np.unique(found.outcome))
    assert reached >= {zj.CODE.stuck, zj.CODE.repeats}
    assert min(reached) >= zj.CODE.unsettled
    start = np.stack(np.meshgrid(phi1, phi2, indexing="ij"))
    holds = np.asarray(zj.sticking_set(dry(2.4)).contains(*start))
    assert 0 < holds.sum() < holds.size / 2
    assert (found.outcome.values[holds] == zj.CODE.stuck).all()
    np.testing.assert_array_equal(
        np.moveaxis(found.rod_amplitude.values, -1, 0)[:, holds],
        np.abs(start)[:, holds],
    )
