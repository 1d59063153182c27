"""JAX's debugging flags: they leave the package alone, and find a law's own NaN."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ziegler_jax as zj
from ziegler_jax import CODE
from ziegler_jax.model.damping import AbstractDamping
from ziegler_jax.runtime import own_flags

KICK = zj.State(omega=(0.0, 0.3))
SHORT = {"windows": zj.Windows(5.0, 5.0, 2), "method": zj.Method(rtol=1e-4, atol=1e-4)}


class Fails(AbstractDamping):
    """A law with a mistake: a root that is NaN beyond an angle of the knee."""

    def matrix(self, cos_d, omega):
        c = jnp.sqrt(cos_d - 0.99)
        return ((c, 0.0), (0.0, c))

    def valid(self):
        return True


def sliding(q=2.6):
    law = zj.SetValuedCoulomb(0.026, pin_radius=1.0, load=zj.ConstantLoad(1.0))
    return zj.uniform_rods(q, friction=law)


def everything():
    """Each kind of plain function once, with NaN and infinity in its results."""
    bare = zj.uniform_rods(2.0)
    found = zj.settle(bare, KICK, **SHORT, certify=False)
    moved = zj.trajectory(bare, KICK, [0.0, 1.0, 2.0])
    none = zj.critical_load(zj.uniform_rods(kappa=1e9), "divergence")
    dead = zj.critical_load(zj.uniform_rods(follower=0.0), "flutter")
    lost = zj.periodic_orbit(
        bare, KICK, period=1.0, method=zj.Method(rtol=1e-4, max_steps=10)
    )
    return [
        found.drift,
        moved.phi,
        none.q_cr,
        dead.q_cr,
        zj.regime(bare),
        zj.spectrum(bare),
        lost.period,
        lost.monodromy,
    ]


@pytest.fixture(scope="module")
def usual():
    return [np.asarray(x) for x in everything()]


@pytest.mark.parametrize(
    "flag", [jax.debug_nans, jax.debug_infs, jax.disable_jit], ids=lambda f: f.__name__
)
def test_the_package_computes_the_same_under_a_debugging_flag(flag, usual):
    with flag(True):
        found = everything()
    for x, y in zip(found, usual, strict=True):
        np.testing.assert_array_equal(x, y)


def test_set_valued_motions_and_cycles_compute_under_all_of_them():
    with jax.debug_nans(True), jax.debug_infs(True), jax.disable_jit():
        found = zj.settle(sliding(), KICK, **SHORT, certify=False)
        orbit = zj.periodic_orbit(sliding(), KICK, method=zj.Method(max_steps=20))
        assert orbit.multipliers.shape == (4,) and not orbit.stable
    assert int(found.outcome) >= CODE.unsettled


def test_flags_cost_nothing_where_none_is_set():
    assert type(own_flags()).__name__ == "nullcontext"
    with jax.debug_nans(True):
        with own_flags():
            jnp.log(jnp.asarray(-1.0))
        with pytest.raises(FloatingPointError):
            jnp.log(jnp.asarray(-1.0))


@pytest.mark.parametrize(
    "call",
    [
        lambda c, y: zj.settle(c, y, **SHORT, certify=False),
        lambda c, y: zj.trajectory(c, y, np.linspace(0, 1, 11)),
        lambda c, y: zj.poincare(column=c, start=y, max_time=10.0),
    ],
    ids=["settle", "trajectory", "poincare"],
)
def test_a_law_that_fails_is_found(call):
    """The knee's angle passes 0.14 after 0.15 time units."""
    column = zj.uniform_rods(2.6, damping=Fails())
    start = zj.State(omega=(0.0, 1.0))
    with jax.debug_nans(True), pytest.raises(FloatingPointError) as caught:
        call(column, start)
    assert " at t = 0." in str(caught.value) and "omega2" in str(caught.value)
    cause = caught.value.__cause__
    assert isinstance(cause, FloatingPointError)
    names = []
    trace = cause.__traceback__
    while trace is not None:
        names.append(trace.tb_frame.f_code.co_qualname)
        trace = trace.tb_next
    assert "Fails.matrix" in names


def test_a_law_that_fails_at_the_start_is_found():
    column = zj.uniform_rods(2.6, damping=Fails())
    with jax.debug_nans(True), pytest.raises(FloatingPointError, match="at t = 0,"):
        zj.settle(column, zj.State(phi=(0.0, 1.0)), **SHORT, certify=False)
    # without the flag the outcome tells
    found = zj.settle(column, zj.State(phi=(0.0, 1.0)), **SHORT, certify=False)
    assert int(found.outcome) == CODE.not_finite


def test_the_environments_flags_are_heeded():
    program = (
        "import ziegler_jax as zj\n"
        "column = zj.uniform_rods(2.0)\n"
        "print(zj.settle(column, zj.State(omega=(0, 0.3)),\n"
        "                windows=zj.Windows(1.0, 5.0, 1)).drift)\n"
        "print(zj.critical_load(column).q_cr)\n"
    )
    flags = {"JAX_DEBUG_NANS": "1", "JAX_DISABLE_JIT": "1", "JAX_ENABLE_X64": "1"}
    done = subprocess.run(
        [sys.executable, "-c", program], env={**os.environ, **flags},
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.stdout.split()[0] == "nan", done.stderr
    assert done.stdout.split()[1].startswith("2.54"), done.stdout
