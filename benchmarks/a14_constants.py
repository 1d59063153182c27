"""Which endings hang on the numbers of a certificate?

Each variant changes one constant of `ziegler_jax.steady`, or several together, in four
samples: random cells of the main job's map; loads beside its thresholds; columns with
viscous damping, many of them on tori; set-valued friction, certified. Endings that
change, the share of steps, and how the motions that changed end at 1e-9, to t = 40 000.
Prints one JSON line a variant and sample; `--table` makes a table of such lines.
All variants take a quarter of an hour.

    python benchmarks/a14_constants.py --table < results/a14_constants.jsonl
    python benchmarks/a14_constants.py [--cells 2000] [--seed 0] [--judge]
        ["returns.OWN=1"] ["shots.COARSE=0.05 shots.FINE=0.005"] ...
"""

import argparse
import importlib
import json
import math
import sys

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from a5_certificates import cells_beside_thresholds, cells_of_the_map
from a13_certified_truth import dry_scene, viscous_scene
from measure import commit, rounded

import ziegler_jax as zj
from ziegler_jax.__main__ import point as main_point

# Each about twice as large, or with less in it
VARIANTS = (
    "returns.RETURNS=(1,2,3)",  # of six that are kept
    "returns.LEVELS=(6e-4,)",
    "returns.TIMES=(130.0,)",
    "returns.LATER=1.5",
    "returns.SMALL=0.02",
    "returns.LARGE=0.06",
    "returns.ALIKE=6.0",
    "returns.CALM=40.0",
    "returns.OWN=6",
    "returns.LOST=0.6",
    "returns.ARRIVED=0.05 certified.ARRIVED=0.05",
    "returns.NOISE=4e-4",
    "returns.LEAK=1.1",
    "certified.STEPS_AT_ONCE=32",
    "certified.MARGIN=2e-3",
    "certified.AT_REST=4.0",
    "shots.COARSE=0.2",
    "shots.FINE=0.02",
    "shots.TOO_FAR=0.6",
    "shots.CLOSE=6e-3",
    "shots.VERIFIED=2e-5",
    "shots.MOST_SHOTS=10",
    "trend.GROWTH=1.02",
    "trend.FALL=0.98",
    "trend.GROWN=6",
    "trend.LASTED=18",
    "trend.RISEN=4",
    "trend.NEARLY=0.02",
    "rest.NOISE=200.0",
    "rest.LEVELS=(1.0,0.1,0.001)",
    "rest.MEANS=16",
    "rest.DECADES=2e-4",
    "contraction.SQUARINGS=12",
    "contraction.DOUBLINGS=8",
    "contraction.SLOWEST=0.999",
)


def changed(variant):
    """Set the constants; how they were, to be set again."""
    before = []
    for pair in variant.split():
        place, value = pair.split("=")
        module, name = place.split(".")
        room = importlib.import_module(f"ziegler_jax.steady.{module}")
        before.append((room, name, getattr(room, name)))
        setattr(room, name, eval(value, {"math": math}))
    return before


def of_the_map(cells):
    table = jnp.asarray(cells)

    def point(place, **options):
        return main_point(*table[place.astype(int)], **options)

    return point


def of_a_family(scene, numbers):
    table = jnp.asarray(numbers)

    def point(place, **options):
        windows = options.pop("windows", zj.Windows(escape=60.0))
        column, start = scene(table[place.astype(int)])
        return zj.settle(column, start, windows=windows, certify=True, **options)

    return point


def samples(count, source):
    """A point for each, and how many places it has."""
    few = count // 2
    tables = source.uniform(size=(2, few, 6))
    return {
        "map": (of_the_map(cells_of_the_map(count, source)), count),
        "beside thresholds": (of_the_map(cells_beside_thresholds(few, source)), few),
        "viscous": (of_a_family(viscous_scene, tables[0]), few),
        "dry": (of_a_family(dry_scene, tables[1]), few),
    }


def ended(point, count):
    ds = zj.sweep(lambda place: point(place), place=np.arange(count), progress=False)
    steps = ds.steps.values + 3 * ds.shot_steps.values
    return ds.outcome.values, steps.sum(), ds.joint_amplitude.values[:, 1]


def truth(point, places):
    """The endings at 1e-9, the constants as they stand in the code."""
    windows = zj.Windows(0.0, 40.0, 1000, escape=60.0)

    def fine(place):
        dry = point.__closure__ and "scene" in point.__code__.co_freevars
        solver = None if dry else dfx.Dopri8()
        method = zj.Method(solver, rtol=1e-9, max_steps=20_000_000)
        return point(place, windows=windows, method=method)

    return zj.sweep(fine, place=places, progress=False).outcome.values


def table(lines):
    """A row a variant: endings that change of so many cells, and the share of steps."""
    rows, sizes = {}, {}
    for line in map(json.loads, lines):
        sizes[line["sample"]] = line["cells"]
        cell = f"{line['endings']}, {line['steps']:.3f}"
        rows.setdefault(line["variant"], {})[line["sample"]] = cell
    head = ["changed to", *(f"{name} ({size})" for name, size in sizes.items())]
    yield f"| {' | '.join(head)} |"
    yield "|---" * len(head) + "|"
    for variant, cells in rows.items():
        row = [f"`{variant}`", *(cells.get(name, "") for name in sizes)]
        yield f"| {' | '.join(row)} |"


def named(code):
    return zj.CODE(int(code)).name


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("variants", nargs="*", default=VARIANTS)
    parser.add_argument("--cells", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--judge", action="store_true", help="those that changed")
    parser.add_argument("--table", action="store_true", help="of lines that come in")
    options = parser.parse_args()
    if options.table:
        print("\n".join(table(sys.stdin)))
        return
    zj.configure_cpu()
    jax.config.update("jax_enable_x64", True)  # for tables of cells
    source = np.random.default_rng(options.seed)
    for sample, (point, count) in samples(options.cells, source).items():
        outcome, steps, amplitude = ended(point, count)
        for variant in options.variants:
            before = changed(variant)
            after, more, other = ended(point, count)
            for room, name, value in before:
                setattr(room, name, value)
            unlike = np.flatnonzero(after != outcome)
            both = (after == outcome) & (after == zj.CODE.cycle)
            off = np.abs(other[both] / amplitude[both] - 1)
            line = {
                "benchmark": "a14_constants",
                "commit": commit(),
                "sample": sample,
                "cells": count,
                "variant": variant,
                "endings": unlike.size,
                "steps": more / steps,
                "amplitudes_off_by_1_percent": int((off > 0.01).sum()),
            }
            if options.judge and unlike.size:
                true = truth(point, unlike)
                line["were, are, at 1e-9"] = [
                    f"{named(outcome[i])}, {named(after[i])}, {named(t)}"
                    for i, t in zip(unlike, true, strict=True)
                ]
            print(json.dumps(rounded(line)), flush=True)


if __name__ == "__main__":
    main()
