"""A page of a map: it needs nothing beside it, and its motions are the cells' own."""

import base64
import io
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser

import diffrax as dfx
import jax.numpy as jnp
import matplotlib
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import Normalize
from PIL import Image
from scipy.interpolate import CubicHermiteSpline

import ziegler_jax as zj
from ziegler_jax.plot.cells import followed
from ziegler_jax.plot.page import TEMPLATE, thinned

Q, MU = np.linspace(1.6, 2.8, 4), np.geomspace(0.05, 0.4, 3)


def cell(q, mu):
    friction = zj.SmoothCoulomb(mu, pin_radius=0.1, v_smooth=0.05)
    return zj.uniform_rods(q, friction=friction), zj.State(omega=(0.0, 0.3))


def point(q, mu):
    windows = zj.Windows(transient=60.0, length=20.0, max_windows=10)
    return zj.settle(*cell(q, mu), windows=windows)  # not <b>bold</b> on the page


@pytest.fixture(scope="module")
def ds():
    ds = zj.sweep(point, q=Q, mu=MU, progress=False)
    ds.joint_amplitude[0, 0] = np.nan
    ds.outcome[0, 0] = zj.CODE.escaped
    ds.outcome[1, 1] = zj.CODE.not_computed
    return ds


class Reader(HTMLParser):
    """What a page refers to, what it holds, and its data."""

    def __init__(self, path):
        super().__init__()
        self.addresses, self.tags, self.text, self.data = [], [], "", ""
        self._in_data = False
        self.feed(path.read_text(encoding="utf-8"))
        self.json = json.loads(self.data, parse_constant=pytest.fail)

    def handle_starttag(self, tag, attrs):
        about = dict(attrs)
        self.tags.append(tag)
        names = ("src", "srcset", "href", "action", "poster", "data")
        self.addresses += [about[name] for name in names if name in about]
        self._in_data = about.get("id") == "data"

    def handle_endtag(self, tag):
        self._in_data = False

    def handle_data(self, data):
        self.data += data if self._in_data else ""
        self.text += "" if self._in_data else data


