r"""Observed numbers of a cycle: a motion from its start over exactly one turn.

A number g of the turn depends on the start, the period and the scene, which the motion
is followed with once more,

$$dg = \partial_{y_0} g\, dy_0 + \partial_T g\, dT + \partial_p g\, dp.$$
"""

from collections.abc import Collection, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..model.chain_of_rods import AbstractChain
from ..model.state import PhasePoint
from ..motion.checks import with_amplitude
from ..motion.implicit import fixed, implicit, moving
from ..motion.integrate import Motion, Run, follow
from ..motion.observation import Observation, Record, Watching
from ..motion.observers import AbstractObserver, Period
from ..motion.options import Method
from ..numerics.numbers import Flag, Scalar
from ..results import CODE, Variable
from ..solvers import Explicit
from ..steady.derivative import floats, with_zeros
from ..steady.growth import Growth
from ..steady.settle import nan_where_failed
from .shooting import SHORTEST


def observation_of(
    question: str, observers: Sequence[AbstractObserver], column: AbstractChain
) -> Observation:
    """The observers beside those of a cycle's own numbers, amplitude and period.

    **Raises:** `ValueError` for what is none, or watches no cycle.
    """
    _, *chosen = with_amplitude(observers, column.system())
    if any(isinstance(observer, Growth) for observer in chosen):
        raise ValueError(
            f"Argument `observers` must not contain `Growth()` in `{question}`, which "
            "watches no motion from its kick on, but does: see `settle`."
        )
    return Observation(tuple(o for o in chosen if not isinstance(o, Period)))


class OneTurn:
    """The motion over one turn of a cycle, and what the observers see of it."""

    def __init__(self, column: AbstractChain, observation: Observation):
        """Part the numbers that move from the others."""
        self.p, self.make = moving((column, observation), jnp.result_type(float))
        self.valid, self.size = observation.valid(), 2 * column.joints

    def motion(
        self, a: Float[Array, " a"], method: Method, good: Flag = True
    ) -> Motion[tuple]:
        """From y0 over the span T, a = (y0, T, p); `good`: whether there is a cycle.

        By Tsit5: between the ends of long steps observers would see little.
        """
        method = Method(Explicit(), *method.tolerances).at_most(method.budget)
        s = self.size
        column, observation = self.make(a[s + 1 :])
        start, good = PhasePoint(a[i] for i in range(s)), self.valid & good
        span = jnp.where(good, a[s], SHORTEST)
        watching = Watching(observation)
        return Motion(column.system(), start, watching, method, end=span, valid=good)

    def follow(
        self, y0: Float[Array, " s"], period: Scalar, method: Method, good: Flag
    ) -> Run[tuple]:
        """It, without derivatives."""
        return follow(self.motion(fixed(self._ambient(y0, period)), method, good))

    def numbers(
        self,
        run: Run[tuple],
        y0: Float[Array, " s"],
        period: Scalar,
        method: Method,
        taken: Collection[str],
    ) -> dict[str, Variable]:
        """By name, with derivatives, NaN where the motion failed.

        **Arguments:** `run`: the motion's end; `method`: of the motions that are
        differentiated; `taken`: names that are.
        """
        a = self._ambient(y0, period)

        def seen_by(a: Float[Array, " a"], run: Run[tuple]) -> dict[str, Variable]:
            column, observation = self.make(a[self.size + 1 :])
            record = Record(run.folded, a[self.size], run.y)
            return observation.variables(column.system(), record, taken)

        def slope(a: Float[Array, " a"], method: Method) -> Float[Array, "m a"]:
            def values(a: Float[Array, " a"]) -> Float[Array, " m"]:
                motion = self.motion(a, method)
                return floats(seen_by(a, motion.advance(motion.begin())))

            return jax.jacfwd(values)(a)

        named = seen_by(fixed(a), run)
        zeros = implicit(floats(named).shape, slope, a, method)
        return nan_where_failed(run.outcome != CODE.complete, with_zeros(named, zeros))

    def _ambient(self, y0: Float[Array, " s"], period: Scalar) -> Float[Array, " a"]:
        return jnp.concatenate([y0, jnp.asarray(period)[None], self.p])
