"""A load that rises and falls slowly: the bifurcation diagram with its hysteresis."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, Shaped

from ..model.chain_of_rods import AbstractChain
from ..model.state import PhasePoint, State
from ..motion.checks import Times, check_maker, check_scene, float_state, made
from ..motion.implicit import forward_only
from ..motion.observers import AbstractObserver
from ..motion.options import Method, Windows, recorded
from ..motion.sequence import run_in_sequence
from ..numerics.no_number import refused
from ..numerics.numbers import Scalar, is_concrete
from ..results import CODE, DIMENSIONS, AbstractDescribed, Settings, Variable
from ..runtime import requires_x64
from ..steady.settle import Settling, may_certify, settled, settling

BRANCHES = ("up", "down")
NO_DERIVATIVE = (
    "`sweep_up_down` has no derivatives where cycles are certified: a motion begins "
    "where the one before had its verdict, and that place has none. Ask for "
    "`certify=False`, or for `settle` at each load."
)
TAKEN = ("branch", *DIMENSIONS)  # dimensions of the results


class UpDownSweep(AbstractDescribed):
    """The settled motions at each load on the way up and on the way down.

    An attribute for each quantity of `Settled.variables()`, e.g. `joint_amplitude`
    (2, n, 2) and `outcome` (2, n): branch, value, then the quantity's own dimensions.
    The values are in increasing order on both branches.
    """

    numbers: dict[str, Shaped[Array, "..."]]
    quantities: tuple[tuple[str, Variable], ...] = eqx.field(static=True)
    axis: tuple[str, tuple[float, ...]] = eqx.field(static=True)
    settings: Settings = eqx.field(static=True)

    def coordinates(self) -> dict[str, Sequence[object]]:
        """The branches and the values."""
        return {"branch": BRANCHES, self.axis[0]: self.axis[1]}


class UpDownState(NamedTuple):
    """Where a column is on its way up and down."""

    place: Int[Array, ""]  # the number of the motion: 0 to n - 1 up, n to 2n - 1 down
    y: PhasePoint  # the state that it takes along
    results: dict[str, Shaped[Array, "..."]]


@requires_x64
def sweep_up_down(
    make_column: Callable[[Scalar], AbstractChain],
    values: Times,
    *,
    kick: State,
    start: State | None = None,
    windows: Windows = Windows(),
    observers: Sequence[AbstractObserver] = (),
    method: Method = Method(),
    certify: bool | None = None,
) -> UpDownSweep:
    r"""Raise the load step by step and lower it again, the last state carried on.

    At each value the motion goes on from where the last one ended, plus `kick`, until
    it settles. Where rest and a cycle coexist, the way up shows rest and the way down
    the cycle.

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

    - `make_column`: a function of one number, the load or any other; its argument's
        name is the axis of a sweep's dataset.
    - `values`: of that number, increasing, shape (n,), at least two.
    - `kick`: the disturbance, added to the state at every value. Without one a column
        that rests stays at rest: with set-valued friction at any load.
    - `start`: the first state, and the one after a motion without numbers (`escaped`
        and the like); None is the upright column.
    - `windows`, `observers`, `method`, `certify`: of each motion, as in `settle`. A
        motion ends when it is near a certified cycle: the next one begins there.

    **Returns:** `UpDownSweep`.

    **Derivatives:** with `certify=False` forward, of every motion by its windows, see
    `settle`; else they are refused (`ValueError`).

    **Raises:** `ValueError` for arguments that break a rule.
    """
    values = _increasing(values)
    check_maker(make_column)
    axis = _name_of_the_number(make_column)
    first_column = made(make_column, values[0])
    upright = State(omega=(0.0,) * first_column.joints)
    start = upright if start is None else start
    kick = upright if kick is None else kick
    check_scene(first_column, start)
    check_scene(first_column, kick, "kick")
    y0, shove = float_state(start), float_state(kick)
    n, dtype = values.size, jnp.result_type(float)
    way = np.stack([np.arange(n), 2 * n - 1 - np.arange(n)]).astype(np.int32)

    def motion(now: UpDownState) -> Settling:
        here = jnp.where(way == now.place, jnp.asarray(values, dtype)[None, :], 0.0)
        y = [a + b for a, b in zip(now.y, shove, strict=True)]
        scene = make_column(jnp.sum(here)), State(y[: len(y) // 2], y[len(y) // 2 :])
        if certify is not False and (certify or may_certify(scene[0], method)):
            scene = refused(NO_DERIVATIVE, scene)
        how = windows, observers, method, certify
        return settling(*scene, "sweep_up_down", *how)

    def update(now: UpDownState, motion: Settling, run: Any) -> UpDownState:
        failed = run.outcome < CODE.unsettled
        y = PhasePoint(jnp.where(failed, a, b) for a, b in zip(y0, run.y, strict=True))

        def put(
            new: Shaped[Array, "*dims"], old: Shaped[Array, "2 n *dims"]
        ) -> Shaped[Array, "2 n *dims"]:
            here = (way == now.place).reshape((2, n) + (1,) * jnp.ndim(new))
            return jnp.where(here, jnp.asarray(new)[None, None], old)

        new = {name: v.value for name, v in settled(motion, run).variables().items()}
        return UpDownState(now.place + 1, y, jax.tree.map(put, new, now.results))

    first = UpDownState(jnp.zeros((), jnp.int32), y0, {})
    described: dict[str, Variable] = {}  # what crosses no trace

    def quantities():
        present = motion(first)
        named = settled(present, present.begin()).variables()
        described.update({k: v._replace(value=None) for k, v in named.items()})
        return {name: v.value for name, v in named.items()}

    shapes = jax.eval_shape(quantities)
    if axis in {*TAKEN, *described}:
        raise ValueError(
            "The argument of `make_column` must be called unlike the results' numbers "
            f"and dimensions, but is `{axis}`."
        )
    empty = {k: jnp.zeros((2, n, *s.shape), s.dtype) for k, s in shapes.items()}
    end, _ = run_in_sequence(
        motion, update, lambda now: now.place < 2 * n, first._replace(results=empty)
    )
    return UpDownSweep(
        numbers=forward_only("sweep_up_down", end.results, once=True),
        quantities=tuple(
            (name, variable._replace(dims=("branch", axis, *variable.dims)))
            for name, variable in described.items()
        ),
        axis=(axis, tuple(float(v) for v in values)),
        settings=recorded(**motion(first).settings()),
    )


def _name_of_the_number(make_column: Callable[[Scalar], AbstractChain]) -> str:
    """The name of the function's argument."""
    try:
        (first, *_) = inspect.signature(make_column).parameters.values()
    except (TypeError, ValueError):  # of a function that is not Python's own
        return "value"
    named = first.kind in (first.POSITIONAL_ONLY, first.POSITIONAL_OR_KEYWORD)
    return first.name if named else "value"


def _increasing(values: Times) -> np.ndarray:
    known = is_concrete(values) and np.ndim(values) == 1 and np.size(values) > 1
    known = np.asarray(values, dtype=float) if known else np.zeros(2)
    if not (np.all(np.isfinite(known)) and np.all(np.diff(known) > 0)):
        raise ValueError(
            "Argument `values` must be at least two finite numbers that increase, but "
            f"is {values!r}."
        )
    return known
