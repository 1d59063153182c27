"""`python -m ziegler_jax` writes a map that can be read, or says why not."""

import contextlib
import io
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import warnings
from collections import Counter

import numpy as np
import pytest
import xarray as xr
from eyes import EYES, lab

import ziegler_jax as zj
from ziegler_jax import __main__ as job
from ziegler_jax._main_both import ends_of_both, shares_over_ratio, summary_of_both
from ziegler_jax.maps.added import add_variables
from ziegler_jax.results import OUTCOMES
from ziegler_jax.sweep.store import SweepStore

pytestmark = pytest.mark.usefixtures("optimised")  # the main job itself runs here

PNG = b"\x89PNG\r\n\x1a\n"
COMMAND = [sys.executable, "-W", "error", "-m", "ziegler_jax"]


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory):
    """What one process has compiled, the next one finds."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setenv("JAX_COMPILATION_CACHE_DIR", str(folder))
        patch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
        yield


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A small map: its folder, and what the command printed."""
    folder = tmp_path_factory.mktemp("map") / "new" / "folder"
    done = subprocess.run(
        [*COMMAND, "--points", "200", "--out", str(folder)],
        capture_output=True,
        text=True,
        timeout=400,
    )
    assert done.returncode == 0, done.stderr
    return folder, done.stdout


def test_the_store_reopens_with_axes_outcomes_and_attributes(written):
    ds = xr.open_zarr(written[0] / "bifurcation_map.zarr", consolidated=False)
    q, mu = job.grid(200)
    np.testing.assert_array_equal(ds["q"], q)
    np.testing.assert_array_equal(ds["mu_s"], mu)
    np.testing.assert_array_equal(ds["mu_k"], mu)
    assert ds["joint_amplitude"].dims == ("q", "mu_s", "mu_k", "joint")
    about = ds["outcome"].attrs
    meanings = dict(
        zip(about["flag_values"], about["flag_meanings"].split(), strict=True)
    )
    assert meanings[zj.CODE.cycle] == "cycle"
    assert ds["joint_amplitude"].attrs["units"] == "rad"
    assert "SmoothCoulomb" in ds.attrs["scene"]
    outcome = ds["outcome"].values
    left_out = np.broadcast_to(mu[:, None] < mu, outcome.shape)
    np.testing.assert_array_equal(outcome == zj.CODE.not_computed, left_out)
    # the most friction holds the lightest load, and not the heaviest
    assert outcome[0, -1, -1] == zj.CODE.stuck
    assert outcome[-1, -1, -1] == zj.CODE.cycle
    amplitude = ds["joint_amplitude"].sel(joint=2).values
    assert np.isfinite(amplitude[~left_out]).all()
    assert amplitude[0, -1, -1] < 0.05 < amplitude[-1, -1, -1]


def test_a_picture_is_written(written):
    picture = (written[0] / "bifurcation_map.png").read_bytes()
    assert picture.startswith(PNG) and len(picture) > 20_000


def test_cells_beside_another_end_are_followed_again_and_the_map_says_so(written):
    folder, said = written
    ds = zj.open_sweep(folder / job.STORE)
    assert ds.rtol == 1e-6 and ds.again.attrs["rtol"] == 1e-8
    ends = (zj.CODE.cycle, zj.CODE.stuck, zj.CODE.escaped)
    settled, again = ds.outcome.isin(ends), ds.again.values
    words = ds.again.attrs["flag_meanings"].split()
    assert words == "not_asked inside same other_end other_time late".split()
    other = xr.zeros_like(settled)
    for dim in settled.dims:
        for way in (1, -1):
            beside = ds.outcome.shift({dim: way}, fill_value=0)
            other |= settled & beside.isin(ends) & (beside != ds.outcome)
    assert other.sum() > 20 and (again[other.values] > 1).all()
    np.testing.assert_array_equal(settled, again > 0)
    late = (ds.time > job.LATE).values & (again > 1)
    assert late.sum() > 5
    np.testing.assert_array_equal(again == 5, late)
    followed = np.isin(again, (2, 3, 4))
    np.testing.assert_array_equal(ds.outcome_again.values > 0, followed)
    alike = ds.outcome_again.values == ds.outcome.values
    assert alike[np.isin(again, (2, 4))].all()
    assert f"{(again > 1).sum()} cells lie beside another end." in said
    lines = said.split("followed again at 1e-08:\n")[1].splitlines()[:4]
    counts = [(again == code).sum() for code in (2, 3, 4, 5)]
    assert [int(line.split()[0]) for line in lines] == counts


