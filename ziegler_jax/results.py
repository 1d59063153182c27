"""What results are made of: codes with their sentences, and named quantities.

A sweep runs thousands of lanes at once and cannot stop at one that fails; every lane
therefore carries a code, and every code a sentence. A result tells a sweep by its
`Variable`s what its numbers are called and mean.
"""

import dataclasses
import enum
from collections.abc import Hashable, Mapping, Sequence
from typing import ClassVar, Generic, NamedTuple, TypeVar

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

    Below `unsettled` the lane's numbers are NaN. All of these but `escaped`, which the
    column does itself, are failures.
    """

    not_computed = 0, "the point was left out or has not been computed yet"
    invalid = 1, "the scene's numbers break a rule, e.g. mu_k > mu_s"
    not_finite = 2, "the motion or its derivative is not a finite number"
    step_vanished = 3, "no step, however small, met the tolerances"
    budget_spent = 4, "the step budget was spent before the span was over"
    chattering = 5, "stick and slip changed again and again without time going on"
    escaped = 6, "a rod's angle passed the named bound, e.g. it turned over"
    unsettled = 7, "neither at rest nor on a cycle by the end of the time"
    stuck = 8, "both joints stuck, or creep, and what is left decays"
    rest = 9, "the same without friction: what is left of the motion decays"
    cycle = 10, "its orbit is certified: closed, stable, and the motion draws near it"
    complete = 11, "the motion was followed to the last of the given times"
    repeats = 12, "two windows agreed in the swing of each joint; not certified"
    conservative = (
        13,
        "the same, but nothing dissipates: another start swings otherwise",
    )


class UNDECIDED(Code):
    """Of which kind a lane is that neither settles nor comes to rest."""

    decided = 0, "it is not undecided, or has not been computed"
    none = 1, "it does not return to phi1 = 0"
    unstable_near = 2, "it was near an unstable cycle, on the way past it"
    slow = 3, "its returns draw near, but too slowly for a certificate"
    aperiodic = 4, "its returns do not draw near: a torus, chaos, a long transient"
    growing = 5, "it grows slowly, on its way to a motion farther out"
    lasting = 6, "it neither falls nor draws near a cycle: a torus or chaos that lasts"


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
    - `codes`: the class of codes of a flag variable, e.g. `OUTCOME`.
    """

    value: Value
    long_name: str
    units: str = "1"
    dims: tuple[str, ...] = ()
    codes: type[Code] | None = None


def labels(variable: Variable) -> dict[str, object]:
    """The attributes of a variable in a dataset."""
    if variable.codes is None:
        return {"long_name": variable.long_name, "units": variable.units}
    return {"long_name": variable.long_name, **flag_attributes(variable.codes)}


def quantity(
    long_name: str,
    units: str = "1",
    dims: tuple[str, ...] = (),
    codes: type[Code] | None = None,
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
        known = {**DIMENSIONS, **self.coordinates()}
        data, coords = {}, {}
        for name, variable in self.variables().items():
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
        known = {int(code): code for code in variable.codes}
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
        metadata=quantity("how the motion ended", codes=OUTCOME)
    )
    settings: Settings = eqx.field(static=True)


# The dimensions that results use, with their coordinates.
DIMENSIONS = {"rod": (1, 2), "joint": (1, 2)}

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
