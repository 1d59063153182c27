"""The house: rooms, and what a scene does not name is not in its program."""

import collections
import functools
import os
import re
import subprocess
import sys
import tomllib
import typing
from pathlib import Path

import diffrax as dfx
import jax
import numpy as np
import pytest
from house import against_the_rule, asked_for_laws, calls, in_a_circle, plan
from house import count as count_house
from tiers import FIRST, NIGHT, SLOW

import ziegler_jax as zj
from ziegler_jax.steady.rest import decays

PACKAGE = Path(zj.__file__).parent

FILES = plan(PACKAGE)
COUNTED = functools.cache(lambda: count_house(PACKAGE))


@pytest.mark.parametrize("file", FILES, ids="/".join)
def test_a_room_imports_only_from_rooms_before_it(file):
    assert not against_the_rule(file, FILES[file])


def test_no_file_imports_itself_through_others():
    assert in_a_circle(FILES) is None


def test_no_folder_and_no_file_is_too_large_to_find_ones_way():
    numbers = COUNTED()
    assert numbers["files in the longest folder"] <= 17
    lines = {path: path.read_text().count("\n") for path in PACKAGE.rglob("*.py")}
    # one idea: what is written, what counts of it, and what a reader is shown of it
    assert lines.pop(PACKAGE / "sweep" / "store.py") <= 920
    # a file is as long as its idea: no class is cut in two for this
    assert max(lines.values()) <= 450


def test_functions_are_short_and_names_and_types_say_something():
    numbers = COUNTED()
    assert numbers["most arguments"] <= 8 and numbers["longest function"] <= 80
    assert numbers["Any and its aliases"] < 100
    assert numbers["participles for names"] == 0


def test_one_place_integrates_and_no_law_is_asked_for_by_its_class():
    (file, _), *others = calls(PACKAGE, "diffeqsolve")
    assert file == ("motion", "integrate") and not others
    assert not asked_for_laws(PACKAGE)


def test_the_tests_of_rooms_see_imports():
    """Else an import that they cannot read would pass."""
    assert {("sweep", "program"), ("runtime",)} <= FILES["sweep", "sweep"]
    assert ("solvers", "__init__") in FILES["motion", "integrate"]
    assert ("solvers", "explicit") in FILES["solvers", "fold"]
    assert ("__init__",) in FILES["__main__",]
    upwards = ("model", "column")
    assert against_the_rule(("numerics", "numbers"), {upwards}) == [upwards]
    assert against_the_rule(("sweep", "sweep"), {("analysis", "threshold")})
    assert in_a_circle(FILES | {("numerics", "numbers"): {upwards}})


