"""Three rods: the critical load of a chain, and a motion above it."""

import jax
import numpy as np

import ziegler_jax as zj

jax.config.update("jax_enable_x64", True)


def chain(q, tau=None):
    law = tau and zj.SmoothCoulomb(
        tau, pin_radius=1, v_smooth=0.1, load=zj.ConstantLoad(1)
    )
    return zj.Chain(q, lengths=(1, 1, 1), masses=(2, 1.5, 1), friction=law)


q_cr = float(zj.critical_load(chain(0)).q_cr)
kick = zj.State(omega=(0, 0, 0.3))
end = zj.settle(chain(1.1 * q_cr, tau=0.05), kick)
print(f"q_cr = {q_cr:.4f}; 10 % above: {zj.CODE(int(end.outcome)).name}")
print("period", end.period, "joint amplitudes", np.round(end.joint_amplitude, 3))