@pytest.fixture(scope="module")
def written(ds, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "map.html"
    cells = [(2.0, 0.05), (2.75, 0.35), (2.0, 0.04), (1.6, 0.05)]
    assert (
        zj.plot.page(ds, cell, path, x="q", y="mu", cells=cells, title="A & B") == path
    )
    return path, Reader(path)


def test_a_page_needs_nothing_beside_it(written):
    path, page = written
    assert page.addresses and all(a.startswith("data:image/") for a in page.addresses)
    assert not {"link", "iframe", "object", "embed"} & set(page.tags)
    code = TEMPLATE.read_text(encoding="utf-8")
    for word in ("http:", "https:", "//cdn", "url(", "@import", "fetch(", "import("):
        assert word not in code
    assert "default-src 'none'" in code  # a browser then asks for nothing, whatever
    assert "{{" not in path.read_text(encoding="utf-8")
    assert path.stat().st_size < 400_000  # measured 245 kB


def test_its_numbers_are_the_maps_and_what_is_none_is_null(ds, written):
    _, page = written
    x, y, fields = (page.json[name] for name in ("x", "y", "fields"))
    amplitude, outcome = fields[:2]
    np.testing.assert_allclose(x["values"], Q, rtol=5e-6)
    np.testing.assert_allclose(y["values"], MU, rtol=5e-6)
    assert amplitude["values"][0][0] is None
    shown = np.array(amplitude["values"], float)
    np.testing.assert_allclose(shown, ds.joint_amplitude.sel(joint=2).T, rtol=5e-5)
    np.testing.assert_array_equal(outcome["values"], ds.outcome.T)
    assert outcome["names"][str(outcome["values"][0][0])] == "escaped"


def test_its_motions_are_those_of_the_cells(ds, written):
    _, page = written
    places = [tuple(cell["at"]) for cell in page.json["cells"]]
    assert places == [(1, 0), (3, 2), (0, 0)]  # each to the nearest, each once
    for (i, j), shown in zip(places, page.json["cells"], strict=True):
        # as the map's, whose method the attributes name
        ts = np.linspace(0, min(200.0, float(ds.time[i, j])), 4001)
        method = zj.Method(dfx.Tsit5(), rtol=1e-6)
        motion = zj.trajectory(*cell(Q[i], MU[j]), ts, method=method)
        assert len(shown["ts"]) < 600  # of 4001, measured 20 to 295
        assert shown["ts"][-1] == motion.ts[-1]
        nodes = (np.array(shown[name]).T for name in ("phi", "omega"))
        cubic = CubicHermiteSpline(shown["ts"], *nodes)
        for ours, exact in ((cubic, motion.phi), (cubic.derivative(), motion.omega)):
            span = np.ptp(exact, axis=0).max()
            off = np.abs(ours(np.asarray(motion.ts)) - exact).max()
            assert off <= 2e-3 * span  # measured 1.998e-3


def test_a_thinned_motion_keeps_its_kinks_and_its_rest():
    """Slip that ends in rest: a rate that falls evenly to zero, and stays there."""
    ts = np.linspace(0, 100, 4001)
    left = np.maximum(0, 10.03 - ts)
    phi = np.stack([-(left**2), 0 * ts], axis=1)
    omega = np.stack([2 * left, 0 * ts], axis=1)
    phi[3500:], omega[3500:] = np.nan, np.nan  # it ended early
    t, angle, rate = thinned(ts, phi, omega)
    assert t.size < 20 and t[-1] == ts[3499]  # measured 11 of 3500
    cubic = CubicHermiteSpline(t, angle, rate)
    assert np.abs(cubic(ts[:3500]) - phi[:3500]).max() < 2e-3 * 10.03**2
    assert np.abs(cubic(ts[:3500], 1) - omega[:3500]).max() < 2e-3 * 20.06
    assert thinned(ts, phi * np.nan, omega)[0].size == 0


@pytest.mark.parametrize("name", [0, 1])
def test_a_circle_stands_on_its_cell(ds, written, name):
    """The picture has the cell's colour where the page puts it: on a log axis too."""
    _, page = written
    source = page.addresses[1 - name]
    data = base64.b64decode(source.removeprefix("data:image/png;base64,"))
    pixels = np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))
    left, top, width, height = page.json["frames"][("wide", "narrow")[name]]
    amplitude = ds.joint_amplitude.sel(joint=2)
    moves = ds.outcome == zj.CODE.cycle
    assert moves.sum() >= 3
    flat = np.isin(ds.outcome, (zj.CODE.not_computed, zj.CODE.stuck))
    norm = Normalize(*np.nanquantile(amplitude.where(~flat), [0, 1]))
    for i, j in zip(*np.nonzero(moves.values), strict=True):
        row = (top + height * (1 - page.json["y"]["at"][j])) * pixels.shape[0]
        column = (left + width * page.json["x"]["at"][i]) * pixels.shape[1]
        expected = matplotlib.colormaps["viridis"](norm(float(amplitude[i, j])))[:3]
        shown = pixels[int(row), int(column)] / 255
        np.testing.assert_allclose(shown, expected, atol=0.01)


def test_its_foot_says_where_the_numbers_come_from(ds, written):
    path, page = written
    assert "zj.settle(*cell(q, mu), windows=windows)" in page.text
    assert "not <b>bold</b>" in page.text and "b" not in page.tags[-20:]
    for name in ("rtol", "ziegler_jax_version", "jax_version", "scene_axes"):
        assert name in page.text and str(ds.attrs[name]) in page.text
    assert "A & B" in page.text and "<title>A &amp; B</title>" in path.read_text(
        "utf-8"
    )


