"""Chains of rods: are certified cycles cycles, and what do more rods cost?

- `certificates`: random chains of n uniform rods with smoothed friction, about their
  critical load, and a third as many that are bent and heavy. Where `settle` certifies a
  cycle its motion is followed on, as `follow_on.py` says, by plain diffrax (Dopri8,
  1e-9) on equations of motion written here, a dense mass matrix solved by LAPACK.
- `steps`: seconds a step of 64 lanes, and of compiling, for n rods, with smoothed
  friction; ratios to those of two, in pairs.

Prints one JSON line each.

    python benchmarks/a15_chains.py [certificates steps] [--rods 3 4] [--cells 400]
        [--seed 0]
"""

import time

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from follow_on import certificates, swept, with_state
from measure import arguments, commit, paired, report

import ziegler_jax as zj

V_SMOOTH, PIN_RADIUS, SAMPLES = 0.02, 0.05, 400
WINDOWS = zj.Windows(transient=100.0, length=40.0, max_windows=40)


def onset(n):
    """The critical load of n rods of length, mass and spring 1, in k/l."""
    return float(zj.critical_load(zj.Chain(lengths=(1.0,) * n)).q_cr)


def chain(n, number, displaced):
    """Of random numbers: load, friction; bend and weight of one that is displaced."""
    q, mu, bent, heavy = number
    law = zj.SmoothCoulomb(0.02 + 0.4 * mu, pin_radius=PIN_RADIUS, v_smooth=V_SMOOTH)
    parts = {"rest_angles": bent, "gravity": zj.Gravity(heavy)} if displaced else {}
    return zj.Chain(q, lengths=(1.0,) * n, friction=law, **parts)


def field(n, number):
    """The same equations: a dense mass matrix, torques joint by joint."""
    q, mu, bent, heavy = number
    arms = np.tril(np.ones((n, n)), -1) + np.eye(n) / 2  # of each rod's centre
    moments = arms.T @ arms + np.eye(n) / 12
    weights = arms.sum(0)
    tau = (0.02 + 0.4 * mu) * PIN_RADIUS * jnp.abs(q)

    def slope(t, y, args):
        phi, w = y[:n], y[n:]
        d = phi[:, None] - phi[None]
        theta, u = jnp.diff(phi, prepend=0.0), jnp.diff(w, prepend=0.0)
        joint = theta - bent + tau * jnp.tanh(u / V_SMOOTH)
        right = -joint + jnp.append(joint[1:], 0.0)
        right += q * jnp.sin(phi - phi[-1]) + heavy * weights * jnp.sin(phi)
        right -= (moments * jnp.sin(d)) @ w**2
        return jnp.concatenate([w, jnp.linalg.solve(moments * jnp.cos(d), right)])

    return slope


def followed(n, numbers, y0, span, last):
    """The largest angles of rods, and of joints but the first, over the last part."""

    def one(number, y0, span, last):
        found = dfx.diffeqsolve(
            dfx.ODETerm(field(n, number)), dfx.Dopri8(), 0.0, span + last, 0.01, y0,
            stepsize_controller=dfx.PIDController(rtol=1e-9, atol=1e-9),
            saveat=dfx.SaveAt(ts=span + last * jnp.linspace(0.0, 1.0, SAMPLES)),
            max_steps=None, throw=False,
        )  # fmt: skip
        phi = found.ys[:, :n]
        angles = jnp.concatenate([phi, jnp.diff(phi, axis=1)], axis=1)
        return jnp.max(jnp.abs(angles), axis=0)

    return np.asarray(jax.jit(jax.vmap(one))(numbers, y0, span, last))


def truth(n, displaced, options):
    rng = np.random.default_rng([options.seed, n, displaced])
    numbers = rng.uniform(0, 1, (options.cells // (3 if displaced else 1), 4))
    numbers[:, 0] = onset(n) * (0.7 + 1.1 * numbers[:, 0])
    numbers[:, 2:] *= 0.05 * displaced
    start = zj.State(omega=(0.0,) * (n - 1) + (0.3,))
    ds = swept(
        numbers,
        lambda row: with_state(
            zj.settle(chain(n, row, displaced), start, windows=WINDOWS)
        ),
    )
    judged = certificates(
        numbers, ds, lambda closed, *rest: followed(n, numbers[closed], *rest)
    )
    return {"rods": n, "displaced": displaced, **judged}


def steps(rods):
    """Seconds of compiling and a step of a lane, by the number of rods."""
    times, programs, compiling = {}, {}, {}
    windows = zj.Windows(transient=100.0, length=40.0, max_windows=1)
    for n in (2, *rods):
        law = zj.SmoothCoulomb(0.1, pin_radius=PIN_RADIUS, v_smooth=V_SMOOTH)
        start = zj.State(omega=(0.0,) * (n - 1) + (0.3,))

        def lane(q, n=n, law=law, start=start):
            scene = zj.Chain(q, lengths=(1.0,) * n, friction=law), start
            result = zj.settle(*scene, windows=windows, certify=False)
            return result.steps, result.joint_amplitude

        loads = jnp.linspace(0.9, 1.1, 64) * 1.3 * onset(n)
        lowered = jax.jit(jax.vmap(lane)).lower(loads)
        begun = time.process_time()
        programs[n] = lowered.compile(), loads
        compiling[n] = time.process_time() - begun
    for _ in range(7):
        for n, (program, loads) in programs.items():
            begun = time.process_time()
            steps = jax.block_until_ready(program(loads))[0]
            seconds = time.process_time() - begun
            times.setdefault(n, []).append(seconds / int(steps.sum()))
    return {
        "ns_a_step": {n: 1e9 * float(np.median(t)) for n, t in times.items()},
        "to_two_rods": {n: paired(t, times[2])[0] for n, t in times.items()},
        "compile_s": compiling,
        "compile_to_two_rods": {n: c / compiling[2] for n, c in compiling.items()},
    }


def main():
    options = arguments(
        __doc__, which=("certificates", "steps"), rods=(3, 4), cells=400, seed=0
    )
    jax.config.update("jax_enable_x64", True)
    head = {"about": lambda: {"commit": commit()}, "seed": options.seed}
    for n in options.rods if "certificates" in options.which else ():
        for displaced in (False, True):
            report("a15_chains", **head, **truth(n, displaced, options))
    if "steps" in options.which:
        report("a15_chains", **head, **steps(options.rods))


if __name__ == "__main__":
    main()
