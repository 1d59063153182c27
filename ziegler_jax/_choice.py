r"""`solver="auto"`: an explicit or a stiff method, by the field's Jacobian at rest.

There, $J = [[0, I], [P, Q]]$. Rates decay with about $\lambda = -\mathrm{tr}\, Q$
($15.4\, \tau_s / v_{smooth}$ for uniform rods with one torque at both joints), the
column moves at rates up to about $\omega = \sqrt{\|P\|_F}$. Steps that meet tolerances
are about $rtol^{1/5} / \omega$ long: a lane is stiff where these decay times are
shorter,

$$\lambda\, rtol^{1/5} > \omega.$$

On a map of friction cycles and sticking columns (q = 1..4, tau = 0.002..0.16, v_smooth
= 0.0003..0.1) that is where the methods' total costs cross, within a factor of 1.5 in
$\lambda$, for tolerances from 1e-4 to 1e-10.

A compiled program holds one method. Where numbers are known the choice is made in
Python; a sweep asks for it first, lane by lane, and compiles a program for each kind.
"""

from collections.abc import Callable
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.extend.core import get_opaque_trace_state

from ._interrupt import held_interrupts
from .column import Column
from .outcome import SOLVER
from .stiffness import is_stiff

AUTO = "auto"
AT_ONCE = 8192  # points asked for in one call


class Undecided(ValueError):
    """The choice depends on numbers that are not known yet.

    `stiff` is what it depends on, in the trace in which it was asked for.
    """

    def __init__(self, stiff: Any):
        """Keep the traced answer."""
        super().__init__(
            "Argument `solver` must be named where numbers are traced, but is 'auto': "
            "use `sweep`, which groups lanes by kind, or give `Explicit()` or "
            "`Rosenbrock()`."
        )
        self.stiff = stiff
        self.trace = get_opaque_trace_state()


_KIND: ContextVar[SOLVER | None] = ContextVar("kind", default=None)


@contextmanager
def lanes_of(kind: SOLVER | None):
    """Trace a scene whose lanes are all of this kind; None: not known."""
    token = _KIND.set(kind)
    try:
        yield
    finally:
        _KIND.reset(token)


def kind_of(column: Column, rtol: Any) -> SOLVER:
    """The kind of a lane.

    **Raises:** `Undecided` where it depends on traced numbers outside of `lanes_of`.
    """
    kind = _KIND.get()
    if kind is not None:
        return kind
    if any(isinstance(x, Tracer) for x in jax.tree.leaves((column, rtol))):
        raise Undecided(is_stiff(column, rtol))
    with jax.ensure_compile_time_eval():
        return SOLVER.stiff if bool(is_stiff(column, rtol)) else SOLVER.explicit


@held_interrupts()
def stiff_points(
    point: Callable, grid: dict[str, np.ndarray], valid: np.ndarray, wide: bool
) -> np.ndarray:
    """Which of the valid points `solver="auto"` calls stiff: booleans on the grid."""
    names, axes = tuple(grid), list(grid.values())
    dtype = np.float64 if wide else np.float32

    def ask(values):
        return _asks(point, dict(zip(names, values, strict=True)))

    found = np.zeros(valid.shape, bool)
    points = np.flatnonzero(valid)
    with jax.enable_x64(wide):
        run = jax.jit(jax.vmap(ask))
        for first in range(0, points.size, AT_ONCE):
            some = points[first : first + AT_ONCE]
            # always the same size, or it would be compiled again
            places = np.unravel_index(np.resize(some, AT_ONCE), valid.shape)
            values = [a[p].astype(dtype) for a, p in zip(axes, places, strict=True)]
            found.flat[some] = np.asarray(run(values))[: some.size]
    return found


def _asks(point: Any, values: dict[str, Any]) -> jax.Array:
    """Whether the first motion of `point` that is chosen for is stiff, traced."""
    here = get_opaque_trace_state()
    try:
        point(**values)
    except Undecided as question:
        if question.trace != here:
            raise ValueError(
                "Argument `solver` must be named inside a transformation (`vmap`, "
                "`jvp`, a loop) of a sweep's point, but is 'auto'."
            ) from None
        return question.stiff
    return jnp.zeros((), bool)
