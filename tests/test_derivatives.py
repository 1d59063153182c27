"""Every derivative is right, NaN or refused: a walk over what the package returns.

Each function, each number of its result, each argument that may be traced. Right is
what differences say; each NaN has its reason here, and nothing else is NaN. One program
a function: all arguments are directions of one `jvp`, the rows of one `vjp` beside it
where reverse mode is promised.
"""

import functools
import inspect
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivative_walk import (
    NUMBERS,
    OF_DRY,
    OF_SMOOTH,
    OF_START,
    Case,
    P,
    column,
    dry,
    given,
    smooth,
    start,
    verdicts,
)

import ziegler_jax as zj
from ziegler_jax.motion.implicit import implicit, lost
from ziegler_jax.numerics.eigenvalues import eigenvalues

MOMENT = "when the verdict comes is a matter of steps"
ROUNDING = "rounding: by how much an equation is missed"
CREEPS = "what creeps on depends on the moment at which it was judged"
ON_THE_ARC = "where a point lies on the arc is a matter of the steps"
OF_THE_BRACKET = "it is a share of the bracket"
IN_STICK = "the edge cycle sticks at its section: no differences of its monodromy"
SECOND = "it would need second variations"
OPTION = "the end of a motion without a verdict depends on them"


def settled(p, law=smooth, begin=None, **options):
    """Of `settle`, the numbers by name and the ending."""
    end = zj.settle(column(p, law), begin or start(p), **options)
    return end.numbers | {
        "final": jnp.stack(end.final.y), "time": end.time, "drift": end.drift,
    }  # fmt: skip


FINE = zj.Method(rtol=1e-10, atol=1e-11)

# The first tier -----------------------------------------------------------------------


def _fields_of_a_column(p):
    """What is a closed form: forces, energies, matrices, loads, sticking sets."""
    smoothed, bare, y = column(p, smooth), column(p), start(p).y
    y3 = zj.PhasePoint((*y.phi, p.phi1, *y.omega, p.phi2))
    held = zj.sticking_set(
        zj.uniform_rods(p.q, l2=p.l2, kappa=p.kappa, friction=dry(p))
    )
    sliding = column(p, dry)
    powers = zj.power(smoothed, y)
    tangent = zj.tangent_column(smoothed)
    load = zj.critical_load(zj.tangent_column(smoothed))
    rows = zj.linearise(bare)
    return {
        "field": jnp.stack(zj.vector_field(0.0, y, smoothed)),
        "sliding": jnp.stack(zj.vector_field(0.0, y, sliding)),
        "reactions": zj.reactions(smoothed, y),
        "energy": zj.energy(bare, y),
        "knots": zj.energy(zj.point_masses(q=p.q, m1=p.m1, m2=p.m2, l2=p.l2), y),
        "power": jnp.stack(powers[:3]),
        "linear": jnp.stack(rows),
        "damping": jnp.array(tangent.damping.rows({(0, 1): (0.0, 1.0)}, (0.0, 0.0))),
        "q_cr": load.q_cr,
        "frequency": load.frequency,
        "divergence": zj.critical_load(
            zj.uniform_rods(kappa=p.kappa, follower=0.3 * p.eta, l2=p.l2), "divergence"
        ).q_cr,
        "spectrum": zj.spectrum(tangent),
        "abscissa": zj.spectral_abscissa(bare),
        "beck": zj.critical_load(zj.beck(3, air=p.c1, tip_inertia=p.m2)).q_cr,
        "chains": jnp.stack(
            [
                *zj.vector_field(0.0, y3, zj.pflueger(3, p.m1, p.q, foundation=p.m2)),
                *zj.vector_field(0.0, y3, zj.leipholz(3, p.q, rest_angles=p.phi1)),
            ]
        ),
        "corners": held.corners,
        "area": held.area,
        "torques": jnp.stack(held.torques(p.phi1, p.phi2)),
        "static": jnp.stack(held.static),
    }


