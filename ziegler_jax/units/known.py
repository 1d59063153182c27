"""The units of the library: powers of m, l and k, and their names in SI."""

from typing import NamedTuple

from ..numerics.numbers import Scalar
from ..results import RATE, TIME

Powers = tuple[float, float, float]  # of m, l and k

PURE = ("1", "rad")


class Unit(NamedTuple):
    """Powers of m, l and k, and the name of their product in SI."""

    powers: Powers
    name: str


UNITS = {
    TIME: Unit((0.5, 1, -0.5), "s"),
    RATE: Unit((-0.5, -1, 0.5), "rad/s"),
    "k": Unit((0, 0, 1), "N m"),
    "k/l": Unit((0, -1, 1), "N"),
    "k/l^3": Unit((0, -3, 1), "N/m^2"),
    "k/(m l)": Unit((-1, -1, 1), "m/s^2"),
    "l": Unit((0, 1, 0), "m"),
    "m": Unit((1, 0, 0), "kg"),
    "m l": Unit((1, 1, 0), "kg m"),
    "m l^2": Unit((1, 2, 0), "kg m^2"),
    "sqrt(k m l^2)": Unit((0.5, 1, 0.5), "N m s"),
    "sqrt(k m)/l^2": Unit((0.5, -2, 0.5), "N s/m^2"),
    "k sqrt(k/(m l^2))": Unit((-0.5, -1, 1.5), "W"),
}


def size(powers: Powers, scales: tuple[Scalar, Scalar, Scalar]) -> Scalar:
    """The unit in SI, where m, l and k are these."""
    product = 1.0
    for scale, power in zip(scales, powers, strict=True):
        if power != 0:
            product = product * scale**power
    return product
