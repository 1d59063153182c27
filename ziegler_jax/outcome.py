"""Why a lane ended, which regime a linear column is in: one small integer each.

A sweep runs thousands of lanes at once and cannot stop at one that fails; every lane
therefore carries a code, and every code a sentence.
"""

import enum


class Code(enum.IntEnum):
    """An integer code with a sentence."""

    sentence: str

    def __new__(cls, value: int, sentence: str):
        """Attach the sentence to the code."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.sentence = sentence
        return member


class OUTCOME(Code):
    """How the motion of a lane ended, in order of precedence.

    Everything below `unsettled` is a failure: the lane's numbers are NaN in a sweep.
    """

    not_computed = 0, "the point was left out or has not been computed yet"
    invalid = 1, "the scene's numbers break a rule, e.g. mu_k > mu_s"
    not_finite = 2, "the motion or its derivative is not a finite number"
    step_vanished = 3, "no step, however small, met the tolerances"
    budget_spent = 4, "the step budget was spent before the span was over"
    chattering = 5, "stick and slip changed again and again without time going on"
    escaped = 6, "a rod's angle passed the named bound, e.g. it turned over"
    unsettled = 7, "no two consecutive windows agreed within the budget"
    stuck = (
        8,
        "both joints stuck for a window, or crept below the cut and did not speed up",
    )
    rest = 9, "the same without friction: the column came to rest"
    cycle = 10, "two consecutive windows agreed: the motion has settled"
    complete = 11, "the motion was followed to the last of the given times"


class REGIME(Code):
    """The linear column's stability at phi = 0."""

    not_computed = 0, "the point was left out or has not been computed yet"
    invalid = 1, "the column's numbers break a rule, e.g. indefinite inertia"
    stable = 2, "every small motion decays"
    marginal = 3, "no motion grows exponentially, not all decay (undamped, a boundary)"
    flutter = 4, "a small motion grows oscillating: a complex pair Re s > 0"
    divergence = 5, "a small motion grows without oscillating: a real s > 0"


class CRITICAL(Code):
    """How the search for a critical load ended, in order of precedence.

    Up to `none` there is no load to name: the numbers and their derivatives are NaN.
    From `preceded` on they stand.
    """

    not_computed = 0, "the point was left out or has not been computed yet"
    invalid = 1, "the column's numbers break a rule, e.g. indefinite inertia"
    unstable_at_zero = 2, "the column is not stable without load, e.g. kappa = 0"
    double_root = 3, "two boundary loads coincide: touched, not crossed; no derivative"
    none = 4, "no load, however high, crosses a boundary of this kind"
    preceded = 5, "found, but stability is lost in the other way at a lower load"
    undamped = 6, "found with C = 0: q_cr jumps there, no derivative in the damping"
    found = 7, "the column loses stability here first"


class SOLVER(Code):
    """Which kind of method `solver="auto"` chose for a lane."""

    not_computed = 0, "the point was left out or has not been computed yet"
    explicit = 1, "an explicit Runge-Kutta method"
    stiff = 2, "a Rosenbrock method, for lanes whose rates decay fast"


def flag_attributes(codes: type[Code]) -> dict[str, object]:
    """The CF-convention attributes that explain a variable of such codes."""
    return {
        "flag_values": [int(code) for code in codes],
        "flag_meanings": " ".join(code.name for code in codes),
        "comment": "; ".join(f"{code.name}: {code.sentence}" for code in codes),
    }