def _units(p):
    """SI: what is made of metres, newtons and seconds, and back."""
    units = zj.SI(p.m, p.l, p.k)
    law = zj.SmoothCoulomb(
        p.mu_s, p.mu_k, pin_radius=p.radius, v_smooth=p.v, v_stribeck=p.v_s,
        load=zj.ConstantLoad(p.n),
    )  # fmt: skip
    joint = units.joint_friction(
        p.mu_s, p.mu_k, pin_radius=p.radius, transition_velocity=p.v
    )
    damping = zj.Sum(zj.Viscous(p.c1, p.c1), zj.Air(p.c1, p.c1, p.l2))
    rods = {"m1": p.m1, "m2": p.m, "l1": p.l, "l2": p.l2}
    made = units.scaled(zj.uniform_rods(p.F, **rods, friction=law, damping=damping))
    begin = units.scaled(zj.State((0.1, 0.2), (p.w1, p.w1)))
    windows = units.scaled(zj.Windows(p.t, p.t, rate_cut=p.w1))
    equal = {"m1": p.m, "m2": p.m, "l1": p.l, "l2": p.l}
    bare = units.scaled(zj.uniform_rods(p.F, **equal))
    motion = zj.trajectory(bare, begin, np.array([0.0, 0.1]), method=FINE)
    back = units.restore(motion)
    return {
        "column": jnp.stack(jax.tree.leaves(made)),
        "joint": jnp.stack(jax.tree.leaves(units.scaled(joint))),
        "rate": units.transition_rate(p.radius, p.v),
        "units": jnp.stack([units.time, units.force]),
        "state": jnp.stack(begin.y),
        "windows": jnp.stack([windows.transient, windows.length, windows.rate_cut]),
        "omega": back.omega,
        "ts": back.ts,
    }


def _history(p):
    history = zj.trajectory(
        column(p, smooth), start(p), jnp.array([0.0, 1.0, 2.0]) * p.t, method=FINE
    )
    return {"ts": history.ts, "phi": history.phi, "omega": history.omega}


def _orbit(p):
    p = P(NUMBERS | p)
    section = zj.SectionPlane("phi1", p.level)
    guess = zj.State((p.level, 0.9), (0.7, 0.9))
    orbit = zj.periodic_orbit(
        column(p, smooth), guess, section=section,
        observers=(zj.EnergyBalance(), zj.Mean()),
    )  # fmt: skip
    return orbit_numbers(orbit) | orbit.numbers


def orbit_numbers(orbit):
    return {
        "state": jnp.stack(orbit.state.y),
        "level": orbit.section.level,
        "period": orbit.period,
        "rod_amplitude": orbit.rod_amplitude,
        "joint_amplitude": orbit.joint_amplitude,
        "monodromy": orbit.monodromy,
        "multipliers": orbit.multipliers,
        "largest_multiplier": orbit.largest_multiplier,
        "residual": orbit.residual,
    }


SI_NUMBERS = {
    "m": 0.1, "l": 0.2, "k": 0.5, "F": 6.5, "m1": 0.12, "l2": 0.18, "c1": 1e-3,
    "mu_s": 0.15, "mu_k": 0.1, "radius": 0.004, "v": 0.3, "v_s": 2.0, "n": 3.0,
    "w1": 2.0, "t": 10.0,
}  # fmt: skip