def test_every_entry_of_the_second_tier_is_a_test_and_no_mark_leaves_none_out():
    """Else one that was renamed would be in the first tier again, without a word."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-m", ""]
    done = subprocess.run(
        [*command, "-p", "no:cacheprovider"], cwd=Path(__file__).parents[1],
        capture_output=True, text=True, timeout=400,
    )  # fmt: skip
    assert done.returncode == 0 and "deselected" not in done.stdout, done.stdout
    tests = [x.removeprefix("tests/") for x in done.stdout.splitlines() if "::" in x]
    entries = [entry for entries in SLOW.values() for entry in entries]
    for entry in [*entries, *NIGHT, *FIRST]:
        assert any(test.startswith(entry) for test in tests), entry


# What tries the inside itself: what is compiled
OF_THE_INSIDE = {"b4_first_call": {"sweep.program"}}


def test_benchmarks_figures_audit_and_studies_use_public_names():
    root = Path(__file__).parents[1]
    found = {}
    folders = ("audit", "benchmarks", "figures", "examples/studies")
    for path in [p for name in folders for p in (root / name).rglob("*.py")]:
        text = path.read_text()
        rooms = set(re.findall(r"from ziegler_jax\.(\S+) import", text))
        names = set(re.findall(r"from ziegler_jax import (\w+)|\bzj\.(\w+)", text))
        names = {name for pair in names for name in pair if name}
        private = names - {"__file__", "__main__", "plot", *zj.__all__} | rooms - {
            "__main__"
        }
        if private or re.search(r"import ziegler_jax\.", text):
            found[path.stem] = private
    assert found == OF_THE_INSIDE


# What is traced -----------------------------------------------------------------------


def equations(jaxpr):
    """All equations of a program, those inside loops and calls included."""
    for equation in jaxpr.eqns:
        yield equation
        for part in jax.tree.leaves(
            list(equation.params.values()), is_leaf=lambda x: hasattr(x, "eqns")
        ):
            inner = getattr(part, "jaxpr", part)
            if hasattr(inner, "eqns"):
                yield from equations(inner)


def count(function, *arguments):
    """How often each primitive stands in the program."""
    closed = jax.make_jaxpr(function)(*arguments)
    return collections.Counter(_name(e) for e in equations(closed.jaxpr))


def _name(equation):
    """The primitive's; of the package's own functions (`_sincos`, `tanh2`) theirs."""
    if equation.primitive.name == "custom_jvp_call":
        about = equation.params["call_jaxpr"].jaxpr.debug_info
        return about.func_src_info.split(" at ")[0]
    return equation.primitive.name


NUMBERS = {"q": 2.0, "mu": 0.1, "eta": 0.5, "c": 0.01}
Y = zj.PhasePoint((0.1, -0.2, 0.3, 0.1))


def field_of(build):
    return count(
        lambda numbers, y: zj.vector_field(0.0, y, build(**numbers)), NUMBERS, Y
    )


def one_coefficient(mu, **parts):
    return zj.SmoothCoulomb(mu, pin_radius=0.1, v_smooth=0.01, **parts)


def two_coefficients(mu, **parts):
    return zj.SmoothCoulomb(
        1.2 * mu, mu, pin_radius=0.1, v_smooth=0.01, v_stribeck=0.1, **parts
    )


BARE = field_of(lambda q, **_: zj.uniform_rods(q))


def sines(program):
    return program["_sincos"]


def test_the_bare_field_has_one_sincos_and_no_friction():
    assert sines(BARE) == 1
    for name in ("tanh2", "half_to_the", "tanh", "exp", "sqrt", "sin", "cos", "pow"):
        assert BARE[name] == 0, name
    assert BARE["div"] == 2  # the determinant's, and that of rod 2's inertia


def test_friction_adds_one_tanh_a_joint_and_no_exponential():
    program = field_of(
        lambda q, mu, **_: zj.uniform_rods(q, friction=one_coefficient(mu))
    )
    assert (program["tanh2"], program["half_to_the"], sines(program)) == (2, 0, 1)
    assert program["tanh"] == program["exp"] == 0


def test_the_static_part_adds_one_exponential_a_joint():
    program = field_of(
        lambda q, mu, **_: zj.uniform_rods(q, friction=two_coefficients(mu))
    )
    assert (program["tanh2"], program["half_to_the"], sines(program)) == (2, 2, 1)
    assert program["tanh"] == program["exp"] == 0


def test_only_loads_on_reactions_have_a_loop_for_them():
    for load in (zj.FollowerLoad(), zj.ConstantLoad(1.0)):
        program = field_of(
            lambda q, mu, load=load, **_: zj.uniform_rods(
                q, friction=one_coefficient(mu, load=load)
            )
        )
        assert program["sqrt"] == 0
    for steps in (1, 3):
        program = field_of(
            lambda q, mu, steps=steps, **_: zj.uniform_rods(
                q, friction=one_coefficient(mu, load=zj.JointReaction(steps))
            )
        )
        # two magnitudes to start, two in the loop's step, two for what is left
        assert (program["sqrt"], program["scan"], sines(program)) == (6, 1, 1)


@pytest.mark.parametrize("eta", [1, 1.0, np.float64(1.0)])
def test_a_tangential_load_has_no_second_sincos(eta):
    assert field_of(lambda q, **_: zj.uniform_rods(q, follower=eta)) == BARE


def test_another_load_has_a_sincos_for_each_rod():
    for eta in (0.5, None):
        program = field_of(
            lambda q, eta=eta, **numbers: zj.uniform_rods(
                q, follower=NUMBERS["eta"] if eta is None else eta
            )
        )
        assert sines(program) == 3


def test_no_damping_leaves_no_trace_and_damping_does():
    damped = field_of(lambda q, c, **_: zj.uniform_rods(q, damping=zj.Viscous(c, c)))
    # C w: four products and two sums, and a row's subtraction each
    assert damped["mul"] == BARE["mul"] + 4
    assert damped["sub"] == BARE["sub"] + 2
    assert field_of(lambda q, **_: zj.uniform_rods(q, damping=None)) == BARE


class Spring(zj.AbstractForce):
    k: float

    def torques(self, t, phi, omega):
        return -self.k * phi[0], 0.0 * phi[1]


def test_no_forces_leave_no_trace_and_a_force_does():
    sprung = field_of(lambda q, c, **_: zj.uniform_rods(q, forces=Spring(c)))
    # its own two products, and a sum for each rod
    assert sprung["mul"] == BARE["mul"] + 2 and sprung["add"] == BARE["add"] + 2
    for none in (None, ()):
        assert field_of(lambda q, none=none, **_: zj.uniform_rods(q, forces=none)) == (
            BARE
        )


def settle_of(build, observers=(), **options):
    def scene(numbers):
        return zj.settle(
            build(**numbers),
            zj.State(omega=(0.0, 0.1)),
            observers=observers,
            **options,
            certify=False,
        ).numbers

    return scene


def bare(q, **_):
    return zj.uniform_rods(q)


def rubbing(q, mu, **_):
    return zj.uniform_rods(q, friction=one_coefficient(mu))


STAGES = {"Tsit5": (dfx.Tsit5, 6), "Dopri8": (dfx.Dopri8, 13)}


@pytest.mark.parametrize("name", STAGES)
def test_settle_evaluates_the_field_once_a_stage(name):
    """Once more for the first stage of the first step, and once for what rests."""
    method, stages = STAGES[name]
    solver, one = zj.Explicit(method.tableau), zj.Windows(max_windows=1)
    scene = settle_of(bare, method=zj.Method(solver), windows=one)
    assert sines(count(scene, NUMBERS)) == stages + 2
    scene = settle_of(rubbing, method=zj.Method(solver), windows=one)
    program = count(scene, NUMBERS)
    rest = count(
        lambda numbers, y: decays(rubbing(**numbers).system(), y, y[0]), NUMBERS, Y
    )
    expected = stages + 1 + sines(rest), 2 * (stages + 1) + rest["tanh2"]
    assert (sines(program), program["tanh2"]) == expected


def test_windows_are_compared_by_losses_without_evaluating_a_law():
    """Sines at each step's end alone, where a motion begins and where a window does."""
    one, several = (
        count(settle_of(rubbing, windows=zj.Windows(max_windows=n)), NUMBERS)
        for n in (1, 2)
    )
    assert sines(several) - sines(one) == 3 and several["tanh2"] == one["tanh2"]


