"""heyoka: Taylor series of adaptive order, an ensemble of SIMD batches on all threads.

As its documentation advises for many small systems: `taylor_adaptive_batch` with the
processor's SIMD width, compact mode off, and `ensemble_propagate_until_batch`. Where
friction has a narrow layer, a step is kept so short that no joint passes the layer
within it: outside, tanh is 1 to the last digit with all its derivatives zero, and the
series sees nothing of it (without that, results at 1e-9 and 1e-16 differ in the second
digit at v_smooth = 1e-4).
"""

import functools
import os

import heyoka as hy
import numpy as np
from measure import clock
from scenes import accelerations

NAME = "heyoka"
WIDTH = hy.recommended_simd_size()
LAYERS_A_STEP = 20.0  # tanh(20) = 1 to the last digit; joints accelerate by less than 1


@functools.cache
def integrator(scene, tol):
    """One compiled batch of lanes for a scene."""
    y = hy.make_vars("phi1", "phi2", "w1", "w2")
    w1_dot, w2_dot = accelerations(hy, scene, hy.par[0], *y)
    slopes = (y[2], y[3], w1_dot, w2_dot)
    return hy.taylor_adaptive_batch(
        list(zip(y, slopes, strict=True)),
        np.zeros((4, WIDTH)),
        pars=np.zeros((1, WIDTH)),
        tol=tol,
    )


def run(scene, q, start, span, rtol):
    taylor = integrator(scene, rtol)
    longest = {}
    if scene.stiff:
        longest["max_delta_t"] = LAYERS_A_STEP * scene.friction.v_smooth
    batches = -(-q.size // WIDTH)
    loads = np.resize(q, batches * WIDTH).reshape(batches, WIDTH)

    def generate(batch, i):
        batch.set_time(0.0)
        batch.state[:] = np.reshape(start, (4, 1))
        batch.pars[0] = loads[i]
        return batch

    begun = clock()
    done = hy.ensemble_propagate_until_batch(
        taylor, span, batches, generate, max_workers=os.cpu_count(), **longest
    )
    seconds = clock() - begun
    return np.concatenate([d[0].state for d in done], axis=1).T[: q.size], seconds
