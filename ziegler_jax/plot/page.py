"""A map as one HTML file, which shows the motion of a cell that is clicked on."""

import base64
import html
import io
import json
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from ..motion.trajectory import Trajectory
from ..numerics.hermite import HermiteQuartic
from ..numerics.rules import instance, whole_number
from ..results import CODE
from .branches import of_dims, select_last_joint
from .cells import Cell, followed, nearest
from .maps import has_motions
from .maps import map as draw_map
from .rods import ARROW, drawn_of
from .style import VERMILLION, flags_of, meaning_of, rod_colours

TEMPLATE = Path(__file__).with_name("page.html")
CELLS, MOST_CELLS = 20, 400
NEAR = 2e-3  # how far thinned motions may be off, of their range
DPI = 200
SPEED = 2.0  # of the moving column: time units a second
# inches of the picture, and its letters, on wide and on narrow screens
PICTURES = {"wide": ((7.2, 5.4), 10.0), "narrow": ((4.2, 4.4), 9.0)}
LEFT_OUT = (CODE.not_computed, CODE.invalid)

Json = dict[str, Any]
Place = tuple[int, int]  # of a cell, along x and along y


def page(
    dataset: xr.Dataset,
    cell: Cell,
    path: str | os.PathLike,
    variable: str = "joint_amplitude",
    *,
    x: str,
    y: str,
    cells: int | Sequence[tuple[float, float]] = CELLS,
    title: str | None = None,
    **style: Any,
) -> Path:
    r"""Write a map as one HTML file: a click on a marked cell shows its motion.

    ```python
    def cell(q, mu):
        friction = zj.SmoothCoulomb(mu, pin_radius=0.1, v_smooth=0.05)
        return zj.uniform_rods(q, friction=friction), zj.State(omega=(0.0, 0.3))

    def point(q, mu):
        return zj.settle(*cell(q, mu))

    ds = zj.sweep(point, q=[2.0, 2.6], mu=[0.1, 0.2])
    zj.plot.page(ds, cell, "map.html", x="q", y="mu", cells=[(2.6, 0.1)])
    ```

    The file needs no server, no network and nothing beside it. It holds the map as
    `map` draws it; the numbers and outcomes of all cells, which the pointer reads; of
    each marked cell the time history, the phase plane and the moving column; and at its
    foot the dataset's attributes: the scene's source, tolerances, versions. Circles are
    reached by keys as well. An axis whose values are evenly spaced in their logarithms,
    and not in themselves, is logarithmic.

    A motion is a `trajectory` of 4001 times with the solver and the tolerances that
    stand in the dataset's attributes, to the time at which the cell's own motion ended,
    at most to 200 (100 where the dataset does not know it). Where it ends otherwise
    than its cell, the page says so: in another outcome, or (of a cycle over its last
    period, of rest in its last state) with an amplitude that differs by over 1 %. Only
    some states are written: the cubics in time through their angles and rates are
    within 0.2 % of all, of the range of the angles and of that of the rates. Of a map
    of 41 by 20 cells with 20 marked ones the page takes 0.6 MB and 8 s to write, with
    400 of them 3.7 MB and 100 s; each cell of the map takes some 10 bytes, each marked
    one some 8 kB.

    **Arguments:**

    - `dataset`, `variable`, `x`, `y`, `style`: as `map`; of the last joint or rod where
        the variable has one a joint or rod and none was chosen. A stored map comes from
        `zj.open_sweep`.
    - `cell`: the scene of a cell, `cell(q, mu, ...) -> column, start`: it is called
        with those coordinates of the dataset that its parameters name.
    - `path`: a file that ends in `.html`; one that is there is replaced.
    - `cells`: the marked ones by their values `(x, y)`, each to the nearest, at most
        400; or about how many are spread over the map, of those that were computed.
    - `title`: the page's heading; None names the variable and the axes.

    **Returns:** the path.

    **Raises:** `ValueError` as `map` and `trajectory`, for a `cell` that is not the
    map's, cells beside the map or too many, and for a file of another kind or in a
    folder that is not there.
    """
    path = _file(path)
    if title is not None:
        instance("title", title, str)
    instance("dataset", dataset, xr.Dataset)
    dataset = select_last_joint(dataset)
    values = of_dims(dataset, variable, {"x": x, "y": y})
    dataset = dataset.sortby([x, y])
    places = _places(dataset, x, y, cells)
    motions = [_motion(dataset, cell, x, y, place) for place in places]
    pictures = {n: _picture(dataset, variable, x, y, n, style) for n in PICTURES}
    fields = [_field(dataset, name, x, y) for name in _read(dataset, variable, x, y)]
    counts = {motion.phi.shape[1] for _, motion in motions}
    if len(counts) > 1:
        raise ValueError(
            "Argument `cells` must give columns of one number of rods, but gives some "
            f"of {' and '.join(map(str, sorted(counts)))}."
        )
    wide, (rods,) = pictures["wide"], counts
    data = {
        "x": _axis(dataset, x, wide.across),
        "y": _axis(dataset, y, wide.up),
        "fields": fields,
        "frames": {name: picture.frame for name, picture in pictures.items()},
        "cells": [about for about, _ in motions],
        "first": len(motions) // 2,
        "speed": SPEED,
        "units": {"time": "√(m l²/k)", "rate": "√(k/(m l²))"},
        "colours": [to_hex(colour) for colour in rod_colours(rods)],
        "load": VERMILLION,
    }
    shape = f"{dataset.sizes[x]} by {dataset.sizes[y]} cells"
    title = title or f"{meaning_of(values)} over {x} and {y}"
    parts = {
        "title": html.escape(title),
        "alt": html.escape(f"Map: {title}, {shape}"),
        **{name: picture.source for name, picture in pictures.items()},
        "key": _key(data["colours"]),
        "chosen": VERMILLION,
        "arrow": str(ARROW),
        "foot": _foot(dataset, motions[0][1]),
        # an end of the script's tag must not stand in it
        "data": _json(data).replace("<", "\\u003c"),
    }
    template = TEMPLATE.read_text(encoding="utf-8")
    text = re.sub(r"\{\{(\w+)\}\}", lambda name: parts[name[1]], template)
    path.write_text(text, encoding="utf-8")
    return path


