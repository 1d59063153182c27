"""Pictures show what was computed, and nothing in between."""

import subprocess
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_rgba

import ziegler_jax as zj
from ziegler_jax.plot.style import REST_COLOUR
from ziegler_jax.results import ONSETS, OUTCOMES, UNSETTLED, flag_attributes

Q, MU = np.array([1.0, 1.5, 2.5, 3.0]), np.array([0.1, 0.2, 0.4])
OUT, RUN = zj.CODE.not_computed, zj.CODE.cycle
CODES = np.array(
    [
        [zj.CODE.stuck, RUN, OUT],
        [zj.CODE.unsettled, RUN, OUT],
        [zj.CODE.escaped, RUN, RUN],
        [zj.CODE.not_finite, RUN, RUN],
    ]
)


FLAGS = {
    "long_name": "how the motion ended",
    **flag_attributes(OUTCOMES),
}


@pytest.fixture
def plane():
    amplitude = np.arange(12.0).reshape(4, 3)
    failed = (CODES < zj.CODE.unsettled) & (CODES != OUT)
    amplitude[failed] = np.nan  # what was left out keeps a number, not to be shown
    named = {"long_name": "largest absolute angle of the joint", "units": "rad"}
    q = {"long_name": "follower load", "units": "1", "symbol": "$q$"}
    mu = {"long_name": "rate", "units": "sqrt(k/(m l^2))", "symbol": r"$\mu$"}
    return xr.Dataset(
        {
            "joint_amplitude": (("q", "mu"), amplitude, named),
            "outcome": (("q", "mu"), CODES, FLAGS),
        },
        {"q": ("q", Q, q), "mu": ("mu", MU, mu), "joint": 2},
    )


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def test_the_outcome_of_a_search_is_not_taken_for_a_motions(plane):
    plane["outcome"] = plane.outcome.assign_attrs(flag_attributes(ONSETS))
    ax = zj.plot.map(plane, "joint_amplitude", x="q", y="mu")
    assert ax.get_legend() is None
    shown = ax.collections[0].get_array()
    assert np.ma.count(shown) == plane.joint_amplitude.notnull().sum()


def layer(ax, name):
    """The centres of the cells of an outcome's layer, and the layer."""
    (cells,) = [c for c in ax.collections if c.get_label() == name]
    centres = [path.vertices[:4].mean(axis=0) for path in cells.get_paths()]
    return np.array(centres), cells


def test_cells_without_a_number_are_hatched_in_red_by_their_code(plane):
    ax = zj.plot.map(plane, "joint_amplitude", "q", "mu")
    # cells of q = 2.5 and 3 at mu = 0.1: edges halfway between the coordinates
    hatches = set()
    for name, centre in (("escaped", [2.375, 0.1]), ("not finite", [3.0, 0.1])):
        centres, cells = layer(ax, name)
        np.testing.assert_allclose(centres, [centre])
        hatched = [c for c in ax.collections if c.get_hatch() == cells.get_hatch()]
        assert hatched == [cells] and cells.get_hatch()
        hatches.add(cells.get_hatch())
    assert len(hatches) == 2


def test_rest_has_a_colour_that_the_colour_map_lacks(plane):
    ax = zj.plot.map(plane, "joint_amplitude", "q", "mu")
    centres, cells = layer(ax, "stuck")
    np.testing.assert_allclose(centres, [[1.0, 0.1]])
    mesh = ax.collections[0]
    shades = mesh.get_cmap()(np.linspace(0, 1, 256))
    assert np.abs(shades - cells.get_facecolor()).max(axis=1).min() > 0.2
    assert mesh.get_array().mask[0, 0]  # no amplitude below it


def test_points_that_were_left_out_stay_blank(plane):
    ax = zj.plot.map(plane, "joint_amplitude", "q", "mu", colorbar=False, legend=False)
    ax.set_axis_off()
    figure = ax.figure
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[::-1]

    def pixel(q, mu):
        x, y = ax.transData.transform((q, mu)).astype(int)
        return tuple(pixels[y, x, :3])

    assert pixel(1.0, 0.4) == pixel(1.5, 0.4) == (255, 255, 255)
    assert pixel(2.5, 0.4) != (255, 255, 255)


