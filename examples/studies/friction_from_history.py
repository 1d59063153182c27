"""Friction from a measured history: torques and dampings, through stick and slip.

Both angles of a fluttering column are measured with noise. From them tau_s = mu_s rho
and tau_k = mu_k rho, the torques per unit of the normal load, and the dampings c1, c2
are fitted by Gauss-Newton steps in a trust region; the derivatives go forward through
each stick and release. Many histories, each with noise of its own, say how far the
estimates spread. Cramer and Rao's bound says how little they can: the inverse of
Fisher's matrix J^T J / sigma^2, with the sensitivities J. The coefficients and the
pin's radius cannot be told apart: for relative changes of (mu_s, mu_k, rho, c1, c2) the
matrix is singular along (1, 1, -1, 0, 0).

    python examples/studies/friction_from_history.py [--small] [--out FOLDER]

Source: H. Cramer, Mathematical Methods of Statistics (1946), chapter 32; C. R. Rao,
Bull. Calcutta Math. Soc. 37 (1945) 81-91.
"""

import functools
import time

import jax
import numpy as np
from pictures import of_fits
from record import begin, save
from scipy.optimize import least_squares
from scipy.stats import norm

import ziegler_jax as zj

MU_S, MU_K, RHO, C1, C2 = TRUE = np.array([0.6, 0.4, 0.1, 0.03, 0.02])
TOGETHER = np.array([MU_S * RHO, MU_K * RHO, C1, C2])  # tau_s, tau_k, c1, c2
GUESS = TOGETHER * np.array([1.2, 0.8, 1.3, 0.7])
LOAD, KICK, TIMES = 2.2, zj.State(omega=(0, 0.5)), np.linspace(0, 30, 151)
DECIBEL = 40  # the angles' mean square over the noise's
METHOD = zj.Method(rtol=1e-11)


def motion(numbers):
    """The column's motion from the kick, of (mu_s, mu_k, rho, c1, c2)."""
    mu_s, mu_k, rho, c1, c2 = numbers
    load = zj.ConstantLoad(1.0)  # k/l
    friction = zj.SetValuedCoulomb(mu_s, mu_k, pin_radius=rho, load=load)
    column = zj.uniform_rods(LOAD, friction=friction, damping=zj.Viscous(c1, c2))
    return zj.trajectory(column, KICK, TIMES, method=METHOD, max_events=60)


@jax.jit
def measured(numbers):
    """The angles' derivatives, (n, 2, 5), and the motion, in one pass."""

    def angles(numbers):
        run = motion(numbers)
        return run.phi, run

    return jax.jacfwd(angles, has_aux=True)(numbers)


@functools.lru_cache(maxsize=2)
def angles_and_slopes(tau_s, tau_k, c1, c2):
    """Of what can be told: all angles in a row, and their derivatives."""
    slopes, run = measured(np.array([tau_s, tau_k, 1.0, c1, c2]))
    slopes = np.delete(np.asarray(slopes), 2, axis=-1)  # rho is in tau
    return np.ravel(run.phi), slopes.reshape(-1, 4)


def fitted(angles):
    """The numbers that fit a history best, with their standard errors."""
    found = least_squares(
        lambda x: angles_and_slopes(*x)[0] - angles,
        GUESS,
        lambda x: angles_and_slopes(*x)[1],
        x_scale=GUESS,
        xtol=1e-7,
    )
    square = 2 * found.cost / (angles.size - 4)
    errors = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)) * square)
    return found.x, errors, found.nfev


def fisher(slopes, at, sigma):
    """Fisher's matrix of relative changes of the numbers."""
    rows = np.asarray(slopes).reshape(-1, len(at)) * at / sigma
    return rows.T @ rows


def main(arguments=None):
    """Fit, draw, and write a line of figures."""
    options = begin(__doc__).parse_args(arguments)
    count, random = 240 if options.small else 2000, np.random.default_rng(1)
    exact, slopes = angles_and_slopes(*TOGETHER)
    sigma = np.sqrt(np.mean(exact**2)) / 10 ** (DECIBEL / 20)
    bound = np.sqrt(np.diag(np.linalg.inv(fisher(slopes, TOGETHER, sigma)))) * TOGETHER
    apart, run = measured(TRUE)
    values, vectors = np.linalg.eigh(fisher(apart, TRUE, sigma))
    start = time.process_time()
    fits = [
        fitted(exact + sigma * random.normal(size=exact.size)) for _ in range(count)
    ]
    seconds = time.process_time() - start
    found, errors, calls = (np.array(column) for column in zip(*fits, strict=True))
    inside = np.abs(found - TOGETHER) < norm.ppf(0.975) * errors
    result = {
        "histories": count,
        "fits_cpu_s": seconds,
        "changes_of_modes": int(run.events.count) - 1,  # the first is the start
        "true": TOGETHER,
        "bound_over_true": bound / TOGETHER,
        "spread_over_bound": found.std(axis=0, ddof=1) / bound,
        "bias_over_bound": (found.mean(axis=0) - TOGETHER) / bound,
        "standard_error_over_bound": errors.mean(axis=0) / bound,
        "inside_95_percent": inside.mean(axis=0),
        "motions_a_fit": [calls.min(), calls.max()],
        "eigenvalues_over_largest": values / values[-1],
        "singular_direction": vectors[:, 0],
    }
    scores = (found - TOGETHER) / bound
    save(of_fits(run, sigma, scores, values), result, options.out, __file__)


if __name__ == "__main__":
    main()
