"""Sections, spectra, and the moving column."""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pytest
from eyes import EYES, lab
from matplotlib.text import Annotation
from PIL import Image

import ziegler_jax as zj
from ziegler_jax.results import (
    CRITICAL_LOADS,
    KINDS,
    ONSETS,
    ORBITS,
    OUTCOMES,
    REGIMES,
)

KICK = zj.State(omega=(0.0, 0.3))


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def motion(ts, phi):
    return zj.Trajectory(ts, phi, np.zeros_like(phi), 5, zj.CODE.complete)


def test_a_harmonic_is_a_peak_of_its_amplitude_at_its_frequency():
    ts = np.linspace(0, 200, 4001)
    phi = np.stack([0.3 * np.cos(2.0 * ts), 0.1 + 0.05 * np.sin(5.0 * ts)], axis=1)
    ax = zj.plot.spectrum(motion(ts, phi))
    for line, amplitude, frequency in zip(
        ax.lines, (0.3, 0.05), (2.0, 5.0), strict=True
    ):
        x, y = line.get_data()
        peak = y.argmax()
        assert abs(x[peak] - frequency) < np.pi / 100  # half a line
        # between two lines Hann's window loses 15 %; measured 6 % and 3 %
        assert 0.85 * amplitude <= y[peak] <= 1.001 * amplitude
    with pytest.raises(ValueError, match="evenly spaced"):
        zj.plot.spectrum(motion(ts**2, phi))
    with pytest.raises(ValueError, match="ended early"):
        zj.plot.spectrum(motion(ts, np.where(ts[:, None] > 190, np.nan, phi)))


def test_a_section_shows_its_points_and_names_its_plane():
    plane = zj.SectionPlane("omega2", 0.1, rising=False)
    points = zj.poincare(
        zj.uniform_rods(2.0), KICK, section=plane, points=5, transient=0.0
    )
    ax = zj.plot.section(points, rod=1)
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), points.phi[:, 0])
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), points.omega[:, 0])
    title = ax.get_title(loc="left")
    assert title == r"section $\dot\varphi_2 = 0.1$, falling"
    with pytest.raises(ValueError, match="`rod` must be one of 1 to 2, but is 3"):
        zj.plot.section(points, rod=3)


def test_the_arrow_turns_by_the_follower_fraction_of_rod_2(tmp_path):
    phi = np.array([[0.1, 0.6], [0.1, 0.6]])
    for follower in (1.0, 0.5, 0.0):
        moving = zj.plot.animate(
            motion(np.arange(2.0), phi),
            tmp_path / "m.gif",
            column=zj.uniform_rods(1.0, follower=follower),
        )
        moving._func(0)
        (arrow,) = [t for t in plt.gcf().axes[0].texts if isinstance(t, Annotation)]
        tail, tip = np.array(arrow.get_position()), np.array(arrow.xy)
        way = (tail - tip) / np.hypot(*(tail - tip))  # from the tip on
        exact = -np.sin(follower * 0.6), np.cos(follower * 0.6)
        # measured 2.2e-16
        np.testing.assert_allclose(way, exact, rtol=0, atol=1e-14)


def test_the_column_moves_as_its_angles_say(tmp_path):
    ts = np.linspace(0, 2, 21)
    phi = np.stack([0.5 * np.sin(ts), -0.2 * ts], axis=1)
    column = zj.uniform_rods(1.0, l2=0.5)
    moving = zj.plot.animate(
        motion(ts, phi), tmp_path / "m.gif", speed=1.0, fps=5, column=column
    )
    with Image.open(tmp_path / "m.gif") as image:
        assert image.n_frames == 10
    moving._func(5)  # at t = 1
    one, two = plt.gcf().axes[0].lines[1:3]
    knee = np.array([one.get_xdata()[1], one.get_ydata()[1]])
    tip = np.array([two.get_xdata()[1], two.get_ydata()[1]])
    a, b = 0.5 * np.sin(1.0), -0.2
    np.testing.assert_allclose(np.abs(knee), [np.sin(a), np.cos(a)], atol=1e-3)
    np.testing.assert_allclose(np.hypot(*(tip - knee)), 0.5, rtol=1e-12)
    # the angle between both rods
    crossed = knee[0] * (tip - knee)[1] - knee[1] * (tip - knee)[0]
    np.testing.assert_allclose(abs(crossed) / 0.5, abs(np.sin(a - b)), atol=1e-3)
    for name, sentence in (("m.png", r"\.gif or \.mp4"), ("m", r"\.gif or \.mp4")):
        with pytest.raises(ValueError, match=sentence):
            zj.plot.animate(motion(ts, phi), tmp_path / name)
    for bad in ("x", 0, np.nan):
        with pytest.raises(ValueError, match="`fps` must be"):
            zj.plot.animate(motion(ts, phi), fps=bad)
    with pytest.raises(ValueError, match="`column` must have the 2 rods .* has 3"):
        zj.plot.animate(motion(ts, phi), column=zj.beck(3))
    with pytest.raises(ValueError, match="`column` must be a `Column` or a `Chain`"):
        zj.plot.animate(motion(ts, phi), column=0.5)


