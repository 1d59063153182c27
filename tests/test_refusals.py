"""Refusals: traced options, 32 bits, wrong options, and what a point may not return."""

import functools

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from options import options_of

import ziegler_jax as zj
from ziegler_jax import CODE
from ziegler_jax.motion.observers import AbstractObserver
from ziegler_jax.results import AbstractResult, Variable
from ziegler_jax.sweep.returned import labelled

KICK = zj.State(omega=(0.0, 0.2))
COLUMN = zj.uniform_rods(2.0)
SLIDING = zj.uniform_rods(
    2.6,
    friction=zj.SetValuedCoulomb(0.026, pin_radius=1.0, load=zj.ConstantLoad(1.0)),
)
QUICK = {"transient": 5.0, "length": 5.0, "max_windows": 2, "rtol": 1e-4, "atol": 1e-4}
SHORT = options_of(zj.settle, **QUICK)


# Options that are traced --------------------------------------------------------------


def settled(**options):
    return zj.settle(
        COLUMN, KICK, **options_of(zj.settle, **{**QUICK, **options}), certify=False
    )


def found_orbit(**options):
    return zj.periodic_orbit(SLIDING, KICK, **options_of(zj.periodic_orbit, **options))


def sliding(q):
    return zj.uniform_rods(q, friction=SLIDING.friction)


@functools.cache
def orbit():
    @jax.jit
    def search():
        near = zj.settle(SLIDING, zj.State(omega=(0.0, 0.3)), certify=False).final
        return zj.periodic_orbit(SLIDING, near)

    with jax.ensure_compile_time_eval():  # also where a question is traced
        return search()


def fold(**options):
    options = options_of(zj.bifurcation, **options)
    return zj.bifurcation(sliding, "fold", orbit(), 2.6, **options)


def branch(**options):
    options = options_of(zj.continue_cycle, points=2, **options)
    return zj.continue_cycle(sliding, orbit(), 2.6, **options)


def kick(**options):
    options = options_of(zj.critical_kick, scan=2, halvings=1, **options)
    return zj.critical_kick(SLIDING, KICK, (0.1, 2.0), **options)


def up_down(**options):
    found = zj.sweep_up_down(
        lambda q: zj.uniform_rods(q),
        [1.0, 1.5],
        kick=KICK,
        certify=False,
        **options_of(zj.sweep_up_down, **{**QUICK, **options}),
    )
    return jnp.max(found.outcome)


def called(question, *scene, **more):
    """The question as a function of fields of its options."""
    return lambda **fields: question(*scene, **options_of(question, **more, **fields))


def outcome(result):
    return getattr(result, "outcome", result)


STEPS = {"rtol": 1e-4, "atol": 1e-4}
CERTIFIED = {**STEPS, "length": 5.0, "escape": 3.0, "rate_cut": 1e-3}
WINDOWS = {**CERTIFIED, "agreement": 1e-3}
BLOCKS = {**STEPS, "length": 5.0, "escape": 3.0}
WALK = {**STEPS, "step": 0.1}
TRACED = {
    "settle": (settled, WINDOWS, CODE.invalid),
    "trajectory": (
        called(zj.trajectory, COLUMN, KICK, [0.0, 1.0]),
        STEPS,
        CODE.invalid,
    ),
    "lyapunov_exponents": (
        called(zj.lyapunov_exponents, COLUMN, KICK, count=1),
        BLOCKS,
        CODE.invalid,
    ),
    "poincare": (
        called(zj.poincare, COLUMN, KICK, points=3),
        {**STEPS, "max_time": 5.0, "escape": 3.0},
        CODE.invalid,
    ),
    "periodic_orbit": (found_orbit, {**STEPS, "max_time": 50.0}, CODE.invalid),
    "its period": (found_orbit, {"period": 4.0}, CODE.invalid),
    "bifurcation": (fold, WALK, CODE.invalid),
    "continue_cycle": (branch, WALK, CODE.invalid),
    "critical_kick": (kick, CERTIFIED, CODE.invalid),
    "sweep_up_down": (up_down, WINDOWS, CODE.invalid),
}