class Picture(NamedTuple):
    """A map's picture as a page shows it."""

    source: str  # as an address that holds it
    frame: list[float]  # its plane's left, top, width and height, shares of its own
    across: np.ndarray  # where the cells' centres are along x, shares of the plane
    up: np.ndarray


def _file(path: str | os.PathLike) -> Path:
    """Where the page goes.

    **Raises:** `ValueError`.
    """
    try:
        file = Path(path)
    except TypeError:
        raise ValueError(f"Argument `path` must be a path, but is {path!r}.") from None
    if file.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"Argument `path` must end in .html, but is {str(file)!r}.")
    if not file.parent.is_dir():
        raise ValueError(
            f"Argument `path` must lie in a folder that is there, but is {str(file)!r}."
        )
    return file


def _key(colours: Sequence[str]) -> str:
    """The rods' colours, for the page's legend."""
    wide = np.linspace(4, 2, len(colours)).round(1).tolist()
    return " ".join(
        f'<b style="color: {colour}; --wide: {w}px">&phi;<sub>{i}</sub>, rod {i}</b>'
        for i, (colour, w) in enumerate(zip(colours, wide, strict=True), 1)
    )


def _picture(
    dataset: xr.Dataset, variable: str, x: str, y: str, name: str, style: Json
) -> Picture:
    """The map, drawn as large as it is shown."""
    size, letters = PICTURES[name]
    small = 0.8 * letters
    with matplotlib.rc_context(
        {"font.size": letters, "legend.fontsize": small, "savefig.bbox": "standard"}
    ):
        figure = Figure(size, dpi=DPI, layout="constrained")
        ax = figure.subplots()
        ax.set(xscale=_scale(dataset[x]), yscale=_scale(dataset[y]))
        draw_map(dataset, variable, x, y, ax=ax, **style)
        file = io.BytesIO()
        figure.savefig(file, format="png", dpi=DPI)
    plane = ax.get_position()
    frame = [plane.x0, 1 - plane.y1, plane.width, plane.height]
    share = ax.transData - ax.transAxes
    xs, ys = (np.asarray(dataset[dim], float) for dim in (x, y))
    across = share.transform(np.stack([xs, np.full_like(xs, ys[0])], axis=-1))
    up = share.transform(np.stack([np.full_like(ys, xs[0]), ys], axis=-1))
    source = "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()
    return Picture(source, [round(s, 5) for s in frame], across[:, 0], up[:, 1])


