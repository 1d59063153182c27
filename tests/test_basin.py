"""Basins: symmetry, the sticking set, and what is counted."""

import numpy as np
import pytest

import ziegler_jax as zj


def dry(q, tau=0.2):
    law = zj.SetValuedCoulomb(tau, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    return zj.uniform_rods(q, friction=law)


@pytest.mark.slow
def test_a_basin_is_symmetric_and_holds_the_sticking_set():
    """(phi, omega) and (-phi, -omega) have the same fate; what can rest, rests."""
    phi1, phi2 = np.linspace(-0.6, 0.6, 7), np.linspace(-0.9, 0.9, 7)
    found = zj.basin(
        dry(2.4), {"phi1": phi1, "phi2": phi2}, rtol_settle=1e-2, progress=False
    )
    mirrored = found.isel(phi1=slice(None, None, -1), phi2=slice(None, None, -1))
    np.testing.assert_array_equal(found.outcome, mirrored.outcome)
    assert set(found.reached.values) >= {"stuck", "cycle"}
    np.testing.assert_allclose(found.fraction.sum(), 1.0, rtol=1e-15)
    holds = zj.sticking_set(dry(2.4)).contains(*np.meshgrid(phi1, phi2, indexing="ij"))
    holds = np.asarray(holds)
    assert 0 < holds.sum() < holds.size / 2
    assert (found.outcome.values[holds] == zj.OUTCOME.stuck).all()
    start = np.abs(np.meshgrid(phi1, phi2, indexing="ij"))
    np.testing.assert_array_equal(
        np.moveaxis(found.rod_amplitude.values, -1, 0)[:, holds], start_at(start, holds)
    )


def start_at(start, holds):
    return np.asarray(start)[:, holds]


def test_bad_arguments_are_named(refuses):
    plane = {"phi1": [0.0, 0.1]}
    refuses(lambda: zj.basin(dry(1.0), {"q": [1.0]}), "`axes`", "phi1")
    refuses(lambda: zj.basin(dry(1.0), [1.0]), "`axes`", "phi1")
    refuses(lambda: zj.basin(dry(1.0), {**plane, "q": [1.0]}), "`column`", "function")
    refuses(lambda: zj.basin(dry, plane), "`column`", "starts")
    refuses(lambda: zj.basin(2.0, plane), "`column`", "2.0")
    refuses(lambda: zj.basin(lambda q: q, {**plane, "q": [1.0]}), "`column`")
    refuses(lambda: zj.basin(dry(1.0), plane, start=3), "`start`", "`State`")
