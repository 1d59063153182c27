"""Observers side by side, and a motion that is followed for what they see of it."""

from collections.abc import Collection
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..model.state import PhasePoint
from ..model.system import System
from ..numerics.numbers import Flag, Numbers, Scalar
from ..results import CODE, Variable, checked
from ..solvers import AbstractFold, Step
from ..solvers.explicit import Integrand
from .observers import AbstractObserver


class Record(NamedTuple):
    """The observers' states, the length of their span, and where it ended."""

    states: tuple
    span: Scalar
    y: PhasePoint


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

        def joint(t: Scalar, y: PhasePoint) -> Numbers:
            now = system.at(t)
            return sum((o.integrand(now, y) for o in self.observers), ())

        zero, numbers = jnp.zeros(()), 2 * system.joints
        asked = jax.eval_shape(lambda: joint(zero, PhasePoint((zero,) * numbers)))
        return joint if asked else None

    def init(self, system: System, t: Scalar, y: PhasePoint) -> tuple:
        """The state before the first step."""
        now = system.at(t)
        return tuple(observer.init(now, t, y) for observer in self.observers)

    def step(self, system: System, states: tuple, step: Step) -> tuple:
        """All after a step."""
        after, used, system = [], 0, system.at(step.t1)
        for observer, part in zip(self.observers, states, strict=True):
            count = len(observer.integrand(system, step.y1))
            mine = step._replace(integrals=step.integrals[used : used + count])
            after.append(observer.step(system, part, mine))
            used += count
        return tuple(after)

    def variables(
        self, system: System, record: Record, taken: Collection[str] = ()
    ) -> dict[str, Variable]:
        """The observed variables by name.

        **Raises:** `ValueError` for a name that stands twice, or is `taken`.
        """
        named: dict[str, Variable] = {}
        for observer, state in zip(self.observers, record.states, strict=True):
            whose = f"The result of the observer `{observer.name}`"
            result = observer.result(system, state, record.span, record.y)
            for name, variable in checked(whose, result).items():
                if name in named or name in taken:
                    hint = ", which a cycle has" if name == "period" else ""
                    raise ValueError(
                        f"{whose} must name its numbers unlike the result's own and "
                        f"those of other observers, but has `{name}`{hint}."
                    )
                named[name] = variable
        return named


class Watching(AbstractFold[tuple]):
    """A motion for what observers see of it; without any, for its end alone."""

    observation: Observation = Observation(())

    def integrand(self, system):
        """The observers'."""
        return self.observation.integrand(system)

    def init(self, system, t0, y0):
        """The state before the first step."""
        return self.observation.init(system, t0, y0)

    def step(self, system, state, step):
        """They see the step."""
        return self.observation.step(system, state, step), jnp.inf, False

    def outcome(self, state):
        """They never end it."""
        del state
        return jnp.asarray(CODE.not_computed, jnp.int32)
