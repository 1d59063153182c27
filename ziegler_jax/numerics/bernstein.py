r"""When a joint's mode ends within a step whose motion is a power series.

Each joint's mode holds as long as a polynomial w of time keeps its side: where the
joint slips, its rate in its direction, $w \ge 0$; where it sticks, its torque,
$|w| \le \tau_s$. A polynomial lies within the hull of its Bernstein coefficients and
crosses a level no more often than they do. They tell that a mode holds over the whole
step, or that it ends there once. Where they tell neither, the step is halved until they
do; then the first end is a root, found by Newton's method.

`joints`: for each the coefficients of w, the limit ($\tau_s$, or 0 where the joint
slips), whether it slips, and how closely the limit is to be met.
"""

import math
from collections.abc import Callable, Sequence
from functools import reduce

import jax.numpy as jnp
from jax import lax

from .hermite import falling_root
from .materialise import if_any_lane, materialise
from .numbers import Flag, Scalar, any_of
from .series import sum_of, value, value_and_slope

# of a joint: see above
Joint = tuple[Sequence[Scalar], Scalar, Flag, Scalar]
IN_DOUBT, MORE_DOUBT = 2.0, 3.0
# Halved so often, what may hide between coefficients, which goes with the square of the
# time, is below rounding.
HALVINGS = 26
NEWTON_STEPS, MOST_ROUNDS = 3, 20  # of them


def _look(
    watched: Sequence[Scalar], limit: Scalar, slips: Flag, tol: Scalar, s: Scalar
) -> Scalar:
    """Whether a joint's mode holds over the time s, by its Bernstein coefficients.

    **Returns:** 0 if it does. Else, with the sign of the side on which the torque
    passes its limit (minus where the joint slips): 1 + about where in s it ends, once;
    IN_DOUBT, if it is left at the end; MORE_DOUBT, if it is not.
    """
    n, power, terms = len(watched) - 1, s, [watched[0]]
    for j, c in enumerate(watched[1:], 1):
        terms.append(c * power / math.comb(n, j))
        power = power * s
    above = below = was = jnp.zeros((), bool)
    plain, count = ~was, 0.0
    up = was
    for i in range(n + 1):
        b = sum_of([math.comb(i, j) * terms[j] for j in range(i + 1)])
        up, down = ~slips & (b > limit + tol), b < -limit - tol
        above, below = above | up, below | down
        low = up | down
        plain &= ~was | low
        count += jnp.where(low, 1.0, 0.0)
        was = low
    plain &= ~(above & below)
    # all before it are fine
    about = 1 + jnp.clip((n + 0.5 - count) / n, 0.0, 0.999)
    ends = jnp.where(plain, about, IN_DOUBT)
    kind = jnp.where(was, ends, jnp.where(plain, 0.0, MORE_DOUBT))
    return jnp.where(jnp.where(was, up, above), kind, -kind)


def first_look(
    joints: Sequence[Joint], s: Scalar, at: Scalar
) -> tuple[Scalar, list[Scalar]]:
    """A time over which all joints' ends are plain, and which they are."""

    def look(s):
        return [_look(w, limit, slips, tol, s) for w, limit, slips, tol in joints]

    def doubtful(state):
        _, ends, count = state
        worst = reduce(jnp.maximum, map(jnp.abs, ends))
        return (worst >= IN_DOUBT) & (count < HALVINGS)

    def halve(state):
        s, _, count = state
        return 0.5 * s, materialise(at, look, 0.5 * s), count + 1

    begin = s, materialise(at, look, s), jnp.zeros((), jnp.int32)
    s, ends, _ = lax.while_loop(doubtful, halve, begin)
    # what is still in doubt counts as an end where the mode is left for good
    return s, [jnp.where(jnp.abs(e) > IN_DOUBT, 0.0, e) for e in ends]