def test_colours_are_the_points_own_numbers(plane):
    """Not interpolated: one cell a point, in the order of sorted axes."""
    shuffled = plane.isel(q=[2, 0, 3, 1])
    ax = zj.plot.map(shuffled, "joint_amplitude", "q", "mu")
    numbers = ax.collections[0].get_array()
    assert numbers.shape == (MU.size, Q.size)
    np.testing.assert_array_equal(numbers[1], [1, 4, 7, 10])
    np.testing.assert_array_equal(
        ax.collections[0].get_coordinates()[0, :, 0], [0.75, 1.25, 2.0, 2.75, 3.25]
    )


def test_labels_carry_symbols_and_units(plane):
    ax = zj.plot.map(plane, "joint_amplitude", "q", "mu")
    assert ax.get_xlabel() == "follower load, $q$ (–)"
    assert ax.get_ylabel() == r"rate, $\mu$ ($\sqrt{k/(m l^2)}$)"
    bar = ax.figure.axes[1]
    assert bar.get_ylabel() == "largest absolute angle of joint 2 (rad)"
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["stuck", "unsettled", "escaped", "not finite"]


def test_unsettled_cells_are_one_layer_and_their_kinds_a_map_of_their_own(plane):
    codes, kinds = np.full_like(CODES, RUN), np.full_like(CODES, zj.CODE.decided)
    for number, kind in enumerate(UNSETTLED[:6]):
        place = np.unravel_index(number, codes.shape)
        codes[place], kinds[place] = zj.CODE.unsettled, kind
    plane["outcome"] = (("q", "mu"), codes, FLAGS)
    plane["undecided"] = (("q", "mu"), kinds, flag_attributes(UNSETTLED))
    ax = zj.plot.map(plane, "joint_amplitude", "q", "mu")
    assert [cells.get_label() for cells in ax.collections[1:]] == ["unsettled"]
    assert len(layer(ax, "unsettled")[0]) == 6
    ax = zj.plot.map(plane, "undecided", "q", "mu")
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    words = "no passages", "unstable near", "slow", "aperiodic", "growing", "lasting"
    assert labels == [*words, "decided"]


def test_stuck_and_resting_cells_share_a_layer_that_names_both(plane):
    codes = CODES.copy()
    codes[1, 0] = zj.CODE.rest
    plane["outcome"] = (("q", "mu"), codes, FLAGS)
    ax = zj.plot.map(plane, "joint_amplitude", "q", "mu")
    centres, _ = layer(ax, "stuck or rest")
    np.testing.assert_allclose(centres, [[1.0, 0.1], [1.625, 0.1]])


def test_a_flag_variable_has_a_colour_a_code(plane):
    ax = zj.plot.map(plane, "outcome", "q", "mu")
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["not finite", "escaped", "unsettled", "stuck", "cycle"]
    mesh = ax.collections[0]
    colours = {tuple(mesh.get_cmap()(mesh.norm(code))) for code in np.unique(CODES)}
    assert len(colours) == np.unique(CODES).size
    stuck = mesh.get_cmap()(mesh.norm(int(zj.CODE.stuck)))
    assert stuck == to_rgba(REST_COLOUR)
    assert mesh.get_array().mask.sum() == (CODES == OUT).sum()


def test_some_codes_may_have_other_colours(plane):
    ax = zj.plot.map(plane, "outcome", "q", "mu", colours={RUN: "lime"})
    mesh, labels = ax.collections[0], ax.get_legend().get_texts()
    shown = {label.get_text() for label in labels}
    assert tuple(mesh.get_cmap()(mesh.norm(int(RUN)))) == (0, 1, 0, 1)
    assert tuple(mesh.get_cmap()(mesh.norm(8))) != (0, 1, 0, 1) and "stuck" in shown


def test_cells_of_a_logarithmic_axis_reach_halfway_as_it_is_seen(plane):
    _, ax = plt.subplots()
    ax.set_yscale("log")
    zj.plot.map(plane, "joint_amplitude", "q", "mu", ax=ax)
    edges = ax.collections[0].get_coordinates()[:, 0, 1]
    between = np.sqrt([0.1 * 0.2, 0.2 * 0.4])
    np.testing.assert_allclose(edges[1:3], between)
    np.testing.assert_allclose(edges[[0, 3]], [0.1 / np.sqrt(2), 0.4 * np.sqrt(2)])
    with pytest.raises(ValueError, match="`mu` must be positive .* reaches 0.0"):
        plane["mu"] = [0.0, 0.2, 0.4]
        zj.plot.map(plane, "joint_amplitude", "q", "mu", ax=ax)


