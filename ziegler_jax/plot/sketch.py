"""A sketch of a column: what its symbols stand for."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch, Wedge
from matplotlib.path import Path

from ..model.chain_of_rods import AbstractChain, check_column
from ..model.column import Column
from ..model.state import State
from ..motion.checks import check_scene
from .rods import DrawnChain, drawn_of
from .style import GREEN, VERMILLION, rod_colours

POSTURE = (0.42, 0.95)  # of the first and last rod, where none is given, in rad
BROWN = "#8A7650"  # of friction
# of the shortest rod: radii of the pin's friction and of the spring's first and last
# turn, the radius of an angle, a kick's arrow
FRICTION, SPRING, ARC, KICK = (0.05, 0.09), (0.11, 0.23), 0.5, 0.36
TURNS = 2.0  # of a spring
SMALLEST = 0.02  # of angles that have an arc, in rad


def sketch(
    column: AbstractChain,
    state: State | None = None,
    *,
    labels: bool = True,
    ax: Axes | None = None,
) -> Axes:
    r"""Draw a column with its springs, friction, angles, follower forces and kick.

    ```python
    zj.plot.sketch(zj.uniform_rods(2.0), zj.State((0.3, 0.7), (0.0, 0.5)))
    ```

    The pivot stands on hatched ground at (0, 0); joint i + 1, or the tip, is at
    $\sum_{j \le i} l_j (-\sin\phi_j, \cos\phi_j)$, in the unit of the rods' lengths.
    Angles are counted from the dashed vertical, anticlockwise. Spirals are the
    springs, brown rings the friction of the pins, where the column has any. Red arrows
    are the follower forces, as a positive load has them: they push onto the rod and
    turn with it, by the follower fraction $\eta$. Fixed forces and those of your own
    are not drawn. Green arrows are the rates of rods that have one.

    **Arguments:**

    - `column`: a `Column` or a `Chain` in its own units.
    - `state`: angles (rad) and rates, one a rod; None chooses angles that are easy
        to read, and no rates.
    - `labels`: whether to name lengths, angles, springs, friction, load and rates.
    - `ax`: where to draw, None opens a figure.

    **Returns:** the axes.

    **Raises:** `ValueError` for what is no column or chain, a column in SI units, and a
    state of another number of rods.
    """
    check_column(column)
    if state is None:
        state = State(tuple(np.linspace(*POSTURE, column.joints).tolist()))
    check_scene(column, state, "state")
    if ax is None:
        ax = plt.subplots(figsize=(4, 4), layout="constrained")[1]
    phi, omega = np.asarray(state.phi, float), np.asarray(state.omega, float)
    chain = DrawnChain(ax, drawn_of(column))
    chain.show(phi)
    chain.joints.set_zorder(5)
    places, size = chain.places(phi), float(chain.lengths.min())
    _ground(ax, size)
    for joint, base in enumerate(places[:-1]):
        before = phi[joint - 1] if joint else 0.0
        _spring(ax, base, size, before, phi[joint])
        if column.friction is not None:
            _ring(ax, base, size)
        _angle(ax, base, phi[joint], size, _index(r"\varphi", joint) if labels else "")
    for rod, rate in enumerate(omega):
        if rate:
            name = _index(r"\dot\varphi", rod) if labels else ""
            _rate(ax, places[rod : rod + 2], phi[rod], rate, size, name)
    if labels:
        _name_parts(ax, column, chain, phi)
    _frame(ax, chain, places, size)
    return ax


def _up(angle: float | np.ndarray) -> np.ndarray:
    """The direction of a rod at this angle."""
    return np.stack([-np.sin(angle), np.cos(angle)], axis=-1)


def _index(symbol: str, part: int) -> str:
    return rf"${symbol}_{{{part + 1}}}$"


def _ground(ax: Axes, size: float) -> None:
    """The pivot's support, and the ground below it."""
    low, wide = -0.26 * size, 0.17 * size
    ax.fill([0, -wide, wide], [0, low, low], fc="white", ec="black", lw=1.2, zorder=1)
    ax.plot([-2.6 * wide, 2.6 * wide], [low, low], color="black", lw=1.2, zorder=1)
    for left in np.linspace(-2.6, 2.2, 13) * wide:
        ends = [left, left + 0.4 * wide], [low - 0.5 * wide, low]
        ax.plot(*ends, color="black", lw=0.7, zorder=1)


def _spring(
    ax: Axes, base: np.ndarray, size: float, before: float, angle: float
) -> None:
    """A spiral from the part below a joint to the rod above it."""
    turn = np.linspace(before - 2 * np.pi * TURNS + np.pi / 2, angle, 200)
    radius = np.linspace(*SPRING, turn.size)[:, None] * size
    ax.plot(*(base + radius * _up(turn)).T, color="black", lw=1.1, zorder=3)