@pytest.mark.parametrize("which", TRACED)
def test_traced_options_are_finite_and_positive(which):
    """One lane for each option and bad value, all others as they should be."""
    call, usual, invalid = TRACED[which]
    lanes = [
        {**usual, name: bad} for name in usual for bad in (np.inf, np.nan, 0.0, -1.0)
    ]
    lanes = {name: jnp.array([lane[name] for lane in lanes]) for name in usual}
    ended = jax.jit(jax.vmap(lambda options: outcome(call(**options))))(lanes)
    assert ended.tolist() == [int(invalid)] * len(ended)


@pytest.mark.parametrize(
    "call, name, invalid",
    [
        (settled, "transient", CODE.invalid),
        (found_orbit, "level", CODE.invalid),
        (called(zj.poincare, COLUMN, KICK), "level", CODE.invalid),
    ],
)
def test_traced_options_that_may_be_zero_are_finite(call, name, invalid):
    bad = jnp.array([jnp.inf, jnp.nan])
    lanes = jax.jit(jax.vmap(lambda x: outcome(call(**{name: x}))))(bad)
    assert lanes.tolist() == [int(invalid)] * 2


def test_an_invalid_motion_is_of_that_kind():
    found = jax.jit(
        lambda x: zj.settle(COLUMN, KICK, method=zj.Method(rtol=x), exponents=2)
    )(jnp.inf)
    assert int(found.kind) == CODE.invalid


# 32 bits ------------------------------------------------------------------------------


def bare(x):
    del x
    return COLUMN


PLAIN = {
    "settle": lambda: zj.settle(
        COLUMN, KICK, method=zj.Method(rtol=1e-3, atol=1e-3), certify=False
    ),
    "trajectory": lambda: zj.trajectory(
        COLUMN, KICK, [0.0, 1.0], method=zj.Method(rtol=1e-3, atol=1e-3)
    ),
    "lyapunov_exponents": lambda: zj.lyapunov_exponents(COLUMN, KICK),
    "poincare": lambda: zj.poincare(COLUMN, KICK),
    "periodic_orbit": lambda: zj.periodic_orbit(SLIDING, KICK),
    "continue_cycle": lambda: zj.continue_cycle(bare, KICK, 2.0),
    "bifurcation": lambda: zj.bifurcation(bare, "fold", KICK, 2.0),
    "branch_off": lambda: zj.branch_off(bare, "flip", KICK),
    "critical_kick": lambda: zj.critical_kick(SLIDING, KICK, (0.0, 1.0)),
    "threshold": lambda: zj.threshold(lambda q: (bare(q), KICK), (0.0, 1.0)),
    "flutter_onset": lambda: zj.flutter_onset(bare, KICK, (0.0, 1.0)),
    "sweep_up_down": lambda: zj.sweep_up_down(bare, [1.0, 2.0], kick=KICK),
    "critical_load": lambda: zj.critical_load(COLUMN),
    "sensitivity": lambda: zj.sensitivity(COLUMN),
    "stabilise": lambda: zj.stabilise(COLUMN, {"kappa": (1.0, 2.0)}),
    "linearise": lambda: zj.linearise(COLUMN),
    "spectrum": lambda: zj.spectrum(COLUMN),
    "spectral_abscissa": lambda: zj.spectral_abscissa(COLUMN),
    "regime": lambda: zj.regime(COLUMN),
    "tangent_column": lambda: zj.tangent_column(COLUMN),
    "sticking_set": lambda: zj.sticking_set(SLIDING),
}


@pytest.mark.parametrize("name", PLAIN)
def test_a_32_bit_session_is_told_what_to_type(refuses, name):
    cure = 'jax.config.update("jax_enable_x64", True)'
    with jax.enable_x64(False):
        refuses(PLAIN[name], f"`{name}`", "64-bit", cure, "`sweep`")


def test_a_trace_in_32_bits_is_refused():
    with pytest.raises(ValueError), jax.enable_x64(False):
        jax.jit(lambda q: zj.critical_load(zj.uniform_rods(q)).q_cr)(1.0)


# Options and values that are none -----------------------------------------------------