def test_marks_are_spread_over_what_was_computed(ds, tmp_path):
    path = zj.plot.page(ds, cell, tmp_path / "a.html", x="q", y="mu", cells=12)
    places = [tuple(cell["at"]) for cell in Reader(path).json["cells"]]
    everywhere = {(i, j) for i in range(4) for j in range(3)}
    assert set(places) == everywhere - {(1, 1)} and len(places) == 11


UNITS = zj.SI(m=0.1, l=0.2, k=0.5)


def in_newtons(F, c):  # noqa: N803
    rods = {"m1": 0.1, "m2": 0.1, "l1": 0.2, "l2": 0.1}
    column = zj.uniform_rods(F, **rods, damping=zj.Viscous(c, c))
    return UNITS.scaled(column), zj.State(omega=(0.0, 0.3))


def angle(F, c):  # noqa: N803
    column, start = in_newtons(F, c)
    end = zj.trajectory(column, start, [0.0, 1.0])
    return {"angle": end.phi[1, 0], "time": zj.Variable(60.0, "time", zj.results.TIME)}


def test_a_store_in_si_units_makes_a_page(tmp_path):
    axes = {"F": [4.0, 6.5], "c": [0.0045, 0.009]}
    zj.sweep(angle, **axes, store=tmp_path / "s", progress=False)
    stored = UNITS.restore(zj.open_sweep(tmp_path / "s"))
    options = {"x": "F", "y": "c", "cells": [(6.5, 0.009)]}
    path = zj.plot.page(stored, in_newtons, tmp_path / "p.html", "angle", **options)
    (shown,) = Reader(path).json["cells"]
    at = np.array(shown["ts"])
    direct = zj.trajectory(*in_newtons(6.5, 0.009), at)
    # the time is that of the column's own units
    assert shown["lengths"] == [1.0, 0.5] and at[-1] == pytest.approx(60.0, rel=1e-12)
    # what is written is rounded, of 0.09: measured 5e-9
    np.testing.assert_allclose(np.array(shown["phi"]).T, direct.phi, rtol=0, atol=5e-8)


def test_the_method_is_the_one_that_the_map_names():
    from ziegler_jax.plot.cells import method_of

    for solver in (dfx.Tsit5(), dfx.Dopri8(), zj.Taylor(5), zj.Rosenbrock()):
        column = zj.uniform_rods(
            2.0, friction=zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.05)
        )
        if isinstance(solver, zj.Taylor):
            column = zj.uniform_rods(
                2.0, friction=zj.SetValuedCoulomb(0.1, pin_radius=0.1)
            )
        method = zj.Method(solver, rtol=1e-5, atol=1e-7)
        ran = zj.trajectory(column, zj.State(), [0.0, 0.1], method=method)
        assert method_of(ran.attributes()) == method
    # nothing is looked up by a name that is not of this list
    assert method_of({"solver": "AbstractERK", "rtol": "set at each point"}) == (
        zj.Method()
    )


def test_a_page_says_where_a_motion_ends_otherwise_than_its_cell(ds, tmp_path):
    told = ds.copy(deep=True)
    told.outcome[0, 0], told.time[0, 0] = zj.CODE.escaped, 50.0  # it does not
    moved = np.argwhere((ds.outcome == zj.CODE.cycle).values)[-1].tolist()
    rests = np.argwhere((ds.outcome == zj.CODE.stuck).values)[0].tolist()
    told["period"] = 0 * told.time + 2.0
    at = {tuple(place): 1.05 for place in (moved, rests)}
    for (i, j), factor in at.items():
        told.joint_amplitude[i, j] *= factor

    def cells(q, mu):  # one of these flies off where the map's does not
        column, start = cell(q, mu)
        kick = jnp.where((q > 2.7) & (mu < 0.06), 30.0, 0.3)
        return column, zj.State(omega=(0.0, kick))

    places = [(0, 0), tuple(moved), tuple(rests), (3, 0)]
    values = [(Q[i], MU[j]) for i, j in places]
    options = {"x": "q", "y": "mu", "cells": values}
    page = Reader(zj.plot.page(told, cells, tmp_path / "p.html", **options))
    notes = [shown["note"] for shown in page.json["cells"]]
    assert "cell is escaped, the motion shown is not" in notes[0]
    assert "joint 2" in notes[1] and "in the map" in notes[1]
    assert "joint 2" in notes[2] and "in the map" in notes[2]
    assert "joint 2" in notes[3] and "in the map" in notes[3]
    same = zj.plot.page(ds, cell, tmp_path / "s.html", **options)
    plain = [shown["note"] for shown in Reader(same).json["cells"]]
    assert not any("in the map" in note or "cell is" in note for note in plain[1:])
    told.attrs["rtol"] = told.attrs["atol"] = 1e-30  # which no step meets
    early = zj.plot.page(told, cell, tmp_path / "e.html", **options)
    notes = [shown["note"] for shown in Reader(early).json["cells"]]
    assert "ended early" in notes[1] and "the map's cell is cycle" in notes[1]