QUICK = {
    # measured, beyond what differences let expect: 4e-13, 4e-14, 5e-11, 2e-8
    "closed forms": Case(_fields_of_a_column, NUMBERS | {"q": 1.5}, reverse=True),
    "SI": Case(_units, SI_NUMBERS, step=1e-3),
    "trajectory": Case(_history, NUMBERS | {"t": 2.0}),
    "periodic_orbit": Case(
        _orbit,
        given("eta", "c1", "mu_s", q=2.8, level=0.05),
        {("residual", "*"): ROUNDING},
        reverse=True,
        rtol=5e-6,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", QUICK)
def test_derivatives_are_right_or_listed(name):
    wrong, worst, tally = verdicts(QUICK[name])
    print(name, tally, f"worst {worst:.1e}")
    assert not wrong, wrong
    assert tally["right"] > 0


def test_steps_behind_a_stop_do_not_move_as_that_which_was_shortened_to_it():
    """Where they ended moved with it 100 times as far; what is read from them, too."""

    @jax.jit
    def stuck(transient):
        def share(transient):
            windows = zj.Windows(transient=transient, length=6.0, max_windows=2)
            end = zj.settle(
                column(P(NUMBERS), smooth), start(P(NUMBERS)), windows=windows,
                observers=(zj.StickFraction(),), method=zj.Method(rtol=1e-8),
                certify=False,
            )  # fmt: skip
            return end.stick_fraction

        return jax.jvp(share, (transient,), (1.0,))

    h = 1e-4
    difference = (stuck(11.0 + h)[0] - stuck(11.0 - h)[0]) / (2 * h)
    # measured 5e-5, before 8e-2
    np.testing.assert_allclose(stuck(11.0)[1], difference, rtol=0, atol=1e-3)


def test_averages_over_long_motions_have_no_derivatives(refuses):
    """Lyapunov exponents: they were 9e14 for 0.47."""

    def exponents(q, length=5.0):
        spans = zj.Spans(20.0, length, 4)
        c = column(P(NUMBERS | {"q": q}), smooth)
        return zj.lyapunov_exponents(c, zj.State(omega=(0, 0.3)), spans=spans)

    for derive in (jax.jacfwd, jax.jacrev):
        derived = derive(jax.jit(lambda q: exponents(q).exponents))
        refuses(
            lambda d=derived: jax.make_jaxpr(d)(2.6),
            "lyapunov_exponents",
            "no derivatives",
        )
    in_length = jax.jacfwd(lambda t: exponents(2.6, t).exponents)
    refuses(lambda: jax.make_jaxpr(in_length)(5.0), "lyapunov_exponents")


@pytest.mark.parametrize("certify", [True, False])
def test_reverse_mode_through_a_motion_of_unknown_length_is_refused(refuses, certify):
    def amplitude(q):
        c = column(P(NUMBERS | {"q": q}), smooth)
        return zj.settle(c, zj.State(omega=(0, 0.3)), certify=certify).rod_amplitude[0]

    derived = jax.grad(jax.jit(amplitude))
    refuses(lambda: jax.make_jaxpr(derived)(2.6), "`settle`", "jax.jacfwd")


ASKED = {
    "settle": lambda c, s, **o: zj.settle(c, s, **o).joint_amplitude,
    "settle by windows": lambda c, s, **o: (
        zj.settle(c, s, certify=False, **o).joint_amplitude
    ),
    "trajectory": lambda c, s, **o: zj.trajectory(c, s, [0.0, 3.0, 6.0], **o).phi,
    "poincare": lambda c, s, **o: (
        zj.poincare(c, s, section=zj.SectionPlane("phi1"), points=1, **o).times
    ),
    "sweep_up_down": lambda c, s, **o: (
        zj.sweep_up_down(
            lambda _: c, [2.4, 2.6], kick=s, certify=False, **o
        ).joint_amplitude
    ),
}


def asked(name, law, q, **options):
    return ASKED[name](column(P(NUMBERS | {"q": q}), law), start(P(NUMBERS)), **options)


@pytest.mark.parametrize(
    "name, law",
    [(name, smooth) for name in ("settle", "settle by windows", "sweep_up_down")]
    + [(name, dry) for name in ("trajectory", "poincare")],
)
def test_second_derivatives_that_would_be_wrong_are_refused(refuses, name, law):
    """They were: of a certified cycle twice the right one, or 20 times."""

    def slope(q):
        return jax.jvp(lambda q: asked(name, law, q), (q,), (1.0,))[1]

    twice = jax.make_jaxpr(lambda q: jax.jvp(jax.jit(slope), (q,), (1.0,)))
    refuses(lambda: twice(2.6), name.split()[0], "first derivatives only")


@pytest.mark.parametrize("name", ["trajectory", "poincare"])
def test_second_derivatives_under_smoothed_friction_are_right(name):
    @jax.jit
    def slopes(q):
        def slope(q):
            number = functools.partial(asked, name, smooth, method=FINE)
            return jax.jvp(number, (q,), (1.0,))[1]

        return jax.jvp(slope, (q,), (1.0,))

    h = 1e-4
    difference = (slopes(2.6 + h)[0] - slopes(2.6 - h)[0]) / (2 * h)
    # measured 1.5e-5, of the differences
    np.testing.assert_allclose(slopes(2.6)[1], difference, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    "name, tolerance", [*((name, "rtol") for name in ASKED), ("trajectory", "atol")]
)
def test_a_derivative_in_a_tolerance_is_refused(refuses, name, tolerance):
    """It was a zero, or NaN."""

    def answer(x):
        return asked(name, smooth, 2.6, method=zj.Method(**{tolerance: x}))

    derived = jax.jacfwd(jax.jit(answer))
    refuses(lambda: jax.make_jaxpr(derived)(1e-6), "`rtol` and `atol`", "no derivative")


def test_what_is_constant_to_jax_refuses_traced_numbers(refuses):
    """`sensitivity` and `stabilise` return datasets."""

    def derivative(kappa):
        return zj.sensitivity(zj.uniform_rods(kappa=kappa)).derivative.values

    def best(kappa):
        return zj.stabilise(zj.uniform_rods(kappa=kappa), {"follower": (0.9, 1.0)})

    def within(high):
        return zj.stabilise(zj.uniform_rods(), {"follower": (0.9, high)})

    for question in (derivative, best, within):
        refuses(lambda f=question: jax.jvp(f, (1.0,), (1.0,)), "concrete", "traced")


def test_a_batch_within_jit_is_derived_by_the_implicit_function_theorem():
    """It was a TypeError where the zeros that carry a derivative were no batch."""

    def root(p):  # of x^2 = p, as a search finds it
        x = jnp.sqrt(jax.lax.stop_gradient(p))
        return x + implicit((), lambda p, x: 0.5 / x[None], p[None], x)

    x = jnp.array([1.0, 4.0])
    for f in (jax.vmap(root), jax.jit(jax.vmap(root))):
        for g in (f, jax.jit(f)):
            np.testing.assert_allclose(jax.jvp(g, (x,), (jnp.ones(2),))[1], [0.5, 0.25])
            np.testing.assert_allclose(jax.vjp(g, x)[1](jnp.ones(2))[0], [0.5, 0.25])


def test_a_lost_derivative_is_nan_and_spoils_no_other():
    def numbers(p):
        rest = p**2
        return {"square": rest, "lost": lost(rest, (p[0], 3.0)), "none": lost(rest, 1)}

    p = jnp.array([1.0, 2.0])
    exact = np.diag([2.0, 4.0])
    for mode in (jax.jacfwd, jax.jacrev):
        for f in (numbers, jax.jit(numbers)):
            slope = mode(f)(p)
            np.testing.assert_array_equal(slope["square"], exact)
            np.testing.assert_array_equal(slope["none"], exact)
            assert np.isnan(slope["lost"][:, 0]).all()
            np.testing.assert_array_equal(slope["lost"][:, 1], exact[:, 1])
    # nor is a second one of it a number
    twice = jax.jacfwd(jax.jacfwd(numbers))(p)["lost"]
    assert np.isnan(twice[:, 0, 0]).all()
    # cotangents of unlike sign have no sum, and still no number
    assert np.isnan(jax.grad(lambda p: jnp.diff(numbers(p)["lost"])[0])(p)[0])
    batch = jax.jvp(jax.jit(jax.vmap(numbers)), (p[None],), (p[None],))[1]
    assert np.isnan(batch["lost"]).all()


@pytest.mark.parametrize("dtype", [float, complex])
def test_eigenvalues_move_one_by_one(rng, dtype):
    """Also of a matrix with a double one: the others keep their derivatives."""
    t = jnp.asarray(rng.normal(size=(4, 4)))
    inverse, to = jnp.linalg.inv(t), jnp.asarray(rng.normal(size=(4, 4)))
    middle = jnp.diag(jnp.array([0.5, -0.3, 0.2, 0.9]))
    if dtype is complex:
        middle = middle.at[:2, :2].set(jnp.array([[0.1, 0.6], [-0.6, 0.1]]))
    m = t @ middle @ inverse

    def values(m):
        return jnp.sort(eigenvalues(m))

    slope = jax.jvp(values, (m,), (to,))[1]
    h = 1e-6
    difference = (values(m + h * to) - values(m - h * to)) / (2 * h)
    np.testing.assert_allclose(slope, difference, rtol=1e-6)
    double = t @ jnp.diag(jnp.array([0.5, 0.5, 0.2, 0.9])) @ inverse
    slope = jax.jvp(values, (double,), (to,))[1]
    assert np.isnan(slope).sum() == 2
    largest = jax.grad(lambda m: values(m)[3].real)(double)
    assert np.isfinite(largest).all()


def test_every_public_function_is_walked_or_has_no_derivatives():
    here = Path(__file__).read_text()
    functions = {
        n for n in zj.__all__ if n.islower() and not inspect.isclass(getattr(zj, n))
    }
    walked = {n for n in functions if re.search(rf"zj\.{n}\(", here)}
    assert functions - walked <= set(CONSTANT)


CONSTANT = {
    "branch_off": "NaN, see `curves/test_flips_and_tori.py`",
    "compare": "of datasets",
    "configure_cache": "an action",
    "configure_cpu": "an action",
    "follow_again": "of datasets",
    "is_stiff": "yes or no",
    "label_cycles": "of datasets",
    "merge": "of datasets",
    "motion": "of datasets",
    "open_sweep": "of datasets",
    "refine": "of datasets",
    "regime": "a code",
    "scene": "of datasets",
    "sweep": "of datasets",
    "tableaus": "a module",
}

# The second ---------------------------------------------------------------------------


def _smooth(p):
    windows = zj.Windows(transient=p.transient, length=p.length, max_windows=3)
    watched = zj.StickFraction(p.cut), zj.Mean()
    return settled(p, windows=windows, observers=watched, method=FINE)


def _dry(p):
    watched = zj.StickFraction(), zj.Mean()
    return settled(p, dry, observers=watched, method=FINE, certify=True)


def _by_windows(p):
    windows = zj.Windows(transient=p.transient, length=p.length, max_windows=3)
    watched = zj.StickFraction(), zj.Mean(), zj.EnergyBalance()
    return settled(p, dry, windows=windows, observers=watched, method=FINE)


def _passages(p):
    found = zj.poincare(
        column(p, smooth), start(p), section=zj.SectionPlane("phi2", p.level),
        points=2, transient=p.transient, method=FINE,
    )  # fmt: skip
    return {"times": found.times, "phi": found.phi, "omega": found.omega}


def _up_and_down(p):
    windows = zj.Windows(transient=2.0, length=3.0, max_windows=2)
    kick = zj.State((0.0, 0.0), (p.w1, p.w2))
    found = zj.sweep_up_down(
        lambda q: column(p, dry, q), [2.4, 2.6], kick=kick, windows=windows, method=FINE
    )
    return {n: v for n, v in found.numbers.items() if n != "outcome"}


def _branch(p):
    """A fold from an orbit that is a constant, and its branch."""

    p = P(BRANCH | p)

    def make(q):
        return column(p, smooth, q)

    orbit, arc = known_orbit(), zj.Arc(direction=-1)
    fold = zj.bifurcation(make, "fold", orbit, p.q, arc=arc)
    short = zj.Arc(direction=-1, points=3)
    branch = zj.continue_cycle(make, orbit, p.q, arc=short, max_special_points=1)
    return {
        "fold": fold.parameter,
        "period": fold.period,
        "cycle": numbers_of_points(fold.cycle),
        "branch": numbers_of_points(branch.points),
    }


# of a fold's four multipliers two are 1: they have no derivatives
OF_POINTS = (
    "parameter", "phi", "omega", "period", "rod_amplitude", "joint_amplitude",
    "monodromy", "multipliers",
)  # fmt: skip


def numbers_of_points(points):
    named = {name: getattr(points, name, None) for name in OF_POINTS}
    return named | {"multipliers": points.multipliers[..., 2:]}


BRANCH = given("q", *OF_SMOOTH[1:], v=0.1) | {"q": 1.5}  # near a fold at 1.43


@functools.cache
def known_orbit():
    """The stable cycle at the numbers of `BRANCH`; asked for outside of a trace first.

    It is a constant of what is derived: a fold does not depend on where it is met.
    """
    at = P(BRANCH)
    guess = zj.State((0, 0), (0.49, 0.68))
    orbit = jax.jit(lambda: zj.periodic_orbit(column(at, smooth), guess))()
    assert orbit.outcome == zj.CODE.found and orbit.stable
    return orbit


def _curve(p):
    p = P(BRANCH | p)
    course = zj.Course(values=jnp.array([p.value]), second=(0.09, 0.11))
    curve = zj.bifurcation_curve(
        lambda q, mu: column(P(p | {"mu_s": mu}), smooth, q), "fold", known_fold(),
        second=0.1, course=course,
    )  # fmt: skip
    points = curve.points
    return numbers_of_points(points) | {
        "first": points.first, "second": points.second, "residual": points.residual,
    }  # fmt: skip


@functools.cache
def known_fold():
    """The fold of its branch, likewise."""
    at, orbit, arc = P(BRANCH), known_orbit(), zj.Arc(direction=-1)
    fold = jax.jit(
        lambda: zj.bifurcation(
            lambda q: column(at, smooth, q), "fold", orbit, at.q, arc=arc
        )
    )()
    assert fold.outcome == zj.CODE.found
    return fold.cycle


def _onset(p):
    p = P(NUMBERS | p)
    found = zj.flutter_onset(
        lambda q: column(p, smooth, q), start(p), (p.low, 3.0),
        search=zj.Search(6, 22),
    )  # fmt: skip
    return {"threshold": found.threshold, "width": found.width, "rises": found.rises}


def _kick(p):
    p = P(NUMBERS | p)
    found = zj.critical_kick(
        column(p, smooth), start(p), (p.low, 6.0), search=zj.Search(6, 22)
    )
    return {"threshold": found.threshold, "width": found.width, "rises": found.rises}


def _line(p):
    """Load and kick grow together."""
    p = P(NUMBERS | p)

    def cell(s):
        phi, omega = start(p).phi, start(p).omega
        return column(p, smooth, s), zj.State(phi, (omega[0], s * omega[1]))

    found = zj.threshold(cell, (p.low, 3.0), search=zj.Search(6, 22))
    return {"threshold": found.threshold, "width": found.width, "rises": found.rises}


def _least(p):
    """As in its own tests, where `energy` is derived in reverse mode, too."""
    friction = zj.SetValuedCoulomb(
        (p.tau1, 0.02), pin_radius=1.0, load=zj.ConstantLoad(1.0)
    )
    found = zj.least_kick(
        zj.uniform_rods(p.q, friction=friction), (0.0, 0.008),
        directions=zj.Directions(count=8, scan=4, width=1e-7),
        method=zj.Method(rtol=1e-9, atol=2e-11),
    )  # fmt: skip
    names = ("energy", "width", "ray", "misalignment", "edge_state", "edge_period")
    names += ("edge_multiplier", "edge_amplitude")
    return {name: getattr(found, name) for name in names}


VERDICT = {("final", "*"): MOMENT, ("time", "*"): MOMENT, ("drift", "*"): ROUNDING}
USUAL = {"cut": 0.05, "transient": 300.0, "length": 20.0}
SETTLE = given(*OF_SMOOTH, *OF_START)
# measured likewise: 7e-6, none, 3e-6, 2e-5, none, 3e-10; 1e-5, 5e-9; 2e-8, 3e-6, 5e-9,
# and 2e-4 of the onset and of the line
OF_A_THRESHOLD = {
    "rtol": 5e-3, "step": 1e-3, "least": 3e-7, "reverse": True, "batch": True,
}  # fmt: skip
SLOW = {
    "settle: a certified cycle": Case(
        _smooth, SETTLE | USUAL, VERDICT, rtol=1e-4, least=1e-8, step=1e-3
    ),
    "settle: rest under a smoothed law": Case(
        _smooth, SETTLE | USUAL | {"q": 1.0}, {("*", "*"): CREEPS}
    ),
    "settle: undecided": Case(
        _smooth,
        SETTLE | {"cut": 0.05, "transient": 5.0, "length": 6.0},
        {("drift", "*"): ROUNDING, ("*", "transient"): OPTION, ("*", "length"): OPTION},
    ),
    "settle: a certified cycle of dry friction": Case(
        _dry, given(*OF_DRY, *OF_START), VERDICT, rtol=1e-4, step=1e-3
    ),
    "settle: dry friction sticks": Case(
        _dry,
        given(*OF_DRY, *OF_START) | {"q": 1.0},
        {("time", "*"): MOMENT, ("drift", "*"): ROUNDING},
        rtol=1e-4,
    ),
    "settle: by windows": Case(
        _by_windows,
        given(*OF_DRY, *OF_START, transient=5.0, length=6.0),
    ),
    "poincare": Case(
        _passages, given(*OF_SMOOTH, *OF_START, level=0.1, transient=5.0), rtol=1e-4
    ),
    "sweep_up_down": Case(_up_and_down, given(*OF_DRY, "w1", "w2"), rtol=1e-4),
    "periodic_orbit": Case(
        _orbit,
        given(*OF_SMOOTH, level=0.05) | {"q": 2.8},
        {("residual", "*"): ROUNDING},
        rtol=5e-6,
        batch=True,
    ),
    # of these some numbers stand for all, which are differentiated as one vector
    "bifurcation, continue_cycle": Case(
        _branch,
        {name: BRANCH[name] for name in ("q", "kappa", "c1", "mu_s")},
        {(f"branch.{n}", "*"): ON_THE_ARC for n in OF_POINTS},
        rtol=1e-4,
        reverse=True,
        batch=True,
    ),
    "bifurcation_curve": Case(
        _curve,
        {"kappa": BRANCH["kappa"], "c1": BRANCH["c1"], "value": 0.1},
        {("residual", "*"): ROUNDING},
        rtol=1e-4,
    ),
    "flutter_onset": Case(
        _onset,
        given("kappa", "c1", "mu_s", "phi2", "w2", low=1.0),
        {("width", "low"): OF_THE_BRACKET},
        **OF_A_THRESHOLD,
    ),
    "threshold": Case(
        _line,
        given("kappa", "c1", "mu_s", "phi2", "w2", low=1.0),
        {("width", "low"): OF_THE_BRACKET},
        **OF_A_THRESHOLD,
    ),
    "critical_kick": Case(
        _kick,
        given("kappa", "mu_s", "w2", low=0.02) | {"q": 1.6},
        {("width", "low"): OF_THE_BRACKET},
        **OF_A_THRESHOLD,
    ),
    "least_kick": Case(
        _least,
        {"q": 2.3, "tau1": 0.02},
        {(n, "*"): SECOND for n in ("width", "ray", "misalignment")}
        | {("edge_multiplier", "*"): IN_STICK},
        rtol=5e-3,
        step=1e-3,
        batch=True,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SLOW)
def test_derivatives_of_long_motions_are_right_or_listed(name):
    for known in {
        "bifurcation, continue_cycle": [known_orbit],
        "bifurcation_curve": [known_fold],
    }.get(name, []):
        known()
    wrong, worst, tally = verdicts(SLOW[name])
    print(name, tally, f"worst {worst:.1e}")
    assert not wrong, wrong
