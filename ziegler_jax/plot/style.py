"""Colours, hatches and units that all pictures share."""

import re
from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.colors import to_hex

from ..motion.trajectory import Trajectory
from ..numerics.rules import instance
from ..results import CODE

# Okabe and Ito's colours, which the colour-blind can tell apart
BLUE, ORANGE, GREEN, VERMILLION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
SKY, PURPLE, YELLOW, GREY = "#56B4E9", "#CC79A7", "#F0E442", "#BBBBBB"
PALE_BLUE = "#D9E8F4"
# of lines in one picture, in this order
LINE_COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, "#000000")
PHI1, PHI2 = "navy", "red"
LIGHTEST = 0.82  # of viridis: lighter lines are lost on white

AT_REST = (CODE.stuck, CODE.rest)
REST_COLOUR, FAILED_COLOUR = "#E8DCC8", "#F2F2F2"
VIOLET = "#4B2E83"
FADED, UNSETTLED_HATCH = (1.0, 1.0, 1.0, 0.6), "...."
# of a motion that has no number: hatch in a map, marker in a diagram
FAILED = {
    CODE.escaped: ("////", "x"),
    CODE.budget_spent: ("xxxx", "+"),
    CODE.step_vanished: (r"\\\\", "1"),
    CODE.chattering: ("oooo", "2"),
    CODE.not_finite: ("||||", "3"),
    CODE.invalid: ("++++", "4"),
}
# Of codes, by their names: one colour in the whole package. Those of one map are at
# least 10 apart (CIE 1976) for normal eyes and for three kinds of colour-blind ones.
COLOUR_OF = {
    "not_computed": "#FFFFFF",
    "invalid": "#000000",
    "not_finite": "#5A5A5A",
    "step_vanished": PURPLE,
    "budget_spent": YELLOW,
    "chattering": GREEN,
    "escaped": VIOLET,
    "unsettled": ORANGE,
    "stuck": REST_COLOUR,
    "rest": "#C9B58F",
    "cycle": BLUE,
    "periodic": "#2840B8",
    "saddle_cycle": BLUE,
    "repeats": "#7848F0",
    "complete": "#A8F078",
    "undecided": "#9A9A9A",
    "decided": "#F2F2F2",
    # of which kind a motion is that has not settled
    "no_passages": "#C8C8C8",
    "unstable_near": "#884028",
    "slow": "#A0E870",
    "aperiodic": "#A028E8",
    "growing": "#70A058",
    "lasting": "#582858",
    "conservative": SKY,
    "quasi_periodic": ORANGE,
    "chaotic": VERMILLION,
    "stable": PALE_BLUE,
    "marginal": SKY,
    "flutter": VERMILLION,
    "divergence": VIOLET,
}
OTHERS = (SKY, ORANGE, BLUE, VERMILLION, GREEN, PURPLE, VIOLET, YELLOW, "#7F7F7F")
MARKERS = {
    CODE.cycle: ("o", BLUE),
    CODE.repeats: ("o", BLUE),
    CODE.conservative: ("D", SKY),
    CODE.complete: ("o", BLUE),
    CODE.unsettled: ("^", ORANGE),
    CODE.stuck: ("s", "#8A7650"),
    CODE.rest: ("s", "#8A7650"),
}


def rod_colours(n: int) -> list[str]:
    """Of n rods, from the base on: of more than two from dark to light."""
    if n == 2:
        return [PHI1, PHI2]
    shades = colormaps["viridis"](np.linspace(0.0, LIGHTEST, n))
    return [to_hex(shade) for shade in shades]


def one_motion(motion: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Its times (n,) and angles (n, rods).

    **Raises:** `ValueError` for what is none, and for one of many columns.
    """
    instance("motion", motion, Trajectory)
    ts, phi = np.asarray(motion.ts), np.asarray(motion.phi)
    if ts.ndim != 1 or phi.ndim != 2 or len(phi) != ts.size:
        raise ValueError(
            "Argument `motion` must be one motion, but its `phi` has shape "
            f"{phi.shape} at times of shape {ts.shape}."
        )
    return ts, phi


def unit_label(units: str) -> str:
    """Units of m, l and k as mathematics; `1` is a pure number."""
    if units == "1":
        return "–"
    if re.fullmatch(r"[mkl0-9/^ ()]+", units) and units != "m":  # `m` alone: metres
        return f"${units}$"
    if "sqrt" not in units:
        return units
    return "$" + re.sub(r"sqrt\((.*)\)", r"\\sqrt{\1}", units) + "$"


def code_colours(names: Sequence[str]) -> list[str]:
    """The colours of the codes of one family, by their names; no two alike."""
    known = [COLOUR_OF.get(name) for name in names]
    spare = iter(colour for colour in OTHERS if colour not in known)
    return [colour or next(spare, GREY) for colour in known]


def flags_of(values: xr.DataArray) -> tuple[list[int], list[str]]:
    """The codes of a flag variable, and their names."""
    codes = np.atleast_1d(values.attrs["flag_values"])
    return [int(c) for c in codes], str(values.attrs["flag_meanings"]).split()


def meaning_of(values: xr.DataArray) -> str:
    """What the numbers are; of one rod or joint, which."""
    text = str(values.attrs.get("long_name", values.name))
    for dim in ("rod", "joint"):
        if dim in values.coords and dim not in values.dims:
            number = int(values.coords[dim])
            text = re.sub(rf"(?:the )?\b{dim}\b", f"{dim} {number}", text)
    return text


def label_of(values: xr.DataArray) -> str:
    """Meaning, symbol and units."""
    name, text = str(values.name), meaning_of(values)
    symbol = str(values.attrs.get("symbol", name))
    if symbol != name and name in values.dims:
        text = f"{text}, {symbol}"
    units = str(values.attrs.get("units", ""))
    return f"{text} ({unit_label(units)})" if units else text


LINE = 44  # letters of a label: what an axis of the usual height has room for


def in_lines(label: str) -> str:
    """A label that fits beside an axis; formulas are not parted."""
    words = re.findall(r"(?:\$[^$]*\$|\S)+", label)
    lines = [""]
    for word in words:
        longer = f"{lines[-1]} {word}".strip()
        if len(longer) > LINE and lines[-1]:
            lines.append(word)
        else:
            lines[-1] = longer
    return "\n".join(lines)