@pytest.mark.parametrize("name", ["smoothed", "dry"])
def test_it_says_so_of_what_was_judged_by_windows(name):
    """Of `repeats`, and of rest, whose amplitude is not the last state's."""

    def cell(q, kick=0.3):
        friction = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.05)
        if name == "dry":
            friction = zj.SetValuedCoulomb(0.1, pin_radius=0.1)
        return zj.uniform_rods(q, friction=friction), zj.State(omega=(0.0, kick))

    def point(q):
        windows = zj.Windows(transient=10.0, length=20.0, max_windows=9)
        return zj.settle(*cell(q), windows=windows, certify=False)

    ds = zj.sweep(point, q=[1.0, 2.2], progress=False)
    assert ds.outcome.values.tolist() == [zj.CODE.stuck, zj.CODE.repeats]
    for place in range(2):
        assert followed(ds, cell, {"q": place}).note == ""
        other = followed(ds, lambda q: cell(q, 1e-3), {"q": place})
        assert "joint 1 is" in other.note and "in the map" in other.note


def test_a_map_of_three_rods_makes_a_page(tmp_path):
    """Its rods, their forces and what the pointer reads, of the last joint."""

    def cell(q):
        damping, forces = zj.Viscous(0.1, 0.1, 0.1), zj.FollowerForces((0.5, 0, 1))
        chain = zj.Chain(q, lengths=(1, 0.5, 2), damping=damping, forces=forces)
        return chain, zj.State(omega=(0.0, 0.0, 0.3))

    def point(q, w):
        ts = np.linspace(0.0, 5.0, 11)
        end = zj.trajectory(*cell(q), ts).phi[-1]
        return {"angle": zj.Variable(w * end, "end", "rad", ("rod",))}

    ds = zj.sweep(point, q=[0.5, 1.0], w=[1.0, 2.0], progress=False)
    options = {"x": "q", "y": "w", "cells": [(1.0, 2.0)]}
    path = zj.plot.page(ds, cell, tmp_path / "p.html", "angle", **options)
    page = Reader(path)
    (shown,), (field,) = page.json["cells"], page.json["fields"]
    assert shown["lengths"] == [1.0, 0.5, 2.0]
    assert shown["forces"] == [[0, 1.0, 1.0, 0.5], [2, 1.0, 1.0, 1.0]]
    assert len(shown["phi"]) == len(shown["omega"]) == len(page.json["colours"]) == 3
    motion = zj.trajectory(*cell(1.0), np.array(shown["ts"]))
    # what is written is rounded, of 1.5: measured 5e-8
    np.testing.assert_allclose(np.array(shown["phi"]).T, motion.phi, atol=5e-7)
    read = [[ds.angle.sel(q=q, w=w, rod=3) for q in ds.q] for w in ds.w]
    np.testing.assert_allclose(field["values"], read, rtol=1e-4)
    assert all(f"rod {i}</b>" in path.read_text("utf-8") for i in (1, 2, 3))


