"""Several observers as one: what is watched while a motion runs."""

from collections.abc import Collection
from typing import NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp

from ..model.column import Column
from ..motion.observers import AbstractObserver
from ..numerics.numbers import Flag, Numbers, Scalar, Traced, Traced4, Vector4
from ..results import Variable, checked
from ..solvers import Step
from ..solvers.explicit import Integrand


class Observation(eqx.Module):
    """Observers side by side; their running numbers are a tuple, one part each."""

    observers: tuple[AbstractObserver, ...]

    def valid(self) -> Flag:
        """Whether their numbers keep their rules; for those only known when traced."""
        good: Flag = True
        for observer in self.observers:
            good &= observer.valid()
        return good

    def integrand(self, column: Column) -> Integrand | None:
        """The integrands of all, one after the other; None if there is none."""

        def joint(y: Vector4) -> Numbers:
            return sum((o.integrand(column, y) for o in self.observers), ())

        zero = jax.ShapeDtypeStruct((), jnp.result_type(float))
        return joint if jax.eval_shape(joint, (zero,) * 4) else None

    def init(self, column: Column, t: Traced, y: Traced4) -> tuple:
        """Nothing seen yet."""
        return tuple(observer.init(column, t, y) for observer in self.observers)

    def step(self, column: Column, states: tuple, step: Step) -> tuple:
        """All after a step."""
        after, used = [], 0
        for observer, part in zip(self.observers, states, strict=True):
            count = len(observer.integrand(column, step.y1))
            mine = step._replace(integrals=step.integrals[used : used + count])
            after.append(observer.step(column, part, mine))
            used += count
        return tuple(after)

    def variables(
        self, column: Column, record: "Record", taken: Collection[str] = ()
    ) -> dict[str, Variable]:
        """What they amount to, by name.

        **Raises:** `ValueError` for a name that stands twice, or is `taken`.
        """
        named: dict[str, Variable] = {}
        for observer, state in zip(self.observers, record.states, strict=True):
            whose = f"The result of the observer `{observer.name}`"
            result = observer.result(
                column, state, record.span, cast(Vector4, record.y)
            )
            for name, variable in checked(whose, result).items():
                if name in named or name in taken:
                    hint = ", which a certificate has" if name == "period" else ""
                    raise ValueError(
                        f"{whose} must name its numbers unlike those of `settle` and "
                        f"of other observers, but has `{name}`{hint}."
                    )
                named[name] = variable
        return named


class Record(NamedTuple):
    """What observers have seen: over how long a span, and where it ended."""

    states: tuple
    span: Scalar
    y: Vector4
