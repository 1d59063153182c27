"""What the methods add to undamped, frictionless motion, over 1e4 time units.

Without friction, damping and load the energy stays; the flow runs backward; and at any
load det M dphi domega stays, so that nothing attracts. A method whose steps shrink that
volume makes a limit cycle of its own where there is none. For each method and
tolerance: the relative drift of the energy at q = 0 (uniform rods, kick 0.3); how far a
motion of as long and back ends from its start (q = 1.5); and the mean rate at
which the numerical flow changes the phase volume along a motion at q = 1.5 and in
flutter at q = 2.6, from the Jacobians of the solved pieces of one time unit. Writes
results/c1_honesty.json and results/c1_honesty.png; about two minutes, most of them to
compile.

    python benchmarks/c1_honesty.py [--span 1e4]
"""

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import ours
from matplotlib.figure import Figure
from measure import LINES, arguments, report, save

import ziegler_jax as zj

SOLVERS = ours.SOLVERS | ours.STIFF_SOLVERS
TOLERANCES = (1e-4, 1e-6, 1e-8)
LOADS = (1.5, 2.6)  # stable, and in flutter
START = (0.0, 0.0, 0.0, 0.3)
PIECE = 1.0
PATH = np.arange(0.0, 501.0, 10.0)  # where the pieces begin
MOST = 50_000_000


def motion(solver, y, q, ts, tol):
    """The states at `ts`, (n, 4)."""
    found = zj.trajectory(
        zj.uniform_rods(q),
        zj.State(tuple(y[:2]), tuple(y[2:])),
        ts,
        method=zj.Method(rtol=tol, atol=tol, solver=solver, max_steps=MOST),
    )
    return jnp.concatenate([found.phi, found.omega], -1)


def log_mass(y):
    return jnp.log(4 / 9 - (jnp.cos(y[0] - y[1]) / 2) ** 2)


def measured(solver, paths, span):
    """What one method adds, at each tolerance."""
    tols = np.array(TOLERANCES)

    def end(y, q, span, tol):
        return motion(solver, y, q, jnp.stack([0.0 * span, span]), tol)[-1]

    def volume(y, q, tol):
        def piece(y):
            after = end(y, q, jnp.asarray(PIECE), tol)
            return after, after

        flow, after = jax.jacfwd(piece, has_aux=True)(y)
        return jnp.linalg.slogdet(flow)[1] + log_mass(after) - log_mass(y)

    ends = jax.jit(jax.vmap(end, (0, None, None, 0)))
    turn = np.array([1.0, 1.0, -1.0, -1.0])
    starts = np.tile(START, (tols.size, 1))
    free = zj.uniform_rods(0.0)
    energy = jax.vmap(lambda y: zj.energy(free, tuple(y)))
    last = ends(starts, 0.0, span, tols)
    # with the rates turned round the motion retraces itself
    back = turn * ends(turn * ends(starts, 1.5, span, tols), 1.5, span, tols)
    along = jax.vmap(jax.vmap(volume, (0, None, None)), (0, 0, None))
    by_tolerance = jax.jit(jax.vmap(along, (None, None, 0)))
    rates = by_tolerance(paths, np.array(LOADS), tols)
    return (
        np.asarray(energy(last) / energy(starts) - 1),
        np.abs(back - starts).max(-1),
        np.asarray(rates.mean(-1) / PIECE),
    )


def draw(result, path):
    figure = Figure(figsize=(11, 3.8), layout="constrained")
    axes = figure.subplots(1, 3)
    left, *volumes = axes
    rate = r"$|\mathrm{d} \log V/\mathrm{d} t|$ ($\sqrt{k/(m l^2)}$)"
    panels = {r"$q$ = 0: $|E/E_0 - 1|$ after the span (–)": result["energy_drift"]}
    panels |= {f"$q$ = {q}: {rate}": x for q, x in result["volume_rate"].items()}
    for ax, (title, numbers) in zip(axes, panels.items(), strict=True):
        looks = zip(numbers, "osD^v", LINES, strict=False)
        for name, marker, colour in looks:
            number = np.array(numbers[name])
            ax.loglog(
                TOLERANCES, np.abs(number), f"{marker}-", color=colour, label=name
            )
            if ax is not left:
                grows = np.where(number > 0, number, np.nan)
                ax.plot(TOLERANCES, grows, marker, color=colour, mfc="w")
        ax.set_title(title, fontsize=10)
        ax.set_xlabel("tolerance rtol = atol (–)")
        ax.spines[["top", "right"]].set_visible(False)
    volumes[0].sharey(volumes[1])
    left.legend(fontsize=9, frameon=False)
    for face, text in (("0.3", "shrinks"), ("w", "grows")):
        mark = {"color": "0.3", "mfc": face, "label": text}
        volumes[1].plot([], [], "o", **mark)
    volumes[1].legend(*[x[-2:] for x in volumes[1].get_legend_handles_labels()])
    figure.savefig(path, dpi=150)


def main():
    options = arguments(__doc__, span=1e4)
    jax.config.update("jax_enable_x64", True)
    best = zj.Explicit(dfx.Dopri8.tableau)
    path = jax.jit(jax.vmap(lambda q: motion(best, START, q, PATH, 1e-12)))
    paths = np.asarray(path(np.array(LOADS)))
    result = {
        "tolerances": list(TOLERANCES),
        "span": options.span,
        "energy_drift": {},
        "return_error": {},
        "volume_rate": {f"{q:g}": {} for q in LOADS},
    }
    for name, solver in SOLVERS.items():
        drift, back, rates = measured(solver, paths, options.span)
        result["energy_drift"][name] = drift.tolist()
        result["return_error"][name] = back.tolist()
        for q, rate in zip(LOADS, rates.T, strict=True):
            result["volume_rate"][f"{q:g}"][name] = rate.tolist()
    result = report("c1_honesty", **result)
    draw(result, save("c1_honesty", result))


if __name__ == "__main__":
    main()
