"""Several observers as one: what is watched while a motion runs."""

from collections.abc import Collection
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..model.state import PhasePoint
from ..model.system import System
from ..motion.observers import AbstractObserver
from ..numerics.numbers import Flag, Numbers, Scalar
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

    def integrand(self, system: System) -> Integrand | None:
        """The integrands of all, one after the other; None if there is none."""

        def joint(y: PhasePoint) -> Numbers:
            return sum((o.integrand(system, y) for o in self.observers), ())

        asked = jax.eval_shape(lambda: joint(PhasePoint((jnp.zeros(()),) * 4)))
        return joint if asked else None

    def init(self, system: System, t: Scalar, y: PhasePoint) -> tuple:
        """Nothing seen yet."""
        return tuple(observer.init(system, t, y) for observer in self.observers)

    def step(self, system: System, states: tuple, step: Step) -> tuple:
        """All after a step."""
        after, used = [], 0
        for observer, part in zip(self.observers, states, strict=True):
            count = len(observer.integrand(system, step.y1))
            mine = step._replace(integrals=step.integrals[used : used + count])
            after.append(observer.step(system, part, mine))
            used += count
        return tuple(after)

    def variables(
        self, system: System, record: "Record", taken: Collection[str] = ()
    ) -> dict[str, Variable]:
        """What they amount to, by name.

        **Raises:** `ValueError` for a name that stands twice, or is `taken`.
        """
        named: dict[str, Variable] = {}
        for observer, state in zip(self.observers, record.states, strict=True):
            whose = f"The result of the observer `{observer.name}`"
            result = observer.result(system, state, record.span, record.y)
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
    y: PhasePoint
