"""Numbers that enter the library, and the names that annotations use.

A number is concrete (Python, NumPy) or belongs to JAX (an array, a tracer). Concrete
numbers stay NumPy float64 in a module, so that a scene built in a 32-bit session loses
no digits in a 64-bit sweep; they are validated where they enter. Traced numbers cannot
be validated then: they are checked inside the program and end a lane as `invalid`.
"""

import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

# A number: of JAX (an array of shape (), a tracer), or concrete (Python's or NumPy's
# float64, which is one).
Scalar = Float[Array, ""] | float
Flag = Bool[Array, ""] | bool  # yes or no, known now or traced
Count = Int[Array, ""] | int  # a whole number, known now or traced
Pair = tuple[Scalar, Scalar]  # one number a joint, or one a rod
Flags = tuple[Flag, Flag]  # the same of yes and no
OneOrTwo = Scalar | Pair  # one number for both joints, or one a joint
Two = Sequence[Scalar] | Float[Array, " 2"]  # a pair, and either, as it may be given
Joints = Scalar | Two
Traced = Float[Array, ""]  # a number of JAX alone, and a state of such
Traced4 = tuple[Traced, Traced, Traced, Traced]
Numbers = tuple[Scalar, ...]  # any number of them, e.g. a state and differences
Option = Scalar | str | None  # an option, as the record of a result has it
Vector4 = tuple[Scalar, Scalar, Scalar, Scalar]  # phi1, phi2, omega1, omega2


def is_concrete(x: object) -> bool:
    """Whether the value of `x` is known now, without JAX."""
    return not isinstance(x, jax.Array)


def equals(x: Scalar | None, value: float) -> bool:
    """Whether `x` is known now to be `value`: then a term can be left out."""
    return x is not None and is_concrete(x) and float(x) == value


def number(name: str, x: object, rule: str = "finite") -> Scalar:
    """A scalar as a module keeps it: concrete ones as validated NumPy float64.

    **Arguments:**

    - `name`: the argument's name, for the sentence of the error.
    - `x`: the value.
    - `rule`: `finite`, `nonnegative` or `positive`.

    **Raises:** `ValueError` if `x` is no scalar, or is concrete and breaks the rule.
    """
    if isinstance(x, jax.Array):
        if x.shape != ():
            raise ValueError(
                f"Argument `{name}` must be a single number, but has shape {x.shape}; "
                "use `jax.vmap` or `sweep` for many."
            )
        return x
    if isinstance(x, (str, bytes)) or x is None:
        raise ValueError(f"Argument `{name}` must be a number, but is {x!r}.")
    try:
        x = np.asarray(x, dtype=np.float64)[()]
    except (TypeError, ValueError):
        raise ValueError(f"Argument `{name}` must be a number, but is {x!r}.") from None
    if np.ndim(x) != 0:
        raise ValueError(
            f"Argument `{name}` must be a single number, but has shape {np.shape(x)}; "
            "use `jax.vmap` or `sweep` for many."
        )
    value = float(x)
    good = math.isfinite(value)
    if rule == "nonnegative":
        good = good and value >= 0
    elif rule == "positive":
        good = good and value > 0
    if not good:
        rule = "finite" if rule == "finite" else f"finite and {rule}"
        raise ValueError(f"Argument `{name}` must be {rule}, but is {value:g}.")
    return cast(np.float64, x)


def article(kind: type) -> str:
    """Of its name."""
    return "an" if kind.__name__[0] in "AEIOU" else "a"


def instance(name: str, x: object, kind: type) -> None:
    """Refuse what is not of a class."""
    if not isinstance(x, kind):
        raise ValueError(
            f"Argument `{name}` must be {article(kind)} `{kind.__name__}`, but is "
            f"{x!r}."
        )


def choice(name: str, x: object, known: Sequence[str]) -> None:
    """Refuse what is none of the known names."""
    if not isinstance(x, str) or x not in known:
        raise ValueError(
            f"Argument `{name}` must be one of {', '.join(known)}, but is {x!r}."
        )


