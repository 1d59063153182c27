"""The designer's table: what each parameter does to the critical load."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax.core import Tracer

from ..model.chain_of_rods import AbstractChain
from ..numerics.numbers import Scalar
from ..results import CODE
from ..runtime import requires_x64
from .critical_load import CriticalLoad, Kind, critical_load
from .parameters import Make, as_function
from .spectrum import linearise


@requires_x64
def sensitivity(
    column: AbstractChain | Make,
    kind: Kind = "flutter",
    *,
    parameters: Mapping[str, Scalar] | Iterable[str] | None = None,
) -> xr.Dataset:
    r"""Derivatives and elasticities of the critical load, parameter by parameter.

    **Arguments:**

    - `column`: a column, whose leaves are the parameters (`kappa`, `damping.c1`, ...);
        or a function that makes one from keywords, e.g. `uniform_rods` for masses and
        lengths.
    - `kind`: as for `critical_load`.
    - `parameters`: which leaves, by default all that the linear map uses; for a
        function its arguments and their values, e.g. `dict(m1=1.0, m2=1.0)`.

    **Returns:** a dataset along `parameter` with `value` p, `derivative`
    $dq_{cr}/dp$ and `elasticity` $(p/q_{cr})\,dq_{cr}/dp$, the per cent of load that
    a per cent of p brings; `attrs` hold q_cr, the frequency, kind and outcome.
    `print(table.to_dataframe())` shows it row by row; the dataset's own print leaves
    out the middle beyond six parameters unless it is given room,
    `xr.set_options(display_width=120)`. At C = 0 exactly, where q_cr jumps, what
    changes the damping has derivative NaN: seen by its derivative and by steps of a
    thousandth.

    **Raises:** `ValueError` for friction, where there is no such load, for a name
    that is no parameter, and inside `jax.jit`: its numbers must be concrete.
    """
    make, values = as_function(column, parameters)
    for name, p in values.items():
        if isinstance(p, Tracer):
            raise ValueError(
                "Argument `parameters` must be concrete numbers, but "
                f"{name!r} is traced: call `sensitivity` outside `jax.jit` and "
                "`jax.vmap`, or differentiate `critical_load`."
            )
    missing = [name for name, p in values.items() if p is None]
    if missing or not values:
        raise ValueError(
            "Argument `parameters` must give a value to each argument of the function, "
            f"but has none for {missing or 'any'}."
        )
    at = {name: jnp.asarray(p, dtype=float) for name, p in values.items()}
    load, slopes, undefined = jax.jit(lambda p: _derivatives(make, p, kind))(at)
    outcome = CODE(int(load.outcome))
    if outcome < CODE.preceded:
        raise ValueError(
            f"Argument `column` must have a critical load of kind {kind!r}, but its "
            f"outcome is `{outcome.name}`: {outcome.sentence}."
        )
    names = list(values)
    value = np.array([float(at[name]) for name in names])
    slope = np.array([float(slopes[name]) for name in names])
    slope[[bool(undefined[name]) for name in names]] = np.nan
    q = float(load.q_cr)
    return xr.Dataset(
        {
            "value": ("parameter", value, {"long_name": "parameter p"}),
            "derivative": ("parameter", slope, {"long_name": "dq_cr/dp"}),
            "elasticity": (
                "parameter",
                value / q * slope,
                {"long_name": "(p/q_cr) dq_cr/dp", "units": "1"},
            ),
        },
        coords={"parameter": names},
        attrs={
            "kind": kind,
            "q_cr": q,
            "frequency": float(load.frequency),
            "outcome": outcome.name,
        },
    )


def _derivatives(
    make: Make, at: dict[str, jax.Array], kind: Kind
) -> tuple[CriticalLoad, dict[str, jax.Array], dict[str, jax.Array]]:
    """The load, its derivatives, and which parameters have none."""

    def load(values):
        result = critical_load(make(**values), kind)
        return result.q_cr, result

    def damping(values):
        return linearise(make(**values)).damping

    slopes, result = jax.grad(load, has_aux=True)(at)
    # where C = 0, q_cr jumps along everything that changes C
    jumps = (kind == "flutter") & jnp.all(damping(at) == 0)
    undefined = {}
    for name, p in at.items():
        # by steps as well: through c = x^2 the first derivative at x = 0 is none
        near = [damping(at | {name: p + h * (1 + jnp.abs(p))}) for h in (1e-3, -1e-3)]
        moves = [jax.jacfwd(lambda p, n=name: damping(at | {n: p}))(p), *near]
        undefined[name] = jumps & jnp.any(jnp.stack(moves) != 0)
    return result, slopes, undefined
