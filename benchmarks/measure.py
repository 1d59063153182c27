"""How the benchmarks measure: interleaved repeats, paired ratios, medians."""

import argparse
import json
import os
import platform
import subprocess
import time
from importlib import metadata
from pathlib import Path

import jax
import numpy as np

import ziegler_jax as zj

# Okabe and Ito's colours, which the colour-blind can tell apart
LINES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
# elsewhere for runs that are no results, as those of the tests
RESULTS = Path(os.environ.get("ZIEGLER_RESULTS", Path(__file__).with_name("results")))


OF_THE_PROCESSOR = os.environ.get("ZIEGLER_CLOCK") == "cpu"


def clock():
    """Seconds: wall time or, with ZIEGLER_CLOCK=cpu, processor time over the cores.

    The second is for a machine that is busy with other work: it equals wall time where
    all cores work, and charges waiting threads nothing.
    """
    if OF_THE_PROCESSOR:
        return time.process_time() / (os.cpu_count() or 1)
    return time.perf_counter()


def interleaved(contestants, repeats):
    """Seconds by `clock`, one list a contestant: every round runs each of them once.

    `contestants` maps names to functions without arguments that return when their work
    is done. Each runs once before, to compile and warm up.
    """
    for run in contestants.values():
        run()
    seconds = {name: [] for name in contestants}
    for _ in range(repeats):
        for name, run in contestants.items():
            start = clock()
            run()
            seconds[name].append(clock() - start)
    return seconds


def paired(numerator, denominator):
    """The median of the rounds' ratios, and their range."""
    ratios = np.array(numerator) / np.array(denominator)
    return float(np.median(ratios)), [float(ratios.min()), float(ratios.max())]


def commit():
    """The commit that last changed the package that is measured."""
    folder = Path(zj.__file__).parent

    def git(*arguments):
        command = ["git", "-C", str(folder), *arguments]
        done = subprocess.run(command, capture_output=True, text=True)
        return done.stdout.strip() if done.returncode == 0 else ""

    changed = " and changes" if git("status", "--porcelain", ".") else ""
    return (git("log", "-1", "--format=%H", ".") or "unknown") + changed


def machine():
    """What the figures belong to."""
    with open("/proc/cpuinfo") as info:
        names = [line.split(":")[1].strip() for line in info if "model name" in line]
    return {
        "commit": commit(),
        "cpu": names[0] if names else platform.processor(),
        "cores": len(names),
        "clock": os.environ.get("ZIEGLER_CLOCK", "wall"),
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in ("jax", "jaxlib", "diffrax")},
    }


def rounded(x, digits=3):
    """Numbers of a result as short as they deserve; None where there is none."""
    if isinstance(x, dict):
        return {key: rounded(value, digits) for key, value in x.items()}
    if isinstance(x, list | tuple):
        return [rounded(value, digits) for value in x]
    if isinstance(x, float):
        return float(f"{x:.{digits}g}") if np.isfinite(x) else None
    return x


def save(name, result):
    """Write `results/<name>.json`; returns the path for the picture beside it."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.json"
    path.write_text(json.dumps(rounded(result), indent=1) + "\n")
    return path.with_suffix(".png")


def report(benchmark, digits=3, about=machine, **numbers):
    """Print one JSON line, and what the figures belong to; returns its dict."""
    line = rounded({"benchmark": benchmark, **numbers, **about()}, digits)
    print(json.dumps(line), flush=True)
    return line


def arguments(doc, which=(), **defaults):
    """The options of a script, by name and default; `--help` shows how it begins.

    A tuple takes several values, each of the kind of its first one. `which` are the
    parts of a script that are named without an option, all of them if none is.
    """
    parser = argparse.ArgumentParser(description=doc.split("\n")[0])
    if which:
        known = ", ".join(which)
        parser.add_argument("which", nargs="*", default=which, help=f"of: {known}")
    for name, value in defaults.items():
        flag = f"--{name.replace('_', '-')}"
        if value is False:
            parser.add_argument(flag, action="store_true")
            continue
        several = isinstance(value, tuple)
        kind = type(value[0] if several else value)
        look = {"nargs": "+"} if several else {}
        parser.add_argument(flag, type=kind, default=value, help=f"{value}", **look)
    return parser.parse_args()


def ready(tree):
    """Wait for JAX."""
    return jax.block_until_ready(tree)
