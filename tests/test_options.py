"""Options are values: what is not named is the question's own, and is recorded."""

import functools

import jax
import numpy as np
import pytest
from options import options_of

import ziegler_jax as zj

KICK = zj.State(omega=(0.0, 0.3))
SLIDING = zj.SetValuedCoulomb(0.026, pin_radius=1.0, load=zj.ConstantLoad(1.0))


SMOOTH = zj.SmoothCoulomb(0.026, pin_radius=1.0, v_smooth=0.1)


def column(q=2.6, friction=SLIDING):
    return zj.uniform_rods(q, friction=friction)


def smooth(q=2.6):
    return column(q, SMOOTH)


def plane(q, tau, smoothed=False):
    del tau
    return smooth(q) if smoothed else column(q)


def smooth_plane(q, tau):
    return plane(q, tau, smoothed=True)


def line(q):
    return column(q), KICK


def smooth_line(q):
    return smooth(q), KICK


def orbit():
    return zj.periodic_orbit(column(), KICK)


def a_flip():
    pair, one = np.ones((1, 2)), np.ones(1)
    kind = np.array([zj.CODE.flip])
    cycle = np.array([[0.0, 0.3]]), pair, one, pair, pair, np.eye(4)[None], kind
    return zj.CyclePoints(2.6 * one, *cycle)


QUESTIONS = {
    zj.settle: (column(), KICK),
    zj.trajectory: (column(), KICK, np.array([0.0, 1.0])),
    zj.sweep_up_down: (column, [1.0, 2.0]),
    zj.threshold: (line, (1.0, 2.0)),
    zj.flutter_onset: (column, KICK, (1.0, 2.0)),
    zj.critical_kick: (column(), KICK, (0.0, 1.0)),
    zj.least_kick: (column(), (0.0, 1.0)),
    zj.periodic_orbit: (column(), KICK),
    zj.continue_cycle: (column, orbit, 2.6),
    zj.bifurcation: (column, "fold", orbit, 2.6),
    zj.branch_off: (column, "flip", a_flip),
    zj.bifurcation_curve: (plane, "fold", orbit),
    zj.lyapunov_exponents: (column(), KICK),
    zj.poincare: (column(), KICK),
}
TOLD = {question.__name__: question for question in QUESTIONS}
NEEDED = {
    zj.sweep_up_down: {"kick": KICK},
    zj.bifurcation_curve: {"first": 2.6, "second": 0.026},
}
SMOOTHED = {column: smooth, plane: smooth_plane, line: smooth_line}


@functools.cache  # a trace takes seconds
def record_of(question, smoothed=False, by_windows=False, **fields):
    """What a question records; it is traced, and not computed."""

    def asked():
        scene = [
            x() if callable(x) and x in (orbit, a_flip) else x
            for x in QUESTIONS[question]
        ]
        if smoothed:
            made = callable(scene[0]) and scene[0] in SMOOTHED
            scene[0] = SMOOTHED[scene[0]] if made else smooth()
        more = NEEDED.get(question, {}) | options_of(question, **fields)
        more |= {"certify": False} if by_windows else {}
        return question(*scene, **more)

    return dict(jax.eval_shape(asked).settings)


def table(value):
    """The table of a docstring: question, column, entry."""
    rows = [
        [cell.strip() for cell in line.strip().strip("|").split("|")]
        for line in value.__doc__.split("\n")
        if line.strip().startswith("|") and "---" not in line
    ]
    head, *rows = rows
    for names, *cells in rows:
        for name in names.split(","):
            for what, cell in zip(head[1:], cells, strict=True):
                yield name.strip(" `"), what, cell


RECORDED = {
    zj.Method: {name: name for name in ("solver", "rtol", "max_steps")},
    zj.Windows: {"length": "window_length"},
    zj.Spans: {"length": "span_length", "count": "span_count"},
}


@pytest.mark.parametrize("value", RECORDED, ids=lambda v: v.__name__)
def test_the_tables_say_what_each_question_does_on_its_own(value):
    records, rows = {}, 0
    for name, what, cell in table(value):
        question = TOLD[name]
        by_windows = value is zj.Windows and question in (zj.settle, zj.sweep_up_down)
        record = records.setdefault(name, record_of(question, by_windows=by_windows))
        if cell == "none":  # where cycles are certified
            assert what not in record
            continue
        said = record[RECORDED[value].get(what, what)]
        if what == "solver":
            assert said == cell.split()[-1]  # with set-valued friction
            usual = record_of(question, smoothed=True)["solver"]
            assert usual == cell.split(",")[0], name
        else:
            exact = np.pi if cell == "pi" else float(cell.split()[0])
            assert said == exact, (name, what)
        rows += 1
    assert rows >= 4 and len(records) == len({name for name, *_ in table(value)})


PARTS = {
    zj.Method: {"rtol": 1e-5},
    zj.Windows: {"length": 5.0},
    zj.Spans: {"length": 5.0},
    zj.Search: {"halvings": 3},
    zj.Arc: {"points": 7},
    zj.SectionPlane: {"level": 0.1},
}


