"""Why a lane ended, what its motion is, which regime a linear column is in: codes.

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


class VERDICT(Code):
    """What kind of motion a start leads to (see `verdict`)."""

    not_computed = 0, "the point was left out or has not been computed yet"
    failed = 1, "the motion could not be followed: the outcome says why"
    escaped = 2, "a rod's angle passed the named bound, e.g. it turned over"
    undecided = 3, "neither sections nor exponents decide within the budget"
    conservative = 4, "nothing is dissipated: no motion attracts, there is no attractor"
    stuck = 5, "it came to rest"
    cycle = 6, "sections repeat, or only one exponent is zero and no other positive"
    quasi_periodic = 7, "two exponents are zero and sections do not repeat"
    chaotic = 8, "the largest exponent is positive, beyond its error"


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


class ONSET(Code):
    """How the search for an onset ended.

    Up to `moves` there is no onset to name, but for `undecided`, whose interval may be
    known and wide.
    """

    not_computed = 0, "the point was left out or has not been computed yet"
    invalid = 1, "the scene's numbers or the bracket break a rule"
    undecided = 2, "a motion that mattered neither came to rest nor settled in time"
    rests = 3, "the column comes to rest all along the scanned bracket"
    moves = 4, "the column never comes to rest along the scanned bracket"
    repeated = 5, "found, but the verdict changes more than once along the bracket"
    found = 6, "the verdict changes once along the scanned bracket, here"


class ORBIT(Code):
    """How the search for a periodic orbit ended, in order of precedence.

    Below `found` there is no orbit: the numbers and their derivatives are NaN.
    """

    not_computed = 0, "the point was left out or has not been computed yet"
    invalid = 1, "the scene's numbers break a rule, e.g. mu_k > mu_s"
    no_return = 2, "the guess did not come back to its section in time"
    not_integrated = (
        3,
        "the motion could not be followed for a period, or the step budget was spent",
    )
    not_converged = 4, "Newton's method did not converge within its budget"
    collapsed = 5, "Newton's method converged to rest"
    beyond = 6, "the branch left the named bounds before what was looked for came"
    found = 7, "the motion closes after its period"


class SPECIAL(Code):
    """What happens at a point of a branch of cycles."""

    none = 0, "nothing special"
    fold = 1, "two cycles meet: a multiplier is 1 and the branch turns back"
    torus = 2, "Neimark-Sacker: a complex pair of multipliers passes the unit circle"
    flip = 3, "the period doubles: a multiplier is -1"
    pitchfork = 4, "a multiplier is 1 and the branch goes on: symmetry breaks"


def flag_attributes(codes: type[Code]) -> dict[str, object]:
    """The CF-convention attributes that explain a variable of such codes."""
    return {
        "flag_values": [int(code) for code in codes],
        "flag_meanings": " ".join(code.name for code in codes),
        "comment": "; ".join(f"{code.name}: {code.sentence}" for code in codes),
    }