def test_colours_belong_to_codes_and_colour_maps_to_numbers(plane):
    with pytest.raises(ValueError, match="`cmap` must not .* `outcome`, which holds c"):
        zj.plot.map(plane, "outcome", "q", "mu", cmap="viridis")
    with pytest.raises(ValueError, match="`colours` must not .* which holds numbers"):
        zj.plot.map(plane, "joint_amplitude", "q", "mu", colours={8: "lime"})
    assert not plt.get_fignums()


def test_a_diagram_marks_each_point_by_its_outcome(plane):
    ax = zj.plot.bifurcation_diagram(plane.sel(mu=0.1))
    lines = {line.get_label(): line for line in ax.lines}
    assert set(lines) == {"stuck", "unsettled", "escaped", "not finite"}
    np.testing.assert_array_equal(lines["unsettled"].get_xydata(), [[1.5, 3.0]])
    np.testing.assert_array_equal(lines["escaped"].get_xdata(), [2.5])
    np.testing.assert_array_equal(lines["not finite"].get_xdata(), [3.0])
    assert len({line.get_marker() for line in ax.lines}) == 4
    assert all(line.get_linestyle() == "None" for line in ax.lines)
    assert ax.get_ylabel().endswith("(rad)")


def test_a_diagram_of_both_ways_has_a_branch_between():
    q = np.array([1.0, 2.0, 3.0])
    both = xr.Dataset(
        {
            "joint_amplitude": (("branch", "q"), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),
            "outcome": (("branch", "q"), np.full((2, 3), int(RUN)), FLAGS),
        },
        {"branch": ["up", "down"], "q": q},
    )
    branch = xr.Dataset(
        {
            "joint_amplitude": ("point", [3.0, 2.0, 1.0, 2.0]),
            "parameter": ("point", [3.0, 2.0, 1.5, 1.8]),
            "stable": ("point", [True, True, False, False]),
        }
    )
    ax = zj.plot.bifurcation_diagram(both, branch=branch)
    lines = {line.get_label(): line for line in ax.lines}
    assert lines["up: cycle"].get_ydata().tolist() == [1.0, 2.0, 3.0]
    assert lines["down: cycle"].get_ydata().tolist() == [4.0, 5.0, 6.0]
    assert lines["up: cycle"].get_marker() == "^"
    assert lines["down: cycle"].get_marker() == "v"
    solid, dashed = lines["branch: attracts"], lines["branch: does not"]
    assert (solid.get_linestyle(), dashed.get_linestyle()) == ("-", "--")
    # a stretch has the look of the point at its beginning
    assert solid.get_ydata().tolist() == [3.0, 2.0, 1.0]
    assert dashed.get_ydata().tolist() == [1.0, 2.0]


def test_one_unstable_cycle_among_stable_ones_parts_the_line():
    q = np.arange(6.0)
    ds = xr.Dataset({"joint_amplitude": ("q", q)}, {"q": q})
    stable = [1.0, 1.0, 0.0, 1.0, 1.0, np.nan]
    values = [*q[:5], np.nan]
    branch = xr.Dataset(
        {
            "joint_amplitude": ("point", values),
            "parameter": ("point", values),
            "stable": ("point", stable),
        }
    )
    ax = zj.plot.bifurcation_diagram(ds, branch=branch)
    lines = {line.get_label(): line.get_ydata() for line in ax.lines}
    np.testing.assert_array_equal(
        lines["branch: attracts"], [0.0, 1.0, 2.0, np.nan, 3.0, 4.0]
    )
    np.testing.assert_array_equal(lines["branch: does not"], [2.0, 3.0])
    with pytest.raises(ValueError, match="`branch` must be the dataset"):
        zj.plot.bifurcation_diagram(ds, branch=3)


