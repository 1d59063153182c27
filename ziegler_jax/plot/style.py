"""Colours, hatches and units that all pictures share."""

import re

from ..results import OUTCOME

# Okabe and Ito's colours, which the colour-blind can tell apart
BLUE, ORANGE, GREEN, VERMILLION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
SKY, PURPLE, YELLOW, GREY = "#56B4E9", "#CC79A7", "#F0E442", "#BBBBBB"
PALE_BLUE, PALE_ORANGE = "#D9E8F4", "#FBE6D0"
# of lines in one picture, in this order; each has a marker of its own as well
LINE_COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, "#000000")
LINE_MARKERS = "os^DvPX"
PHI1, PHI2 = "navy", "red"

AT_REST = (OUTCOME.stuck, OUTCOME.rest)
REST_COLOUR, FAILED_COLOUR = "#E8DCC8", "#F2F2F2"
FAILED_HATCH, UNSETTLED_HATCH = "////", "...."
# in the order of OUTCOME: failures, unsettled, stuck and rest, cycle and complete
CODE_COLOURS = (
    ("#FFFFFF", "#000000", "#7F7F7F", PURPLE, YELLOW, GREEN, VERMILLION)
    + (ORANGE, REST_COLOUR, "#F6EFE2", BLUE, SKY)
)  # fmt: skip
MARKERS = {
    OUTCOME.cycle: ("o", BLUE),
    OUTCOME.complete: ("o", BLUE),
    OUTCOME.unsettled: ("^", ORANGE),
    OUTCOME.stuck: ("s", "#8A7650"),
    OUTCOME.rest: ("s", "#8A7650"),
}


def unit_label(units: str) -> str:
    """Units as mathematics where they are roots; `1` is a pure number."""
    if units == "1":
        return "–"
    if "sqrt" not in units:
        return units
    return "$" + re.sub(r"sqrt\((.*)\)", r"\\sqrt{\1}", units) + "$"
