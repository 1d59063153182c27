"""How `a5`, `a13` and `a15` judge long motions: each is followed on, longer and finer.

A certified cycle is continued from its last state by another code, for 400 time units
and 20 periods at least, 1500 where its multiplier is above 0.95. The certificate is
false where a rod's or a joint's amplitude over the last two periods is off by more than
1 % of the largest. A threshold is followed at both ends of its last interval.
"""

import jax.numpy as jnp
import numpy as np

import ziegler_jax as zj

SPAN, PERIODS, SLOW, SLOW_SPAN, OFF = 400.0, 20, 0.95, 1500.0, 0.01
RESTS = (zj.CODE.stuck, zj.CODE.rest)


def swept(table, function):
    """A function of a row of numbers, at each row of the table."""
    numbers = jnp.asarray(table)
    return zj.sweep(
        lambda place: function(numbers[place.astype(int)]),
        place=np.arange(len(table)),
        progress=False,
    )


def with_state(settled):
    """All numbers of a motion, and its last state."""
    state = zj.Variable(jnp.stack(settled.final.y), "state", dims=("i",))
    return {**settled.variables(), "state": state}


def outcomes(codes):
    """How many motions ended in each way, by name."""
    codes = np.asarray(codes)
    return {c.name: int((codes == c).sum()) for c in zj.CODE if (codes == c).any()}


def certificates(cells, ds, follow):
    """How many certificates are false, and how far amplitudes are off.

    `follow` takes the places of the certified cells, their last states, spans and the
    lengths of what is judged, and gives the amplitudes of all rods, then of all joints
    but the first, which is the first rod's.
    """
    closed = np.flatnonzero(ds.outcome.values == zj.CODE.cycle)
    some = ds.isel(place=closed)
    period = some.period.values
    slow = some.largest_multiplier.values > SLOW
    spans = np.maximum(np.where(slow, SLOW_SPAN, SPAN), PERIODS * period)
    true = follow(closed, some.state.values, spans, 2 * period)
    joints = some.joint_amplitude.values[:, 1:]
    said = np.concatenate([some.rod_amplitude.values, joints], axis=1)
    off = np.abs(said - true).max(axis=1) / true.max(axis=1)
    false = closed[~(off <= OFF)]
    undecided = ds.undecided.values[ds.outcome.values == zj.CODE.unsettled]
    return {
        "points": len(cells),
        "outcomes": outcomes(ds.outcome),
        "undecided": outcomes(undecided),
        "certified": closed.size,
        "false": false.size,
        "false_cells": cells[false].tolist(),
        "amplitude_off_median": float(np.median(off)) if off.size else None,
        "amplitude_off_largest": float(off.max(initial=0.0)),
        "steps": float(ds.steps.mean()),
        "steps_with_tangents": float((ds.steps + 3 * ds.shot_steps).mean()),
    }


def last_intervals(ds, outcome_at):
    """Whether the last intervals of searches part rest from motion.

    `outcome_at(known, values)` gives the outcomes of motions at the places `known` and
    values just within the interval.
    """
    known = np.flatnonzero(np.isin(ds.outcome, [zj.CODE.found, zj.CODE.repeated]))
    threshold, width, rises = (
        ds[name].values[known] for name in ("threshold", "width", "rises")
    )
    result = {"searches": outcomes(ds.outcome), "intervals": known.size}
    for name, side, rests in (("resting", -0.4999, True), ("moving", 0.4999, False)):
        ends = outcome_at(known, threshold + side * rises * width)
        right = np.isin(ends, RESTS) == rests
        result[f"{name}_ends"] = outcomes(ends)
        result[f"{name}_ends_right"] = int(right.sum())
        result[f"{name}_ends_wrong"] = known[~right].tolist()
    return result
