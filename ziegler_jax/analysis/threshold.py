r"""Thresholds: where along a line of loads or kicks the column stops coming to rest.

With dry friction there is no infinitesimal onset. Rest and a flutter cycle coexist, a
kick below a threshold sticks and one above it flutters, and onset is that threshold:
along any line (`threshold`), of the kick at a given load (`critical_kick`),
of the load, or another number, at a given kick (`flutter_onset`). It is the crossing of
the stable manifold of an unstable cycle, near which motions linger: a verdict takes
thousands of time units there.

A search scans the bracket first and then halves the interval in which the verdict
first changes. A motion's verdict is

- *rests*: it came to rest. With set-valued friction that is certain as soon as both
  joints stick at once, for then they stick for ever. Under a smoothed law both joints
  stay below the cut for 20 time units and do not speed up.
- *moves*: it draws near a cycle that is certified (see `settle`), or a rod turned over
  (`escape`), or it endures: its returns have grown for long, or have not fallen for
  longer (see `steady/trend.py`). Where friction alone dissipates, a motion may grow
  for thousands of time units before its cycle is certain. One that lingers beside an
  unstable cycle does none of these yet.
- none: it neither rested nor moves within its budget, or failed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..model.chain_of_rods import AbstractChain, check_column
from ..model.state import State
from ..motion.checks import check_maker, check_scene, check_takes, made, scene_at
from ..motion.implicit import fixed, lost
from ..motion.method import explicit_method
from ..motion.options import Method, Windows, recorded
from ..motion.sequence import run_in_sequence
from ..numerics.numbers import Flag, Pair, Scalar, Two, is_concrete
from ..numerics.rules import instance, pair, whole_number
from ..results import (
    CODE,
    ONSETS,
    OUTCOMES,
    AbstractResult,
    Settings,
    Variable,
    quantity,
)
from ..runtime import requires_x64
from ..steady.certified import CertifiedMotion
from ..steady.lane import Certifying
from .manifold import carried

RESTS, MOVES, NONE = -1.0, 1.0, 0.0


class Search(eqx.Module):
    """How a threshold is searched for in its bracket.

    **Arguments:** `scan`: the number of intervals in which the bracket is scanned first
    (two changes within one go unnoticed); `halvings`: how often the first interval with
    a change is halved.

    **Raises:** `ValueError` for a number that is not an integer of at least 1.
    """

    scan: int = eqx.field(static=True)
    halvings: int = eqx.field(static=True)

    def __init__(self, scan: int = 8, halvings: int = 10):
        """Check and keep them."""
        self.scan = whole_number("scan", scan)
        self.halvings = whole_number("halvings", halvings)


class Threshold(AbstractResult):
    """The threshold along the bracket, and how it was found.

    `threshold`: the middle of the last interval, `width`: its width. No motion is
    judged while it lingers beside an unstable cycle, so this interval contains the
    threshold. `rises`: 1 for rest below and motion above, -1 for the reverse;
    `changes`: the number of changes of the verdict along the scan, more than one where
    the outcome is `repeated`; `undecided`: the number of motions without a verdict,
    `obstacle`: how the first of these ended, a `CODE` (none without such a motion);
    `steps`: of all motions; `outcome`: a `CODE`.
    """

    threshold: Float[
        Array, "*lanes"
    ]  # the middle of the last interval; NaN where none was found
    width: Float[Array, "*lanes"] = eqx.field(
        metadata=quantity("width of the last interval")
    )
    rises: Float[Array, "*lanes"] = eqx.field(
        metadata=quantity("1: rest below, motion above; -1: reversed")
    )
    changes: Int[Array, "*lanes"] = eqx.field(  # more than 1: repeated
        metadata=quantity("changes of the verdict along the scan")
    )
    undecided: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("motions without a verdict")
    )
    obstacle: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("how the first undecided motion ended", codes=OUTCOMES)
    )
    steps: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("attempted steps")
    )  # of all motions
    outcome: Int[Array, "*lanes"] = eqx.field(
        metadata=quantity("how the search ended", codes=ONSETS)
    )
    long_name: str = eqx.field(static=True)  # of the threshold
    settings: Settings = eqx.field(static=True)

    def variables(self) -> dict[str, Variable]:
        """All numbers with their names, units and dimensions."""
        threshold = Variable(self.threshold, self.long_name)
        return {"threshold": threshold, **super().variables()}


@requires_x64
def threshold(
    cell: Callable[[Scalar], tuple[AbstractChain, State]],
    bracket: Two,
    *,
    search: Search = Search(),
    windows: Windows = Windows(),
    method: Method = Method(),
) -> Threshold:
    r"""The place along a line at which the column stops coming to rest.

    The line may be of loads, of kicks, of both together, of a damping or a size.

    ```python
    def point(angle, tau):
        def cell(s):  # load and kick grow together
            law = zj.SetValuedCoulomb(tau, pin_radius=1, load=zj.ConstantLoad(1))
            column = zj.uniform_rods(1 + s * jnp.cos(angle), friction=law)
            return column, zj.State(omega=(0, s * jnp.sin(angle)))

        return zj.threshold(cell, (0, 2))
    ```

    **Arguments:** (times in $\sqrt{m l^2/k}$)

    - `cell`: a function of one number that returns a column and its start.
    - `bracket`: the least and the largest number. Either end may be the resting one.
    - `search`: see `Search`.
    - `windows`: of each motion, as in `settle`.
    - `method`: of each motion.

    **Returns:** `Threshold`: `threshold`, `width` (of the last interval), `outcome` and
    more. A motion without a verdict inside the halved interval ends the search there,
    as `undecided`, with the width of that interval.

    **Derivatives:** of `threshold`, forward and reverse, first order, in every number
    of the columns and starts; not in the bracket and the options, on which a threshold
    does not depend. They come from the tangents of the motion on the threshold (see
    `analysis/manifold.py`) and are as good as that is near: measured, of the largest
    relative derivative, 2e-2 where what changes along the line (the load, the kick)
    changes over the `width` by 1.5e-3 of itself, 3e-3 at 4e-4, 2e-3 at 5e-5, 4e-5 at
    3e-6, or the steps' error if that is larger; by a saddle of rest, whose joint 2 is
    stiff, 6e-2 at 6e-4 and 2e-4 at 2e-4. They are NaN where it changes by more,
    and where tangents disagree, as by an unstable cycle that hardly repels: a finer
    `search` helps. And they are NaN unless the outcome is `found`: where
    the verdict changes more than once (`repeated`), as along a fractal boundary, or
    gives out (`undecided`), as in chaos, choose a narrower bracket.

    **Raises:** `ValueError` for arguments that break a rule.
    """
    check_takes("Argument `cell` must be a function of one number", cell, 1)
    meaning = "threshold: the number at which the verdict first changes"
    question = _Question("threshold", meaning, cell, search, windows, method)
    return _search(question, bracket)


@requires_x64
def critical_kick(
    column: AbstractChain,
    direction: State,
    bracket: Two,
    *,
    search: Search = Search(),
    windows: Windows = Windows(),
    method: Method = Method(),
) -> Threshold:
    r"""The smallest kick along a direction after which the column does not stick.

    `threshold` of a column and the start s times `direction`: the critical kick is the
    first s in the bracket at which the verdict changes.

    ```python
    def point(q, tau):
        law = zj.SetValuedCoulomb(tau, pin_radius=1, load=zj.ConstantLoad(1))
        column = zj.uniform_rods(q, friction=law)
        return zj.critical_kick(column, zj.State(omega=(0, 1)), (0, 40 * tau))
    ```

    **Arguments:**

    - `column`: the column or chain.
    - `direction`: a state; the kick is its multiple, in its units.
    - `bracket`: the least and the largest multiple.
    - `search`, `windows`, `method`: as `threshold`.

    **Returns:** `Threshold`, with derivatives in the column's and the direction's
    numbers.

    **Raises:** `ValueError` for arguments that break a rule.
    """
    check_column(column)
    instance("direction", direction, State)
    if all(is_concrete(x) and x == 0 for x in direction.y):
        raise ValueError("Argument `direction` must not be zero, but is.")

    def cell(s: Scalar) -> tuple[AbstractChain, State]:
        scaled = [s * x for x in direction.y]
        n = column.joints
        return column, State(scaled[:n], scaled[n:])

    meaning = "critical kick, as a multiple of its direction"
    question = _Question("critical_kick", meaning, cell, search, windows, method)
    return _search(question, bracket)


@requires_x64
def flutter_onset(
    make_column: Callable[[Scalar], AbstractChain],
    start: State,
    bracket: Two,
    *,
    search: Search = Search(),
    windows: Windows = Windows(),
    method: Method = Method(),
) -> Threshold:
    r"""The load, or another number of the column, from which a start no longer rests.

    `threshold` of `make_column(x)` and the same start.

    **Arguments:**

    - `make_column`: a function of one number, e.g. `lambda q: zj.uniform_rods(q,
        friction=law)`.
    - `start`: the same for every column.
    - `bracket`, `search`, `windows`, `method`: as `threshold`.

    **Returns:** `Threshold`, with derivatives in the columns' and the start's numbers.

    **A clean map** asks for a bracket whose lower end rests, and for a scan with
    intervals shorter than a window of rest that shall be noticed. Over 210 pairs of
    `mu_s` >= `mu_k` (0.02 to 0.4, both pins 0.05, set-valued, load F, kick 0.3, bracket
    0.5 to 4, all else by default) 159 onsets are `found`, 28 `repeated` (rest returns
    at higher loads: in scans of 400 loads of 20 of them each time), 17 `moves` (where
    `mu_k` is small flutter sets in below 0.5) and 6 `undecided`: there a motion still
    falls, or wanders beside an unstable cycle, at t = 40 000. Of the 187 last intervals
    all lower ends come to rest by other steps, and 186 upper ones move: the other lies
    where small chaos is born (`benchmarks/a13_certified_truth.py onsets`).

    **Raises:** `ValueError` for arguments that break a rule.
    """
    check_maker(make_column)
    instance("start", start, State)

    def cell(x: Scalar) -> tuple[AbstractChain, State]:
        return made(make_column, x), start

    meaning = "onset: the parameter at which the verdict first changes"
    question = _Question("flutter_onset", meaning, cell, search, windows, method)
    return _search(question, bracket)


class _Question(NamedTuple):
    """The question of a search, and its options."""

    name: str  # by which it was called
    meaning: str  # of the threshold
    cell: Callable[[Scalar], tuple[AbstractChain, State]]
    search: Search
    windows: Windows
    method: Method

    def check(self) -> None:
        """Refuse what is no such option (ValueError)."""
        instance("search", self.search, Search)
        instance("windows", self.windows, Windows)
        instance("method", self.method, Method)

    def motion(self, x: Scalar) -> CertifiedMotion:
        """The motion at a place of the bracket."""
        column, start = fixed(scene_at(self.cell, x))
        check_scene(column, start)
        windows, method = fixed((self.windows, self.method))
        if method.solver is None and column.system().has_series:
            # with Taylor's longer steps a threshold follows the steps' errors more
            method = explicit_method("threshold", method)
        return CertifiedMotion(column, start, "threshold", windows, None, method)


class _Search(NamedTuple):
    """The verdicts of the motions so far."""

    x: Float[Array, ""]  # where the next motion starts
    tried: Int[Array, ""]  # how many motions there were
    verdict: Float[Array, ""]  # the last one, and where
    place: Float[Array, ""]
    low: Float[
        Array, ""
    ]  # the interval of the first change; the verdict at its lower end
    high: Float[Array, ""]
    below: Float[Array, ""]
    changes: Int[Array, ""]
    undecided: Int[Array, ""]
    obstacle: Int[Array, ""]
    over: Bool[Array, ""]


def _search(question: _Question, bracket: Two) -> Threshold:
    question.check()
    least, largest = bracket_of(bracket)
    scan, halvings = question.search.scan, question.search.halvings

    def motion(search: _Search) -> CertifiedMotion:
        return question.motion(search.x)

    def update(search: _Search, motion: CertifiedMotion, run: Certifying) -> _Search:
        del motion
        verdict = verdict_of(run.outcome, run.moves)
        return _updated(search, verdict, run.outcome, (least, largest), question.search)

    zero, none = jnp.zeros_like(least), jnp.zeros((), jnp.int32)
    nan = zero + jnp.nan
    first = _Search(
        x=least,
        tried=none,
        verdict=zero + NONE,
        place=least,
        low=nan,
        high=nan,
        below=zero + NONE,
        changes=none,
        undecided=none,
        obstacle=none,
        over=~(jnp.isfinite(largest - least) & (least < largest)),
    )
    search, steps = run_in_sequence(motion, update, lambda search: ~search.over, first)
    exists = search.changes > 0
    value = jnp.where(exists, (search.low + search.high) / 2, jnp.nan)
    width = jnp.where(exists, search.high - search.low, jnp.nan)
    outcome = _outcome(search, scan, halvings)
    last = motion(first)
    change = carried(
        partial(scene_at, question.cell),
        jnp.where(exists, value, least),
        width,
        search.over & (outcome == CODE.found),
        last.last,
        last.horizon,
        last.method,
    )
    return Threshold(
        threshold=value + change,
        width=lost(width, bracket),
        rises=jnp.where(exists, -search.below, jnp.nan),
        changes=search.changes,
        undecided=search.undecided,
        obstacle=search.obstacle.astype(jnp.int8),
        steps=steps,
        outcome=outcome,
        long_name=question.meaning,
        settings=recorded(**last.settings(), scan=scan, halvings=halvings),
    )


def bracket_of(bracket: Two, rule: str = "finite") -> list[Float[Array, ""]]:
    """The two ends of a search, without derivatives.

    **Raises:** `ValueError` where they do not increase, or break the rule.
    """
    low, high = fixed(pair("bracket", bracket, rule))
    if is_concrete(low) and is_concrete(high) and not low < high:
        raise ValueError(
            f"Argument `bracket` must increase, but is ({low:g}, {high:g})."
        )
    return [jnp.asarray(x, jnp.result_type(float)) for x in (low, high)]


def verdict_of(outcome: Int[Array, ""], moves: Flag) -> Float[Array, ""]:
    """The verdict of a motion that has ended: `RESTS`, `MOVES` or `NONE`."""
    rests = (outcome == CODE.stuck) | (outcome == CODE.rest)
    return jnp.where(rests, RESTS, jnp.where(moves, MOVES, NONE))


def _updated(
    search: _Search,
    verdict: Float[Array, ""],
    outcome: Int[Array, ""],
    bracket: Pair,
    how: Search,
) -> _Search:
    """The search after one more motion: along the scan, then by halves."""
    scan, halvings = how.scan, how.halvings
    least, largest = bracket
    decided, scanning = verdict != NONE, search.tried <= scan
    change = scanning & decided & (search.verdict * verdict < 0)
    first = change & (search.changes == 0)
    x = search.x
    low = jnp.where(first, search.place, search.low)
    high = jnp.where(first, x, search.high)
    below = jnp.where(first, search.verdict, search.below)
    halving = ~scanning & decided
    low = jnp.where(halving & (verdict == below), x, low)
    high = jnp.where(halving & (verdict != below), x, high)
    changes = search.changes + change.astype(jnp.int32)
    tried = search.tried + 1
    over = (tried > scan) & (changes == 0)
    over |= (tried > scan + halvings) | (~scanning & ~decided)
    over |= outcome == CODE.invalid
    along = least + (largest - least) * (tried / scan).astype(x.dtype)
    return _Search(
        x=jnp.where(tried <= scan, along, (low + high) / 2),
        tried=tried,
        verdict=jnp.where(decided, verdict, search.verdict),
        place=jnp.where(decided, x, search.place),
        low=low,
        high=high,
        below=below,
        changes=changes,
        undecided=search.undecided + (~decided).astype(jnp.int32),
        obstacle=jnp.where(decided | (search.undecided > 0), search.obstacle, outcome),
        over=over,
    )


def _outcome(search: _Search, scan: int, halvings: int) -> Int[Array, ""]:
    outcome = jnp.where(search.changes > 1, CODE.repeated, CODE.found)
    short = search.tried <= scan + halvings
    outcome = jnp.where(short, CODE.undecided, outcome)
    rests = jnp.where(search.verdict == RESTS, CODE.rests, CODE.moves)
    rests = jnp.where(search.undecided > 0, CODE.undecided, rests)
    outcome = jnp.where(search.changes == 0, rests, outcome)
    invalid = (search.tried == 0) | (search.obstacle == CODE.invalid)
    return jnp.where(invalid, CODE.invalid, outcome).astype(jnp.int8)
