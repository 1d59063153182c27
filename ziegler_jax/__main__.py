"""The main job: where the column flutters, over the load and both frictions.

`python -m ziegler_jax` kicks the column of two uniform rods once at every (q, mu_s,
mu_k) with mu_k <= mu_s and follows it until its motion has settled. The map is the
store of a sweep: the same command goes on with one that was stopped. `--law` says
which friction: smoothed, dry (set-valued), or both and where their outcomes differ.
Cells beside another end are followed once more at a finer tolerance: the map's `again`
says which of them may end otherwise with other steps.
"""

import argparse
import contextlib
import functools
import os
import signal
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import numpy as np
import xarray as xr

import ziegler_jax as zj
from ziegler_jax._main_both import (
    counted,
    ends_of_both,
    shares_over_ratio,
    summary_of_both,
)
from ziegler_jax.maps.added import add_variables
from ziegler_jax.maps.follow_again import ENDED, FOLLOWED, INSIDE

# ---- the scene and how it is settled: everything that the map depends on
PIN_RADIUS, KICK, V_STRIBECK = 0.05, (0.0, 0.3), 0.1
# At rest the smoothed law is viscous damping tau_s / v_smooth: here 5 at every point,
# above what would make the smoothed column flutter from rest.
DAMPING_AT_REST = 5.0
WINDOWS = zj.Windows(transient=100, length=40, max_windows=40)
SETTLE = {"windows": WINDOWS, "observers": (zj.StickFraction(),)}
Q_RANGE, MU_RANGE, MU_EXACT = (1.0, 4.0), (0.02, 0.4), (0.1, 0.12)
Q_VALUES, MU_VALUES = 129, 40
POINTS = Q_VALUES * MU_VALUES * (MU_VALUES + 1) // 2
FEWEST, MOST = 20, 10_000_000  # four values of mu and two of q; about 2 GB
ADVICE = "what was finished is kept, and the same command{} goes on from there"
SECTIONS = (
    (1.0, r"$\mu_k = \mu_s$"),
    (1.2, r"$\mu_k \approx \mu_s / 1.2$"),
    (2.0, r"$\mu_k \approx \mu_s / 2$"),
)
CLOSE = 1 / 8  # of mu_s / ratio, for the grid's closest mu_k to stand for it
# Cells beside another end that settle later than this would take 62 % of the time that
# following all of them again takes, 84 % under dry friction, and 40 and 24 % of them
# would be marked (timed by hand, with `late=None`).
RTOL, FINER, LATE = 1e-6, 1e-8, 200.0
ONSET_AT = (0.05, 0.1, 0.12, 0.4)  # values of mu_s, printed where the grid has them
STORE, PICTURE = "bifurcation_map.zarr", "bifurcation_map.png"
# what `--law` takes, by how a heading names the friction
LAWS = {
    "smoothed": "tanh friction",
    "dry": "set-valued friction",
    "both": "tanh and set-valued friction",
}


def point(q, mu_s, mu_k, rtol=RTOL, law="smoothed", **options):
    """Settle one column: N = q, and of the smoothed law v_smooth = tau_s / 5."""
    if law == "dry":
        friction = zj.SetValuedCoulomb(mu_s, mu_k, pin_radius=PIN_RADIUS)
    else:
        friction = zj.SmoothCoulomb(
            mu_s,
            mu_k,
            pin_radius=PIN_RADIUS,
            v_stribeck=V_STRIBECK,
            v_smooth=mu_s * PIN_RADIUS * q / DAMPING_AT_REST,
        )
    column = zj.uniform_rods(q=q, friction=friction)
    options = {**SETTLE, "method": zj.Method(rtol=rtol), **options}
    return zj.settle(column, zj.State(omega=KICK), **options)


def file_of(name: str, law: str) -> str:
    """The name of a file for a law, e.g. bifurcation_map_dry.png."""
    return name if law == "smoothed" else name.replace("_map", f"_map_{law}")


def grid(points: int) -> tuple[np.ndarray, np.ndarray]:
    """The values of q and of mu (static and kinetic) of a map of about `points` points.

    Both axes keep their range and their proportion; mu is evenly spaced between its
    ends, 0.10 and 0.12, which it always contains.
    """
    count = max(4, round(MU_VALUES * (points / POINTS) ** (1 / 3)))
    pairs = count * (count + 1) // 2
    marks = [MU_RANGE[0], *MU_EXACT, MU_RANGE[1]]
    share = np.diff(marks) / (marks[-1] - marks[0])
    parts = np.maximum(1, np.round(share * (count - 1)).astype(int))
    parts[-1] = count - 1 - parts[:-1].sum()
    spans = zip(marks[:-1], marks[1:], parts, strict=True)
    mu = [np.linspace(a, b, n + 1)[1:] for a, b, n in spans]
    q = np.linspace(*Q_RANGE, max(2, round(points / pairs)))
    return q, np.concatenate([[MU_RANGE[0]], *mu])


