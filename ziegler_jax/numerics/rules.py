"""Rules that numbers keep, where they enter and where they are traced.

Concrete numbers are validated where they enter. Traced ones cannot be: they are checked
inside the program, by the same rules, and end a lane as `invalid`.
"""

import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from ..results import Units
from .numbers import (
    Flag,
    Joints,
    Numbers,
    OneOrEach,
    Pair,
    Scalar,
    Several,
    Two,
    is_concrete,
)

# of each rule that binds several numbers: these, whether they keep it, and what to say
# if they do not
Invariants = Iterable[tuple[Numbers, Callable[..., Flag], str]]


class AbstractRuled(eqx.Module):
    """Numbers that keep rules.

    `rules` names for each of them the rule that it keeps: `finite`, `nonnegative`,
    `positive`; `invariants` gives those that bind several, the sentence's braces being
    filled with the numbers. Concrete numbers that break one are refused, a lane in
    which traced ones do ends as `invalid`.
    `units` names for each of them its unit, for `SI.scaled` alone: `1`, `rad`, another
    one that it lists, or the powers of m, l and k.
    """

    rules: ClassVar[Mapping[str, str]] = {}
    units: ClassVar[Units] = {}

    def invariants(self) -> Invariants:
        """Rules that bind several numbers."""
        return ()

    def refuse_broken(self) -> None:
        """Raise the sentence of an invariant that concrete numbers break."""
        for numbers, keep, sentence in self.invariants():
            if all(map(is_concrete, numbers)) and not keep(*numbers):
                raise ValueError(sentence.format(*numbers))

    def valid(self) -> Flag:
        """Whether the numbers, and those of its parts, keep their rules."""
        good = keeps_rules(self.rules, self)
        for numbers, keep, _ in self.invariants():
            good &= keep(*numbers)
        for part in _parts(self):
            good &= part.valid()
        return good


def _parts(owner: AbstractRuled) -> Iterable[AbstractRuled]:
    """What of it has rules of its own, alone or in a tuple."""
    for part in vars(owner).values():
        several = part if isinstance(part, tuple) else (part,)
        yield from (x for x in several if isinstance(x, AbstractRuled))


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
    beside one number: `positive; each`, one a joint; `positive; each or none`.

    **Raises:** `ValueError` as `number`.
    """
    numbers = []
    for name, x in values.items():
        rule, beside = _read(rules, name)
        read = number_or_each if "each" in beside else number
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


def several(name: str, x: Several, rule: str = "finite") -> Numbers:
    """Numbers, one a rod, from a sequence or an array; at least two."""
    try:
        numbers = list(x)
    except TypeError:
        numbers = []
    if isinstance(x, str) or len(numbers) < 2:
        raise ValueError(
            f"Argument `{name}` must be at least two numbers, one a rod or joint, but "
            f"is {x!r}."
        )
    return tuple(number(f"{name}[{i}]", n, rule) for i, n in enumerate(numbers))


def number_or_each(name: str, x: Joints, rule: str = "finite") -> OneOrEach:
    """One number for all joints, or a tuple with one a joint."""
    if isinstance(x, (tuple, list)) or np.ndim(cast(float, x)) == 1:
        return several(name, cast(Several, x), rule)
    return number(name, x, rule)


def fit(owner: AbstractRuled, n: int) -> None:
    """Refuse numbers, its own or of its parts, that are one a joint of another count.

    **Raises:** `ValueError`.
    """
    for name in owner.rules:
        x = getattr(owner, name)
        several = "each" in _read(owner.rules, name)[1]
        if several and isinstance(x, tuple) and len(x) != n:
            raise ValueError(
                f"Argument `{name}` of `{type(owner).__name__}` must be one number, or "
                f"one for each of {n} joints, but is {len(x)} numbers."
            )
    for part in _parts(owner):
        fit(part, n)