def whole_number(name: str, x: int) -> int:
    """A count of at least one, validated."""
    whole = isinstance(x, (int, np.integer)) and not isinstance(x, bool)
    if not whole or not 1 <= x < 2**31:  # steps are counted in 32 bits
        raise ValueError(
            f"Argument `{name}` must be a whole number of at least 1 and below 2^31, "
            f"but is {x!r}."
        )
    return int(x)


def keeps(rule: str, *numbers: Scalar | None) -> Flag:
    """Whether traced numbers keep a rule of `number`; concrete ones do, None is none.

    **Returns:** True, or a traced boolean.
    """
    good: Flag = True
    for x in numbers:
        if x is None or is_concrete(x):
            continue
        good &= _holds(rule, x)
    return good


def checked(rules: Mapping[str, str], **values: Joints | None) -> list[Any]:
    """Numbers as a module keeps them, by a table of rules.

    **Arguments:** `rules`: for each name a rule of `number`, and what there may be
    beside one number: `positive; two`, a pair, one a joint; `positive; two or none`.

    **Raises:** `ValueError` as `number`.
    """
    numbers = []
    for name, x in values.items():
        rule, beside = _read(rules, name)
        read = number_or_pair if "two" in beside else number
        absent = x is None and "none" in beside
        numbers.append(None if absent else read(name, cast(Joints, x), rule))
    return numbers


def keeps_rules(rules: Mapping[str, str], owner: eqx.Module) -> Flag:
    """Whether an object's numbers keep the same rules: those only known when traced.

    **Raises:** `ValueError` for a rule that is none.
    """
    good: Flag = True
    for name in rules:
        (rule, _), value = _read(rules, name), getattr(owner, name)
        for x in jax.tree.leaves(value):
            holds = _holds(rule, jnp.asarray(x))
            good &= jnp.all(holds) if holds.ndim else holds
    return good


def _holds(rule: str, x: Scalar) -> Bool[Array, "..."]:
    """Whether JAX's numbers keep a rule."""
    if rule == "finite":
        return jnp.isfinite(x)
    return jnp.isfinite(x) & (x > 0 if rule == "positive" else x >= 0)


def _read(rules: Mapping[str, str], name: str) -> tuple[str, str]:
    """A rule, and what there may be beside one number."""
    rule, _, beside = rules[name].partition("; ")
    if rule not in ("finite", "nonnegative", "positive"):
        raise ValueError(
            f"The rule of `{name}` must be `finite`, `nonnegative` or `positive`, but "
            f"is {rule!r}."
        )
    return rule, beside


def positive(**values: Scalar) -> list[Scalar]:
    """Positive numbers; NaN for a traced one that is not, so that its lane is invalid.

    Without it a negative mass could still make a positive definite inertia.
    """
    checked = [number(name, value, "positive") for name, value in values.items()]
    return [x if is_concrete(x) else jnp.where(x > 0, x, jnp.nan) for x in checked]


def check_options(
    who: str,
    options: Mapping[str, object],
    known: Callable[..., object] | Iterable[str],
) -> None:
    """Raise `TypeError` for an option that is none of `who`.

    **Arguments:** `known`: their names, or a function whose keywords they are.
    """
    if callable(known):
        parameters = inspect.signature(known).parameters.values()
        known = [p.name for p in parameters if p.kind is p.KEYWORD_ONLY]
    known = list(known)
    for name in options:
        if name not in known:
            raise TypeError(
                f"`{who}` has no option `{name}`; its options are {', '.join(known)}."
            )


def pair(name: str, x: Two, rule: str = "finite") -> Pair:
    """Two numbers, from a sequence or an array of length 2."""
    try:
        first, second = x
    except (TypeError, ValueError):
        raise ValueError(
            f"Argument `{name}` must be two numbers, but is {x!r}."
        ) from None
    return number(f"{name}[0]", first, rule), number(f"{name}[1]", second, rule)


def number_or_pair(name: str, x: Joints, rule: str = "finite") -> OneOrTwo:
    """One number for both joints, or a tuple with one a joint."""
    if isinstance(x, (tuple, list)) or np.ndim(cast(float, x)) == 1:
        return pair(name, cast(Two, x), rule)
    return number(name, x, rule)


def both(x: OneOrTwo) -> Pair:
    """A number or a pair, as a pair."""
    return x if isinstance(x, tuple) else (x, x)