def _ring(ax: Axes, base: np.ndarray, size: float) -> None:
    """The friction of a pin."""
    inner, outer = (radius * size for radius in FRICTION)
    look = {"facecolor": BROWN, "edgecolor": "none", "zorder": 4}
    ax.add_patch(Wedge(tuple(base), outer, 0, 360, width=outer - inner, **look))


def _arrow(ax: Axes, points: np.ndarray, colour: str, wide: float) -> None:
    """An arrow along these points (n, 2)."""
    look = {"arrowstyle": "-|>", "mutation_scale": 6 + 4 * wide, "lw": wide}
    look |= {"color": colour, "shrinkA": 0, "shrinkB": 0, "zorder": 3}
    ax.add_patch(FancyArrowPatch(path=Path(points), **look))


def _angle(ax: Axes, base: np.ndarray, phi: float, size: float, name: str) -> None:
    """An angle from the dashed vertical to a rod."""
    top = base + [0, (ARC + 0.16) * size]
    line = np.transpose([base, top])
    ax.plot(*line, color="0.45", lw=0.9, ls=(0, (5, 3)), zorder=1)
    if abs(phi) > SMALLEST:
        _arrow(ax, base + ARC * size * _up(np.linspace(0, phi, 50)), "black", 0.9)
    if name:
        _text(ax, base + (ARC + 0.12) * size * _up(phi / 2), name)


def _rate(
    ax: Axes, ends: np.ndarray, phi: float, rate: float, size: float, name: str
) -> None:
    """A rod's rate, across it: the way that its end goes."""
    across = np.sign(rate) * _up(phi + np.pi / 2)
    begin = ends[0] + 0.82 * (ends[1] - ends[0]) + 0.05 * size * across
    end = begin + KICK * size * across
    _arrow(ax, np.array([begin, end]), GREEN, 2.2)
    if name:
        _text(ax, end + 0.13 * size * across, name, GREEN)


def _text(
    ax: Axes, at: np.ndarray, text: str, colour: str = "black", side: str = "center"
) -> None:
    """A name whose middle, or side, is there."""
    ax.text(float(at[0]), float(at[1]), text, color=colour, ha=side, va="center")


def _name_parts(
    ax: Axes, column: AbstractChain, chain: DrawnChain, phi: np.ndarray
) -> None:
    """Lengths, springs, friction and follower forces by their symbols."""
    size, places = float(chain.lengths.min()), chain.places(phi)
    equal = bool(np.all(chain.lengths == chain.lengths[0]))
    for rod, colour in enumerate(rod_colours(len(phi))):
        # on the other side of the rod than its angle
        base, side = places[rod], _up(phi[rod] + np.copysign(np.pi / 2, phi[rod]))
        name = "$l$" if equal else _index("l", rod)
        if not equal and isinstance(column, Column) and rod == 0:
            name = "$l$"
        middle = base + chain.lengths[rod] * 0.5 * _up(phi[rod])
        _text(ax, middle + 0.12 * size * side, name, colour)
        spring = _index("k", rod)
        if isinstance(column, Column) and rod == 1:
            spring = "$k_2 = k$"
        beside, below = np.array([[0.29, 0.0], [0.0, -0.06]]) * size
        _text(ax, base + beside + below, spring, side="left")
        if column.friction is not None:
            _text(ax, base - beside + below, r"$\mu_s, \mu_k$", BROWN, "right")
    for force in chain.forces:
        begin, end = places[force.rod : force.rod + 2]
        along = _up(force.follower * phi[force.rod])
        middle = begin + force.at * (end - begin)
        middle = middle + 0.6 * force.share * chain.arrow * along
        across = _up(force.follower * phi[force.rod] - np.pi / 2)
        name = "$F$" if len(chain.forces) == 1 else _index("F", force.rod)
        _text(ax, middle + 0.16 * size * across, name, VERMILLION)


def _frame(ax: Axes, chain: DrawnChain, places: np.ndarray, size: float) -> None:
    """Limits that hold the chain, its arrows and their names."""
    tails = [arrow.get_position() for arrow in chain.loads]
    shown = np.concatenate([places, np.reshape(tails, (-1, 2))])
    (left, low), (right, high) = shown.min(axis=0), shown.max(axis=0)
    ax.set(xlim=(left - 0.35 * size, right + 0.65 * size))
    ax.set(ylim=(min(low, 0.0) - 0.42 * size, high + 0.25 * size))
