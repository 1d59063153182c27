"""What results are made of: codes with their sentences, and named quantities.

A sweep runs thousands of lanes at once and cannot stop at one that fails; every lane
therefore carries a code, and every code a sentence. A result tells a sweep by its
`Variable`s what its numbers are called and mean.
"""

import dataclasses
import enum
from collections.abc import Hashable, Mapping, Sequence
from typing import ClassVar, Generic, NamedTuple, TypeVar, cast

import equinox as eqx
import jax
import jax.core
import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int, Shaped

TIME, RATE = "sqrt(m l^2/k)", "sqrt(k/(m l^2))"
# Of a value's fields: units, or powers of m, l and k.
Units = Mapping[str, str | tuple[float, float, float]]

Final = TypeVar("Final")  # the state at the end: no room below knows states


@enum.unique
class CODE(enum.IntEnum):
    """How a lane ended, or what it is: one number a word, with a sentence.

    A variable of codes holds some of these, and lists them in its attributes. Numbers
    are grouped, and in order of precedence within a question: below `unsettled` there
    is nothing to name, and numbers are NaN; below `decided` it is not decided what
    there is. The last group, from `ordinary` on, is of points on branches and curves.
    """

    sentence: str

    def __new__(cls, value: int, sentence: str):
        """Attach the sentence to the code."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.sentence = sentence
        return member

    not_computed = 0, "the point was left out or has not been computed yet"
    # nothing to name
    invalid = 1, "numbers of the scene or the question break a rule, e.g. mu_k > mu_s"
    not_finite = 2, "the motion or its derivative is not a finite number"
    step_vanished = 3, "no step, however small, met the tolerances"
    budget_spent = 4, "the step budget was spent before the span was over"
    chattering = 5, "stick and slip changed again and again without time going on"
    escaped = 7, "a rod's angle passed the named bound, e.g. it turned over"
    no_return = 8, "the guess did not come back to its section in time"
    not_integrated = 9, "a motion could not be followed, or the step budget was spent"
    not_converged = 10, "Newton's method did not converge within its budget"
    collapsed = 11, "the cycle shrinks to rest, or Newton's method converged to rest"
    beyond = 12, "a parameter reached its bound"
    no_start = 13, "no such bifurcation was met near the start"
    unstable_at_zero = 14, "the column is not stable without load, e.g. kappa = 0"
    double_root = 15, "two boundary loads coincide: touched, not crossed; no derivative"
    no_load = 16, "no load, however high, crosses a boundary of this kind"
    no_threshold = 17, "there is no threshold to start from"
    rests = 18, "the column comes to rest wherever it was tried"
    moves = 19, "the column flutters wherever it was tried, or at the smallest kick"
    # not decided
    unsettled = 20, "neither at rest nor on a cycle by the end of the time"
    no_passages = 21, "it does not return to phi1 = 0"
    unstable_near = 22, "it was near an unstable cycle, on the way past it"
    slow = 23, "its returns draw near, but too slowly for a certificate"
    aperiodic = 24, "its returns do not draw near: a torus, chaos, a long transient"
    growing = 25, "it grows slowly, on its way to a motion farther out"
    lasting = 26, "it neither falls nor draws near a cycle: a torus or chaos that lasts"
    undecided = (
        28,
        "a motion that mattered neither rested nor settled in time, or was misjudged",
    )
    unknown = 29, "Newton's method found neither an unstable cycle nor an equilibrium"
    # what a motion is
    decided = 30, "it is not undecided"
    stuck = 31, "both joints stuck, or creep, and what is left decays"
    rest = 32, "the same without friction: what is left of the motion decays"
    cycle = 33, "its orbit is certified: closed, stable, and the motion draws near it"
    complete = 34, "the motion was followed to the last of the given times"
    repeats = 35, "two windows agreed in the swing of each joint; not certified"
    conservative = (
        36,
        "nothing dissipates, none attracts: another start swings otherwise",
    )
    periodic = 37, "by its exponents it is on a cycle, too long or slow to certify"
    quasi_periodic = 38, "a torus: two exponents are zero and returns do not repeat"
    chaotic = 39, "the largest exponent is positive: chaos, which may yet end"
    # how a small motion at phi = 0 goes on
    stable = 40, "every small motion decays"
    marginal = 41, "no motion grows exponentially, not all decay (undamped, a boundary)"
    flutter = 42, "a small motion grows oscillating: a complex pair Re s > 0"
    divergence = 43, "a small motion grows without oscillating: a real s > 0"
    # what a search found
    preceded = 44, "found, but stability is lost in the other way at a lower load"
    undamped = 45, "found with C = 0: q_cr jumps there, no derivative in the damping"
    repeated = 46, "found, but the verdict changes more than once along the bracket"
    saddle_cycle = 47, "an unstable cycle, with one multiplier outside the unit circle"
    equilibrium = 48, "an unstable equilibrium; where joints slip, under their friction"
    found = 49, "what was looked for is here"
    # points and ends of branches and curves
    ordinary = 50, "nothing special"
    fold = 51, "two cycles meet: a multiplier is 1 and the branch turns back"
    torus = 52, "Neimark-Sacker: a complex pair of multipliers passes the unit circle"
    flip = 53, "the period doubles: a multiplier is -1"
    pitchfork = 54, "a multiplier is 1 and the branch goes on: symmetry breaks"
    cusp = 55, "two curves of folds end in a point: one cycle on one side, three beyond"
    unit = (
        56,
        "one more multiplier is 1: a curve of folds or pitchforks, or a torus' end",
    )
    minus = (
        57,
        "a multiplier is -1 (of a symmetric cycle's half map): flip or pitchfork",
    )
    pair = 58, "a complex pair is on the unit circle, or a torus' own pair meets at +-1"
    modes_change = 59, "stick and slip follow in another sequence beyond"
    resonance = 60, "the pair of a torus meets at 1 or -1: the curve is none beyond"
    unfinished = 61, "all points of the walk were used"


Codes = tuple[CODE, ...]


def _codes(words: str) -> Codes:
    return tuple(CODE[word] for word in words.split())


# What each question can answer beside `not_computed`, in order of precedence.
OUTCOMES = _codes(  # how a motion ended
    "invalid not_finite step_vanished budget_spent chattering escaped "
    "unsettled stuck rest cycle complete repeats conservative"
)
UNSETTLED = _codes(  # of which kind a motion is that neither settles nor rests
    "no_passages unstable_near slow aperiodic growing lasting decided conservative "
    "periodic quasi_periodic chaotic"
)
KINDS = _codes(  # how a motion ended, and where it has not settled, of which kind it is
    "invalid not_finite step_vanished budget_spent chattering escaped no_passages "
    "unstable_near slow aperiodic growing lasting stuck rest cycle conservative "
    "periodic quasi_periodic chaotic"
)
REGIMES = _codes("invalid stable marginal flutter divergence")  # stability at phi = 0
CRITICAL_LOADS = _codes(  # how the search for a critical load ended
    "invalid unstable_at_zero double_root no_load preceded undamped found"
)
ONSETS = _codes("invalid rests moves undecided repeated found")  # of flutter
KICKS = _codes("invalid rests moves undecided found")  # the least one
EDGES = _codes(  # what a motion on a threshold draws near, between rest and flutter
    "no_threshold unknown saddle_cycle equilibrium"
)
ORBITS = _codes(  # how the search for a periodic orbit ended
    "invalid no_return not_integrated not_converged collapsed beyond found"
)
OFFSHOOTS = _codes(  # how the search for a cycle of a branch that crosses ended
    "invalid not_integrated not_converged no_start found"
)
SPECIALS = _codes("ordinary fold torus flip pitchfork")  # points of a branch
MEETINGS = _codes(  # points of a curve of bifurcations
    "beyond ordinary cusp unit minus pair modes_change"
)
CURVE_ENDS = _codes(  # how a curve of bifurcations ends in one of its directions
    "invalid not_integrated not_converged collapsed beyond no_start "
    "modes_change resonance unfinished"
)


def flag_attributes(codes: Codes) -> dict[str, object]:
    """The CF-convention attributes that explain a variable of such codes.

    A sweep may leave out any point: `not_computed` is always among them.
    """
    codes = tuple(dict.fromkeys((CODE.not_computed, *codes)))
    return {
        "flag_values": [int(code) for code in codes],
        "flag_meanings": " ".join(code.name for code in codes),
        "comment": "; ".join(f"{code.name}: {code.sentence}" for code in codes),
    }


# The attributes without which a variable's numbers mean nothing.
MEANING = ("units", "si_unit", "flag_values", "flag_meanings")


def unlike_meaning(
    one: Mapping[Hashable, object], other: Mapping[Hashable, object]
) -> str | None:
    """The first of `MEANING` in which a variable's attributes differ, or None."""
    for key in MEANING:
        if not np.array_equal(np.asarray(one.get(key)), np.asarray(other.get(key))):
            return key
    return None