def test_the_clock_of_a_moving_column_has_a_unit(tmp_path):
    ts = np.linspace(0, 2, 21)
    moved = motion(ts, np.zeros((21, 2)))
    for shown, unit in (
        (moved, r"$\sqrt{m l^2/k}$"),
        (zj.SI(m=1.0, l=1.0, k=4.0).restore(moved), "s"),
    ):
        zj.plot.animate(shown, tmp_path / "m.gif")._func(0)
        (clock,) = [t for t in plt.gcf().axes[0].texts if "=" in t.get_text()]
        assert clock.get_text() == f"$t$ = 0.0 {unit}"


def test_a_chain_moves_as_its_angles_say_under_all_its_forces(tmp_path):
    ts, angles = np.linspace(0, 2, 21), np.array([0.1, -0.3, 0.8])
    lengths, ways = (0.5, 1.0, 0.25), np.array([1.0, 0.5, 0.0])
    forces = zj.FollowerForces((2.0, 0.0, -1.0), tuple(ways), at=(0.5, 1.0, 1.0))
    chain = zj.Chain(1.0, lengths=lengths, forces=forces)
    moving = zj.plot.animate(
        motion(ts, np.tile(angles, (21, 1))), tmp_path / "m.gif", column=chain
    )
    moving._func(5)
    ax = plt.gcf().axes[0]
    steps = np.array(lengths) * [-np.sin(angles), np.cos(angles)]
    places = np.concatenate([np.zeros((2, 1)), np.cumsum(steps, axis=1)], axis=1)
    for i, rod in enumerate(ax.lines[1:4]):
        np.testing.assert_allclose(rod.get_data(), places[:, i : i + 2], atol=1e-14)
    one, three = [t for t in ax.texts if isinstance(t, Annotation)]
    np.testing.assert_allclose(one.xy, places[:, 1] / 2, atol=1e-14)
    np.testing.assert_allclose(three.xy, places[:, 3], atol=1e-14)
    # tails: what presses stands before the rod, what pulls lies behind its end
    first, last = (np.array(t.get_position()) - t.xy for t in (one, three))
    along = [-np.sin(ways[0] * angles[0]), np.cos(ways[0] * angles[0])]
    np.testing.assert_allclose(first / np.hypot(*first), along, atol=1e-14)
    np.testing.assert_allclose(last, [0.0, -np.hypot(*first) / 2], atol=1e-14)
    plt.close("all")
    pictured = zj.plot.spectrum(motion(ts, np.outer(ts, angles)), skip=0.0)
    assert len(pictured.lines) == 3


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("codes", [OUTCOMES, KINDS, REGIMES])
def test_codes_of_a_map_are_told_apart_by_any_eye(codes, eye):
    from ziegler_jax.plot.style import code_colours

    colours = code_colours([code.name for code in (zj.CODE.not_computed, *codes)])
    places = [lab(colour, eye) for colour in colours]
    apart = [np.linalg.norm(a - b) for i, a in enumerate(places) for b in places[:i]]
    assert min(apart) > 10  # measured 10.7: white and the pale blue of stable columns


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("rods", range(2, 8))
def test_rods_beside_each_other_are_told_apart_by_any_eye(rods, eye):
    from ziegler_jax.plot.style import rod_colours

    places = [lab(colour, eye) for colour in rod_colours(rods)]
    beside = zip(places, places[1:], strict=False)
    apart = min(np.linalg.norm(a - b) for a, b in beside)
    assert apart > 10  # measured 11.4 of seven, 31 of three


def test_stuck_has_one_colour_and_no_other_verdict_wears_it():
    from ziegler_jax.plot.style import REST_COLOUR, code_colours

    families = (OUTCOMES, KINDS, REGIMES, CRITICAL_LOADS, ONSETS, ORBITS)
    for codes in families:
        names = [code.name for code in codes]
        colours = dict(zip(names, code_colours(names), strict=True))
        wearing = {name for name, c in colours.items() if c == REST_COLOUR}
        assert wearing == {"stuck"} & set(names)
        assert len(set(colours.values())) == len(names)
