"""A sketch shows joints, rods, angles, loads and rates where they are."""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import FancyArrowPatch, Wedge

import ziegler_jax as zj

DRY = zj.SetValuedCoulomb(0.1, pin_radius=0.1)
# columns, and angles and rates of their rods
CASES = [
    (zj.uniform_rods(2.0, friction=DRY), (0.4, 0.9), (0.0, 0.3)),
    (zj.uniform_rods(1.0, l2=0.5, follower=0.5), (-0.3, 0.6), (-0.2, 0.4)),
    (zj.beck(3, 10.0, friction=DRY), (0.2, -0.4, -1.2), (0.0, 0.0, 0.0)),
]


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def up(angle):
    return np.array([-np.sin(angle), np.cos(angle)])


def places_of(column, phi):
    """Joints and tip, (rods + 1, 2), from the base on."""
    lengths = (1.0, column.l2) if isinstance(column, zj.Column) else column.lengths
    steps = [length * up(angle) for length, angle in zip(lengths, phi, strict=True)]
    return np.cumsum([np.zeros(2), *steps], axis=0)


def named(ax, word):
    return [np.array(t.get_position()) for t in ax.texts if word in t.get_text()]


@pytest.mark.parametrize(("column", "phi", "omega"), CASES)
def test_joints_rods_and_load_are_where_the_angles_say(column, phi, omega):
    ax = zj.plot.sketch(column, zj.State(phi, omega))
    places = places_of(column, phi)
    marked = [line.get_xydata() for line in ax.lines if line.get_marker() == "o"]
    np.testing.assert_allclose(marked[0], places[:-1], atol=1e-15)
    for rod, (begin, end) in enumerate(zip(places, places[1:], strict=False)):
        np.testing.assert_allclose(ax.lines[rod].get_xydata(), [begin, end], atol=1e-15)
    (load,) = [t for t in ax.texts if t.get_text() == ""]
    np.testing.assert_allclose(load.xy, places[-1], atol=1e-15)
    pushed = np.array(load.xy) - load.get_position()
    way = -up(getattr(column, "follower", 1.0) * phi[-1])
    np.testing.assert_allclose(pushed / np.hypot(*pushed), way, atol=1e-14)
    rings = [patch.center for patch in ax.patches if isinstance(patch, Wedge)]
    expected = [] if column.friction is None else places[:-1]
    np.testing.assert_allclose(
        np.reshape(rings, (-1, 2)), np.reshape(expected, (-1, 2))
    )


@pytest.mark.parametrize(("column", "phi", "omega"), CASES)
def test_angles_are_named_between_the_vertical_and_their_rods(column, phi, omega):
    ax = zj.plot.sketch(column, zj.State(phi, omega))
    for rod, (base, angle) in enumerate(
        zip(places_of(column, phi)[:-1], phi, strict=True)
    ):
        (at,) = named(ax, rf"$\varphi_{{{rod + 1}}}$")
        way = (at - base) / np.hypot(*(at - base))
        np.testing.assert_allclose(way, up(angle / 2), atol=1e-14)


@pytest.mark.parametrize(("column", "phi", "omega"), CASES)
def test_arrows_of_rates_point_the_way_that_rods_go(column, phi, omega):
    labelled = zj.plot.sketch(column, zj.State(phi, omega))
    moving = [i for i, rate in enumerate(omega) if rate]
    assert len(named(labelled, r"\dot\varphi")) == len(moving)
    ax = zj.plot.sketch(column, zj.State(phi, omega), labels=False)
    arrows = [p for p in ax.patches if isinstance(p, FancyArrowPatch)]
    straight = [p._path_original.vertices for p in arrows]
    straight = [v for v in straight if len(v) == 2]
    assert len(straight) == len(moving)
    for rod, (begin, end) in zip(moving, straight, strict=True):
        way = np.sign(omega[rod]) * up(phi[rod] + np.pi / 2)  # of d(rod's end)/dt
        np.testing.assert_allclose(
            (end - begin) / np.hypot(*(end - begin)), way, atol=1e-14
        )
    assert not [text for text in ax.texts if text.get_text()]


def test_a_sketch_without_a_state_has_angles_and_no_rates():
    ax = zj.plot.sketch(zj.beck(4, 10.0))
    assert len(named(ax, r"$\varphi")) == 4 and not named(ax, r"\dot")


def test_misuse_of_a_sketch_is_named(refuses):
    column = zj.uniform_rods(1.0)
    refuses(lambda: zj.plot.sketch(0.5), "`column` must be", "`Chain`, but is 0.5")
    refuses(
        lambda: zj.plot.sketch(column, zj.State((0.1, 0.2, 0.3))), "`state`", "2 rods"
    )
    refuses(lambda: zj.plot.sketch(column, (0.1, 0.2)), "`state` must be a `State`")