def _scale(axis: xr.DataArray) -> str:
    """Logarithmic for values that are evenly spaced so, and not in themselves."""
    values = np.asarray(axis, float)
    if values.size < 3 or values.min() <= 0:
        return "linear"
    steps = np.diff(values), np.diff(np.log(values))
    even = [np.ptp(s) < 1e-6 * abs(s.mean()) for s in steps]
    return "log" if even == [False, True] else "linear"


def _places(
    dataset: xr.Dataset, x: str, y: str, cells: int | Sequence[tuple[float, float]]
) -> list[Place]:
    """The marked cells, each once.

    **Raises:** `ValueError`.
    """
    if isinstance(cells, int | np.integer):
        number = whole_number("cells", cells)
        places = _spread(dataset, x, y, number) if number <= MOST_CELLS else []
    else:
        if not isinstance(cells, Iterable) or isinstance(cells, str):
            raise ValueError(
                "Argument `cells` must be how many cells are marked, or pairs of "
                f"values of `{x}` and `{y}`, but is {cells!r}."
            )
        pairs = [np.ravel(pair) for pair in cells]
        for pair in pairs:
            if pair.size != 2 or pair.dtype.kind not in "iuf":
                raise ValueError(
                    "Argument `cells` must hold pairs of values of "
                    f"`{x}` and `{y}`, but has {pair.tolist()}."
                )
        places = [(nearest(dataset, x, a), nearest(dataset, y, b)) for a, b in pairs]
        places = [*dict.fromkeys(places)]
        number = len(places)
    if not 1 <= number <= MOST_CELLS:
        raise ValueError(
            f"Argument `cells` must name 1 to {MOST_CELLS} cells, but names {number}."
        )
    if not places:
        raise ValueError(
            "Argument `cells` must name cells that were computed, but of those spread "
            "over the map none was."
        )
    return places


