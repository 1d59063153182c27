"""Cells beside another end, followed once more: which are, and what is said of them."""

import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import ziegler_jax as zj
from ziegler_jax.__main__ import point as job_point

Q, MU = [1.9, 1.99, 2.01, 2.1, 2.9, 3.1], [1.0, 2.0, 3.0]
INSIDE, SAME, OTHER_END, OTHER_TIME, LATE = 1, 2, 3, 4, 5


def made_up(q, mu, rtol):
    """Rest below q = 2, with an error of 2e4 rtol; two cycles meet at q = 3.

    Motions of mu = 2 settle later by this error, those of mu = 3 at t = 300.
    """
    error = 2e4 * rtol
    moves = q > 2 + error
    time = jnp.where(mu > 2.5, 300.0, 100.0) * (1 + jnp.where(mu > 1.5, error, 0.0))
    amplitude = jnp.where(moves, jnp.where(q > 3, 1.3, 1.0), 1e-4 * q**9)
    outcome = jnp.where(moves, zj.CODE.cycle, zj.CODE.stuck).astype(jnp.int8)
    return {
        "outcome": zj.Variable(outcome, "end", codes=(zj.CODE.stuck, zj.CODE.cycle)),
        "time": zj.Variable(time, "time at which it ended"),
        "steps": zj.Variable(10 * time, "steps"),
        "joint_amplitude": zj.Variable(
            jnp.stack([amplitude, 0.5 * amplitude]), "amplitude", dims=("joint",)
        ),
    }


@pytest.fixture(scope="module")
def program():
    return zj.Program(made_up)


def swept(program, **axes):
    axes = {"q": Q, "mu": MU, "rtol": 1e-6} | axes
    return zj.sweep(program, progress=False, **axes)


def test_each_mark_is_what_its_cell_does_at_the_finer_tolerance(program):
    before = swept(program)
    ds = zj.follow_again(program, before, rtol=1e-8, late=200.0)
    # beside another end lie those at q = 2 and, by the amplitude, at q = 3; what is
    # late is not followed, else what ends otherwise is marked so, whatever its time
    assert ds.again.values.tolist() == [
        [INSIDE, INSIDE, INSIDE],
        [INSIDE, INSIDE, INSIDE],
        [OTHER_END, OTHER_END, LATE],
        [SAME, OTHER_TIME, LATE],
        [SAME, OTHER_TIME, LATE],
        [SAME, OTHER_TIME, LATE],
    ]
    cycle, none = int(zj.CODE.cycle), 0
    assert ds.outcome_again.values.tolist() == (
        [[none] * 3] * 2 + [[cycle, cycle, none]] * 4
    )
    assert ds.drop_vars(["again", "outcome_again"]).identical(before)
    assert ds.again.attrs["rtol"] == 1e-8 and ds.again.attrs["late"] == 200.0


def test_marks_do_not_depend_on_the_order_of_axes_nor_on_the_store(program, tmp_path):
    marks = zj.follow_again(program, swept(program)).again
    turned = swept(program, q=Q[::-1], store=tmp_path / "map.zarr").transpose()
    again = zj.follow_again(made_up, turned).again  # traced once more: the same point
    assert again.transpose(*marks.dims).sel(q=marks.q).equals(marks)
    assert not (marks == LATE).any()  # all are followed where nothing is said of time


def test_what_was_left_out_or_has_not_settled_is_neither_followed_nor_a_neighbour(
    program,
):
    ds = swept(program, where=lambda q, mu, rtol: (q != 2.01) & (mu < 1.5))
    marks = zj.follow_again(program, ds).again
    assert marks.values[:, 0].tolist() == [1, 1, 0, 1, SAME, SAME]
    assert (marks.values[:, 1:] == 0).all()
    undecided = swept(program)
    undecided["outcome"] = undecided.outcome.where(undecided.q != 2.1, 20)
    marks = zj.follow_again(program, undecided).again
    assert marks.values[:, 0].tolist() == [1, 1, 1, 0, SAME, SAME]


def test_a_number_that_is_none_is_not_the_same(program):
    ds = swept(program)
    ds["time"] = ds.time.where(ds.q != 2.1)
    marks = zj.follow_again(program, ds, late=200.0).again
    assert marks.sel(q=2.1).values.tolist() == [OTHER_TIME] * 3