def killed(store):
    """After the first of two variables, while a file was being written."""
    shutil.rmtree(store / "again")
    (store / "sweep-record" / "parts" / "added" / "again").mkdir(parents=True)


def without_its_chunk(store):
    """It would read as 0."""
    (chunk,) = (path for path in (store / "again" / "c").rglob("*") if path.is_file())
    chunk.unlink()


def damaged(store):
    (chunk,) = (path for path in (store / "again" / "c").rglob("*") if path.is_file())
    chunk.write_bytes(b"damaged")


def of_another_tolerance(store):
    about = store / "again" / "zarr.json"
    about.write_text(about.read_text().replace('"rtol": 1e-08', '"rtol": 1e-09'))


@pytest.mark.parametrize(
    "harm", [killed, without_its_chunk, damaged, of_another_tolerance, None]
)
def test_marks_that_are_not_whole_are_made_anew(written, tmp_path, monkeypatch, harm):
    store = tmp_path / job.STORE
    shutil.copytree(written[0] / job.STORE, store)
    whole = zj.open_sweep(written[0] / job.STORE).load()
    if harm:
        harm(store)
    asked = []

    def follow_again(program, ds, rtol, late):
        asked.append((rtol, late))
        marks = whole[["again", "outcome_again"]]
        return ds.drop_vars(marks, errors="ignore").assign(marks)

    monkeypatch.setattr(zj, "Program", lambda *_, **__: None)
    monkeypatch.setattr(zj, "sweep", lambda *_, store, **__: zj.open_sweep(store.path))
    monkeypatch.setattr(zj, "follow_again", follow_again)
    job.compute(200, store)
    assert asked == ([(job.FINER, job.LATE)] if harm else [])
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a folder that is no part of the store
        xr.open_zarr(store, consolidated=False)
    ds = zj.open_sweep(store)
    for name in ("again", "outcome_again"):
        assert ds[name].identical(whole[name]), name


def test_marks_are_not_written_into_a_store_that_another_one_writes_to(
    written, tmp_path
):
    store = tmp_path / job.STORE
    shutil.copytree(written[0] / job.STORE, store)
    marks = zj.open_sweep(store)[["again"]].load()
    with SweepStore(store) as other:
        other.claim()
        with pytest.raises(ValueError, match="another"):
            add_variables(store, marks)
    add_variables(store, marks)


def test_the_summary_counts_every_outcome_that_there_is(written):
    folder, text = written
    ds = xr.open_zarr(folder / "bifurcation_map.zarr", consolidated=False)
    total = int((ds["outcome"] != zj.CODE.not_computed).sum())
    assert text.startswith(f"{total} motions, each")
    for code in OUTCOMES:
        lines = [x for x in text.splitlines() if f"%  {code.name}: " in x]
        count = int((ds["outcome"] == code).sum())
        assert len(lines) == (count > 0)
        for line in lines:
            assert line.split()[:2] == [str(count), f"{count / total:.1%}"]
            assert code.sentence in line
    assert "motions a second on" in text and "XLA" not in text
    assert "< q_on <=" in text and "bifurcation_map.png" in text


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--points", "0"], "--points"),
        (["--points", "-5"], "--points"),
        (["--points", "2.5"], "--points"),
        (["--points", "many"], "--points"),
        (["--points", "1000000000000"], "--points"),
        (["--out", __file__], "--out"),
        (["--out", __file__ + "/below"], "--out"),
        (["--out", ""], "--out"),
        (["--law", "wet"], "--law"),
        (["--nonsense"], "--nonsense"),
    ],
)
def test_nonsense_gets_one_line_and_exit_code_2(arguments, named, capsys, monkeypatch):
    monkeypatch.setattr(job, "compute", lambda *_: pytest.fail("it computes"))
    with pytest.raises(SystemExit) as end:
        job.main(arguments)
    assert end.value.code == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1 and named in printed.err


def test_nonsense_ends_the_process_with_exit_code_2():
    command = [*COMMAND, "--points", "0"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200)
    assert done.returncode == 2
    assert done.stdout == "" and len(done.stderr.splitlines()) == 1


