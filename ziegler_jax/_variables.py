"""How a result of the library tells a sweep what its numbers are called and mean."""

from typing import Any, NamedTuple

import numpy as np

from .outcome import REGIME, Code


class Variable(NamedTuple):
    """One named quantity of a result.

    `value` has the shape that `dims` names; under `vmap` lanes stand in front.
    """

    value: Any
    long_name: str
    units: str = "1"
    dims: tuple[str, ...] = ()
    codes: type[Code] | None = None  # for flag variables


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
    "v_smooth": ("smoothing rate", "sqrt(k/(m l^2))", "$v_{smooth}$"),
    "v_stribeck": ("Stribeck rate", "sqrt(k/(m l^2))", "$v_{stribeck}$"),
    "kappa": ("stiffness ratio k1/k2", "1", r"$\kappa$"),
    "eta": ("follower fraction", "1", r"$\eta$"),
    "follower": ("follower fraction", "1", r"$\eta$"),
    "c1": ("damping of joint 1", "sqrt(k m l^2)", "$c_1$"),
    "c2": ("damping of joint 2", "sqrt(k m l^2)", "$c_2$"),
    "phi1": ("angle of rod 1 at the start", "rad", r"$\varphi_1$"),
    "phi2": ("angle of rod 2 at the start", "rad", r"$\varphi_2$"),
    "omega1": ("rate of rod 1 at the start", "sqrt(k/(m l^2))", r"$\dot\varphi_1$"),
    "omega2": ("rate of rod 2 at the start", "sqrt(k/(m l^2))", r"$\dot\varphi_2$"),
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
                '"what it is", "its unit")`, from `ziegler_jax.observers`.'
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