def compute(
    points: int, store: Path, overwrite: bool = False, law: str = "smoothed"
) -> xr.Dataset:
    """The map as a dataset over (q, mu_s, mu_k): what its store lacks is computed.

    That is first its cells, then what `follow_again` says of those beside another end.
    """
    q, mu = grid(points)
    names = "q", "mu_s", "mu_k", "rtol"
    program = zj.Program(functools.partial(point, law=law), names=names)
    ds = zj.sweep(
        program, where=lambda mu_s, mu_k, **_: mu_k <= mu_s,
        q=q, mu_s=mu, mu_k=mu, rtol=RTOL, store=zj.Store(store, overwrite),
    )  # fmt: skip
    if not _is_marked(ds):
        ds = zj.follow_again(program, ds, rtol=FINER, late=LATE)
        add_variables(store, ds[["outcome_again", "again"]])
    return ds


def _is_marked(ds: xr.Dataset) -> bool:
    """Whether a store's map has its marks, whole and of these tolerances."""
    if not {"outcome_again", "again"} <= {*ds}:
        return False
    about = ds["again"].attrs
    if (about.get("rtol"), about.get("late")) != (FINER, LATE):
        return False
    try:
        asked = ds["again"].values > 0, ds["outcome"].isin(ENDED).values
        ends = ds["outcome_again"].values > 0, ds["again"].isin(FOLLOWED).values
    except Exception:  # zarr's, of a damaged chunk, of many kinds
        return False
    return bool(np.all(asked[0] == asked[1]) and np.all(ends[0] == ends[1]))


def section(ds: xr.Dataset, ratio: float) -> xr.Dataset:
    """The plane of `ds` over (q, mu_s) whose mu_k is closest to mu_s / ratio.

    The grid has no value close to small mu_s / ratio: up to the last row where the
    closest is more than `CLOSE` off, rows are as if they had not been computed.
    """
    mu_s, mu_k = ds["mu_s"].values, ds["mu_k"].values
    wanted = mu_s / ratio
    chosen = np.abs(mu_k[:, None] - wanted).argmin(axis=0)
    far = np.flatnonzero(np.abs(mu_k[chosen] / wanted - 1) > CLOSE)
    close = np.arange(mu_s.size) > far.max(initial=-1)
    rows = xr.DataArray(chosen, dims="mu_s")
    keep = xr.DataArray(close, dims="mu_s")
    plane = ds.isel(mu_k=rows)
    for name in {"outcome", "ends"} & set(plane):
        plane[name] = plane[name].where(keep, zj.CODE.not_computed)
    return plane


