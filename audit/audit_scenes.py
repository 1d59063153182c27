"""The scenes by which `audit.py` judges the paper's claims: one function a question.

Times are in sqrt(m l^2/k), torques in k, angles in rad.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import seed_style as style
from audit_readings import MU_K, RADII, READINGS, TRANSITION, UNITS, joint, law
from audit_readings import reading as reading  # for the table's lines
from scipy.integrate import solve_ivp
from seed_fig3 import KICK, as_printed, printed
from seed_fig3 import resolved as run_resolved

import ziegler_jax as zj

zj.configure_cpu()
resolved = functools.cache(run_resolved)
__all__ = ["np", "jnp", "zj", "printed", "resolved", "stiff"]
__all__ += ["MU_K", "RADII", "READINGS", "UNITS", "joint", "law", "reading"]


def public(function):
    """Name a scene for the lines of the table."""
    __all__.append(function.__name__)
    return function


def mean_rate(ts, size):
    """The slope of log(size), by the envelope's maxima."""
    top = np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:])) + 1
    return np.polyfit(ts[top], np.log(size[top]), 1)[0]


@functools.cache
def stiff(q, span, kick=KICK):
    """The same by scipy's BDF at error 1e-5."""
    return style.stiff(q, span, kick)


@public
def growth(q, kick=1e-8, begin=30.0, end=60.0):
    """The growth rate of the nonlinear column after a kick."""
    motion = resolved(q, end, kick, method=zj.Method(rtol=1e-11, atol=1e-16))
    ts = np.asarray(motion.ts)
    late = ts > begin
    return mean_rate(ts[late], np.abs(np.asarray(motion.phi[late, 1])))


@public
def onset(kick=1e-8):
    """Where the nonlinear column's growth rate squared, extrapolated, is zero."""
    q = np.array([2.56, 2.58, 2.60, 2.62])
    rate = np.array([growth(x, kick) for x in q])
    return np.polynomial.Polynomial.fit(q, rate**2, 2).roots().min()


@public
def peak(motion, begin=0.0, end=np.inf):
    """The largest angles of both rods between two times."""
    here = style.part(motion, begin, end)
    return np.abs(here.phi).max(axis=0)


@public
def crossings(motion):
    """The states (phi1, phi2, omega1) where rod 2 turns back."""
    y = np.concatenate([motion.phi, motion.omega], axis=1)
    w = y[:, 3]
    at = np.flatnonzero((w[:-1] > 0) & (w[1:] <= 0))
    share = (w[at] / (w[at] - w[at + 1]))[:, None]
    return (y[at] + share * (y[at + 1] - y[at]))[:, :3]


@public
def section(motion, begin=0.0, near=0.01):
    """How many of a motion's turning points differ by more than 1 %, and how many."""
    points = crossings(style.part(motion, begin, np.inf))
    scale = np.abs(points).max()
    found = []
    for point in points:
        if all(np.abs(point - other).max() > near * scale for other in found):
            found.append(point)
    return len(found), len(points)


@public
def reversal(q, span=40.0, kick=0.02):
    """Run, reverse the rates, run as long: how far from the start, relative."""
    ts = np.array([0.0, span])
    column, start = zj.uniform_rods(q=q), zj.State(omega=(0.0, kick))
    tight = {"method": zj.Method(rtol=1e-12, atol=1e-14)}
    there = zj.trajectory(column, start, ts, **tight)
    middle = zj.State(tuple(there.phi[-1]), tuple(-there.omega[-1]))
    back = zj.trajectory(column, middle, ts, **tight)
    miss = np.array([*back.phi[-1], *(back.omega[-1] + jnp.array([0.0, kick]))])
    return np.abs(miss).max() / float(np.abs(there.phi).max())


@public
def volume(q, span=20.0, kick=0.02):
    """The flow's change of the volume det M dphi dphi'."""
    column = zj.uniform_rods(q=q)

    def end(y):
        start = zj.State(y[:2], y[2:])
        m = zj.trajectory(
            column,
            start,
            np.array([0.0, span]),
            method=zj.Method(rtol=1e-11, atol=1e-13),
        )
        return jnp.concatenate([m.phi[-1], m.omega[-1]])

    def density(y):
        return column.a * column.d - (column.b * np.cos(y[0] - y[1])) ** 2

    y0 = jnp.array([0.0, 0.0, 0.0, kick])
    jacobian = np.asarray(jax.jit(jax.jacfwd(end))(y0))
    y1 = np.asarray(jax.jit(end)(y0))
    return np.linalg.det(jacobian) * density(y1) / density(np.asarray(y0))


