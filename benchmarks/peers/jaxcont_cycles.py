"""Three cycles by JaxCont's collocation and by shooting: periods and multipliers.

`pip install jaxcont` (0.4.0 was used). One line of JSON a cycle.
"""

import json

import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)

from jaxcont.core.collocation import Collocation  # noqa: E402
from jaxcont.problems.periodic import periodic_orbit_problem  # noqa: E402
from jaxcont.stability.floquet import floquet_multipliers  # noqa: E402

import ziegler_jax as zj  # noqa: E402

MESH = Collocation(ntst=60, ncol=5)


def smooth(q):
    load = zj.ConstantLoad(1.0)
    law = zj.SmoothCoulomb(0.03, pin_radius=1.0, v_smooth=0.3, load=load)
    return zj.uniform_rods(q, friction=law)


SCENES = {
    "uniform rods, c = 0.1": (
        lambda q: zj.uniform_rods(q, damping=zj.Viscous(0.1, 0.1)),
        1.8,
    ),
    "Ziegler's masses, c = 0.2": (
        lambda q: zj.point_masses(2, 1, q=q, damping=zj.Viscous(0.2, 0.2)),
        1.6,
    ),
    "smoothed friction, tau = 0.03": (smooth, 2.0),
}


def main():
    for name, (make, q) in SCENES.items():

        @jax.jit
        def ours(q, make=make):
            kicked = zj.settle(make(q), zj.State(omega=(0.0, 0.5)), certify=False)
            orbit = zj.periodic_orbit(make(q), kicked.final)
            return orbit, orbit.multipliers

        orbit, mu = ours(jnp.asarray(q))
        ts = jnp.linspace(0.0, 1.0, 401) * orbit.period
        motion = zj.trajectory(make(q), orbit.state, ts)
        path = jnp.concatenate([motion.phi, motion.omega], axis=1)

        def field(u, p, args, make=make):
            return jnp.stack(zj.vector_field(0.0, tuple(u), make(p)))

        problem = periodic_orbit_problem(field, path, ts, orbit.period, q, MESH)
        period = problem.u0[-1]
        values = floquet_multipliers(field, MESH, problem.u0, jnp.asarray(q))
        off = [float(np.abs(values - m).min()) for m in np.asarray(mu)]
        print(json.dumps({
            "cycle": name, "q": q, "period": float(orbit.period),
            "period_difference": float(period - orbit.period),
            "multipliers": [f"{m:.8f}" for m in np.asarray(mu)],
            "multiplier_difference": max(off),
        }))  # fmt: skip


if __name__ == "__main__":
    main()