def onset(plane: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Where flutter begins with growing q: the last stuck q, the first fluttering one.

    Flutter is a certified cycle (or a column that turns over). Unsettled points between
    the two are undecided and make the interval wide. One interval a row of mu_s; NaN
    where the grid holds no stuck point below its first fluttering one.
    """
    q, outcome = plane["q"].values, plane["outcome"].transpose("mu_s", "q").values
    low, high = np.full((2, len(outcome)), np.nan)
    for row, codes in enumerate(outcome):
        flutters = np.isin(codes, (zj.CODE.cycle, zj.CODE.escaped))
        first = flutters.argmax() if flutters.any() else 0
        stuck = np.flatnonzero(codes[:first] == zj.CODE.stuck)
        if stuck.size:
            low[row], high[row] = q[stuck[-1]], q[first]
    return low, high


def draw(ds: xr.Dataset, path: Path, law: str = "smoothed") -> None:
    """Draw three sections of the map, and the flutter onset in each."""
    from ziegler_jax._main_picture import draw_sections

    planes = [section(ds.sel(joint=2), ratio) for ratio, _ in SECTIONS]
    titles, onsets = [title for _, title in SECTIONS], [onset(p) for p in planes]
    draw_sections(planes, titles, onsets, _heading(law), path)


def draw_both(ends: xr.Dataset, path: Path) -> None:
    """Draw where the laws' outcomes differ: three sections, and over mu_k / mu_s."""
    from ziegler_jax._main_picture import draw_differences

    planes = [section(ends, ratio) for ratio, _ in SECTIONS]
    titles = [title for _, title in SECTIONS]
    draw_differences(planes, titles, shares_over_ratio(ends), _heading("both"), path)


def _heading(law: str) -> str:
    """The scene in a line."""
    kick = rf"kick $\dot\varphi_2(0) = {KICK[1]}\,\sqrt{{k/(ml^2)}}$"
    return f"Uniform rods, {LAWS[law]}, pins of {PIN_RADIUS} l, {kick}"


def summary(ds: xr.Dataset) -> str:
    """What the map holds, where flutter begins, and what it cost."""
    a, outcome = ds.attrs, ds["outcome"].values
    ends = outcome[outcome != zj.CODE.not_computed]
    lines = [f"{counted(ends.size)} motions. How they ended:"]
    lines += _shares(ends, ends.size, "  ")
    undecided = ds["undecided"].values[outcome == zj.CODE.unsettled]
    if undecided.size:
        lines.append("What the unsettled ones may be:")
        lines += _shares(undecided, ends.size, "  ")
    lines += _marked(ds)
    begins = [line for ratio, _ in SECTIONS for line in _onsets(section(ds, ratio))]
    if begins:
        lines.append("Flutter begins between the last stuck q and the first cycle's:")
        lines += begins
    if "run_seconds" in a:  # not where the last run was killed after its last point
        lines.append(
            f"The last run that computed any took {a['run_seconds']:.1f} s after "
            f"{a['compile_seconds']:.1f} s of compilation, "
            f"{counted(round(a['points_per_second']))} motions a second on "
            f"{a['threads']} threads."
        )
    return "\n".join(lines)


def _shares(codes: np.ndarray, whole: int, indent: str) -> list[str]:
    """A line for each code that there is, the most frequent one first."""
    counts = [(int((codes == code).sum()), code) for code in zj.CODE]
    counts = sorted((-count, code) for count, code in counts if count)
    return [
        f"{indent}{counted(-count):>10s} {-count / whole:6.1%}  {code.name}: "
        f"{code.sentence}"
        for count, code in counts
    ]


def _onsets(plane: xr.Dataset) -> list[str]:
    """Where flutter begins in a section, at some of its frictions."""
    lines, (low, high), mu_s = [], onset(plane), plane["mu_s"].values
    for mu in ONSET_AT:
        row = int(np.abs(mu_s - mu).argmin())
        if abs(mu_s[row] - mu) > 1e-9:
            continue
        where = f"  mu_s = {mu:.2f}, mu_k = {plane['mu_k'].values[row]:.4f}: "
        if np.isfinite(low[row]):
            lines.append(f"{where}{low[row]:.3f} < q_on <= {high[row]:.3f}")
        elif (plane["outcome"].isel(mu_s=row) != zj.CODE.not_computed).any():
            lines.append(f"{where}not on this grid")
    return lines


def _marked(ds: xr.Dataset) -> list[str]:
    """How many cells lie beside another end, and what became of them."""
    about = ds["again"].attrs
    sentences = about["comment"].split("; ")
    counts = [int((ds["again"].values == i).sum()) for i in range(len(sentences))]
    rows = [*zip(counts, sentences, strict=True)][INSIDE + 1 :]
    return [
        f"{counted(sum(n for n, _ in rows))} cells lie beside another end. Those that "
        f"ended by t = {about['late']:g} were followed again at {about['rtol']:g}:",
        *(f"  {counted(n):>10s} {text}" for n, text in rows),
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the main job; returns the exit status."""
    parser = _parser()
    options = parser.parse_args(arguments)
    advice = ADVICE.format(" without --overwrite" if options.overwrite else "")
    try:
        zj.configure_cpu()
        printed, written = _run(options, parser, f"Stopped: {advice}.")
    except KeyboardInterrupt:
        print(f"Stopped: {advice}.", file=sys.stderr)
        return 130
    except OSError as error:
        print(f"Could not write to {options.out}: {error}; {advice}.", file=sys.stderr)
        return 1
    written = f"Written: {', '.join(map(str, written))}."
    if printed and _say(written):
        return 0
    print(f"Standard output took nothing. {written}", file=sys.stderr)
    return 3


def _run(
    options: argparse.Namespace, parser: argparse.ArgumentParser, stopped: str
) -> tuple[bool, list[Path]]:
    """Compute, tell and draw; whether all was told, and what was written."""
    q, mu = grid(options.points)
    count = counted(q.size * mu.size * (mu.size + 1) // 2)
    laws = ("smoothed", "dry") if options.law == "both" else (options.law,)
    maps, printed, written = {}, True, []

    def into(name: str, law: str) -> Path:
        written.append(options.out / file_of(name, law))
        return written[-1]

    for law in laws:
        store = into(STORE, law)
        printed &= _say(
            f"{count} motions, each kicked once and followed until it settles, under "
            f"{law} friction, into {store}."
        )
        with _ended_by_ctrl_c(stopped):
            with _refused_by(parser, options.law, law):
                maps[law] = compute(options.points, store, options.overwrite, law)
            printed &= _say(summary(maps[law]))
    picture = into(PICTURE, options.law)
    if options.law == "both":
        ends = ends_of_both(maps["smoothed"], maps["dry"])
        printed &= _say(summary_of_both(ends))
        draw_both(ends, picture)
    else:
        draw(maps[options.law], picture, options.law)
    return printed, written


def _say(text: str) -> bool:
    """Print, in whatever letters standard output has; whether it took them."""
    if sys.stdout is None:  # it was closed before Python began
        return False
    letters = sys.stdout.encoding or "utf-8"
    try:
        print(text.encode(letters, "backslashreplace").decode(letters), flush=True)
    except OSError:
        # else Python tries once more at its end, and complains
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
        return False
    return True


@contextlib.contextmanager
def _refused_by(parser: argparse.ArgumentParser, laws: str, law: str):
    """What is there is not this map: nothing is replaced unasked."""
    replaces = "--overwrite" if laws == law else f"--law {law} --overwrite"
    try:
        yield
    except ValueError as error:
        parser.error(f"{error} {replaces} replaces it, --out writes elsewhere")


@contextlib.contextmanager
def _ended_by_ctrl_c(sentence: str):
    """Ctrl-C ends the process at once, as a kill would, which a store survives.

    There is nothing to tidy, and an exception inside a compiler's callback can be lost.
    """

    def end(*_):
        os.write(2, f"{sentence}\n".encode())
        os._exit(130)

    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield  # who ignores or handles it goes on
        return
    before = signal.signal(signal.SIGINT, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="python -m ziegler_jax",
        description="Kick a column of two uniform rods at every follower load q in "
        "[1, 4] and friction 0.02 <= mu_k <= mu_s <= 0.4, follow it until its motion "
        f"has settled, and write {STORE} and {PICTURE}; of dry friction "
        f"{file_of(STORE, 'dry')} and {file_of(PICTURE, 'dry')}; of both laws both "
        f"stores, and {file_of(PICTURE, 'both')}: where their outcomes differ. A map "
        "that was stopped is gone on with: only what is missing is computed.",
        epilog="Exit status: 0 written; 1 could not be written; 2 refused; 3 written, "
        "but standard output was closed; 130 stopped by Ctrl-C.",
    )
    parser.add_argument(
        "--points",
        type=_points,
        default=POINTS,
        metavar="N",
        help="about how many points; all axes grow or shrink (default %(default)s)",
    )
    parser.add_argument(
        "--law",
        choices=LAWS,
        default="smoothed",
        help="the friction: smoothed by a tanh, dry (set-valued), or both laws, one "
        "after the other (default %(default)s)",
    )
    parser.add_argument(
        "--out",
        type=_folder,
        default=".",
        metavar="FOLDER",
        help="where to write, made if need be (default: the current folder)",
    )
    anew = "begin anew, in place of the map that is there"
    parser.add_argument("--overwrite", action="store_true", help=anew)
    return parser


class _Parser(argparse.ArgumentParser):
    """A parser that refuses in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message} (see --help)\n")


def _points(text: str) -> int:
    try:
        points = int(text)
    except ValueError:
        points = 0
    if not FEWEST <= points <= MOST:
        raise argparse.ArgumentTypeError(
            f"must be a whole number from {FEWEST} to {MOST}, but is {text!r}"
        )
    return points


def _folder(text: str) -> Path:
    """A folder that can be written to, now rather than after the computation."""
    folder = Path(text)
    try:
        if not text:
            raise OSError("it has no name")
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = error.strerror or str(error)
        raise argparse.ArgumentTypeError(
            f"must be a folder that can be written to, but {text!r} is not: {reason}"
        ) from None
    return folder


if __name__ == "__main__":
    sys.exit(main())