@public
def printed_energy(span=50.0, kick=1.0):
    """At q = 0 the energy of Eq (3)'s own mass matrix, end over start."""
    m = printed(0.0, span, kick)
    (p1, p2), (w1, w2) = m.phi.T, m.omega.T / style.SEED_TIME
    e = 4 / 3 * w1**2 + np.cos(p1 - p2) * w1 * w2 + w2**2 / 3
    e = e + (p1**2 + (p2 - p1) ** 2) / 2
    return e.min() / e[0], e.max() / e[0]


@public
def right_energy(span=50.0, kick=1.0):
    """The same of the right equations."""
    m = resolved(0.0, span, kick)
    y = (m.phi[:, 0], m.phi[:, 1], m.omega[:, 0], m.omega[:, 1])
    e = np.asarray(zj.energy(zj.uniform_rods(), y))
    return e.min() / e[0], e.max() / e[0]


@public
def bdf_energy(span=1000.0, kick=0.2):
    """At q = 0, what is left of the energy by BDF at error 1e-5."""
    m = stiff(0.0, span, kick)
    y = (m.phi[:, 0], m.phi[:, 1], m.omega[:, 0], m.omega[:, 1])
    e = np.asarray(zj.energy(zj.uniform_rods(), y))
    return e[-1] / e[0]


@public
def printed_linear_error(q=2.6, h=1e-6):
    """Eq (3) against Eq (4) near 0: the largest difference of their Jacobians."""
    step = [
        (np.array(as_printed(0, h * e, q)) - as_printed(0, -h * e, q)) / (2 * h)
        for e in np.eye(4)
    ]
    m, k = np.array([[8 / 3, 1], [1, 2 / 3]]), np.array([[2 - q, q - 1], [-1, 1]])
    return np.abs(np.array(step).T[2:, :2] + np.linalg.solve(m, k)).max()


@public
def work(q=2.6, span=20.0, kick=0.02):
    """Gain of energy and work of the follower load over a span."""
    m = resolved(q, span, kick)
    y = (m.phi[:, 0], m.phi[:, 1], m.omega[:, 0], m.omega[:, 1])
    column = zj.uniform_rods(q=q)
    e, power = np.asarray(zj.energy(column, y)), zj.power(column, y).follower
    return e[-1] - e[0], np.trapezoid(power, m.ts)


@public
def linear_with_friction(q=2.6, tau=0.026, kick=3.0, spans=(20.0, 40.0, 60.0)):
    """Largest angle of the linearised column with Coulomb friction in its joints."""
    linear = zj.linearise(zj.uniform_rods(q=q))
    m, k = np.asarray(linear.mass), np.asarray(linear.stiffness)

    def field(t, y):
        t1, t2 = tau * np.tanh(y[2] / 0.01), tau * np.tanh((y[3] - y[2]) / 0.01)
        force = -k @ y[:2] + np.array([t2 - t1, -t2])
        return np.concatenate([y[2:], np.linalg.solve(m, force)])

    y = solve_ivp(field, (0, spans[-1]), (0, 0, 0, kick), "Radau", spans, rtol=1e-6).y
    return np.abs(y).max(axis=0)


@public
def flutter_under_gravity(weight=9.81 / 10):
    """The first q at which the upright column flutters; `weight` is m g l/k."""
    mass = np.array([[4 / 3, 1 / 2], [1 / 2, 1 / 3]])
    for q in np.linspace(0, 4, 4001):
        stiffness = np.array([[2 - q, q - 1], [-1, 1]]) - weight * np.diag([1.5, 0.5])
        if np.iscomplex(np.linalg.eigvals(np.linalg.solve(mass, stiffness))).any():
            return q
    return np.inf