def test_the_boundaries_of_a_refined_map_are_lines_of_their_own(plane):
    lines = xr.Dataset(
        {
            "boundary_q": ("vertex", [1.0, 2.0, 2.5, 3.0]),
            "boundary_mu": ("vertex", [0.1, 0.2, 0.3, 0.4]),
            "boundary_line": ("vertex", [0, 0, 1, 1]),
        }
    )
    ax = zj.plot.map(plane.merge(lines), "joint_amplitude", "q", "mu")
    (line,) = ax.lines
    x, y = line.get_data()
    np.testing.assert_array_equal(x, [1.0, 2.0, np.nan, 2.5, 3.0])
    np.testing.assert_array_equal(y, [0.1, 0.2, np.nan, 0.3, 0.4])


def test_a_time_history_stands_beside_its_phase_plane():
    ts = np.linspace(0, 1, 5)
    phi, omega = np.stack([ts, 2 * ts], 1), np.stack([ts**2, -ts], 1)
    motion = zj.Trajectory(ts, phi, omega, 5, zj.CODE.complete)
    history, phase = zj.plot.time_history(motion)
    np.testing.assert_array_equal(history.lines[1].get_xydata().T, [ts, 2 * ts])
    np.testing.assert_array_equal(phase.lines[1].get_xydata().T, [2 * ts, -ts])
    assert [line.get_color() for line in history.lines] == ["navy", "red"]
    assert "sqrt{m l^2/k}" in history.get_xlabel() and "rad" in history.get_ylabel()
    assert history.get_title() == ""
    ended = zj.Trajectory(ts, phi, omega, 5, zj.CODE.budget_spent)
    assert "budget_spent" in zj.plot.time_history(ended)[0].get_title()


def test_a_time_history_has_as_many_lines_as_rods():
    ts = np.linspace(0, 1, 5)
    phi, omega = np.outer(ts, [1, 2, 3, 4]), np.outer(ts**2, [1, -1, 2, -2])
    motion = zj.Trajectory(ts, phi, omega, 5, zj.CODE.complete)
    history, phase = zj.plot.time_history(motion)
    for i in range(4):
        np.testing.assert_array_equal(history.lines[i].get_ydata(), phi[:, i])
        np.testing.assert_array_equal(
            phase.lines[i].get_xydata().T, [phi[:, i], omega[:, i]]
        )
    labels = [text.get_text() for text in history.get_legend().get_texts()]
    assert labels == [rf"$\varphi_{{{i}}}$" for i in (1, 2, 3, 4)]
    # above the lines
    assert history.get_ylim()[1] > 1.1 * phi.max()


def test_what_is_drawn_goes_where_it_was_asked_to(plane):
    axes = plt.subplots(1, 2)[1]
    assert zj.plot.map(plane, "joint_amplitude", "q", "mu", ax=axes[1]) is axes[1]
    assert zj.plot.bifurcation_diagram(plane.sel(mu=0.1), ax=axes[0]) is axes[0]
    assert len(plt.get_fignums()) == 1


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ("amplitude", "q", "mu"),
            "`variable` must be .*joint_amplitude.* 'amplitude'",
        ),
        (("outcome", "mu_s", "mu"), "`x` must be .* q, mu, but is 'mu_s'"),
        (("outcome", "q", "joint"), "`y` must be .* but is 'joint'"),
        (("outcome", "q", "q"), "`x` and `y` must differ"),
    ],
)
def test_a_map_refuses_what_the_dataset_lacks(plane, arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        zj.plot.map(plane, *arguments)
    assert not plt.get_fignums()  # and opens no figure before


def test_a_dimension_left_over_is_named(plane):
    with pytest.raises(ValueError, match=r"but has mu; choose with .*sel\(mu="):
        zj.plot.bifurcation_diagram(plane)


def test_one_motion_at_a_time():
    many = zj.Trajectory(np.zeros((2, 3)), np.zeros((2, 3, 2)), None, 1, 10)
    with pytest.raises(ValueError, match="`motion` must be one motion"):
        zj.plot.time_history(many)


def test_matplotlib_is_imported_only_when_used():
    code = (
        "import sys, ziegler_jax as zj; assert 'matplotlib' not in sys.modules; "
        "zj.plot.map; assert 'matplotlib' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