def _spread(dataset: xr.Dataset, x: str, y: str, count: int) -> list[Place]:
    """About so many cells, evenly over the map, but for those not computed."""
    nx, ny = dataset.sizes[x], dataset.sizes[y]
    rows = min(ny, max(1, math.isqrt(count)))
    columns = min(nx, count // rows)
    rows = min(ny, count // columns)
    across = ((np.arange(columns) + 0.5) * nx / columns).astype(int).tolist()
    up = ((np.arange(rows) + 0.5) * ny / rows).astype(int).tolist()
    places = [(i, j) for j in up for i in across]
    if not has_motions(dataset) or {*dataset["outcome"].dims} != {x, y}:
        return places
    codes = np.asarray(dataset["outcome"].transpose(x, y))
    return [place for place in places if codes[place] not in LEFT_OUT]


def _motion(
    dataset: xr.Dataset, cell: Cell, x: str, y: str, place: Place
) -> tuple[Json, Trajectory]:
    """The motion of a cell as the page has it, and as it was computed."""
    column, moved, note = followed(dataset, cell, dict(zip((x, y), place, strict=True)))
    written = thinned(*(np.asarray(a) for a in (moved.ts, moved.phi, moved.omega)))
    ts, phi, omega = (a.T.tolist() for a in written)
    lengths, forces = drawn_of(column)
    about = {"at": place, "note": note, "lengths": lengths, "forces": forces}
    return {**about, "ts": ts, "phi": phi, "omega": omega}, moved


def thinned(
    ts: np.ndarray, phi: np.ndarray, omega: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r"""Some of a motion's states, whose cubics pass near all the others.

    **Arguments:** times (n,), angles and rates (n, rods); states that are NaN are left
    out.

    **Returns:** the same of fewer states. The cubics that have their angles and rates
    are within `NEAR` of the ranges of angles and rates at all n times.
    """
    there = np.isfinite(phi).all(axis=1)
    ts, phi, omega = ts[there], phi[there], omega[there]
    if ts.size < 2:
        return ts, phi, omega
    near = [max(NEAR * np.ptp(a, axis=0).max(), 1e-12) for a in (phi, omega)]
    # rounded before they are compared: rounding is part of the error
    digits = [4 - math.floor(math.log10(d)) for d in near]
    nodes = phi.round(digits[0]), omega.round(digits[1])

    def passes(i: int, j: int) -> bool:
        h, inner = ts[j] - ts[i], slice(i + 1, j)
        s = ((ts[inner] - ts[i]) / h)[:, None]
        (a, b), (va, vb) = nodes[0][[i, j]], h * nodes[1][[i, j]]
        cubic = HermiteQuartic(a, b, va, vb, 0.0)  # of all rods at once
        off = np.abs(cubic(s) - phi[inner]), np.abs(cubic.slope(s) / h - omega[inner])
        return bool((off[0] <= near[0]).all() and (off[1] <= near[1]).all())

    chosen, length = [0], ts.size
    while (i := chosen[-1]) < ts.size - 1:
        length = min(2 * length, ts.size - 1 - i)
        while length > 1 and not passes(i, i + length):
            length = length * 3 // 4
        chosen.append(i + length)
    return ts[chosen], nodes[0][chosen], nodes[1][chosen]


def _read(dataset: xr.Dataset, variable: str, x: str, y: str) -> list[str]:
    """What the pointer reads of a cell: the variable, and how its motion ended."""
    codes = [
        name
        for name in ("outcome", "undecided")
        if name in dataset and {*dataset[name].dims} == {x, y}
    ]
    return [*dict.fromkeys([variable, *codes])]


def _field(dataset: xr.Dataset, name: str, x: str, y: str) -> Json:
    """The numbers or codes of all cells, row by row."""
    values = dataset[name].transpose(y, x)
    units = str(values.attrs.get("units", "1"))
    field: Json = {"name": name, "units": "" if units == "1" else f" {units}"}
    if "flag_values" in values.attrs:
        codes, names = flags_of(values)
        words = [name.replace("_", " ") for name in names]
        field["names"] = dict(zip(map(str, codes), words, strict=True))
        if name == "undecided":
            field["silent"] = [int(CODE.not_computed), int(CODE.decided)]
    rows = np.asarray(values, float).tolist()
    return {**field, "values": [[_number(v, 5) for v in row] for row in rows]}


def _axis(dataset: xr.Dataset, dim: str, places: np.ndarray) -> Json:
    """An axis: its values, and where they are along the plane."""
    values = [_number(v, 6) for v in np.asarray(dataset[dim], float).tolist()]
    return {"name": dim, "values": values, "at": places.round(5).tolist()}


def _number(value: float, digits: int) -> float | None:
    """A number of so many digits; what is none is null, as JSON has it."""
    if not math.isfinite(value):
        return None
    short = float(f"{value:.{digits}g}")
    return int(short) if short.is_integer() else short


def _json(data: object) -> str:
    return json.dumps(data, allow_nan=False, separators=(",", ":"), ensure_ascii=False)


def _foot(dataset: xr.Dataset, moved: Trajectory) -> str:
    """Where the numbers come from: the scene's source, tolerances, versions."""
    about = {str(name): value for name, value in dataset.attrs.items()}
    source = html.escape(str(about.pop("scene", "")))
    how = ", ".join(f"{name} {value}" for name, value in moved.attributes().items())
    return (
        f"<p>The motions shown were computed for this page by trajectory: "
        f"{html.escape(how)}. Of their {moved.phi.shape[0]} states some are written; "
        f"the cubics between are within {NEAR:.1%} of the range of angles and rates "
        f"at all.</p>\n"
        f"<details open><summary>The scene</summary><pre>{source}</pre></details>\n"
        f"<details><summary>How the map was computed</summary>{_list(about)}</details>"
    )


def _list(named: Mapping[str, object]) -> str:
    rows = (
        f"<dt>{html.escape(name)}</dt><dd>{html.escape(str(value))}</dd>"
        for name, value in named.items()
    )
    return f"<dl>{''.join(rows)}</dl>"
