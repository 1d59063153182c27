"""Long computations in legs: a lane pauses after a number of steps and goes on later.

A vmapped loop runs until its slowest lane ends. A sweep therefore lets every lane run
a leg, replaces those that have ended by new ones, and runs the next leg, as a
hand-written kernel refills its lanes. `settle` offers its state at the end of a leg
here and takes it back at the next; the arithmetic is that of one uninterrupted run.

The sweep sets the legs while it traces a scene; outside a sweep there are none.
"""

from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import get_opaque_trace_state


class Legs:
    """What passes between a sweep and the one computation that runs in legs.

    **Arguments:** `quota`: the most steps of a leg; `fresh`: whether the lane starts;
    `carry`: where it goes on if it does not, None to find out what is carried.
    """

    def __init__(self, quota: Any, fresh: Any, carry: Any):
        """Nothing has asked for legs yet."""
        self.quota, self.fresh, self.carry = quota, fresh, carry
        self.trace = get_opaque_trace_state()
        self.left: Any = None  # the leaves to go on from
        self.running: Any = None  # whether the lane must go on
        self.steps: Any = None  # how many it has taken
        self.calls = 0
        self.refused = False  # whether one asked that cannot run in legs

    def enter(self, start: Any) -> Any:
        """Where this leg begins: at the start or where the last one ended."""
        self.calls += 1
        if self.carry is None:
            return start
        leaves, tree = jax.tree.flatten(start)
        kept = zip(leaves, self.carry, strict=True)
        return tree.unflatten([jnp.where(self.fresh, new, old) for new, old in kept])

    def leave(self, carry: Any, running: Any, steps: Any) -> None:
        """Keep where this leg ended."""
        self.left = jax.tree.leaves(carry)
        self.running, self.steps = running, steps


_CURRENT: ContextVar[Legs | None] = ContextVar("legs", default=None)


def current_legs() -> Legs | None:
    """The legs that a sweep has set, if any.

    None, too, inside a transformation of the scene's own (`vmap`, `jvp`, `jit`): its
    numbers cannot be handed from there to the next leg.
    """
    legs = _CURRENT.get()
    if legs is None:
        return None
    if legs.trace != get_opaque_trace_state():
        legs.refused = True
        return None
    return legs


@contextmanager
def in_legs(legs: Legs):
    """Trace a scene with these legs."""
    token = _CURRENT.set(legs)
    try:
        yield legs
    finally:
        _CURRENT.reset(token)
