"""What the methods add to undamped, frictionless motion, over 1e4 time units.

Without friction, damping and load the energy stays; the flow runs backward; and at any
load det M dphi domega stays, so that nothing attracts. A method whose steps shrink that
volume makes a limit cycle of its own where there is none. For each method and
tolerance: the relative drift of the energy at q = 0 (uniform rods, kick 0.3); how far a
motion of 100 time units and back ends from its start (q = 1.5); and the mean rate at
which the numerical flow changes the phase volume along a motion at q = 1.5 and in
flutter at q = 2.6, from the Jacobians of the solved pieces of one time unit. Writes
results/honesty.json and results/honesty.png; a few minutes.

    python benchmarks/c1_honesty.py
"""

import argparse
import json
from pathlib import Path

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from measure import machine, rounded

import ziegler_jax as zj

RESULTS = Path(__file__).parent / "results"
SOLVERS = {
    "Tsit5": zj.Explicit(),
    "Dopri8": zj.Explicit(dfx.Dopri8.tableau),
    "Rodas5P": zj.Rosenbrock(),
}
TOLERANCES = (1e-4, 1e-6, 1e-8)
START = (0.0, 0.0, 0.0, 0.3)
SPAN, PIECE, BACK = 1e4, 1.0, 100.0
MOST = 50_000_000


def state(y):
    return zj.State(tuple(y[:2]), tuple(y[2:]))


def advanced(solver, y, q, span, tol):
    """The state after `span`."""
    found = zj.trajectory(
        zj.uniform_rods(q), state(y), jnp.stack([0.0 * span, span]), rtol=tol, atol=tol,
        solver=solver, max_steps=MOST,
    )  # fmt: skip
    return jnp.concatenate([found.phi[-1], found.omega[-1]])


def energies(solver):
    column, ts = zj.uniform_rods(0.0), np.linspace(0.0, SPAN, 11)

    @jax.jit
    @jax.vmap
    def run(tol):
        found = zj.trajectory(
            column, state(START), ts, rtol=tol, atol=tol, solver=solver, max_steps=MOST
        )
        y = (*found.phi.T, *found.omega.T)
        e = jax.vmap(lambda *y: zj.energy(column, y))(*y)
        return e / e[0] - 1

    return np.asarray(run(np.array(TOLERANCES)))


def returns(solver):
    """There and back: with the rates turned round the motion retraces itself."""

    @jax.jit
    @jax.vmap
    def run(tol):
        turn = jnp.array([1.0, 1.0, -1.0, -1.0])
        there = advanced(solver, jnp.array(START), 1.5, jnp.asarray(BACK), tol)
        back = advanced(solver, turn * there, 1.5, jnp.asarray(BACK), tol)
        return jnp.abs(turn * back - jnp.array(START)).max()

    return np.asarray(run(np.array(TOLERANCES)))


def volumes(solver, q):
    """D log(det M dphi domega) / dt of the numerical flow, at each tolerance."""
    ts = np.arange(0.0, 501.0, 10 * PIECE)
    path = zj.trajectory(
        zj.uniform_rods(q), state(START), ts, rtol=1e-12, atol=1e-12, max_steps=MOST
    )
    states = np.concatenate([path.phi, path.omega], -1)

    def log_mass(y):
        return jnp.log(4 / 9 - (jnp.cos(y[0] - y[1]) / 2) ** 2)

    @jax.jit
    @jax.vmap
    def rate(tol):
        def piece(y):
            end = advanced(solver, y, q, jnp.asarray(PIECE), tol)
            return end, end

        def of(y):
            flow, end = jax.jacfwd(piece, has_aux=True)(y)
            return jnp.linalg.slogdet(flow)[1] + log_mass(end) - log_mass(y)

        return jax.vmap(of)(states).mean() / PIECE

    return np.asarray(rate(np.array(TOLERANCES)))


def draw(result, path):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    colours = dict(zip(SOLVERS, ("#0072B2", "#E69F00", "#009E73"), strict=True))
    with plt.rc_context({"font.size": 10}):
        figure, (left, right) = plt.subplots(
            1, 2, figsize=(8.3, 3.4), layout="constrained"
        )
        for name, marker in zip(SOLVERS, "osD", strict=True):
            drift = np.abs(np.array(result["energy_drift"][name]))
            left.loglog(
                TOLERANCES, drift, marker=marker, color=colours[name], label=name
            )
            for q, style in (("1.5", "-"), ("2.6", "--")):
                rate = np.abs(np.array(result["volume_rate"][q][name]))
                right.loglog(
                    TOLERANCES, rate, style, marker=marker, color=colours[name],
                    label=f"{name}, $q$ = {q}",
                )  # fmt: skip
        left.set_ylabel(r"$|E/E_0 - 1|$ after $10^4$ time units (–)")
        left.set_title(r"energy at $q$ = 0", fontsize=10)
        right.set_ylabel(r"$|\mathrm{d} \log V/\mathrm{d} t|$ ($\sqrt{k/(m l^2)}$)")
        right.set_title("phase volume", fontsize=10)
        for ax in (left, right):
            ax.set_xlabel("tolerance rtol = atol (–)")
            ax.legend(fontsize=8, frameon=False)
            ax.spines[["top", "right"]].set_visible(False)
        figure.savefig(path, dpi=150)
        plt.close(figure)


def main():
    argparse.ArgumentParser(description=__doc__.split("\n")[0]).parse_args()
    jax.config.update("jax_enable_x64", True)
    result = {
        "benchmark": "c1_honesty",
        "tolerances": list(TOLERANCES),
        "energy_drift": {},
        "return_error": {},
        "volume_rate": {"1.5": {}, "2.6": {}},
    }
    for name, solver in SOLVERS.items():
        drift = energies(solver)
        result["energy_drift"][name] = [float(x) for x in drift[:, -1]]
        result["return_error"][name] = [float(x) for x in returns(solver)]
        for q, rates in result["volume_rate"].items():
            rates[name] = [float(x) for x in volumes(solver, float(q))]
    RESULTS.mkdir(exist_ok=True)
    result = rounded(result | machine())
    (RESULTS / "honesty.json").write_text(json.dumps(result) + "\n")
    draw(result, RESULTS / "honesty.png")
    print(json.dumps(result))


if __name__ == "__main__":
    main()
