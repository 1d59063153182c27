"""jit, vmap and jvp around `settle`."""

import jax
import jax.numpy as jnp

import ziegler_jax as zj

jax.config.update("jax_enable_x64", True)
START = zj.State(omega=(0, 0.3))


def amplitude(q):  # of the second joint
    friction = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.1)
    column = zj.uniform_rods(q, friction=friction)
    return zj.settle(column, START, certify=False).joint_amplitude[1]


print("one", jax.jit(amplitude)(2.6))
q = jnp.linspace(2.2, 3.0, 5)
print("many", jax.jit(jax.vmap(amplitude))(q))
print("and their slopes", jax.jit(lambda q: jax.jvp(amplitude, (q,), (1.0,)))(2.6))