# of a variable: the numbers, their shape alone, or none yet
Value = Shaped[ArrayLike, "..."] | jax.ShapeDtypeStruct | None


class Variable(NamedTuple):
    """One named quantity of a result.

    A `point` may return one as well: an array then names its dimensions.

    ```python
    def point(q):
        s = zj.spectrum(zj.uniform_rods(q))
        return {"growth": zj.Variable(s.real, "growth rate", dims=("mode",))}
    ```

    **Arguments:**

    - `value`: an array of the shape that `dims` names; under `vmap` lanes stand in
        front.
    - `long_name`: what it is; `units`: those of the scaled column, e.g. `"rad"`.
    - `codes`: those that a flag variable can hold, e.g. `(CODE.stuck, CODE.cycle)`.
    """

    value: Value
    long_name: str
    units: str = "1"
    dims: tuple[str, ...] = ()
    codes: Codes | None = None


def labels(variable: Variable) -> dict[str, object]:
    """The attributes of a variable in a dataset."""
    if variable.codes is None:
        return {"long_name": variable.long_name, "units": variable.units}
    return {"long_name": variable.long_name, **flag_attributes(variable.codes)}


def quantity(
    long_name: str,
    units: str = "1",
    dims: tuple[str, ...] = (),
    codes: Codes | None = None,
) -> dict[str, Variable]:
    """The metadata of a field that is a number of its result, under the field's name.

    **Arguments:** those of `Variable`, but for its value.
    """
    return {"quantity": Variable(None, long_name, units, dims, codes)}


