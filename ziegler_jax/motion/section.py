"""Where a step passes a plane of phase space: the one watch over sections."""

from typing import Any, NamedTuple

from ..numerics.hermite import Course, Quintic, place, rough_place
from ..numerics.materialise import if_any_lane
from ..numerics.numbers import Scalar, Vector4
from ..solvers import Step


class Plane(NamedTuple):
    """A coordinate (0 to 3), its level, and the direction of passage."""

    coordinate: int = 0
    level: Scalar = 0.0
    rising: bool = True


class Passage(NamedTuple):
    """Whether a step passes the plane, when and where."""

    there: Any
    time: Scalar
    y: Vector4


def passage(plane: Plane, step: Step) -> Passage:
    """The step's passage through the plane: angles on quintics, rates on cubics."""
    i, h = plane.coordinate, step.t1 - step.t0
    sign = -1.0 if plane.rising else 1.0
    g0, g1 = (sign * (y[i] - plane.level) for y in (step.y0, step.y1))
    there = (g0 > 0) & (g1 <= 0)

    def locate(found):
        del found
        zero = 0.0 * h
        ends = list(zip(step.y0, step.y1, step.f0, step.f1, strict=True))
        rates = [Course(a, b, h * f, h * g, zero) for a, b, f, g in ends[2:]]
        paths = [*angles(step)[:2], *rates]
        guard = type(paths[i])(*(sign * x for x in paths[i]))
        guard = guard._replace(g0=g0, g1=g1)
        about = rough_place(guard, zero, zero + 1.0)
        x = place(guard, 0.0, about, zero, zero + 1.0)
        y = tuple(path(x) for path in paths)
        return Passage(there, step.t0 + x * h, y)  # type: ignore[arg-type]

    return if_any_lane(there, locate, Passage(there, step.t1, step.y1))


def angles(step: Step) -> tuple[Quintic, Quintic, Quintic]:
    """phi1, phi2 and phi2 - phi1 over the step."""
    h = step.t1 - step.t0
    one, two = (
        Quintic(*(x for y, f in ends for x in (y[i], h * y[i + 2], h * h * f[i + 2])))
        for i in (0, 1)
        for ends in [((step.y0, step.f0), (step.y1, step.f1))]
    )
    return one, two, Quintic(*(b - a for a, b in zip(one, two, strict=True)))