@public
def swing(q, kick, span=500.0):
    """The largest angle of a rod without friction up to a time."""
    whole = zj.Windows(transient=0.0, length=span, max_windows=1, escape=1e3)
    column, start = zj.uniform_rods(q=q), zj.State(omega=(0.0, kick))
    return float(
        zj.settle(
            column, start, windows=whole, method=zj.Method(rtol=1e-8), certify=False
        ).rod_amplitude.max()
    )


@public
def beats(motion, begin=1500.0, window=200):
    """Rod 2's largest angle in windows of 10: the largest over the smallest of them."""
    phi = np.abs(np.asarray(style.part(motion, begin, np.inf).phi[:, 1]))
    tops = phi[: phi.size // window * window].reshape(-1, window).max(axis=1)
    return tops.max() / tops.min()


@public
def force_of_load(q=2.6, phi=(0.3, -0.2)):
    """The follower load's generalised forces by virtual work at the tip."""
    tip = jax.jacfwd(lambda p: jnp.array([jnp.sin(p).sum(), jnp.cos(p).sum()]))
    along = -q * jnp.array([jnp.sin(phi[1]), jnp.cos(phi[1])])
    return np.asarray(along @ tip(jnp.array(phi))), q * np.sin(phi[0] - phi[1])


@public
def settled(friction, q=2.6, kick=2.0, **options):
    """What a kick of rod 2 settles to."""
    watch = (zj.StickFraction(), zj.Period())
    return zj.settle(
        zj.uniform_rods(q=q, friction=friction),
        zj.State(omega=(0.0, kick)),
        **{"observers": watch} | options,
        certify=False,
    )


@public
def below_critical(q, kick=0.5, small=0.01):
    """Joint 1's swing without and with friction, and what a small kick ends in."""
    friction = law(0.03)
    free = float(peak(resolved(q, 1000, kick))[0])
    cycle = settled(friction, q, kick)
    quiet = settled(friction, q, small)
    swings = free, float(cycle.joint_amplitude[0])
    return swings, zj.CODE(int(quiet.outcome)).name


@public
def softer(friction, factor):
    """The same joint of the same program on a column with a unit of time so longer."""
    return zj.SmoothCoulomb(
        friction.mu_s,
        friction.mu_k,
        pin_radius=friction.pin_radius,
        v_stribeck=factor * friction.v_stribeck,
        v_smooth=factor * friction.v_smooth,
        load=friction.load,
    )


@public
@functools.cache
def sticks():
    """Stick fractions of both joints on every pin, load F, after a hard kick."""
    return [np.asarray(settled(law(r)).stick_fraction) for r in RADII]


@public
@functools.cache
def late(radius, q=2.6):
    """Ten periods of what a kick settles to, from the friction `law(radius)`."""
    windows = zj.Windows(agreement=1e-6, max_windows=200)
    end = settled(law(radius), q, windows=windows, method=zj.Method(rtol=1e-9))
    column = zj.uniform_rods(q=q, friction=law(radius))
    return zj.trajectory(
        column, end.final, np.linspace(0, 10 * float(end.period), 6001)
    )


@public
def losses(radius, q=2.6):
    """The spread of friction's loss over ten cycles of the settled motion, relative."""
    motion = late(radius, q)
    # over a cycle the energy comes back: the loss is the load's work
    y = (*motion.phi.T, *motion.omega.T)
    power = np.asarray(zj.power(zj.uniform_rods(q=q), y).follower)
    ts = np.asarray(motion.ts)
    loss = [
        np.trapezoid(power[i : i + 601], ts[i : i + 601]) for i in range(0, 6000, 600)
    ]
    return np.ptp(loss) / np.mean(loss)


@public
def regimes(radius, rate=TRANSITION, q=2.6):
    """Joint 2's shares of time in static friction, in passage, in dynamic friction."""
    friction = joint(radius, zj.FollowerLoad(), rate)
    cut = UNITS.transition_rate(radius, rate * radius)
    watched = [UNITS.scaled(zj.StickFraction(x)) for x in (cut, 1.5 * cut)]
    below, passed = (
        float(settled(friction, q, observers=(x,)).stick_fraction[1]) for x in watched
    )
    return below, passed - below, 1 - passed
