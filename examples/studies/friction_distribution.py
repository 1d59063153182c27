"""Friction as a distribution: how probable flutter is, and what its onset hangs on.

The kinetic coefficient of each joint is log-normal about a mean that both share, and
static friction exceeds kinetic friction by a log-normal share: three standard normal
numbers z. Over load and mean friction the probability of flutter is the share of draws
of z, the same in every cell, in which a kick does not come to rest. At one mean
friction the load from which the kick starts flutter is a function of z. Sobol's indices
part its variance among the three; its derivatives at z = 0 do so to first order. If it
were continuous, the mean square of a derivative over the variance would be no less than
the total index; where it is less, the onset load jumps.

    python examples/studies/friction_distribution.py [--small] [--out FOLDER]

Source: A. Saltelli et al., Comput. Phys. Commun. 181 (2010) 259-270; I. M. Sobol, S.
Kucherenko, Math. Comput. Simul. 79 (2009) 3009-3017, on that bound.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np
from indices import indices, saltelli, samples
from pictures import of_distribution
from record import begin, save
from scipy.stats import norm, qmc

import ziegler_jax as zj

SPREAD = 0.2  # of the logarithm of a joint's friction
EXCESS, SPREAD_OF_EXCESS = 0.2, 0.4  # median of mu_s / mu_k - 1, and of its logarithm
PIN_RADIUS, KICK = 0.05, zj.State(omega=(0, 0.3))
WINDOWS = zj.Windows(max_windows=100)  # to t = 4100
MEAN, BRACKET, Z = 0.2, (0.4, 3.0), ("z1", "z2", "z3")  # of the onset load
FINE = {"search": zj.Search(scan=13, halvings=11)}
COARSE = {"search": zj.Search(scan=2, halvings=3), "method": zj.Method(rtol=1e-5)}


def column(q, mu, z):
    """A column whose friction is mu on average, and lies where z says."""
    mu_k = [mu * jnp.exp(SPREAD * x - SPREAD**2 / 2) for x in z[:2]]
    ratio = 1 + EXCESS * jnp.exp(SPREAD_OF_EXCESS * z[2])
    mu_s = [ratio * x for x in mu_k]
    friction = zj.SetValuedCoulomb(tuple(mu_s), tuple(mu_k), pin_radius=PIN_RADIUS)
    return zj.uniform_rods(q, friction=friction)


def probability(q, mu, draws):
    """The share of the draws that flutters at each (q, mu): what does not stick."""

    def point(q, mu, z1, z2, z3):
        ended = zj.settle(column(q, mu, (z1, z2, z3)), KICK, windows=WINDOWS)
        return {"outcome": ended.outcome}

    z = norm.ppf(qmc.Sobol(3, rng=1).random(draws))
    ds = zj.sweep(point, q=q, mu=mu, **samples(z, Z))
    on_cycle = ds.outcome.isin([zj.CODE.cycle, zj.CODE.escaped])
    ds["probability"] = (ds.outcome != zj.CODE.stuck).mean("sample")
    ds["unsettled"] = ds.probability - on_cycle.mean("sample")  # or failed
    ds.probability.attrs["long_name"] = "probability of flutter"
    return ds


def onset_of(how):
    """The load from which the kick starts flutter, and its derivatives, of z."""

    def load(z):
        found = zj.flutter_onset(lambda q: column(q, MEAN, z), KICK, BRACKET, **how)
        return found.threshold, found.outcome

    def point(z1, z2, z3):
        run = jax.value_and_grad(load, has_aux=True)
        (threshold, outcome), slopes = run(jnp.stack([z1, z2, z3]))
        slopes = zj.Variable(slopes, "derivatives of the onset load", dims=("z",))
        return {"onset_load": threshold, "slopes": slopes, "outcome": outcome}

    return point


def viscous_variance(n, low=0.05, high=0.4):
    """The variance of q_cr under random viscous damping: sampled, and in closed form.

    Uniform rods with c1 = c2 = c: Hurwitz' determinant of the characteristic polynomial
    7/36 s^4 + 3 c s^3 + (3 + c^2 - 5 q / 6) s^2 + 2 c s + 1 is zero at q_cr =
    74/45 + 6 c^2 / 5. With c uniform, Var q_cr = (36 / 25) (E c^4 - (E c^2)^2).
    """

    def point(c):
        return zj.critical_load(zj.uniform_rods(damping=zj.Viscous(c, c)))

    def moment(k):
        return (high ** (k + 1) - low ** (k + 1)) / ((k + 1) * (high - low))

    c = low + (high - low) * qmc.Sobol(1, rng=1).random(n)
    sampled = zj.sweep(point, **samples(c, ["c"])).q_cr.var()
    return float(sampled), 36 / 25 * (moment(4) - moment(2) ** 2)


def main(arguments=None):
    """Compute, draw, and write a line of figures."""
    options = begin(__doc__).parse_args(arguments)
    width, height, draws, rows = (4, 3, 4, 2) if options.small else (64, 32, 64, 256)
    q, mu = np.linspace(1.0, 3.0, width), np.linspace(0.0125, 0.4, height)
    start = time.process_time()
    ds = probability(q, mu, draws)
    middle = time.process_time()
    problem, points = saltelli(Z, rows, bounds=[[0, 1]] * 3, dists=["norm"] * 3)
    onset = onset_of(COARSE if options.small else FINE)
    loads = zj.sweep(onset, **samples([*points, [0, 0, 0]], Z))  # the last: z = 0
    end = time.process_time()
    shares, values = indices(problem, loads.onset_load.values[:-1])
    slopes, steep = loads.slopes.values[-1], loads.slopes.values[:-1]
    missing = int(np.isnan(steep).any(axis=1).sum())
    squares = np.nansum(steep**2, axis=0) / max(len(steep) - missing, 1)
    sampled, exact = viscous_variance(4096)
    left = max(ds.unsettled.sum(), 1e-9)
    result = {
        "lanes": ds.outcome.size,
        "map_cpu_s": middle - start,
        "map_run_s": ds.attrs["run_seconds"],
        "map_compile_s": ds.attrs["compile_seconds"],
        "unsettled_share": float(ds.unsettled.mean()),
        "of_these_below_1.5": float(ds.unsettled.sel(q=slice(1.5)).sum() / left),
        "onsets": loads.onset_load.size,
        "onsets_cpu_s": end - middle,
        "rows_without_a_value": rows - len(values),
        "rest_returns_share": float((loads.outcome == zj.CODE.repeated).mean()),
        "onset_mean_and_deviation": [values.mean(), values.std()],
        "onset_at_mean_friction": float(loads.onset_load[-1]),
        "deviation_by_derivatives": float(np.linalg.norm(slopes)),
        **{name: shares[name] for name in ("S1", "S1_conf", "ST", "ST_conf")},
        "shares_by_derivatives": slopes**2 / (slopes @ slopes),
        "mean_square_slopes_over_variance": squares / values.var(),
        "slopes_without_a_value": missing,
        "viscous_variance_over_closed_form": sampled / exact,
    }
    save(of_distribution(ds, loads, values, shares), result, options.out, __file__)


if __name__ == "__main__":
    main()