def test_a_partial_value_leaves_the_rest_to_the_question():
    """To each question that takes such values, a part of each of them at once.

    What was named is recorded as it was named, in its own place, and nothing else has
    changed.
    """
    asked = dict.fromkeys(PARTS, 0)
    for question in QUESTIONS:
        parts, expected = {}, {}
        for value, part in PARTS.items():
            (options,) = options_of(question, **part).values()
            if not isinstance(options, value):
                continue
            if (value, question) == (zj.Arc, zj.bifurcation_curve):
                continue  # of the branch on which it is met; the curve has a Course
            ((name, number),) = part.items()
            parts[name] = expected[RECORDED.get(value, {}).get(name, name)] = number
            asked[value] += 1
        if "rtol" in expected:
            expected["atol"] = expected["rtol"]
        before, after = record_of(question), record_of(question, **parts)
        changed = {n: after[n] for n in before if before[n] != after[n]}
        assert changed == expected, question.__name__
        assert set(after) == set(before)
    assert asked == {
        value: {zj.Method: 14, zj.Windows: 6, zj.Search: 3, zj.Spans: 1}.get(value, 2)
        for value in PARTS
    }


def test_the_absolute_tolerance_is_the_relative_one_unless_it_is_named():
    assert record_of(zj.settle, rtol=1e-3)["atol"] == 1e-3
    assert record_of(zj.settle, atol=1e-3)["rtol"] == 1e-6
    assert record_of(zj.settle)["atol"] == 1e-6


def test_a_diffrax_solver_is_taken_as_it_is():
    import diffrax

    smooth = zj.SmoothCoulomb(0.1, pin_radius=0.1, v_smooth=0.1)

    def ends(solver):
        method = zj.Method(solver, rtol=1e-8)
        motion = zj.trajectory(column(2.6, smooth), KICK, [0.0, 5.0], method=method)
        return np.append(motion.phi[-1], motion.omega[-1]), motion.attributes()

    same, record = ends(diffrax.Dopri8())
    assert record["solver"] == "Dopri8"
    np.testing.assert_array_equal(same, ends(zj.Explicit(diffrax.Dopri8.tableau))[0])
    other, record = ends(diffrax.Dopri5())
    assert record["solver"] == "Dopri5"
    # measured 1.3e-8: each within its tolerance
    np.testing.assert_allclose(other, same, rtol=0, atol=1e-7)


def test_what_is_no_value_is_refused_by_name(refuses):
    refuses(
        lambda: zj.settle(column(), KICK, method=1e-6, certify=False),
        "`method`",
        "`Method`",
    )
    refuses(
        lambda: zj.settle(column(), KICK, windows=40, certify=False),
        "`windows`",
        "`Windows`",
    )
    refuses(
        lambda: zj.lyapunov_exponents(column(), KICK, spans=9),
        "`spans`",
        "`Spans`",
        "9",
    )
    refuses(lambda: zj.poincare(column(), KICK, section=0), "`section`", "0")
    refuses(lambda: zj.critical_kick(column(), KICK, (0, 1), search=3), "`search`", "3")
    refuses(lambda: zj.continue_cycle(column, KICK, 2.6), "`orbit`", "`PeriodicOrbit`")
    refuses(lambda: zj.Method(zj.Explicit), "`solver`", "diffrax.Dopri8()")


@pytest.mark.parametrize(
    "make, parts",
    [
        (lambda: zj.SectionPlane(rising="falling"), ("`rising`", "'falling'")),  # type: ignore
        (lambda: zj.SectionPlane("phi0"), ("`coordinate`", "phi1", "'phi0'")),  # type: ignore
        (lambda: zj.Arc(bounds=("a", "b")), ("`bounds`", "two numbers", "'a'")),  # type: ignore
        (lambda: zj.Arc(bounds=(3, 1)), ("`bounds`", "increase", "(3, 1)")),
        (lambda: zj.Arc(direction=True), ("`direction`", "1, -1 or", "True")),
        (lambda: zj.Arc("up"), ("`direction`", "1, -1 or", "'up'")),
        (lambda: zj.Arc(step=0.0), ("`step`", "positive", "0")),
        (lambda: zj.Spans(count=1), ("`count`", "at least 2", "1")),
        (lambda: zj.Search(scan=0), ("`scan`", "at least 1", "0")),
        (lambda: zj.Windows(max_windows=2.5), ("`max_windows`", "whole", "2.5")),  # type: ignore
        (lambda: zj.Method(rtol=-1.0), ("`rtol`", "positive", "-1")),
        (lambda: zj.Store("a", overwrite="no"), ("`overwrite`", "'no'")),  # type: ignore
    ],
)
def test_a_value_refuses_what_breaks_its_rule(refuses, make, parts):
    refuses(make, *parts)


def test_a_method_may_come_through_a_jit():
    def steps(method):
        windows = zj.Windows(transient=1.0, length=1.0, max_windows=1)
        return zj.settle(
            smooth(), KICK, windows=windows, method=method, certify=False
        ).steps

    method, through = zj.Method(rtol=1e-4, max_steps=1000), jax.jit(steps)
    assert int(through(method)) == int(jax.jit(lambda: steps(method))()) > 1
    assert int(through(zj.Method(rtol=1e-4, max_steps=2))) == 2
