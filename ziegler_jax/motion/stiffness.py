r"""Whether a stiff method is the cheaper one, by the field's Jacobian at rest.

There, $J = [[0, I], [P, Q]]$. Rates decay with about $\lambda = -\mathrm{tr}\, Q$
($15.4\, \tau_s / v_{smooth}$ for uniform rods with one torque at both joints), the
column moves at rates up to about $\omega = \sqrt{\|P\|_F}$. Steps that meet tolerances
are about $rtol^{1/5} / \omega$ long: a column is stiff where these decay times are
shorter,

$$\lambda\, rtol^{1/5} > \omega.$$
"""

from __future__ import annotations

from contextlib import ExitStack

import jax
import jax.numpy as jnp

from ..model.chain_of_rods import AbstractChain, check_column
from ..model.column import check_autonomous, refuse_si
from ..model.jacobian import accelerations_and_slopes
from ..model.state import PhasePoint
from ..model.system import System
from ..numerics.numbers import Scalar, is_concrete
from ..numerics.rules import number
from ..numerics.series import sum_of
from ..runtime import refuse_forked


def is_stiff(column: AbstractChain, rtol: Scalar) -> jax.Array:
    r"""Whether `Rosenbrock()` is cheaper for this column than `Explicit()`.

    $$-\mathrm{tr}\, \frac{\partial\dot\omega}{\partial\omega}\, rtol^{1/5} >
    \left\|\frac{\partial\dot\omega}{\partial\phi}\right\|_F^{1/2}
    \text{ at } \phi = \omega = 0$$

    On a map of friction cycles and sticking columns (q = 1..4, tau = 0.002..0.16,
    v_smooth = 0.0003..0.1) the total costs of the two methods cross there, within
    a factor of 1.5 in the left side, for tolerances from 1e-4 to 1e-10.

    A compiled program has one method. For a map from wide layers to thin ones, run two
    sweeps, each over the points of its method, and combine them:

    ```python
    def settled(solver):
        def point(q, v):
            method = zj.Method(solver)
            return zj.settle(column(q, v), start, method=method, certify=False)

        return point

    ds = zj.sweep(lambda q, v: {"stiff": zj.is_stiff(column(q, v), 1e-6)}, **axes)
    stiff = ds.stiff == 1
    thin = zj.sweep(settled(zj.Rosenbrock()), where=lambda **_: stiff.values, **axes)
    wide = zj.sweep(settled(zj.Explicit()), where=lambda **_: ~stiff.values, **axes)
    ds = thin.where(stiff, wide)
    ```

    **Arguments:** `column`; `rtol`: the tolerance of the motion's steps. For concrete
    numbers the answer is concrete, in 64 bits, also under `jax.jit`.

    **Returns:** a boolean. False for numbers that are NaN, and with `SetValuedCoulomb`,
    whose sticking joints have no fast rates.

    **Raises:** `ValueError` for an argument that is not a `Column`, and for a concrete
    `rtol` that is not positive.
    """
    check_column(column)
    refuse_forked()
    refuse_si(column)
    check_autonomous("is_stiff", column)
    rtol = number("rtol", rtol, "positive")
    with ExitStack() as known:
        if all(is_concrete(x) for x in jax.tree.leaves((column, rtol))):
            known.enter_context(jax.ensure_compile_time_eval())
            known.enter_context(jax.enable_x64(True))
        if column.sticks:
            return jnp.zeros((), bool)
        return _decays_fast(column.system(), rtol)


def _decays_fast(system: System, rtol: Scalar) -> jax.Array:
    zero = jnp.zeros((), jnp.result_type(float))

    n = system.joints
    rest = PhasePoint((zero,) * (2 * n))
    _, rows = accelerations_and_slopes(zero, rest, system)
    square = sum_of([x**2 for row in rows for x in row[:n]])
    decay = -sum_of([row[n + i] for i, row in enumerate(rows)])
    return decay * jnp.asarray(rtol, zero.dtype) ** 0.2 > square**0.25