@pytest.mark.skipif(
    signal.getsignal(signal.SIGINT) is signal.SIG_IGN,
    reason="this process ignores Ctrl-C, as under nohup, and so do its children",
)
def test_ctrl_c_gets_one_line_and_exit_code_130(tmp_path):
    with subprocess.Popen(
        [*COMMAND, "--out", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()  # it is about to compute
            time.sleep(0.5)
            process.send_signal(signal.SIGINT)
            _, stderr = process.communicate(timeout=200)
        finally:
            process.kill()
    assert process.returncode == 130
    (line,) = stderr.splitlines()
    assert line.startswith("Stopped") and "same command goes on" in line
    assert not (tmp_path / job.PICTURE).exists()


IN_SMALL_BLOCKS = """
import sys
from ziegler_jax import __main__
from ziegler_jax.sweep import grid
grid.POINTS_A_BLOCK = 20
sys.exit(__main__.main(sys.argv[1:]))
"""


def marks(folder):
    """The finished blocks, and when each was written."""
    found = (folder / job.STORE / "sweep-record" / "blocks").glob("*[0-9]")
    return {path.name: path.stat().st_mtime_ns for path in found}


def test_a_killed_map_goes_on_where_it_was_and_ends_in_the_same_bits(written, tmp_path):
    command = [sys.executable, "-W", "error", "-c", IN_SMALL_BLOCKS]
    command += ["--points", "200", "--out", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        while process.poll() is None and not marks(tmp_path):
            time.sleep(0.001)
        process.kill()
    before = marks(tmp_path)
    assert before and not (tmp_path / job.PICTURE).exists()
    done = subprocess.run(command, capture_output=True, text=True, timeout=400)
    assert done.returncode == 0, done.stderr
    after = marks(tmp_path)
    ds = zj.open_sweep(tmp_path / job.STORE)
    assert len(before) < len(after) == ds.attrs["blocks"]
    assert before.items() <= after.items()  # none was computed again
    assert (tmp_path / job.PICTURE).read_bytes().startswith(PNG)
    whole = zj.open_sweep(written[0] / job.STORE)
    for name in whole.variables:
        assert ds[name].values.tobytes() == whole[name].values.tobytes(), name


@pytest.fixture
def drawn_anew(written, monkeypatch):
    """`main` finds a whole map, and only tells of it and draws it."""
    monkeypatch.setattr(zj, "configure_cpu", lambda: "set")
    whole = zj.open_sweep(written[0] / job.STORE)
    monkeypatch.setattr(job, "compute", lambda *_: whole)


CLOSED = """
import sys
import ziegler_jax as zj
from ziegler_jax import __main__
__main__.compute = lambda *_: zj.open_sweep(sys.argv[1])
sys.exit(__main__.main(["--out", sys.argv[2]]))
"""


@pytest.mark.parametrize("closed", ["after a line", "from the start"])
def test_a_closed_stdout_is_named_and_the_map_is_written(written, tmp_path, closed):
    python = [sys.executable, "-W", "error", "-c", CLOSED, written[0] / job.STORE]
    shell = ["sh", "-c", 'exec "$@" >&-', "sh"]  # no standard output at all
    with subprocess.Popen(
        [*(shell if closed == "from the start" else []), *python, tmp_path],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.readline()
        process.stdout.close()
        (line,) = process.stderr.read().splitlines()
    assert process.returncode == 3
    assert line.startswith("Standard output took nothing. Written: ")
    assert (tmp_path / job.PICTURE).read_bytes().startswith(PNG)


def test_letters_that_stdout_lacks_are_written_as_their_codes(
    drawn_anew, tmp_path, monkeypatch
):
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding="ascii"))
    folder = tmp_path / "F\u00f6hn"
    assert job.main(["--out", str(folder)]) == 0
    last = raw.getvalue().decode("ascii").splitlines()[-1]
    assert last.startswith("Written: ") and "F\\xf6hn" in last
    assert (folder / job.PICTURE).exists()


def test_a_disk_that_is_full_is_named_with_what_is_kept(
    drawn_anew, tmp_path, monkeypatch, capsys
):
    def full(*_):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(job, "draw", full)
    assert job.main(["--out", str(tmp_path)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert str(tmp_path) in line and "No space left" in line and "is kept" in line


def test_another_map_is_refused_in_one_line_and_overwritten_when_asked(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(zj, "configure_cpu", lambda: "set")
    there = ["--out", str(tmp_path)]
    assert job.main(["--points", "20", *there]) == 0
    picture = (tmp_path / job.PICTURE).read_bytes()
    capsys.readouterr()
    with pytest.raises(SystemExit) as end:
        job.main(["--points", "30", *there])
    assert end.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "--overwrite" in line and str(tmp_path / job.STORE) in line
    assert zj.open_sweep(tmp_path / job.STORE).attrs["points"] == 20
    assert (tmp_path / job.PICTURE).read_bytes() == picture
    assert job.main(["--points", "30", "--overwrite", *there]) == 0
    ds = zj.open_sweep(tmp_path / job.STORE)
    assert ds.attrs["points"] == ds.attrs["points_done"] == 30
    # once more: nothing is computed, the picture is drawn again
    (tmp_path / job.PICTURE).unlink()
    before = marks(tmp_path)
    assert job.main(["--points", "30", *there]) == 0
    assert marks(tmp_path) == before and (tmp_path / job.PICTURE).exists()


@pytest.fixture(scope="module")
def of_both(tmp_path_factory):
    """A small map of both laws: its folder, and what was printed."""
    folder, said = tmp_path_factory.mktemp("both"), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(said):
        patch.setattr(zj, "configure_cpu", lambda: "set")
        arguments = ["--law", "both", "--points", "60"]
        assert job.main([*arguments, "--out", str(folder)]) == 0
    return folder, said.getvalue()


def test_both_laws_have_a_store_each_and_one_picture(of_both):
    folder, said = of_both
    names = {"bifurcation_map.zarr", "bifurcation_map_dry.zarr"}
    names |= {"bifurcation_map_both.png"}
    assert {path.name for path in folder.iterdir()} == names
    assert all(f"{folder / name}" in said for name in names)
    picture = (folder / "bifurcation_map_both.png").read_bytes()
    assert picture.startswith(PNG) and len(picture) > 20_000
    dry = zj.open_sweep(folder / "bifurcation_map_dry.zarr")
    assert dry.attrs["solver"] == "Taylor8"  # and not the smoothed law once more
    assert zj.open_sweep(folder / job.STORE).attrs["solver"] == "Tsit5"


def test_the_cells_that_differ_are_counted_by_pairs_of_outcomes(of_both):
    folder, said = of_both
    names = (job.STORE, job.file_of(job.STORE, "dry"))
    one, other = (zj.open_sweep(folder / name).outcome.values for name in names)
    unlike, total = (one != other) & (one > 0), int((one > 0).sum())
    assert 0 < unlike.sum() < total
    share = f"{unlike.sum()} of {total} cells, {unlike.sum() / total:.1%}:"
    head, rows = said.split("both laws differ in ")[1].split("\n", 1)
    assert head == share
    told = re.findall(r"^ +(\d+) +[\d.]+%  smoothed (\w+), dry (\w+)$", rows, re.M)
    pairs = zip(one[unlike], other[unlike], strict=True)
    exact = Counter((zj.CODE(a).name, zj.CODE(b).name) for a, b in pairs)
    assert {(a, b): int(n) for n, a, b in told} == exact


def test_dry_friction_alone_goes_on_with_its_store_and_draws_it(
    of_both, tmp_path, monkeypatch
):
    monkeypatch.setattr(zj, "configure_cpu", lambda: "set")
    store = job.file_of(job.STORE, "dry")
    shutil.copytree(of_both[0] / store, tmp_path / store)
    before = (tmp_path / store / "zarr.json").stat().st_mtime_ns
    command = ["--law", "dry", "--points", "60", "--out", str(tmp_path)]
    assert job.main(command) == 0
    assert (tmp_path / store / "zarr.json").stat().st_mtime_ns == before
    assert {path.name for path in tmp_path.iterdir()} == {
        store, "bifurcation_map_dry.png"
    }  # fmt: skip


def test_a_store_of_one_law_is_refused_for_another(
    of_both, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(zj, "configure_cpu", lambda: "set")
    store = tmp_path / job.file_of(job.STORE, "dry")
    shutil.copytree(of_both[0] / job.STORE, store)
    with pytest.raises(SystemExit) as end:
        job.main(["--law", "dry", "--points", "60", "--out", str(tmp_path)])
    assert end.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "--overwrite" in line and str(store) in line
    assert zj.open_sweep(store).attrs["solver"] == "Tsit5"


def small_maps(smoothed, dry):
    """Maps of one mu_k and two of mu_s over the loads, given as letters by rows."""
    mu = {"mu_s": [0.2, 0.4], "mu_k": [0.2]}
    return [
        plane(*rows).expand_dims(mu_k=[0.2]).assign_coords(mu)
        for rows in (smoothed, dry)
    ]


def test_what_differs_is_what_both_laws_have_and_have_unlike():
    ends = ends_of_both(*small_maps(["sC?e", "C? s"], ["sC?e", "sC ?"]))
    differ = ends["differ"].sel(mu_k=0.2).transpose("mu_s", "q").values
    np.testing.assert_array_equal(differ, [[0, 0, 0, 0], [1, 1, 0, 1]])
    names = ends["ends"].attrs["flag_meanings"].split()
    found = ends["ends"].sel(mu_k=0.2).transpose("mu_s", "q").values
    assert [names[i].replace("_", " ") for i in found.ravel()] == [
        "both stuck", "both cycle", "both unsettled", "otherwise",
        "smoothed cycle, dry stuck", "smoothed unsettled, dry cycle", "not computed",
        "smoothed stuck, dry unsettled",
    ]  # fmt: skip
    told = summary_of_both(ends).splitlines()
    assert "3 of 7 cells, 42.9%" in told[0] and len(told) == 4
    shares = shares_over_ratio(ends)
    # mu_k / mu_s is 1/2 where three cells count, and 1 where four do
    np.testing.assert_allclose(shares.ratio, [0.5, 1.0])
    np.testing.assert_allclose(shares.differ, [1.0, 0.0])
    np.testing.assert_allclose(shares.settled, [1 / 3, 0.0])


@pytest.mark.parametrize("eye", EYES)
def test_pairs_of_outcomes_are_told_apart_by_any_eye(eye):
    from ziegler_jax._main_picture import PAIR_COLOURS

    places = [lab(colour, eye) for colour in ("#FFFFFF", *PAIR_COLOURS)]
    apart = [np.linalg.norm(a - b) for i, a in enumerate(places) for b in places[:i]]
    assert min(apart) > 10  # measured 10.7: white and the pale blue of cycles


def test_the_default_map_has_the_values_it_promises():
    q, mu = job.grid(job.POINTS)
    assert (q.size, q[0], q[-1]) == (129, 1.0, 4.0)
    assert (mu.size, mu[0], mu[-1]) == (40, 0.02, 0.4)
    assert q.size * mu.size * (mu.size + 1) // 2 == job.POINTS == 105_780
    assert 0.1 in mu and 0.12 in mu
    assert np.ptp(np.diff(mu)) < 5e-4  # evenly spaced, but for the exact values


@pytest.mark.parametrize("points", [20, 200, 5_000, 300_000, 10_000_000])
def test_a_map_of_any_size_keeps_its_ends_and_about_its_points(points):
    q, mu = job.grid(points)
    valid = q.size * mu.size * (mu.size + 1) // 2
    assert abs(valid / points - 1) < 0.1
    assert 0.1 in mu and 0.12 in mu and (np.diff(mu) > 0).all()
    assert (mu[0], mu[-1], q[0], q[-1]) == (0.02, 0.4, 1.0, 4.0)


def plane(*rows):
    """Outcomes over (mu_s, q), given as letters."""
    letters = {"s": "stuck", "?": "unsettled", "C": "cycle", "e": "escaped"}
    letters |= {" ": "not_computed"}
    codes = [[zj.CODE[letters[letter]] for letter in row] for row in rows]
    q = np.arange(1.0, 1 + len(rows[0]))
    return xr.Dataset({"outcome": (("mu_s", "q"), codes)}, {"q": q})


def test_the_onset_lies_between_the_last_stuck_and_the_first_fluttering_point():
    low, high = job.onset(plane("ssCC", "s?sC", "s??C", "sCsC", "sse?"))
    np.testing.assert_array_equal(low, [2, 3, 1, 1, 2])
    np.testing.assert_array_equal(high, [3, 4, 4, 2, 3])


def test_there_is_no_onset_without_both_its_sides():
    low, high = job.onset(plane("CCCC", "ssss", "????", "?CsC", "    "))
    assert np.isnan(low).all() and np.isnan(high).all()


def test_a_section_keeps_only_rows_whose_kinetic_friction_is_close():
    mu = np.array([0.02, 0.1, 0.12, 0.2, 0.25, 0.4])
    mu_k = np.broadcast_to(mu, (2, 6, 6))
    ds = xr.Dataset(
        {
            "outcome": (
                ("q", "mu_s", "mu_k"),
                np.full((2, 6, 6), zj.CODE.cycle, np.int8),
            ),
            "own": (("q", "mu_s", "mu_k"), mu_k),
        },
        {"q": [1.0, 2.0], "mu_s": mu, "mu_k": mu},
    )
    plane = job.section(ds, 2.0)
    # wanted: 0.01, 0.05, 0.06, which the grid lacks, and 0.1, 0.125, 0.2
    np.testing.assert_array_equal(plane["own"][0, 3:], [0.1, 0.12, 0.2])
    kept = (plane["outcome"][0] != zj.CODE.not_computed).values
    np.testing.assert_array_equal(kept, [False, False, False, True, True, True])
    same = job.section(ds, 1.0)
    np.testing.assert_array_equal(same["own"][0], mu)
    assert (same["outcome"] == zj.CODE.cycle).all()
