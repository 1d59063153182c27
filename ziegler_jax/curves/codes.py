"""Codes of curves of bifurcations, each with its sentence."""

from ..results import Code


class MEETING(Code):
    """What happens at a point of a curve of bifurcations in two parameters."""

    none = 0, "nothing special"
    cusp = 1, "two curves of folds end in a point: one cycle on one side, three beyond"
    unit = (
        2,
        "one more multiplier is 1: a curve of folds or pitchforks, or a torus' end",
    )
    minus = 3, "a multiplier is -1 (of a symmetric cycle's half map): flip or pitchfork"
    torus = 4, "a complex pair is on the unit circle, or a torus' own pair meets at +-1"
    edge = 5, "a parameter reaches its bound"
    modes_change = 6, "the curve ends: stick and slip follow in another sequence beyond"


class CURVE(Code):
    """How a curve of bifurcations ends in one of its two directions."""

    not_computed = 0, "the point was left out or has not been computed yet"
    invalid = 1, "the scene's numbers break a rule, e.g. mu_k > mu_s"
    no_start = 2, "no such bifurcation was met near the start"
    not_integrated = 3, "a motion could not be followed, or the step budget was spent"
    not_converged = 4, "Newton's method did not converge, however short the step"
    modes_change = 5, "stick and slip follow in another sequence beyond"
    collapsed = 6, "the cycle shrinks to rest"
    resonance = 7, "the pair of a torus meets at 1 or -1: the curve is none beyond"
    unfinished = 8, "all points of the walk were used"
    beyond = 10, "a parameter reached its bound"
