r"""Onset: where along a line of scenes the column stops coming to rest.

With dry friction there is no infinitesimal onset. Rest and a flutter cycle coexist, a
kick below a threshold sticks and one above it flutters, and onset is that threshold: of
the kick at a given load (`critical_kick`) or of the load, or any other number, at a
given kick (`flutter_onset`). It is the crossing of the stable manifold of an unstable
cycle, near which motions linger: a verdict takes thousands of time units there.

A search scans the bracket first and then halves the interval in which the verdict
first changes. A motion's verdict is

- *rests*: it came to rest. With set-valued friction that is certain as soon as both
  joints stick at once, for then they stick for ever. Under a smoothed law both joints
  stay below the cut for two windows and do not speed up.
- *moves*: it settled on a cycle, or a rod turned over (`escape`). Settled means that
  windows agree to `rtol_settle` and draw nearer. Where motions part from an unstable
  cycle by a factor $e^{\lambda w}$ a window, one that came within
  `rtol_settle` $/ (\lambda w)$ of its amplitude can still pass for settled.
- none: it neither rested nor settled within its budget, or failed.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..context import plain
from ..model.column import Column, State
from ..motion.integrate import Run
from ..motion.scene import (
    check_maker,
    check_scene,
    explicit_method,
    has_series,
    made,
    recorded,
)
from ..motion.sequence import in_turn
from ..motion.settle_problem import Settling
from ..numerics.numbers import check_options, instance, is_concrete, pair, whole_number
from ..results import ONSET, OUTCOME, AbstractResult, Variable, quantity
from ..solvers import Explicit
from .implicit import fixed
from .threshold import carried

RESTS, MOVES, NONE = -1.0, 1.0, 0.0
# the options of each motion
SETTLE = {
    "window": 40.0,
    "max_windows": 200,
    "rtol_settle": 5e-5,
    "rtol": 1e-6,
    "atol": 1e-6,
    "solver": None,
    "escape": np.pi,
    "rate_cut": None,
    "max_steps": 1_000_000,
}
OPTIONS = ("scan", "halvings", *SETTLE)


class Onset(AbstractResult):
    """Where the verdict first changes along the bracket.

    `width` is that of the last interval and no bound on the error of `value`. A motion
    that lingers beside the unstable cycle can be misjudged there: its windows agree to
    within `rtol_settle` while it is still on its way to rest. At q = 1.5 (`SetValued-
    Coulomb(0.01, pin_radius=1, load=ConstantLoad(1))`, `rtol_settle` 5e-5) the answer
    is 21.27756 with a width of 0.00125, and kicks up to 21.281 still come to rest,
    after up to 1448 time units. A finer `rtol_settle` with more windows tells.
    """

    value: Any  # the middle of the last interval; NaN where none was found
    width: Any = eqx.field(metadata=quantity("width of the last interval"))
    rises: Any = eqx.field(
        metadata=quantity("1: rest below, motion above; -1: reversed")
    )
    changes: Any = eqx.field(  # more than 1: repeated
        metadata=quantity("changes of the verdict along the scan")
    )
    undecided: Any = eqx.field(metadata=quantity("motions without a verdict"))
    obstacle: Any = eqx.field(
        metadata=quantity("how the first undecided motion ended", codes=OUTCOME)
    )
    steps: Any = eqx.field(metadata=quantity("attempted steps"))  # of all motions
    outcome: Any = eqx.field(metadata=quantity("how the search ended", codes=ONSET))
    name: str = eqx.field(static=True)
    long_name: str = eqx.field(static=True)
    settings: tuple[tuple[str, Any], ...] = eqx.field(static=True)

    def variables(self) -> dict[str, Variable]:
        """All numbers with their names, for `sweep`."""
        value = Variable(self.value, self.long_name)
        return {self.name: value, **super().variables()}


@plain
def critical_kick(
    column: Column, direction: State, bracket: Any, **options: Any
) -> Onset:
    r"""The smallest kick along a direction after which the column does not stick.

    The start is s times `direction`; the critical kick is the first s in the bracket
    at which the verdict changes.

    ```python
    def point(q, tau):
        law = zj.SetValuedCoulomb(tau, pin_radius=1, load=zj.ConstantLoad(1))
        column = zj.uniform_rods(q, friction=law)
        return zj.critical_kick(column, zj.State(omega=(0, 1)), (0, 40 * tau))
    ```

    **Arguments:**

    - `column`: the scene.
    - `direction`: a state; the kick is its multiple, in its units.
    - `bracket`: the least and the largest multiple.
    - `options`: of the search, as `flutter_onset` has them.

    **Returns:** `Onset`; its `value` has derivatives, see `flutter_onset`. Its `width`
    is no bound on the error, see `Onset`.

    **Raises:** `ValueError` for arguments that break a rule.
    """
    check_options("critical_kick", options, OPTIONS)
    instance("direction", direction, State)
    if all(is_concrete(x) and x == 0 for x in direction.y):
        raise ValueError("Argument `direction` must not be zero, but is.")

    def scene(s: Any) -> tuple[Column, State]:
        scaled = [s * x for x in direction.y]
        return column, State(scaled[:2], scaled[2:])

    meaning = "critical kick, as a multiple of its direction"
    return _search(scene, bracket, "critical_kick", meaning, **options)


@plain
def flutter_onset(
    make_column: Callable[[Any], Column], start: State, bracket: Any, **options: Any
) -> Onset:
    r"""The load, or another number of the column, from which a start no longer rests.

    **Arguments:** (times in $\sqrt{m l^2/k}$)

    - `make_column`: a function of one number, e.g. `lambda q: zj.uniform_rods(q,
        friction=law)`.
    - `start`: the same for every column.
    - `bracket`: the least and the largest number. Either end may be the resting one.
    - `scan`: how many intervals the bracket is scanned in before it is halved. A pair
        of changes within one interval goes unnoticed.
    - `halvings`: how often the first interval with a change is halved.
    - `window`, `max_windows`, `rtol_settle`, `rtol`, `atol`, `solver`, `escape`,
        `rate_cut`, `max_steps`: of each motion, as in `settle`, with the stricter rules
        of this module; with set-valued friction a `solver` of None is Tsit5.

    **Returns:** `Onset`: `value`, `width` (of the last interval: no bound on the error,
    see there), `outcome` and more. A motion without a
    verdict inside the halved interval ends the search there, as `undecided`: its
    width is then what is known.

    **Derivatives:** of `value`, forward and reverse, first order, in every number of
    the column and the start (or direction); not in the bracket and the options, on
    which a threshold does not depend. They come from the tangents of the motion on the
    threshold (see `threshold`) and are as good as that is near: relative to the value,
    about its `width`, or the steps' error if that is larger. They are NaN unless the
    outcome is `found`: where the verdict changes more than once (`repeated`), as along
    a fractal boundary, or gives out (`undecided`), as in chaos, choose a narrower
    bracket. They are NaN, too, where the tangents disagree by more than a twentieth.

    **Raises:** `ValueError` for arguments that break a rule.
    """
    check_options("flutter_onset", options, OPTIONS)
    check_maker(make_column)

    def scene(x: Any) -> tuple[Column, State]:
        return made(make_column, x), start

    meaning = "onset: the parameter at which the verdict first changes"
    return _search(scene, bracket, "flutter_onset", meaning, **options)


class _Search(NamedTuple):
    """What the motions so far have told."""

    x: Any  # where the next motion starts
    tried: Any  # how many motions there were
    verdict: Any  # the last one, and where
    place: Any
    low: Any  # the interval of the first change; the verdict at its lower end
    high: Any
    below: Any
    changes: Any
    undecided: Any
    obstacle: Any
    over: Any


def _search(
    scene: Callable[[Any], tuple[Column, State]],
    bracket: Any,
    name: str,
    long_name: str,
    *,
    scan: int = 8,
    halvings: int = 10,
    **options: Any,
) -> Onset:
    least, largest = fixed(pair("bracket", bracket))
    if is_concrete(least) and is_concrete(largest) and not least < largest:
        raise ValueError(
            f"Argument `bracket` must increase, but is ({least:g}, {largest:g})."
        )
    scan, halvings = whole_number("scan", scan), whole_number("halvings", halvings)
    settle = fixed({**SETTLE, **options})
    dtype = jnp.result_type(float)
    least, largest = jnp.asarray(least, dtype), jnp.asarray(largest, dtype)

    def motion(search: _Search) -> Settling:
        column, start = fixed(scene(search.x))
        check_scene(column, start)
        # the derivative is carried along the steps of the same method
        series = has_series(column)
        solver = settle["solver"]
        solver = explicit_method(solver, Explicit()) if series else solver
        return Settling(
            column,
            start,
            **{**settle, "solver": solver},
            transient=np.float64(0),
            observers=(),
            strict=True,
        )

    def heard(search: _Search, motion: Settling, run: Run) -> _Search:
        del motion
        return _heard(search, run.outcome, least, largest, scan, halvings)

    zero, none = jnp.zeros((), dtype), jnp.zeros((), jnp.int32)
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
    search, steps = in_turn(motion, heard, lambda search: ~search.over, first)
    found = search.changes > 0
    value = jnp.where(found, (search.low + search.high) / 2, jnp.nan)
    width = jnp.where(found, search.high - search.low, jnp.nan)
    outcome = _outcome(search, scan, halvings)
    last = motion(first)
    change = carried(
        scene,
        jnp.where(found, value, least),
        width,
        search.over & (outcome == ONSET.found),
        last.watch.span,
        last.end,
        last.method._replace(max_steps=settle["max_steps"]),
    )
    return Onset(
        value=value + change,
        width=width,
        rises=jnp.where(found, -search.below, jnp.nan),
        changes=search.changes,
        undecided=search.undecided,
        obstacle=search.obstacle.astype(jnp.int8),
        steps=steps,
        outcome=outcome,
        name=name,
        long_name=long_name,
        settings=recorded(**last.settings(), scan=scan, halvings=halvings),
    )


def _verdict(outcome: Any) -> Any:
    rests = (outcome == OUTCOME.stuck) | (outcome == OUTCOME.rest)
    moves = (outcome == OUTCOME.cycle) | (outcome == OUTCOME.escaped)
    return jnp.where(rests, RESTS, jnp.where(moves, MOVES, NONE))


def _heard(
    search: _Search, outcome: Any, least: Any, largest: Any, scan: int, halvings: int
) -> _Search:
    """The search after one more motion: along the scan, then by halves."""
    verdict = _verdict(outcome)
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
    over |= outcome == OUTCOME.invalid
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


def _outcome(search: _Search, scan: int, halvings: int) -> Any:
    outcome = jnp.where(search.changes > 1, ONSET.repeated, ONSET.found)
    short = search.tried <= scan + halvings
    outcome = jnp.where(short, ONSET.undecided, outcome)
    rests = jnp.where(search.verdict == RESTS, ONSET.rests, ONSET.moves)
    rests = jnp.where(search.undecided > 0, ONSET.undecided, rests)
    outcome = jnp.where(search.changes == 0, rests, outcome)
    invalid = (search.tried == 0) | (search.obstacle == OUTCOME.invalid)
    return jnp.where(invalid, ONSET.invalid, outcome).astype(jnp.int8)
