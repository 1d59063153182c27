"""Chains of rods: are certified cycles cycles, and what do more rods cost?

- `certificates`: random chains of n uniform rods with smoothed friction, about their
  critical load, and a third as many that are bent and heavy. Where `settle` certifies a
  cycle its motion is followed on from its last state by plain diffrax (Dopri8, 1e-9) on
  equations of motion written here, a dense mass matrix solved by LAPACK, for 400 time
  units and 20 periods at least, 1500 where its multiplier is above 0.95. A certificate
  is false where an amplitude over the last two periods is off by more than 1 %.
- `steps`: seconds a step of 64 lanes, and of compiling, for n rods, with smoothed
  friction; ratios to those of two, in pairs.

Prints one JSON line each.

    python benchmarks/a15_chains.py [certificates] [steps] [--rods 3 4] [--cells 400]
        [--seed 0]
"""

import argparse
import json
import time

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from measure import commit, rounded

import ziegler_jax as zj

SPAN, PERIODS, SLOW, SLOW_SPAN, OFF = 400.0, 20, 0.95, 1500.0, 0.01
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


def followed(n, numbers, y0, span, period):
    """The largest angles of rods and joints over the last two periods."""

    def one(number, y0, span, period):
        end = span + 2 * period
        ts = span + 2 * period * jnp.linspace(0.0, 1.0, SAMPLES)
        found = dfx.diffeqsolve(
            dfx.ODETerm(field(n, number)), dfx.Dopri8(), 0.0, end, 0.01, y0,
            stepsize_controller=dfx.PIDController(rtol=1e-9, atol=1e-9),
            saveat=dfx.SaveAt(ts=ts), max_steps=None, throw=False,
        )  # fmt: skip
        phi = found.ys[:, :n]
        joints = jnp.diff(phi, axis=1, prepend=0.0)
        return jnp.max(jnp.abs(phi), 0), jnp.max(jnp.abs(joints), 0)

    return jax.jit(jax.vmap(one))(numbers, y0, span, period)


def report_certificates(n, displaced, options):
    rng = np.random.default_rng([options.seed, n, displaced])
    count = options.cells // 3 if displaced else options.cells
    numbers = rng.uniform(0, 1, (count, 4))
    numbers[:, 0] = onset(n) * (0.7 + 1.1 * numbers[:, 0])
    numbers[:, 2:] *= 0.05 * displaced
    table = jnp.asarray(numbers)
    start = zj.State(omega=(0.0,) * (n - 1) + (0.3,))

    def at(cell):
        scene = chain(n, table[cell.astype(int)], displaced), start
        result = zj.settle(*scene, windows=WINDOWS)
        state = zj.Variable(jnp.stack(result.final.y), "state", dims=("i",))
        return {**result.variables(), "state": state}

    ds = zj.sweep(at, cell=np.arange(count), progress=False)
    mine = np.flatnonzero(ds.outcome.values == zj.CODE.cycle)
    period = ds.period.values[mine]
    slow = ds.largest_multiplier.values[mine] > SLOW
    span = np.maximum(np.where(slow, SLOW_SPAN, SPAN), PERIODS * period)
    rods, joints = followed(n, numbers[mine], ds.state.values[mine], span, period)
    largest = ds.rod_amplitude.values[mine].max(1)
    off = np.maximum(
        np.abs(rods - ds.rod_amplitude.values[mine]).max(1),
        np.abs(joints - ds.joint_amplitude.values[mine]).max(1),
    )
    wrong = ~(off / largest < OFF)
    codes = ds.outcome.values
    return {
        "rods": n,
        "displaced": displaced,
        "cells": count,
        "outcomes": {c.name: int((codes == c).sum()) for c in zj.CODE if c in codes},
        "certified": len(mine),
        "false": int(wrong.sum()),
        "worst": float((off / largest).max()),
        "false_cells": numbers[mine][wrong].tolist(),
    }


def report_steps(options):
    """Seconds of compiling and a step of a lane, by the number of rods."""
    times = {n: [] for n in (2, *options.rods)}
    programs, compiles = {}, {}
    for n in times:
        law = zj.SmoothCoulomb(0.1, pin_radius=PIN_RADIUS, v_smooth=V_SMOOTH)
        load = 1.3 * onset(n)
        start = zj.State(omega=(0.0,) * (n - 1) + (0.3,))
        windows = zj.Windows(transient=100.0, length=40.0, max_windows=1)

        def lane(q, n=n, law=law, start=start, windows=windows):
            scene = zj.Chain(q, lengths=(1.0,) * n, friction=law), start
            result = zj.settle(*scene, windows=windows, certify=False)
            return result.steps, result.joint_amplitude

        loads = jnp.linspace(0.9, 1.1, 64) * load
        lowered = jax.jit(jax.vmap(lane)).lower(loads)
        begun = time.process_time()
        programs[n] = lowered.compile(), loads
        compiles[n] = time.process_time() - begun
    for _ in range(7):
        for n, (program, loads) in programs.items():
            begun = time.process_time()
            steps = jax.block_until_ready(program(loads))[0]
            times[n].append((time.process_time() - begun) / int(steps.sum()))
    step = {n: float(np.median(t)) for n, t in times.items()}
    return {
        "ns_a_step": {n: 1e9 * t for n, t in step.items()},
        "to_two_rods": {
            n: float(np.median(np.array(t) / np.array(times[2])))
            for n, t in times.items()
        },
        "compile_s": compiles,
        "compile_to_two_rods": {n: c / compiles[2] for n, c in compiles.items()},
    }


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("reports", nargs="*", default=["certificates", "steps"])
    parser.add_argument("--rods", nargs="+", type=int, default=[3, 4])
    parser.add_argument("--cells", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    about = {"commit": commit(), "seed": options.seed}
    for name in options.reports:
        if name == "steps":
            print(
                json.dumps(rounded({**about, "report": name, **report_steps(options)}))
            )
            continue
        for n in options.rods:
            for displaced in (False, True):
                found = report_certificates(n, displaced, options)
                line = {**about, "report": name, **found}
                print(json.dumps(rounded(line)), flush=True)


if __name__ == "__main__":
    main()