Settings = tuple[tuple[str, object], ...]


class AbstractResult(eqx.Module):
    """A result: named numbers, and how they were computed.

    Its fields (and properties, by `DERIVED`) that are numbers have the names, meanings
    and units that they have in a dataset: of `to_dataset`, or of a `sweep` whose point
    returns the result.
    """

    settings: eqx.AbstractVar[Settings]

    DERIVED: ClassVar[Mapping[str, Variable]] = {}  # quantities that are properties

    def variables(self) -> dict[str, Variable]:
        """All numbers with their names, units and dimensions."""
        about = {f.name: f.metadata.get("quantity") for f in dataclasses.fields(self)}
        about |= self.DERIVED
        return {
            name: variable._replace(value=getattr(self, name))
            for name, variable in about.items()
            if variable is not None
        }

    def coordinates(self) -> dict[str, Sequence[object]]:
        """The values along the dimensions of its own."""
        return {}

    def attributes(self) -> dict[str, object]:
        """How it was computed: the options that are the same at every point."""
        return dict(self.settings)

    def to_dataset(self) -> xr.Dataset:
        """The numbers as a sweep labels them.

        **Returns:** a dataset; axes of `jax.vmap` are its dimensions `lane_1`,
        `lane_2`, ...

        **Raises:** JAX's error inside its transformations, where nothing is known yet.
        """
        named = self.variables()
        known = {**counted(named), **self.coordinates()}
        data, coords = {}, {}
        for name, variable in named.items():
            value = np.asarray(variable.value)
            lanes = [f"lane_{i + 1}" for i in range(value.ndim - len(variable.dims))]
            data[name] = (*lanes, *variable.dims), value, labels(variable)
            mine = [dim for dim in variable.dims if dim in known]
            coords |= {dim: coordinate(dim, known[dim]) for dim in mine}
        return xr.Dataset(data, coords, self.attributes())

    def __repr__(self) -> str:
        """The numbers with their units, and what the codes mean."""
        try:
            named = self.variables()
        except (TypeError, AttributeError):  # of shapes: properties are not computed
            return eqx.tree_pformat(self)
        width = max(map(len, named), default=0)
        rows = [f"  {name:{width}} = {_shown(name, v)}" for name, v in named.items()]
        return "\n".join([type(self).__name__, *rows])