def test_an_end_that_a_motion_did_not_reach_is_marked():
    """The motion ends on another cycle at a tolerance of 1e-8."""
    q = np.array([1.5882352941176472 - 0.1, 1.5882352941176472])

    def point(q, rtol):
        return job_point(q, 0.37666666666666665, 0.12, rtol)

    program = zj.Program(point)
    ds = zj.sweep(program, q=q, rtol=1e-6, progress=False)
    fine = zj.sweep(program, q=q, rtol=1e-8, progress=False)
    apart = np.abs(ds.joint_amplitude - fine.joint_amplitude).max("joint")
    assert (ds.outcome == zj.CODE.cycle).all() and apart[1] > 0.05
    # as if another end lay beside it, of which here there is none
    ds["outcome"] = ds.outcome.where(ds.q != q[0], int(zj.CODE.stuck))
    marks = zj.follow_again(program, ds)
    assert marks.again[1] == OTHER_END
    np.testing.assert_array_equal(marks.outcome_again, fine.outcome)


@pytest.mark.parametrize(
    ("change", "options", "parts"),
    [
        (lambda ds: ds, {"rtol": 1e-6}, ("`rtol`", "finer", "1e-06")),
        (lambda ds: ds, {"rtol": -1e-8}, ("`rtol`", "positive")),
        (lambda ds: ds, {"rtol": np.nan}, ("`rtol`", "nan")),
        (lambda ds: ds, {"late": 0.0}, ("`late`", "positive")),
        (lambda ds: ds, {"late": np.nan}, ("`late`", "positive", "nan")),
        (lambda ds: ds, {"late": "x"}, ("`late`", "number", "'x'")),
        (lambda ds: ds, {"late": np.ones(2)}, ("`late`", "single number")),
        (lambda ds: ds.isel(q=0, mu=0), {}, ("`dataset`", "over axes")),
        (lambda ds: ds.isel(joint=0), {}, ("`dataset`", "`joint`", "q, mu")),
        (lambda ds: ds.isel(mu=0, drop=True), {}, ("`dataset`", "parameters", "q")),
        (lambda ds: ds.assign_coords(rtol=np.nan), {}, ("`dataset.rtol`", "nan")),
        (lambda ds: ds.assign_coords(rtol="a"), {}, ("`dataset.rtol`", "number")),
        (lambda ds: 3.0, {}, ("`dataset`", "sweep of `settle`")),
        (lambda ds: ds.drop_vars("rtol"), {}, ("`dataset`", "no `rtol`")),
        (lambda ds: ds.drop_vars("time"), {}, ("`dataset`", "no `time`")),
        (lambda ds: ds.expand_dims("rtol"), {}, ("`dataset`", "along `rtol`")),
        (
            lambda ds: ds.assign_attrs(scene_digest="another"),
            {},
            ("`dataset`", "this `point`", "'another'"),
        ),
        (lambda ds: ds.drop_vars("q"), {}, ("`q`", "neighbours")),
    ],
)
def test_what_cannot_be_followed_again_is_refused(program, change, options, parts):
    with pytest.raises(ValueError) as refusal:
        zj.follow_again(program, change(swept(program)), **options)
    for part in parts:
        assert part in str(refusal.value)


def test_a_point_that_takes_no_tolerance_is_refused(program):
    def of_its_own(q, mu):
        return made_up(q, mu, 1e-6)

    ds = zj.sweep(of_its_own, q=Q, mu=MU, progress=False).assign_coords(rtol=1e-6)
    with pytest.raises(ValueError, match="`rtol` among them, but these are q, mu"):
        zj.follow_again(of_its_own, ds)
    with pytest.raises(ValueError, match="`point` must be a function"):
        zj.follow_again(None, swept(program))  # pyright: ignore[reportArgumentType]


def test_a_sweep_with_a_number_is_refined(program):
    ds = zj.refine(program, swept(program), levels=1, audit=10, width=1e-3)
    assert ds.boundary_q.size and abs(ds.boundary_q - 2.02).max() < 2.1 * 1e-3
    again = zj.refine(made_up, swept(program), levels=1, audit=10, width=1e-3)
    assert again.boundary_q.equals(ds.boundary_q)


def test_a_sweep_of_samples_is_refused(program):
    q, mu = (xr.DataArray(x, dims="sample") for x in (Q[:3], MU))
    ds = swept(program, q=q, mu=mu)
    with pytest.raises(ValueError, match="`sample`.*neighbours"):
        zj.follow_again(program, ds)
