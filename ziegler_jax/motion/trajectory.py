"""`trajectory`: the states of a motion at given times, and its events.

Nothing is interpolated between steps, which end on both.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float, Int

from ..model.chain_of_rods import AbstractChain
from ..model.state import State
from ..numerics.numbers import Count, Flag, Numbers, Scalar, is_concrete
from ..numerics.rules import keeps, whole_number
from ..results import (
    CODE,
    OUTCOMES,
    RATE,
    TIME,
    AbstractResult,
    Settings,
    Variable,
    labels,
    quantity,
)
from ..solvers import AbstractFold, Explicit
from . import not_finite
from .checks import Times, check_scene, float_state, increasing_times, valid_scene
from .ending import nan_where
from .implicit import forward_only
from .integrate import FIRST_STEP, Motion, follow
from .method import method_of, usual_method
from .options import Method, recorded


class Events(eqx.Module):
    """Changes of modes with set-valued friction, in order; the first is the start.

    `times` (n,), NaN where there is no event; `joints` (n,): 1, 2, 4, ... for joint 1,
    2, 3, ..., of several at once their sum, 0 for the start; `modes` (n, joints) after
    the event: 1 and -1 slip, 0 sticks; `count`: the number of events, which may exceed
    that of the recorded ones.
    """

    times: Float[Array, "*lanes n"]
    joints: Int[Array, "*lanes n"]
    modes: Int[Array, "*lanes n joints"]
    count: Int[Array, "*lanes"]

    def variables(self) -> dict[str, Variable]:
        """`event_times(event)`, `event_joints`, `event_modes`, `event_count`."""
        joints, modes = "joints that changed, 1, 2, 4, ...", "1 and -1 slip, 0 sticks"
        along = ("event",)
        return {
            "event_times": Variable(self.times, "time of the event", TIME, along),
            "event_joints": Variable(self.joints, joints, dims=along),
            "event_modes": Variable(self.modes, modes, dims=(*along, "joint")),
            "event_count": Variable(self.count, "changes of modes"),
        }


class Recorded(NamedTuple):
    """The state of `Record`."""

    events: Events | None
    ys: Float[Array, "numbers n"]  # the states at `ts`, NaN where the lane has not been
    recorded_count: Int[Array, ""]  # how many of them are there
    outcome: Int[Array, ""]


class Record(AbstractFold[Recorded]):
    """The states at given times, on which steps end, and room for `size` events.

    There are none without stick and slip.
    """

    ts: Float[Array, " n"]
    size: int

    def init(self, system, t0, y0):
        """The start, with the modes that it begins in."""
        n, dtype, events = self.size, jnp.result_type(y0[0]), None
        if system.sticks:
            none = Events(
                jnp.full(n, jnp.nan, dtype),
                jnp.zeros(n, jnp.int32),
                jnp.zeros((n, system.joints), jnp.int32),
                jnp.zeros((), jnp.int32),
            )
            events = _with(none, True, t0, 0, system.law.modes)
        ys = jnp.full((len(y0), self.ts.shape[0]), jnp.nan, dtype)
        ys = ys.at[:, 0].set(jnp.stack(y0))
        none = jnp.asarray(CODE.not_computed, jnp.int32)
        return Recorded(events, ys, jnp.array(1, jnp.int32), none)

    def step(self, system, state, step):
        """Add the event on which the step ended, and the state if it was waited for."""
        del system
        events = state.events
        if step.modes:
            assert events is not None and step.event
            joint, modes = step.event
            events = _with(events, joint > 0, step.t1, joint, modes)
        due = step.t1 >= self.ts[state.recorded_count]
        beyond = self.ts.shape[0]  # what is put there is dropped
        place = jnp.where(due, state.recorded_count, beyond)
        ys = state.ys.at[:, place].set(jnp.stack(step.y1), mode="drop")
        recorded_count = state.recorded_count + due.astype(jnp.int32)
        over = recorded_count >= self.ts.shape[0]
        following = self.ts[jnp.minimum(recorded_count, self.ts.shape[0] - 1)]
        outcome = jnp.where(over, CODE.complete, state.outcome).astype(jnp.int32)
        return Recorded(events, ys, recorded_count, outcome), following, over


def _with(
    log: Events, happened: Flag, t: Scalar, joint: Count, modes: Numbers
) -> Events:
    place = jnp.where(happened, log.count, log.times.shape[0])  # beyond: dropped
    row = jnp.stack(modes).astype(jnp.int32)
    return Events(
        log.times.at[place].set(t, mode="drop"),
        log.joints.at[place].set(joint, mode="drop"),
        log.modes.at[place].set(row, mode="drop"),
        log.count + jnp.where(happened, 1, 0),
    )


class Trajectory(AbstractResult):
    """A time history: `ts` (n,), `phi` and `omega` (n, rods), `outcome`.

    Where the motion ended early, angles and rates after it are NaN and `outcome` says
    why; otherwise it is `complete`. With set-valued friction `events` lists the changes
    of modes; else it is None. In a dataset `ts` is the dimension of the others; where
    times are traced, it is a variable over the dimension `sample`.
    """

    ts: Float[Array, "*lanes n"]
    phi: Float[Array, "*lanes n rods"]
    omega: Float[Array, "*lanes n rods"]
    steps: Int[Array, "*lanes"] = eqx.field(metadata=quantity("attempted steps"))
    outcome: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("how the motion ended", codes=OUTCOMES)
    )
    settings: Settings = eqx.field(static=True, default=())
    events: Events | None = None
    times: tuple[float, ...] | None = eqx.field(static=True, default=None)  # if known

    @property
    def in_si(self) -> bool:
        """Whether `SI.restore` has made it: in s and rad/s."""
        return ("units", "SI") in self.settings

    def variables(self) -> dict[str, Variable]:
        """All numbers with their names, units and dimensions."""
        own = self._variables()
        if not self.in_si:
            return own
        si = {TIME: "s", RATE: "rad/s"}
        return {n: v._replace(units=si.get(v.units, v.units)) for n, v in own.items()}

    def to_dataset(self) -> xr.Dataset:
        """The time history with names and units; see `event_dataset` for its events."""
        alone = eqx.tree_at(lambda t: t.events, self, None, is_leaf=lambda x: x is None)
        ds = AbstractResult.to_dataset(alone)
        if self.in_si and "ts" in ds.coords:
            ds["ts"].attrs["units"] = "s"
        return ds

    def event_dataset(self) -> xr.Dataset:
        """The changes of modes with names and units, as many as there are.

        Of several lanes as many as the longest has; `event_count` says how many are a
        lane's own.

        **Raises:** `ValueError` for a motion without stick and slip, which has none.
        """
        if self.events is None:
            raise ValueError(
                "The motion must have set-valued friction, whose modes change, for "
                "`event_dataset`, but has none."
            )
        named = self.events.variables()
        room = self.events.times.shape[-1]
        longest = min(int(np.max(np.asarray(self.events.count))), room)
        data = {}
        for name, variable in named.items():
            values = np.asarray(variable.value)
            lanes = [f"lane_{i + 1}" for i in range(values.ndim - len(variable.dims))]
            dims = (*lanes, *variable.dims)
            units = "s" if self.in_si and variable.units == TIME else variable.units
            cut = {"event": slice(longest)} if "event" in dims else {}
            labelled = xr.Variable(dims, values, labels(variable._replace(units=units)))
            data[name] = labelled.isel(cut)
        joints = range(1, self.events.modes.shape[-1] + 1)
        return xr.Dataset(data, {"joint": list(joints)}, self.attributes())

    def _variables(self) -> dict[str, Variable]:
        along = "sample" if self.times is None else "ts"
        angle, rate = "angle of the rod", "rate of the rod"
        named = {
            "phi": Variable(self.phi, angle, "rad", (along, "rod")),
            "omega": Variable(self.omega, rate, RATE, (along, "rod")),
        }
        if self.times is None:
            named["ts"] = Variable(self.ts, "time", TIME, (along,))
        if self.events is not None:
            named |= self.events.variables()
        return named | super().variables()

    def coordinates(self) -> dict[str, Sequence[object]]:
        """The times, where they are known."""
        return {} if self.times is None else {"ts": self.times}


@not_finite.motion
def trajectory(
    column: AbstractChain,
    start: State,
    ts: Times,
    *,
    max_events: int = 1000,
    method: Method = Method(),
) -> Trajectory:
    r"""The motion of a column at the times `ts`.

    Steps end on every one of `ts`: nothing is interpolated.

    **Arguments:**

    - `column`, `start`: the column or chain, and its state at `ts[0]`.
    - `ts`: increasing times in $\sqrt{m l^2/k}$, shape (n,), at least two.
    - `max_events`: the number of events that are recorded, with set-valued friction.
    - `method`: any, see `Method`.

    **Returns:** `Trajectory`.

    **Derivatives:** forward, of the steps, also in the times. Second ones are
    refused (`ValueError`) with set-valued friction.

    **Raises:** `ValueError` as `settle`, and for times that do not increase.
    """
    check_scene(column, start)
    system = column.system()
    usual = usual_method(system) if system.sticks else Explicit(dfx.Dopri8.tableau)
    method = method_of("trajectory", method, system, usual)
    y0 = float_state(start)
    given, ts = ts, increasing_times(ts, jnp.result_type(y0[0]))
    times = tuple(np.asarray(given, float).tolist()) if is_concrete(given) else None
    good = valid_scene(column, y0) & keeps("positive", method.rtol, method.atol)
    good &= jnp.all(jnp.diff(ts) > 0) & jnp.all(jnp.isfinite(ts))
    # diffrax refuses bad times, and a span of none; nothing moves on from NaN
    ts = jnp.where(good, ts, jnp.arange(ts.size, dtype=ts.dtype))
    y0 = nan_where(~good, y0)
    run = follow(
        Motion(
            system,
            y0,
            Record(ts, whole_number("max_events", max_events)),
            method,
            valid=good,
            start=ts[0],
            first_step=jnp.minimum(FIRST_STEP, ts[1] - ts[0]),
            first_stop=ts[1],
            end=ts[-1],
        )
    )
    ys = run.folded.ys.T
    history = Trajectory(
        ts=ts,
        phi=ys[:, : system.joints],
        omega=ys[:, system.joints :],
        steps=run.steps,
        outcome=run.outcome.astype(jnp.int8),
        settings=recorded(**method.settings(), max_events=max_events),
        events=run.folded.events,
        times=times,
    )
    return forward_only("trajectory", history, once=system.sticks)