def _shown(name: str, variable: Variable) -> str:
    """A value for the eye; a code beside the outcome that tells nothing is none."""
    if isinstance(variable.value, jax.core.Tracer):
        return f"{variable.value.aval.str_short()}, traced"
    value = np.asarray(variable.value)
    if value.dtype.kind not in "biufc":
        return repr(variable.value)
    if variable.codes is not None:
        known = {int(code): code for code in CODE}
        codes, counts = np.unique(value, return_counts=True)
        if value.size == 1 and codes[0] in known:
            code = known[codes[0]]
            if code.name == "not_computed" and not name.endswith("outcome"):
                return "none"
            return f"{code.name}: {code.sentence}"
        pairs = zip(codes.tolist(), counts.tolist(), strict=True)
        named = ((known[c].name if c in known else c, count) for c, count in pairs)
        return ", ".join(f"{count} {name}" for name, count in named)
    text = np.array2string(value, precision=6, threshold=8, edgeitems=2)
    text = " ".join(text.split())
    shape = f"  (shape {value.shape})" if value.size > 8 else ""
    return text + ("" if variable.units == "1" else f" {variable.units}") + shape


class AbstractDescribed(AbstractResult):
    """A result whose numbers depend on what was asked for: an attribute each."""

    numbers: eqx.AbstractVar[dict[str, Shaped[Array, "..."]]]
    quantities: eqx.AbstractVar[tuple[tuple[str, Variable], ...]]  # without values

    def __getattr__(self, name: str) -> Shaped[Array, "..."]:
        """The quantity of that name."""
        numbers = self.__dict__.get("numbers", {})
        if name in numbers:
            return numbers[name]
        raise AttributeError(
            f"A `{type(self).__name__}` has `{name}` only where it was asked for; this "
            f"one has {', '.join(numbers)}."
        )

    def variables(self) -> dict[str, Variable]:
        """All numbers with their names, units and dimensions."""
        named = {n: v._replace(value=self.numbers[n]) for n, v in self.quantities}
        return named | super().variables()


def without_values(
    variables: Mapping[str, Variable],
) -> tuple[tuple[str, Variable], ...]:
    """Variables without their values: a static part of a result."""
    return tuple((n, v._replace(value=None)) for n, v in variables.items())


class AbstractMotionResult(AbstractResult, Generic[Final]):
    """The result of one motion: beside others, where, when and how it ended."""

    final: Final  # the state at the end
    time: Float[Array, "*lanes"] = eqx.field(metadata=quantity("time at the end", TIME))
    steps: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("attempted steps")
    )  # also rejected ones
    outcome: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("how the motion ended", codes=OUTCOMES)
    )
    settings: Settings = eqx.field(static=True)


DIMENSIONS = ("rod", "joint")  # that results use, counted from the base on


def counted(named: Mapping[str, Variable]) -> dict[str, Sequence[object]]:
    """The coordinates of those dimensions, as long as the variables say."""
    known: dict[str, Sequence[object]] = {}
    for variable in named.values():
        shape = np.shape(cast(ArrayLike, variable.value))
        sizes = shape[len(shape) - len(variable.dims) :]
        if len(shape) >= len(variable.dims):
            for dim, size in zip(variable.dims, sizes, strict=True):
                if dim in DIMENSIONS:
                    known.setdefault(dim, tuple(range(1, size + 1)))
    return known


# Names that scenes give their axes: meaning, units, symbol.
AXES = {
    "q": ("follower load", "k/l", "$q$"),
    "F": ("follower load", "N", "$F$"),
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
    "ts": ("time", TIME, "$t$"),
    "phi1": ("angle of rod 1 at the start", "rad", r"$\varphi_1$"),
    "phi2": ("angle of rod 2 at the start", "rad", r"$\varphi_2$"),
    "omega1": ("rate of rod 1 at the start", RATE, r"$\dot\varphi_1$"),
    "omega2": ("rate of rod 2 at the start", RATE, r"$\dot\varphi_2$"),
}


def coordinate(name: str, values: Sequence[object] | np.ndarray) -> tuple:
    """A coordinate of a dataset, with what is known of its name."""
    if name not in AXES:
        return name, list(values)
    meaning, units, symbol = AXES[name]
    attributes = {"long_name": meaning, "units": units, "symbol": symbol}
    return name, np.asarray(values), attributes


def checked(whose: str, named: object) -> dict[str, Variable]:
    """What an observer or a result gave: a `Variable` a name.

    **Raises:** `ValueError` that names the entry which is none.
    """
    if not isinstance(named, dict):
        raise ValueError(f"{whose} must be a dict of `Variable`, but is {named!r}.")
    for name, entry in named.items():
        if not isinstance(name, str):
            raise ValueError(f"{whose} must have names, but has {name!r}.")
        if not isinstance(entry, Variable):
            raise ValueError(
                f"{whose} must have a `Variable` for `{name}`, but has "
                f"{type(entry).__name__}; write `zj.Variable(value, "
                '"what it is", "its unit")`.'
            )
    return named
