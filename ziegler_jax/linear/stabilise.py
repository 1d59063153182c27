"""Raise the critical load: follow its gradient through a box of parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import xarray as xr
from jax.core import Tracer

from ..model.chain_of_rods import AbstractChain
from ..numerics.rules import pair
from ..results import CODE
from ..runtime import requires_x64
from .critical_load import CriticalLoad, Kind, critical_load
from .parameters import Make, as_function


class Stabilised(NamedTuple):
    """What `stabilise` found.

    `parameters`: the best values by name; `column`: the column they make; `load`: its
    critical load; `converged`: whether the last step was below the tolerances, else
    the steps were spent, as they are in front of an exchange of the kinds; `history`:
    a dataset along `step` of the parameters, q_cr, frequency and the slope left.
    """

    parameters: dict[str, float]
    column: AbstractChain
    load: CriticalLoad
    converged: bool
    history: xr.Dataset


@requires_x64
def stabilise(
    column: AbstractChain | Make,
    parameters: Mapping[str, tuple[float, float]],
    *,
    kind: Kind = "flutter",
    start: Mapping[str, float] | None = None,
    rtol: float = 1e-10,
    max_steps: int = 256,
) -> Stabilised:
    r"""The parameters within bounds that raise the critical load most.

    BFGS (optimistix) on $-q_{cr}$ with the exact gradient of `critical_load`. Each
    parameter is $p = (lo + hi)/2 + (hi - lo)/2 \sin x$ with x free, so that a best
    value on a bound is reached and not only approached. A step into a column whose
    outcome is not `found` (no such load, or the other kind comes first) is refused:
    the search ends in front of the exchange. What it finds is a local maximum.

    **Arguments:**

    - `column`: a column, whose leaves can be named (`kappa`, `damping.c1`); or a
        function that makes one from keywords. A parameter that spans decades is better
        named by its logarithm, e.g. `lambda log_ratio: ...`.
    - `parameters`: name: (lower bound, upper bound).
    - `kind`: as for `critical_load`.
    - `start`: where to start, by name; else the column's own values, or the middle.
        A start on or outside a bound is moved inside by a hundredth of the width.
    - `rtol`: the relative step at which to stop; `max_steps`: evaluations.

    **Raises:** `ValueError` for no bounds or such that are not low < high, a start
    that is not `found`, `max_steps` below 1, friction, and traced numbers.
    """
    if not isinstance(parameters, Mapping) or not parameters:
        raise ValueError(
            "Argument `parameters` must map at least one name to (low, high), but is "
            f"{parameters!r}."
        )
    if max_steps < 1:
        raise ValueError(f"Argument `max_steps` must be positive, but is {max_steps}.")
    if any(isinstance(x, Tracer) for x in jax.tree.leaves((column, parameters, start))):
        raise ValueError(
            "Arguments `column`, `parameters` and `start` must be concrete numbers, "
            "but some are traced: call `stabilise` outside `jax.jit` and `jax.vmap`."
        )
    make, own = as_function(column, list(parameters))
    start = dict(start or {})
    unknown = set(start) - set(parameters)
    if unknown:
        raise ValueError(f"Argument `start` must name `parameters`, but has {unknown}.")
    low, width, x = {}, {}, {}
    for name, bounds in parameters.items():
        lo, hi = pair(f"parameters[{name!r}]", bounds)
        if not (np.isfinite(lo) and np.isfinite(hi) and lo < hi):
            raise ValueError(
                f"Argument `parameters` must give bounds low < high, but {name!r} has "
                f"({lo}, {hi})."
            )
        first = start.get(name, own[name])
        part = 0.5 if first is None else float((first - lo) / (hi - lo))
        low[name], width[name] = float(lo), float(hi - lo)
        # sin has no slope on a bound: a start there would stay
        x[name] = jnp.arcsin(2 * jnp.clip(jnp.asarray(part), 0.01, 0.99) - 1)

    def values(x):
        return {n: low[n] + width[n] * (1 + jnp.sin(x[n])) / 2 for n in x}

    def objective(x, scale):
        at = values(x)
        load = critical_load(make(**at), kind)
        good = load.outcome == int(CODE.found)
        return jnp.where(good, -load.q_cr * scale, jnp.inf), (at, load)

    (_, (_, load)), slopes = jax.jit(jax.value_and_grad(objective, has_aux=True))(
        x, 1.0
    )
    outcome = CODE(int(load.outcome))
    if outcome is not CODE.found:
        raise ValueError(
            f"Argument `start` must lose stability by {kind} first, but its "
            f"outcome is `{outcome.name}`: {outcome.sentence}."
        )
    # BFGS begins with a step of the slope's length: at most a tenth of the box's pi
    size = float(jnp.sqrt(sum(g * g for g in slopes.values())))
    scale = min(1.0, 0.3 / size) if size > 0 else 1.0
    rtol = max(rtol, 8 * float(jnp.finfo(float).eps))
    solver = optx.BFGS(rtol=rtol, atol=rtol)
    out, aux = eqx.filter_eval_shape(objective, x, scale)
    state = solver.init(objective, x, scale, {}, out, aux, frozenset())

    @eqx.filter_jit
    def advance(x, state):
        x, state, _ = solver.step(objective, x, scale, {}, state, frozenset())
        done, _ = solver.terminate(objective, x, scale, {}, state, frozenset())
        size = jnp.sqrt(sum(g * g for g in jax.tree.leaves(state.f_info.grad)))
        return x, state, done, state.num_accepted_steps, (*state.aux, size / scale)

    rows, accepted, converged = [], 0, False
    for _ in range(max_steps):
        x, state, done, count, row = advance(x, state)
        if int(count) > accepted:
            accepted = int(count)
            rows.append(jax.device_get(row))
        if bool(done):
            converged = True
            break
    best = {name: float(p) for name, p in rows[-1][0].items()}
    best = {name: best[name] for name in parameters}
    chosen = make(**best)
    return Stabilised(
        best, chosen, critical_load(chosen, kind), converged, _history(rows)
    )


def _history(
    rows: list[tuple[dict[str, np.ndarray], CriticalLoad, np.ndarray]],
) -> xr.Dataset:
    at, loads, sizes = zip(*rows, strict=True)
    data = {name: [row[name] for row in at] for name in at[0]}
    data["q_cr"] = [load.q_cr for load in loads]
    data["frequency"] = [load.frequency for load in loads]
    data["slope"] = list(sizes)
    history = xr.Dataset(
        {name: ("step", np.array(rows)) for name, rows in data.items()},
        coords={"step": np.arange(len(rows))},
    )
    history.slope.attrs["long_name"] = "norm of dq_cr/dx in the free coordinates"
    return history