def test_what_makes_no_page_is_refused(ds, refuses, tmp_path):
    path = tmp_path / "p.html"

    def page(dataset=ds, path=path, **options):
        axes = {"x": "q", "y": "mu", "cell": cell}
        return lambda: zj.plot.page(dataset, path=path, **{**axes, **options})

    refuses(page(path=tmp_path / "p.pdf"), "`path`", ".html", "p.pdf")
    refuses(page(cells=[(9.0, 0.1)]), "`q`", "1.6 to 2.8", "9")
    refuses(page(cells=[(2.0, 0.1, 0.1)]), "`cells`", "pairs", "`q` and `mu`")
    refuses(page(cells=[]), "`cells`", "1 to 400", "0")
    refuses(page(cells=401), "`cells`", "1 to 400", "401")
    refuses(page(cells=0), "`cells`", "at least 1", "0")
    refuses(page(cells=1.5), "`cells`", "how many", "1.5")
    refuses(page(cells="all"), "`cells`", "pairs", "'all'")
    refuses(page(cells=[("a", "b")]), "`cells`", "pairs", "'a'")
    refuses(page(title=3), "`title`", "3")
    refuses(page(path=3), "`path`", "3")
    refuses(page(path=tmp_path / "not" / "p.html"), "`path`", "folder")
    refuses(page(ds.isel(q=slice(0))), "`dataset`", "empty")
    refuses(page(xr.Dataset(attrs=ds.attrs)), "`dataset`", "empty")
    refuses(page(shine=True), "`shine`", "pcolormesh")
    left_out = ds.assign(outcome=0 * ds.outcome)
    left_out.outcome.attrs = ds.outcome.attrs
    refuses(page(left_out, cells=3), "`cells`", "computed")
    refuses(page(cell=3), "`cell`", "column and a start", "3")
    refuses(page(cell=lambda q, tau: None), "`cell`", "`tau`", "`q`, `mu`")
    refuses(page(cell=lambda q: q), "`cell`", "return column, start")
    refuses(page(variable="steps", y="w"), "`y`", "'w'")
    refuses(page(dataset=3), "`dataset`", "3")
    assert not path.exists()


BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-headless-shell", "chrome"))),
    None,
)


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here to click in")
def test_a_click_shows_the_cell_in_a_browser(written, tmp_path):
    """Beside a circle, a circle itself, and by key; the page says what it shows."""
    path, page = written
    clicks = """<script>
      const said = [], note = () => said.push($("name").textContent);
      addEventListener("error", event => said.push(event.message));
      const beside = () => {  // a page that was scrolled has other places
        const box = plane.getBoundingClientRect(), [u, v] = spot(data.cells[1]);
        return {clientX: box.left + (u - 0.1) * box.width,
          clientY: box.bottom - (v - 0.1) * box.height, bubbles: true};
      };
      plane.dispatchEvent(new MouseEvent("click", beside())); note();
      buttons[0].click(); note();
      plane.dispatchEvent(new KeyboardEvent("keydown", {key: "ArrowLeft"})); note();
      plane.dispatchEvent(new PointerEvent("pointermove", beside()));
      said.push($("reading").textContent);
      document.title = said.join(" | ");
    </script></body>"""
    clicked = tmp_path / "clicked.html"
    clicked.write_text(path.read_text("utf-8").replace("</body>", clicks), "utf-8")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"]
    home = f"--user-data-dir={tmp_path / 'home'}"
    run = [BROWSER, *options, home, clicked.as_uri()]
    done = subprocess.run(run, capture_output=True, text=True, timeout=120)
    title = re.search("<title>(.*?)</title>", done.stdout)[1]
    said = title.split(" | ")
    assert said[:3] == ["q = 2.8, mu = 0.4", "q = 2, mu = 0.05", "q = 1.6, mu = 0.05"]
    assert said[3].startswith("q = 2.8, mu = 0.4: joint_amplitude ")
