"""Pictures of sweeps: what was computed, and nothing in between.

A cell of a map is one point, never interpolated. Points that were left out stay blank,
failed ones are hatched, and rest has a colour of its own. Axes take their names,
symbols and units from the dataset.
"""

from collections.abc import Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch
from matplotlib.typing import ColorType

from ..analysis.continuation import Branch
from ..analysis.hysteresis import UpDownSweep
from ..results import (
    CODE,
    OUTCOMES,
    AbstractResult,
    flag_attributes,
    unlike_meaning,
)
from .branches import branch_dataset, draw_branch, of_dims, select_last_joint
from .style import (
    AT_REST,
    BLUE,
    FADED,
    FAILED,
    FAILED_COLOUR,
    GREY,
    MARKERS,
    REST_COLOUR,
    UNSETTLED_HATCH,
    VERMILLION,
    code_colours,
    flags_of,
    in_lines,
    label_of,
)

Edges = tuple[np.ndarray, np.ndarray]  # of the cells, along x and y
Codes = np.ndarray  # of the cells


def map(
    dataset: xr.Dataset,
    variable: str,
    x: str,
    y: str,
    *,
    ax: Axes | None = None,
    colorbar: bool = True,
    legend: bool = True,
    colours: Mapping[int, ColorType] | None = None,
    **style: Any,
) -> Axes:
    """Colour the points of a plane by a variable, one cell a point.

    ```python
    zj.plot.map(ds.sel(joint=2, mu_k=0.1), "joint_amplitude", x="q", y="mu_s")
    ```

    Where the dataset has an `outcome`, stuck and resting points have one flat colour,
    unsettled ones are faded and dotted, and those without a number are hatched in red,
    each kind with its name: `escaped`, `budget spent`, ... A flag variable (`outcome`,
    `regime`, or `undecided`, of which kind an unsettled motion is) is drawn in one
    colour a code. The boundaries of a map from `refine` are drawn as lines over its
    coarse cells.

    **Arguments:**

    - `dataset`: from `sweep`, reduced to the plane: choose the rest with `sel`.
    - `variable`: what to colour by.
    - `x`, `y`: dimensions of the dataset. Cells reach halfway to their neighbours, on
        a logarithmic axis as it is seen there.
    - `ax`: where to draw, with the scales of its axes (`ax.set_yscale("log")`); None
        opens a figure.
    - `colorbar`, `legend`: whether to explain the colours and the outcomes.
    - `colours`: of a flag variable, other colours for some of its codes, e.g.
        `{zj.CODE.flutter: "orange"}`.
    - `style`: more for `pcolormesh`, of numbers e.g. `vmax`, `norm`, `cmap` (viridis).

    **Returns:** the axes.

    **Raises:** `ValueError` that names the argument, for a variable or dimension that
    the dataset does not have, for dimensions left over, for an unknown `style`, for
    values that a logarithmic axis does not have, and for colours of codes where there
    are none, or the reverse.
    """
    chosen = of_dims(dataset, variable, {"x": x, "y": y})
    flags = "flag_values" in chosen.attrs
    misplaced = {"cmap", "norm", "vmin", "vmax"} & set(style) if flags else colours
    if misplaced:
        name, kind = (
            (sorted(misplaced)[0], "codes") if flags else ("colours", "numbers")
        )
        raise ValueError(
            f"Argument `{name}` must not be given for `{variable}`, which holds "
            f"{kind}; their colours come from `{'colours' if flags else 'cmap'}`."
        )
    ax = plt.subplots(layout="constrained")[1] if ax is None else ax
    dataset = dataset.sortby([x, y])
    values = dataset[variable].transpose(y, x)
    edges = _edges(dataset, x, ax.xaxis), _edges(dataset, y, ax.yaxis)
    if flags:
        handles = _codes(ax, edges, values, colours or {}, **style)
    else:
        handles = []
        numbers = np.asarray(values, dtype=float)
        outcome = None
        if has_motions(dataset):
            outcome = np.asarray(dataset["outcome"].transpose(y, x))
            flat = np.isin(outcome, (CODE.not_computed, *AT_REST))
            numbers = np.where(flat, np.nan, numbers)
        mesh = _mesh(ax, edges, np.ma.masked_invalid(numbers), **style)
        if colorbar:
            figure = ax.get_figure(root=False)
            assert figure is not None
            figure.colorbar(mesh, ax=ax, label=in_lines(label_of(values)))
        if outcome is not None:
            handles = _outcomes(ax, edges, outcome)
    _boundaries(ax, dataset, x, y)
    ax.set(xlabel=in_lines(label_of(dataset[x])))
    ax.set(ylabel=in_lines(label_of(dataset[y])))
    if legend and handles:
        # beside the plane, not on its data; some codes have long names
        columns = 4 if all(len(str(h.get_label())) < 14 for h in handles) else 2
        ax.legend(handles=handles, loc=(0, 1.01), ncols=columns, frameon=False)
    return ax


