"""Points with loops that a sweep cuts, and how they are swept here."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

import ziegler_jax as zj
from ziegler_jax.numerics import resumable

X, Y = np.linspace(0.5, 3.0, 23), np.array([1.0, 2.0, 5.0])
TABLE = np.linspace(1.0, 2.0, 1000)


def loop(target, start, factor=1.5):
    """Grow by a factor until the target is passed: how far, and in how many steps."""

    def running(state):
        return state[0] < target

    def advance(state, max_steps):
        least = state[1] + max_steps
        return lax.while_loop(
            lambda s: running(s) & (s[1] < least),
            lambda s: (s[0] * factor, s[1] + 1),
            state,
        )

    first = start, jnp.zeros((), jnp.int32)
    return resumable.resumable(
        first,
        [resumable.Phase(advance)],
        lambda s: (resumable.place_of(running(s)), s[1]),
    )


def one(x, y):
    far, steps = loop(1e3 * y**4, x)
    return {"far": far, "steps": steps}


def three(x, y):
    """Each loop hangs on the one before; the table varies with no lane."""
    table = jnp.sin(TABLE)
    far, steps = loop(1e3 * y**4, x)
    early = x * y + table[3]
    next_, more = loop(far * table[7] * 50, early)
    last, most = loop(jnp.where(more > 9, 1e6, 10.0) * next_, jnp.sqrt(far), 1.01)
    return {"last": last, "all": steps + more + most, "early": early - y}


def unread(x, y):
    loop(1e9, x)
    return {"far": loop(y * 100, x)[0], "constant": 2.0}


def never(x, y):
    """A loop that has ended before it begins, and results that no lane varies."""
    far, steps = loop(-1.0, x)
    return {"far": far, "steps": steps, "table": jnp.asarray(TABLE[2])}


def within(x, y):
    """What a transformation of the point's own holds cannot be cut."""
    grown = jax.vmap(lambda start: loop(100 * y, start)[0])(jnp.stack([x, 2 * x]))
    return {"far": loop(y * 100, grown.sum())[0]}


class Cut(NamedTuple):
    """What grows until it is cut down, and what is remembered of that."""

    far: jax.Array
    steps: jax.Array
    cuts: jax.Array
    seen: jax.Array  # how far it was at the last four
    high: jax.Array  # whether one ever was
    ever: jax.Array  # known before anything is computed


def decided(x, y):
    """Lanes ask now and then, each at its own times, and are decided one by one."""
    table = jnp.cos(jnp.asarray(TABLE, x.dtype))

    def goes(s):
        return (s.far < 50 * y) & (s.steps < 60)

    def advance(s, max_steps):
        most = s.steps + max_steps

        def grown(s):
            return s._replace(far=s.far * (1 + 0.1 * x), steps=s.steps + 1)

        return lax.while_loop(lambda s: goes(s) & (s.steps < most), grown, s)

    def asks(s):
        return s.far >= 50 * y

    def decide(s):
        seen = jnp.concatenate([s.far[None], s.seen[:-1]])
        far = s.far / (3 + table[s.cuts]) + x
        high = s.high | (s.far > 55 * y)
        return Cut(far, s.steps, s.cuts + 1, seen, high, jnp.asarray(True))

    none, no = jnp.zeros((), jnp.int32), jnp.asarray(False)
    first = Cut(x, none, none, jnp.zeros(4, x.dtype), no, no)
    decisions = [resumable.Decision(asks, decide)]
    phase = resumable.phase_of(resumable.Stop(advance, decisions, 5))
    last = resumable.resumable(
        first, [phase], lambda s: (resumable.place_of(goes(s) | asks(s)), s.steps), 16
    )
    seen = {f"seen_{i}": far for i, far in enumerate(last.seen)}
    flags = {"high": last.high, "ever": last.ever}
    return {"cuts": last.cuts, "far": last.far, **flags, **seen}


SCENES = {one: 1, three: 3, unread: 1, never: 1, within: 1, decided: 1}


def numbers(ds):
    return {name: ds[name].values for name in ds.data_vars}


EIGHT = zj.Lanes(batch_size=8)


def sweep(scene, **options):
    options = {"x": X, "y": Y, "lanes": EIGHT, "progress": False, **options}
    return zj.sweep(scene, **options)