def first_event(
    joints: Sequence[Joint], ends: list[Scalar], s: Scalar, at: Scalar
) -> tuple[Scalar, Sequence[Flag]]:
    """When the first joint's mode ends, and which joint it is."""
    there = [e != 0 for e in ends]

    def guards():
        """Of each joint: limit - side x watched."""
        for (watched, limit, *_), e in zip(joints, ends, strict=True):
            side = jnp.sign(e)
            first, *rest = (-side * c for c in watched)
            yield [limit * jnp.abs(side) + first, *rest]

    def guard(which):
        """Of one of the joints."""
        return [_of_one(which, column) for column in zip(*guards(), strict=True)]

    asked = any_of(there)
    abouts = [jnp.abs(e) - 1 for e in ends]
    which, begins = there[:1], abouts[0]
    some = there[0]
    for ends_too, about in zip(there[1:], abouts[1:], strict=True):
        better = ends_too & (~some | (about < begins))
        begins, some = jnp.where(better, about, begins), some | ends_too
        which = [*(w & ~better for w in which), better]
    about = jnp.where(asked, s * jnp.clip(begins, 0, 1), 0.0)
    levels = [-0.5 * joint[3] for joint in joints]
    level = _of_one(which, levels)
    root = _root(lambda: guard(which), level, about, s, asked, at)

    for _ in joints[1:]:  # each that the first guess has passed over

        def late(which=which, root=root):
            """One whose guard is below its level already."""
            passed, one = [], jnp.zeros_like(asked)
            for w, e, row, level in zip(which, there, guards(), levels, strict=True):
                low = value(row, root) < 2 * level
                passed.append(low & e & ~w & ~one)
                one |= passed[-1]
            return passed

        passed = materialise(at, late)
        sooner = any_of(passed)

        def correct(root, passed=passed, sooner=sooner):
            other = _of_one(passed, levels)
            new = _root(lambda: guard(passed), other, 0.5 * root, s, sooner, at)
            return jnp.where(sooner, new, root)

        root = if_any_lane(sooner, correct, root)
        pairs = zip(which, passed, strict=True)
        which = [jnp.where(sooner, p, w) for w, p in pairs]
    return root, which


def _of_one(which: Sequence[Flag], values: Sequence[Scalar]) -> Scalar:
    """The number of the joint that is meant; of none the first's."""
    chosen = values[0]
    for flag, x in zip(which[1:], values[1:], strict=True):
        chosen = jnp.where(flag, x, chosen)
    return chosen


def _root(
    guard: Callable[[], Sequence[Scalar]],
    level: Scalar,
    about: Scalar,
    s: Scalar,
    asked: Flag,
    at: Scalar,
) -> Scalar:
    """Where a guard falls to a level within s: Newton's method, kept in a bracket."""

    def nearer(x, times):
        row = guard()

        def above(x):
            height, slope = value_and_slope(row, x)
            return height - level, slope

        x = falling_root(above, x, 0.0 * s, s, times)
        # it begins below, or ends there
        return jnp.where(asked & (row[0] > level), x, 0.0)

    def pair(x):
        """After some steps and one more, by which the place has its derivative."""
        x = materialise(at, lambda: nearer(x, NEWTON_STEPS))
        return x, materialise(at, lambda: nearer(lax.stop_gradient(x), 1))

    def far(state):
        x, new, count = state
        return (jnp.abs(new - x) > near * s) & (count < MOST_ROUNDS)

    # what the last step moved is squared by the next
    near = 0.1 * jnp.sqrt(-level)
    begin = *pair(about), jnp.zeros((), jnp.int32)
    _, x, _ = lax.while_loop(far, lambda now: (*pair(now[1]), now[2] + 1), begin)
    return x


def ends_here(joint: Joint, s: Scalar, mine: Flag) -> Flag:
    """Whether a joint's mode ends at s: as found, or within its tolerance by chance."""
    watched, limit, slips, tol = joint
    now, slope = value_and_slope(watched, s)
    guard = jnp.where(slips, now, limit - jnp.abs(now))
    falls = jnp.where(slips, slope, jnp.where(now > 0, -slope, slope)) < 0
    return mine | ((guard <= tol) & falls)
