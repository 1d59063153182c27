"""What decides where a step must end: a guard for each joint, over the step."""

from collections.abc import Sequence
from functools import reduce

import jax
import jax.numpy as jnp

from ..model.chain import joint_angles
from ..model.state import PhasePoint
from ..model.system import System
from ..numerics.hermite import (
    HermiteQuartic,
    bezier_verdict,
    extrema,
    falls_below,
)
from ..numerics.materialise import if_any_lane, materialise, tree_where
from ..numerics.numbers import Flag, Numbers, Scalar


def rate_courses(y0, y1, h, f0, f1, bends) -> list[HermiteQuartic]:
    """The state over a step, a quartic for each coordinate."""
    rows = zip(y0, y1, f0, f1, bends, strict=True)
    return [HermiteQuartic(a, b, h * va, h * vb, bend) for a, b, va, vb, bend in rows]


def brackets_of(
    courses: list[HermiteQuartic], tol: Numbers, t0: Scalar
) -> Sequence[tuple[Flag, Scalar, Scalar]]:
    """For each guard whether it falls below its tolerance, and between which places."""
    plain = materialise(
        t0, lambda: [bezier_verdict(c, e) for c, e in zip(courses, tol, strict=True)]
    )
    sure = reduce(jnp.logical_and, (known for known, _ in plain))
    doubtful = jnp.logical_not(sure)
    zero, one = jnp.zeros_like(t0), jnp.ones_like(t0)
    brackets = [(falls, zero, one) for _, falls in plain]

    def refine(brackets):
        turns = materialise(t0, lambda: [extrema(course) for course in courses])
        new = [
            falls_below(course, e, turn)
            for course, e, turn in zip(courses, tol, turns, strict=True)
        ]
        return tree_where(doubtful, new, brackets)

    return if_any_lane(doubtful, refine, brackets)


def sliding_guards(
    modes: Numbers, motion: list[HermiteQuartic]
) -> list[HermiteQuartic]:
    """The guards of joints that slip, from the courses of the state."""
    rates = motion[len(modes) :]
    turns = map(joint_angles, zip(*rates, strict=True))
    courses = (HermiteQuartic(*each) for each in zip(*turns, strict=True))
    pairs = zip(modes, courses, strict=True)
    return [jax.tree.map(lambda x, m=m: m * x, u) for m, u in pairs]


def guard_of(system: System, y: PhasePoint, least: Scalar) -> Numbers:
    """The guards of joints that stick, in the system's modes."""
    return system.law.guard(system.balance(y), least)
