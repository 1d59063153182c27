"""How the benchmarks measure: interleaved repeats, paired ratios, medians."""

import platform
import time
from importlib import metadata

import jax
import numpy as np


def interleaved(contestants, repeats):
    """Wall seconds, one list a contestant: every round runs each of them once.

    `contestants` maps names to functions without arguments that return when their work
    is done. Each runs once before, to compile and warm up.
    """
    for run in contestants.values():
        run()
    seconds = {name: [] for name in contestants}
    for _ in range(repeats):
        for name, run in contestants.items():
            start = time.perf_counter()
            run()
            seconds[name].append(time.perf_counter() - start)
    return seconds


def paired(numerator, denominator):
    """The median of the rounds' ratios, and their range."""
    ratios = np.array(numerator) / np.array(denominator)
    return float(np.median(ratios)), [float(ratios.min()), float(ratios.max())]


def machine():
    """What the figures belong to."""
    with open("/proc/cpuinfo") as info:
        names = [line.split(":")[1].strip() for line in info if "model name" in line]
    return {
        "cpu": names[0] if names else platform.processor(),
        "cores": len(names),
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in ("jax", "jaxlib", "diffrax")},
    }


def rounded(x, digits=3):
    """Numbers of a result as short as they deserve."""
    if isinstance(x, dict):
        return {key: rounded(value, digits) for key, value in x.items()}
    if isinstance(x, list):
        return [rounded(value, digits) for value in x]
    return float(f"{x:.{digits}g}") if isinstance(x, float) else x


def ready(tree):
    """Wait for JAX."""
    return jax.block_until_ready(tree)