def test_settle_without_friction_has_no_tanh():
    program = count(settle_of(bare), NUMBERS)
    for name in ("tanh2", "half_to_the", "tanh", "exp", "log"):
        assert program[name] == 0, name


def carried(scene):
    """How many numbers the step loop carries."""
    closed = jax.make_jaxpr(scene)(NUMBERS)
    loops = [e for e in equations(closed.jaxpr) if e.primitive.name == "while"]
    assert len(loops) == 1
    return len(loops[0].params["body_jaxpr"].jaxpr.outvars)


@pytest.mark.parametrize(
    "observer, numbers",
    [
        (zj.Mean(), 2),
        (zj.Period(), 3),
        (zj.StickFraction(), 2),
        (zj.EnergyBalance(), 3),
    ],
    ids=lambda x: type(x).__name__,
)
def test_an_observer_carries_its_own_numbers_and_no_other_does(observer, numbers):
    """The energy at the start and two works, for a column with friction."""
    without, alone = carried(settle_of(rubbing)), carried(settle_of(rubbing, observer))
    assert alone - without == numbers


def test_amplitude_is_there_once_even_if_asked_for():
    assert count(settle_of(rubbing, (zj.Amplitude(),)), NUMBERS) == count(
        settle_of(rubbing), NUMBERS
    )


def test_powers_are_integrated_only_where_asked_for():
    without = count(settle_of(rubbing, (zj.Mean(),)), NUMBERS)
    asked = count(settle_of(rubbing, (zj.EnergyBalance(),)), NUMBERS)
    assert sines(asked) - sines(without) >= 6  # one a stage


def test_one_window_keeps_nothing_to_compare():
    """Of joints turns, the least and the greatest energy; losses; three of a balance.

    Of the window before the same energies, losses and swings; and how far swings moved.
    """
    one = settle_of(bare, windows=zj.Windows(max_windows=1))
    assert carried(settle_of(bare)) - carried(one) == (6 + 1 + 3) + (6 + 1) + 1


# What is imported ---------------------------------------------------------------------


def test_importing_starts_no_backend_and_draws_nothing_in():
    program = (
        "import os, sys, ziegler_jax\n"
        "from jax._src import xla_bridge\n"
        "import jax\n"
        "print('matplotlib' in sys.modules, xla_bridge.backends_are_initialized(),\n"
        "      jax.config.jax_enable_x64, 'XLA_FLAGS' in os.environ)\n"
    )
    environment = {
        k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_ENABLE_X64")
    }
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment, capture_output=True, text=True, timeout=100,
    )  # fmt: skip
    assert done.stdout.split() == ["False"] * 4, done.stderr


def test_the_public_names_are_there_once():
    assert all(hasattr(zj, name) for name in zj.__all__)
    assert len(set(zj.__all__)) == len(zj.__all__)


def test_pictures_are_among_the_public_names_and_types_are_shipped():
    assert "plot" in dir(zj) and "settle" in dir(zj)
    project = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text())["project"]
    assert zj.__version__ == project["version"]
    assert (PACKAGE / "py.typed").exists()


# of `sweep` the cluster's client is known to the type checker alone
@pytest.mark.parametrize("name", sorted({*zj.__all__} - {"sweep"}))
def test_annotations_name_what_exists(name):
    """Those of modules that keep them as text, which Python reads only when asked."""
    if callable(getattr(zj, name)):
        assert typing.get_type_hints(getattr(zj, name)) is not None
