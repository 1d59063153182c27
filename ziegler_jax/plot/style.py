"""Colours, hatches and units that all pictures share."""

import re

from ..results import OUTCOME

# Okabe and Ito's colours, which the colour-blind can tell apart
BLUE, ORANGE, GREEN, VERMILLION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
SKY, PURPLE, YELLOW, GREY = "#56B4E9", "#CC79A7", "#F0E442", "#BBBBBB"
PHI1, PHI2 = "navy", "red"

AT_REST = (OUTCOME.stuck, OUTCOME.rest)
REST_COLOUR, FAILED_COLOUR = "#E8DCC8", "#F2F2F2"
FAILED_HATCH, UNSETTLED_HATCH = "////", "...."
CODE_COLOURS = (
    ("#FFFFFF", "#000000", "#7F7F7F", PURPLE, YELLOW, VERMILLION)
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