@pytest.mark.parametrize(
    "who, call, options",
    [
        (
            "uniform_rods",
            lambda: zj.uniform_rods(1.0, mass=2),
            "m1, m2, l1, l2, kappa, follower, damping, friction, forces, "
            "rest_angles, dead_load, gravity, foundation, tip_mass, tip_inertia",
        ),
        (
            "point_masses",
            lambda: zj.point_masses(mass=2),
            "m1, m2, l1, l2, kappa, follower, damping, friction, forces, "
            "rest_angles, dead_load, gravity, foundation, tip_mass, tip_inertia",
        ),
    ],
)
def test_a_function_names_its_own_options(who, call, options):
    with pytest.raises(TypeError) as caught:
        call()
    sentence = f"`{who}` has no option `mass`; its options are {options}."
    assert str(caught.value) == sentence


@pytest.mark.parametrize(
    "wrong, parts",
    [
        (dfx.Euler(), ("`tableau`", "Euler")),
        (dfx.Tsit5, ("`tableau`", "Tsit5", "`diffrax.ButcherTableau`")),
        ("Tsit5", ("`tableau`", "`diffrax.ButcherTableau`", "'Tsit5'")),
        (None, ("`tableau`", "None")),
    ],
    ids=str,
)
def test_a_method_is_made_of_a_tableau(refuses, wrong, parts):
    refuses(lambda: zj.Explicit(wrong), *parts)


@pytest.mark.parametrize(
    "method", [zj.Explicit(), zj.Rosenbrock(), zj.Explicit(dfx.Dopri8.tableau)]
)
def test_a_method_may_be_an_argument_of_a_jit(method):
    assert jax.tree.leaves(method) == []
    inside = jax.jit(lambda m: settled(solver=m))(method)
    outside = jax.jit(lambda: settled(solver=method))()
    np.testing.assert_array_equal(inside.final.y, outside.final.y)


# What a point returns -----------------------------------------------------------------


@pytest.mark.parametrize(
    "point, parts",
    [
        (lambda q: zj.spectrum(zj.uniform_rods(q)), ("`value`", "(4,)", "dims=")),
        (lambda q: {"s": zj.Variable(jnp.ones(3), "it")}, ("`s`", "(3,)", "dims=")),
        (lambda q: zj.linearise(zj.uniform_rods(q)), ("`Linear`", "numbers of it")),
        (lambda q: {"start": zj.State()}, ("`start`", "`State`", "state.phi[0]")),
        (lambda q: {"a_time": q, "a": settled()}, ("two", "`a_time`")),
        (lambda q: {"a": at([0, 1]), "b": at([0, 2])}, ("agree", "`ts`")),
    ],
    ids=["an array", "without dims", "linearise", "a state", "twice", "times"],
)
def test_what_a_point_may_not_return_is_named(refuses, point, parts):
    refuses(lambda: zj.sweep(point, q=[1.0], progress=False), "`point`", *parts)


def at(ts):
    return zj.trajectory(COLUMN, KICK, ts)


class Bare(AbstractObserver):
    """An observer that forgets to say what its number is."""

    name = "rate"

    def init(self, column, t, y):
        return y[2]

    def step(self, column, state, step):
        return step.y1[2]

    def result(self, column, state, span, y):
        return {"rate": state}


def test_an_observer_names_its_numbers(refuses):
    def point(q):
        return zj.settle(
            zj.uniform_rods(q), KICK, observers=(Bare(),), **SHORT, certify=False
        )

    parts = "observer `rate`", "`Variable`", "`rate`", "write `zj.Variable(value, "
    refuses(lambda: zj.sweep(point, q=[1.0], progress=False), *parts)


class Own(AbstractResult):
    """A result of one's own that says something else of its numbers."""

    named: object
    settings: tuple = ()

    def variables(self):
        return self.named  # type: ignore[return-value]


def test_a_result_of_ones_own_names_its_numbers(refuses):
    refuses(lambda: labelled(Own({"a": 1.0})), "`Own`", "`a`", "float")
    refuses(lambda: labelled(Own([1.0])), "`Own`", "dict", "[1.0]")
    good = {"a": Variable(1.0, "a number")}
    assert labelled(Own(good)).variables == good