def _boundaries(ax: Axes, dataset: xr.Dataset, x: str, y: str) -> None:
    """The lines that `refine` has found, if it has."""
    names = [f"boundary_{name}" for name in (x, y, "line")]
    if not all(name in dataset for name in names):
        return
    across, up, line = (np.asarray(dataset[name]) for name in names)
    gaps = np.flatnonzero(np.diff(line)) + 1  # NaN parts one line from the next
    ax.plot(
        np.insert(across, gaps, np.nan),
        np.insert(up, gaps, np.nan),
        color="black",
        linewidth=0.8,
    )


def bifurcation_diagram(
    dataset: xr.Dataset,
    variable: str = "joint_amplitude",
    along: str = "q",
    *,
    branch: xr.Dataset | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw a variable over one axis, each point marked by its outcome.

    ```python
    zj.plot.bifurcation_diagram(ds.sel(joint=2, mu_s=0.12, mu_k=0.1), along="q")
    ```

    Points are not joined: branches may jump. Those without a number are red marks on
    the axis, by their codes; points that were left out are not drawn. Of a
    `sweep_up_down` triangles point the way that the load went.

    **Arguments:**

    - `dataset`: reduced to one dimension, or to that and `branch`, the load's ways.
    - `variable`, `along`: what is drawn, over which dimension.
    - `branch`: of `continue_cycle`, reduced to its points, e.g.
        `branch.to_dataset().sel(joint=2)`: a line, solid where the cycle attracts and
        dashed where it does not.
    - `ax`: where to draw, None opens a figure.

    **Returns:** the axes.

    **Raises:** `ValueError` as `map`.
    """
    ways = [str(way) for way in dataset["branch"].values] if _goes_ways(dataset) else []
    parts = [dataset.sel(branch=way) for way in ways] or [dataset]
    values = [of_dims(part, variable, {"along": along}) for part in parts]
    ax = plt.subplots(layout="constrained")[1] if ax is None else ax
    if branch is not None:
        draw_branch(ax, branch, variable)
    for way, part, of_it in zip(ways or [""], parts, values, strict=True):
        places, numbers = np.asarray(dataset[along]), np.asarray(of_it, dtype=float)
        if has_motions(part):
            _motions(ax, places, numbers, np.asarray(part["outcome"]), way)
        else:
            ax.plot(places, numbers, "o", color=BLUE, markersize=3)
    if ax.get_legend_handles_labels()[0]:
        ax.legend()
    ax.set(xlabel=label_of(dataset[along]), ylabel=in_lines(label_of(values[0])))
    return ax


def up_down(
    motions: UpDownSweep | xr.Dataset,
    variable: str = "joint_amplitude",
    *,
    branch: Branch | xr.Dataset | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw a hysteresis: what the column settles to on the way up and on the way down.

    ```python
    zj.plot.up_down(both, branch=branch)
    ```

    Triangles point the way that the load went.

    **Arguments:**

    - `motions`: of `sweep_up_down`, or a dataset of it: of a sweep, reduced to one
        place by `sel`.
    - `variable`: what is drawn, of the last joint or rod where it has one a joint or
        rod and none was chosen.
    - `branch`: of `continue_cycle`: a line between, see `branch`.
    - `ax`: where to draw, None opens a figure.

    **Returns:** the axes.

    **Raises:** `ValueError` for what is no such result, and as `bifurcation_diagram`.
    """
    dataset = motions
    if isinstance(motions, AbstractResult):  # one in SI units, too
        dataset = motions.to_dataset()
    if not isinstance(dataset, xr.Dataset) or not _goes_ways(dataset):
        raise ValueError(
            "Argument `motions` must be of `sweep_up_down`, with the ways of the load "
            f"along `branch`, but is {type(motions).__name__}."
        )
    if branch is not None:
        branch = select_last_joint(branch_dataset(branch))
    dataset = select_last_joint(dataset)
    dims = [d for d in of_dims(dataset, variable).dims if d != "branch"]
    along = str(dims[0]) if dims else "branch"
    return bifurcation_diagram(dataset, variable, along, branch=branch, ax=ax)


WAYS = {"up": "^", "down": "v"}


def _goes_ways(dataset: xr.Dataset) -> bool:
    """Whether it is of a load that goes up and down."""
    known = isinstance(dataset, xr.Dataset) and "branch" in dataset.dims
    return known and all(str(way) in WAYS for way in dataset["branch"].values)


def _motions(
    ax: Axes, places: np.ndarray, numbers: np.ndarray, outcome: np.ndarray, way: str
) -> None:
    """Points by their outcome; `way`: the load's, if it has one."""
    before = f"{way}: " if way else ""
    for code, (marker, colour) in MARKERS.items():
        here = outcome == code
        if here.any():
            look = WAYS.get(way, marker)
            ax.plot(
                places[here],
                numbers[here],
                look,
                color=colour,
                markersize=5 if way else 3.5,
                markerfacecolor="none" if way else colour,
                label=before + code.name,
            )
    for code, (_, marker) in FAILED.items():
        here = outcome == code
        if here.any():
            ax.plot(
                places[here],
                np.zeros(here.sum()),
                marker,
                color=VERMILLION,
                transform=ax.get_xaxis_transform(),
                clip_on=False,
                label=before + _words(code),
            )


def has_motions(dataset: xr.Dataset) -> bool:
    """Whether `outcome` says how motions ended, not how a search did."""
    if "outcome" not in dataset:
        return False
    about = dataset["outcome"].attrs
    return unlike_meaning(about, {**about, **flag_attributes(OUTCOMES)}) is None


def _edges(dataset: xr.Dataset, dim: str, axis: Axis) -> np.ndarray:
    """Cell edges: halfway between neighbours, and as far beyond the first and last.

    Halfway as the axis shows it: the geometric mean where it is logarithmic.
    """
    shown = axis.get_transform()
    values = np.asarray(dataset[dim], dtype=float)
    if axis.get_scale() == "log" and values.min() <= 0:
        raise ValueError(
            f"Axis `{dim}` must be positive to be shown on a logarithmic axis, but "
            f"reaches {values.min()}."
        )
    centres = np.asarray(shown.transform(values))
    if centres.size == 1:
        return np.asarray(shown.inverted().transform(centres + np.array([-0.5, 0.5])))
    steps = np.diff(centres)
    if not np.all(steps > 0):
        raise ValueError(f"Axis `{dim}` must not repeat values, but does.")
    inner = centres[:-1] + steps / 2
    ends = centres[0] - steps[0] / 2, centres[-1] + steps[-1] / 2
    edges = np.concatenate([ends[:1], inner, ends[1:]])
    return np.asarray(shown.inverted().transform(edges))


def _words(code: CODE) -> str:
    return code.name.replace("_", " ")


def _outcomes(ax: Axes, edges: Edges, outcome: Codes) -> list[Patch]:
    """Cells that say how the motion ended; returns what a legend needs."""
    rest = " or ".join(code.name for code in AT_REST if (outcome == code).any())
    layers = (
        (rest, np.isin(outcome, AT_REST), REST_COLOUR, None, "none"),
        ("unsettled", outcome == CODE.unsettled, FADED, UNSETTLED_HATCH, "black"),
        *(
            (_words(code), outcome == code, FAILED_COLOUR, hatch, VERMILLION)
            for code, (hatch, _) in FAILED.items()
        ),
    )
    handles = []
    for name, here, face, hatch, line in layers:
        if not here.any():
            continue
        look = {"edgecolor": line, "hatch": hatch, "linewidth": 0, "label": name}
        # antialiased edges of neighbours would show through what is faded
        cells = PolyCollection(
            _rectangles(edges, here), facecolor=face, antialiased=False, **look
        )
        ax.add_collection(cells)
        handles.append(Patch(facecolor=GREY if face == FADED else face, **look))
    return handles


def _rectangles(edges: Edges, here: np.ndarray) -> list[np.ndarray]:
    """The corners of each of the cells `here` (y, x)."""
    row, column = np.nonzero(here)
    left, right = edges[0][column], edges[0][column + 1]
    low, high = edges[1][row], edges[1][row + 1]
    corners = [(left, low), (right, low), (right, high), (left, high)]
    return list(np.moveaxis(np.array(corners), -1, 0))


def _mesh(ax: Axes, edges: Edges, values: np.ndarray, **style: Any) -> QuadMesh:
    """Coloured cells.

    **Raises:** `ValueError` for a style that `pcolormesh` does not know.
    """
    try:
        mesh = ax.pcolormesh(*edges, values, **style)
    except (AttributeError, TypeError, ValueError) as error:
        if not style:
            raise
        raise ValueError(
            f"Arguments `{'`, `'.join(sorted(style))}` must be what Matplotlib's "
            f"`pcolormesh` takes, but it says: {error}"
        ) from error
    mesh.set_rasterized(True)
    return mesh


def _codes(
    ax: Axes,
    edges: Edges,
    values: xr.DataArray,
    colours: Mapping[int, ColorType],
    **style: Any,
) -> list[Patch]:
    """One colour a code of a CF flag variable, blank where nothing was computed."""
    codes = np.asarray(values)
    flags, names = flags_of(values)
    usual = dict(zip(flags, code_colours(names), strict=True))
    chosen: dict[int, ColorType] = {**usual, **colours}
    cmap = ListedColormap([chosen[flag] for flag in flags])
    norm = BoundaryNorm([*(f - 0.5 for f in flags), flags[-1] + 0.5], len(flags))
    shown = np.ma.masked_equal(codes, CODE.not_computed)
    _mesh(ax, edges, shown, cmap=cmap, norm=norm, **style)
    return [
        Patch(facecolor=cmap(norm(flag)), edgecolor=GREY, label=name.replace("_", " "))
        for flag, name in zip(flags, names, strict=True)
        if flag != CODE.not_computed and (codes == flag).any()
    ]
