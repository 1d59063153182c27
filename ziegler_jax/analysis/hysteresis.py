"""A load that rises and falls slowly: the bifurcation diagram with its hysteresis."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..context import plain
from ..model.column import Column, State
from ..motion.integrate import Run
from ..motion.observers import AbstractObserver
from ..motion.scene import check_maker, check_scene, float_state, made, recorded
from ..motion.sequence import in_turn
from ..motion.settle import settled
from ..motion.settle_problem import Settling
from ..numerics.numbers import instance, is_concrete
from ..results import OUTCOME, AbstractResult, Variable
from ..solvers import Explicit

BRANCHES = ("up", "down")


class UpDown(AbstractResult):
    """What a column settles to at each load on the way up and on the way down.

    An attribute for each quantity of `Settled.variables()`, e.g. `joint_amplitude`
    (2, n, 2) and `outcome` (2, n): branch, value, then the quantity's own dimensions.
    The values are in increasing order on both branches.
    """

    found: dict[str, Any]
    described: tuple[tuple[str, Variable], ...] = eqx.field(static=True)
    axis: tuple[str, tuple[float, ...]] = eqx.field(static=True)
    settings: tuple[tuple[str, Any], ...] = eqx.field(static=True)

    def __getattr__(self, name: str) -> Any:
        """The quantity of that name."""
        found = self.__dict__.get("found", {})
        if name in found:
            return found[name]
        raise AttributeError(
            f"`sweep_up_down` did not observe `{name}`: it has {', '.join(found)}."
        )

    def variables(self) -> dict[str, Variable]:
        """All numbers with their names, units and dimensions, for `sweep`."""
        return {n: v._replace(value=self.found[n]) for n, v in self.described}

    def coordinates(self) -> dict[str, Any]:
        """The branches and the values."""
        return {"branch": BRANCHES, self.axis[0]: self.axis[1]}


class _Way(NamedTuple):
    """Where a column is on its way up and down."""

    place: Any  # the number of the motion: 0 to n - 1 up, n to 2n - 1 down
    y: Any  # the state that it takes along
    found: Any


@plain
def sweep_up_down(
    make_column: Callable[[Any], Column],
    values: Any,
    *,
    kick: State,
    start: State | None = None,
    axis: str = "q",
    transient: Any = 0.0,
    window: Any = 40.0,
    max_windows: int = 100,
    rtol_settle: Any = 2e-4,
    observers: tuple[AbstractObserver, ...] = (),
    rtol: Any = 1e-6,
    atol: Any = 1e-6,
    solver: Explicit | None = None,
    escape: Any = np.pi,
    rate_cut: Any = None,
    max_steps: int = 1_000_000,
) -> UpDown:
    r"""Raise the load step by step and lower it again, the last state carried on.

    At each value the motion goes on from where the last one ended, plus `kick`, until
    it settles. Where rest and a cycle coexist the way up shows the one, the way down
    the other.

    ```python
    def point(mu_s, mu_k):
        def column(q):
            law = zj.SetValuedCoulomb(mu_s, mu_k, pin_radius=0.1)
            return zj.uniform_rods(q, friction=law)

        return zj.sweep_up_down(
            column, np.linspace(1, 3, 41), kick=zj.State(omega=(0, 0.05))
        )

    ds = zj.sweep(point, mu_s=mu, mu_k=mu, where=lambda mu_s, mu_k: mu_k <= mu_s)
    ```

    **Arguments:**

    - `make_column`: a function of one number, the load or any other.
    - `values`: that number's, increasing, shape (n,), at least two.
    - `kick`: the disturbance, added to the state at every value. Without one a column
        that rests stays at rest: with set-valued friction at any load.
    - `start`: the first state, and the one after a motion that failed (`escaped` and
        the like); None is the upright column.
    - `axis`: what the values are called in a sweep's dataset.
    - the others as in `settle`.

    **Returns:** `UpDown`.

    **Raises:** `ValueError` for arguments that break a rule.
    """
    values = _increasing(values)
    start = State() if start is None else start
    check_maker(make_column)
    instance("kick", kick, State)
    check_scene(made(make_column, values[0]), start)
    y0, shove = float_state(start), float_state(kick)
    n, dtype = values.size, jnp.result_type(float)
    way = np.stack([np.arange(n), 2 * n - 1 - np.arange(n)]).astype(np.int32)

    def motion(now: _Way) -> Settling:
        here = jnp.where(way == now.place, jnp.asarray(values, dtype)[None, :], 0.0)
        y = [a + b for a, b in zip(now.y, shove, strict=True)]
        return Settling(
            make_column(jnp.sum(here)),
            State(y[:2], y[2:]),
            transient=transient,
            window=window,
            max_windows=max_windows,
            rtol_settle=rtol_settle,
            observers=observers,
            rtol=rtol,
            atol=atol,
            solver=solver,
            escape=escape,
            rate_cut=rate_cut,
            max_steps=max_steps,
        )

    def heard(now: _Way, motion: Settling, run: Run) -> _Way:
        failed = run.outcome < OUTCOME.unsettled
        y = tuple(jnp.where(failed, a, b) for a, b in zip(y0, run.y, strict=True))

        def kept(new: Any, old: Any) -> Any:
            here = (way == now.place).reshape((2, n) + (1,) * jnp.ndim(new))
            return jnp.where(here, jnp.asarray(new)[None, None], old)

        new = {name: v.value for name, v in settled(motion, run).variables().items()}
        return _Way(now.place + 1, y, jax.tree.map(kept, new, now.found))

    first = _Way(jnp.zeros((), jnp.int32), y0, {})
    described: dict[str, Variable] = {}  # what crosses no trace

    def quantities():
        present = motion(first)
        named = settled(present, present.begin()).variables()
        described.update({k: v._replace(value=None) for k, v in named.items()})
        return {name: v.value for name, v in named.items()}

    shapes = jax.eval_shape(quantities)
    empty = {k: jnp.zeros((2, n, *s.shape), s.dtype) for k, s in shapes.items()}
    end, _ = in_turn(
        motion, heard, lambda now: now.place < 2 * n, first._replace(found=empty)
    )
    return UpDown(
        found=end.found,
        described=tuple(
            (name, variable._replace(dims=("branch", axis, *variable.dims)))
            for name, variable in described.items()
        ),
        axis=(axis, tuple(float(v) for v in values)),
        settings=recorded(**motion(first).settings()),
    )


def _increasing(values: Any) -> np.ndarray:
    known = is_concrete(values) and np.ndim(values) == 1 and np.size(values) > 1
    known = np.asarray(values, dtype=float) if known else np.zeros(2)
    if not (np.all(np.isfinite(known)) and np.all(np.diff(known) > 0)):
        raise ValueError(
            "Argument `values` must be at least two finite numbers that increase, but "
            f"is {values!r}."
        )
    return known
