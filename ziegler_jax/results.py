"""What results are made of: codes with their sentences, and named quantities.

A sweep runs thousands of lanes at once and cannot stop at one that fails; every lane
therefore carries a code, and every code a sentence. A result tells a sweep by its
`Variable`s what its numbers are called and mean.
"""

import dataclasses
import enum
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

TIME, RATE = "sqrt(m l^2/k)", "sqrt(k/(m l^2))"


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


class Variable(NamedTuple):
    """One named quantity of a result.

    `value` has the shape that `dims` names; under `vmap` lanes stand in front.
    """

    value: Any
    long_name: str
    units: str = "1"
    dims: tuple[str, ...] = ()
    codes: type[Code] | None = None  # for flag variables


def labels(variable: Variable) -> dict[str, Any]:
    """The attributes of a variable in a dataset."""
    if variable.codes is None:
        return {"long_name": variable.long_name, "units": variable.units}
    return {"long_name": variable.long_name, **flag_attributes(variable.codes)}


def quantity(*about: Any, **more: Any) -> dict[str, Variable]:
    """The metadata of a field that is a number of its result, under the field's name.

    **Arguments:** those of `Variable`, but for its value.
    """
    return {"quantity": Variable(None, *about, **more)}


class AbstractResult(eqx.Module):
    """A result: the numbers that its fields declare, and how it was computed."""

    settings: eqx.AbstractVar[tuple[tuple[str, Any], ...]]

    def variables(self) -> dict[str, Variable]:
        """All numbers with their names, units and dimensions, for `sweep`."""
        about = {f.name: f.metadata.get("quantity") for f in dataclasses.fields(self)}
        return {
            name: variable._replace(value=getattr(self, name))
            for name, variable in about.items()
            if variable is not None
        }

    def attributes(self) -> dict[str, Any]:
        """How it was computed: the options that are the same at every point."""
        return dict(self.settings)


class AbstractMotionResult(AbstractResult):
    """The result of one motion: beside others, where, when and how it ended."""

    final: Any  # the state at the end
    time: Any = eqx.field(metadata=quantity("time at the end", TIME))
    steps: Any = eqx.field(metadata=quantity("attempted steps"))  # also rejected ones
    outcome: Any = eqx.field(metadata=quantity("how the motion ended", codes=OUTCOME))
    settings: tuple[tuple[str, Any], ...] = eqx.field(static=True)


# The dimensions that results use, with their coordinates.
DIMENSIONS = {"rod": (1, 2), "joint": (1, 2)}

# Names that scenes give their axes: meaning, units, symbol.
AXES = {
    "q": ("follower load F l/k", "1", "$q$"),
    "mu_s": ("static friction coefficient", "1", r"$\mu_s$"),
    "mu_k": ("kinetic friction coefficient", "1", r"$\mu_k$"),
    "mu": ("friction coefficient", "1", r"$\mu$"),
    "tau": ("friction torque", "k", r"$\tau$"),
    "pin_radius": ("pin radius", "l", r"$\rho$"),
    "v_smooth": ("smoothing rate", RATE, "$v_{smooth}$"),
    "v_stribeck": ("Stribeck rate", RATE, "$v_{stribeck}$"),
    "kappa": ("stiffness ratio k1/k2", "1", r"$\kappa$"),
    "eta": ("follower fraction", "1", r"$\eta$"),
    "follower": ("follower fraction", "1", r"$\eta$"),
    "c1": ("damping of joint 1", "sqrt(k m l^2)", "$c_1$"),
    "c2": ("damping of joint 2", "sqrt(k m l^2)", "$c_2$"),
    "phi1": ("angle of rod 1 at the start", "rad", r"$\varphi_1$"),
    "phi2": ("angle of rod 2 at the start", "rad", r"$\varphi_2$"),
    "omega1": ("rate of rod 1 at the start", RATE, r"$\dot\varphi_1$"),
    "omega2": ("rate of rod 2 at the start", RATE, r"$\dot\varphi_2$"),
}

# Names that scenes give codes which come without a result: flag variables.
FLAGS = {"regime": REGIME}


# Results whose arrays have no names in a dataset: how to take numbers from them.
_NUMBERS_OF = {
    "Trajectory": '{"phi2": result.phi[-1, 1], "outcome": result.outcome}',
    "Section": '{"omega2": result.omega[0, 1], "count": result.count}',
    "Branch": '{"lowest": jnp.nanmin(result.points.parameter)}',
    "State": '{"phi1": state.phi[0]}',
}
_ANY = '{"name": number}'


def checked(whose: str, named: Any) -> dict[str, Variable]:
    """What `variables()` of an observer or a result gave: a `Variable` a name.

    **Raises:** `ValueError` that names the entry which is none.
    """
    if not isinstance(named, dict):
        raise ValueError(
            f"`variables()` of {whose} must return a dict of `Variable`, but returns "
            f"{named!r}."
        )
    for name, entry in named.items():
        if not isinstance(entry, Variable):
            raise ValueError(
                f"`variables()` of {whose} must give a `Variable` for `{name}`, but "
                f"gives {type(entry).__name__}; write `Variable(value, "
                '"what it is", "its unit")`, from `ziegler_jax.results`.'
            )
    return named


def named_variables(result: Any) -> dict[str, Variable]:
    """What a `point` returned, as named variables.

    **Arguments:** `result`: a scalar (its name is `value`), a dict of scalars, or a
    result of the library.

    **Raises:** `ValueError` that names the entry which is neither.
    """
    if hasattr(result, "variables"):
        return checked(f"a `{type(result).__name__}`", result.variables())
    if type(result).__module__.split(".")[0] == __name__.split(".")[0]:
        kind = type(result).__name__
        raise ValueError(
            f"`point` must return numbers with names, but returns a `{kind}`, whose "
            "arrays have dimensions of their own; return numbers of it, e.g. "
            f"`{_NUMBERS_OF.get(kind, _ANY)}`."
        )
    if not isinstance(result, dict):
        result = {"value": result}
    if not result:
        raise ValueError("`point` must return something, but returns an empty dict.")
    named = {}
    for name, value in result.items():
        shape = getattr(value, "shape", None)
        if isinstance(value, (bool, int, float)):
            shape = ()
        if shape is None:
            raise ValueError(
                "`point` must return a scalar, a dict of scalars or a result of the "
                f"library, but `{name}` is {type(value).__name__}."
            )
        if shape != ():
            raise ValueError(
                "`point` must return a scalar, a dict of scalars or a result of the "
                f"library, but `{name}` has shape {tuple(shape)} and no declared "
                "dimensions."
            )
        named[str(name)] = Variable(value, str(name), codes=FLAGS.get(str(name)))
    return named


def empty(variable: Variable, shape: tuple[int, ...]) -> np.ndarray:
    """A variable over a grid: NaN for numbers, 0 (`not_computed`) for codes.

    One number in memory, however large the shape: copy it to write to it.
    """
    dtype = np.dtype(variable.value.dtype)
    if dtype.kind in "biu" and variable.codes is None:
        dtype = np.dtype(np.float64)  # so that a missing point can be told from 0
    fill = np.array(np.nan if dtype.kind in "fc" else 0, dtype)
    return np.broadcast_to(fill, shape + tuple(variable.value.shape))
