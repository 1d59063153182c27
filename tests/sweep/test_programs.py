"""A program: a point that is traced and compiled once, in sweeps and by itself."""

import sys

import numpy as np
import pytest

import ziegler_jax as zj

KICK = zj.State(omega=(0.0, 0.3))
TABLE = {"damping": 0.05}


def point(q, mu, kappa=1.0):
    law = zj.SmoothCoulomb(mu, pin_radius=0.1, v_smooth=0.05)
    damping = zj.Viscous(TABLE["damping"], TABLE["damping"])
    column = zj.uniform_rods(q, kappa=kappa, friction=law, damping=damping)
    windows = zj.Windows(transient=5.0, length=5.0, max_windows=2)
    return zj.settle(column, KICK, windows=windows, certify=False)


Q, MU = np.linspace(1.0, 3.0, 9), np.array([0.1, 0.3])


@pytest.fixture(scope="module")
def program():
    return zj.Program(point)


def same(one, other):
    for name in one.data_vars:
        a, b = (ds[name].transpose("q", "mu", ...) for ds in (one, other))
        np.testing.assert_array_equal(a.values, b.values, err_msg=name)


def test_it_names_its_numbers_and_knows_what_it_returns(program):
    assert program.names == ("q", "mu")
    assert {"outcome", "joint_amplitude"} <= set(program.variables)
    assert "q, mu ->" in repr(program) and program.digest[:12] in repr(program)


def test_its_sweep_is_that_of_the_point_to_the_last_bit(program):
    """Whatever the order of the axes, and known by the same digest."""
    lanes = zj.Lanes(batch_size=128)
    known = zj.sweep(point, lanes=lanes, progress=False, q=Q, mu=MU)
    same(known, zj.sweep(program, progress=False, q=Q, mu=MU))
    turned = zj.sweep(program, progress=False, mu=MU, q=Q)
    same(known, turned)
    assert turned.outcome.dims == ("mu", "q")
    assert known.scene_digest == turned.scene_digest == program.digest


def test_it_is_neither_traced_nor_compiled_again(program, monkeypatch):
    def never(*_, **__):
        raise AssertionError("traced again")

    first = zj.sweep(program, progress=False, q=Q[:2], mu=MU)
    for module in ("sweep", "once"):  # by name: `zj.sweep` is a function
        for act in ("traced", "compiled"):
            monkeypatch.setattr(sys.modules[f"ziegler_jax.sweep.{module}"], act, never)
    again = zj.sweep(program, progress=False, q=Q[:2], mu=MU)
    same(first, again)
    assert again.compile_seconds == 0


def test_it_keeps_what_it_read_and_a_sweep_of_its_point_reads_anew(
    program, monkeypatch
):
    before = zj.sweep(program, progress=False, q=Q, mu=MU)
    monkeypatch.setitem(TABLE, "damping", 0.5)
    same(before, zj.sweep(program, progress=False, q=Q, mu=MU))
    after = zj.sweep(point, progress=False, q=Q, mu=MU)
    assert (after.joint_amplitude != before.joint_amplitude).any()


def test_called_it_gives_the_lanes_of_a_sweep(program):
    ds = zj.sweep(program, progress=False, q=Q, mu=MU)
    grid = program(q=Q[:, None], mu=MU)
    alone = program(q=Q[3], mu=0.3)
    for name, values in grid.items():
        np.testing.assert_array_equal(values, ds[name].values, err_msg=name)
        np.testing.assert_array_equal(alone[name], values[3, 1], err_msg=name)
    assert grid["joint_amplitude"].shape == (9, 2, 2)


def test_a_default_may_be_a_parameter_by_name():
    program = zj.Program(point, names=("q", "kappa", "mu"))
    assert program.names == ("q", "kappa", "mu")
    one = program(q=2.0, mu=0.1, kappa=1.0)["joint_amplitude"]
    other = program(q=2.0, mu=0.1, kappa=1.3)["joint_amplitude"]
    assert (one != other).any()


def test_what_breaks_a_rule_is_named(program, refuses):
    refuses(lambda: zj.Program(3), "`point`", "function", "3")
    refuses(lambda: zj.Program(lambda **axes: 1.0), "`point`", "names")
    refuses(lambda: zj.Program(point, names=("q",)), "`mu`", "axis")
    refuses(lambda: zj.Program(point, lanes=8), "`lanes`", "8")
    refuses(lambda: zj.sweep(program, q=Q), "`mu`", "axis")
    axes = {"q": Q, "mu": MU}
    refuses(lambda: zj.sweep(program, kappa=[1.0], **axes), "q, mu", "kappa")
    refuses(
        lambda: zj.sweep(program, lanes=zj.Lanes(batch_size=32), **axes),
        "`batch_size`", "32",
    )  # fmt: skip
    refuses(lambda: program(q=1.0), "q, mu", "given q")
    refuses(lambda: program(q=1.0, mu=np.nan), "`mu`", "nan")
    refuses(lambda: program(q=[1.0, 2.0], mu=[1.0, 2.0, 3.0]), "(2,)", "(3,)")
