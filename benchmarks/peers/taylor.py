"""heyoka: Taylor series of adaptive order, SIMD batches on all threads.

As its documentation advises for many small systems: `taylor_adaptive_batch` with the
processor's SIMD width, compact mode off. Each thread has one integrator, whose lanes
are set anew: its `ensemble_propagate_until_batch` copies one for each batch, which took
three to six times as long on an Intel Xeon, with the same results to the bit. Where
friction has a narrow layer, a step is kept so short that no joint passes the layer
within it: outside, tanh is 1 to the last digit with all its derivatives zero, and the
series sees nothing of it (without that, results at 1e-9 and 1e-16 differ in the second
digit at v_smooth = 1e-4).
"""

import copy
import functools
import os
from concurrent.futures import ThreadPoolExecutor

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
    batches, threads = -(-q.size // WIDTH), os.cpu_count() or 1
    loads = np.resize(q, batches * WIDTH).reshape(batches, WIDTH)
    ends = [np.zeros((4, WIDTH))] * batches

    def work(thread):
        batch = copy.deepcopy(taylor)
        for i in range(thread, batches, threads):
            batch.set_time(0.0)
            batch.state[:] = np.reshape(start, (4, 1))
            batch.pars[0] = loads[i]
            batch.propagate_until(span, **longest)
            ends[i] = batch.state.copy()

    begun = clock()
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, range(threads)))
    seconds = clock() - begun
    return np.concatenate(ends, axis=1).T[: q.size], seconds
