"""What a refactoring must not change: computed, written, and compared to the bit.

    python benchmarks/guard.py --write FILE
    python benchmarks/guard.py --against FILE [--against FILE ...]

The first computes all lines of `guard_motions.py` and `guard_questions.py`, and the
census of instructions of each kind of lane, and writes them with commit, versions and
processor. The second computes them anew and prints each beside the file's: name,
before, after, difference, verdict. A file of another jax is passed over, so that the
files of several can be given at once.

Verdicts: `bit-equal`; `equal to rounding`, where the difference (relative, of an array
to its largest number) is within the line's tolerance, 1e-12 unless the line says
otherwise; `fewer` and `within 1 %` for counts of instructions; `new`; `not compared`
where a census cannot be made; else `DIFFERS`, and the exit status is 1.

`--only` computes and compares some sections, whose names the run prints; written into
a file that exists, it leaves all others as they are. Some five minutes of two quiet
cores; the table is of the package that Python imports. `before_after.py` compares
seconds.
"""

import argparse
import inspect
import json
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path

import numpy as np

SKIP = "skipped"


def begun():
    """The package, imported as the main job does, in 64 bits."""
    os.environ["JAX_ENABLE_COMPILATION_CACHE"] = "false"
    import ziegler_jax as zj

    zj.configure_cpu()
    import jax

    jax.config.update("jax_enable_x64", True)
    return zj


def dump_to(folder):
    """Let XLA write its object files; before JAX's backend starts.

    Without places in the source: where a function stands in its file changes the order
    of XLA's instructions, and the count by up to 4 % (measured).
    """
    flags = os.environ.get("XLA_FLAGS", "")
    os.environ["XLA_FLAGS"] = f"{flags} --xla_dump_to={folder}".strip()
    import jax

    jax.config.update("jax_traceback_in_locations_limit", 0)
    jax.config.update("jax_include_full_tracebacks_in_locations", False)
    jax.config.update("jax_hlo_source_file_canonicalization_regex", ".*")


def sections():
    """Functions of lines by name; after `begun`."""
    import guard_motions
    import guard_questions

    return {**guard_questions.SECTIONS, **guard_motions.SECTIONS}


def section(name):
    """The lines of one section, in this process."""
    import census

    why = census.obstacle()
    with tempfile.TemporaryDirectory() as folder:
        begun()
        compute = sections()[name]
        if not inspect.signature(compute).parameters:  # no program of it is counted
            return compute()
        if why is None:
            dump_to(folder)
        watch = census.Watch(None if why else folder)
        lines = compute(watch)
    for lane, found in watch.found.items():
        for what in ("all", "arithmetic"):
            line = {SKIP: found}
            if not isinstance(found, str):
                count = found.total() if what == "all" else found[what]
                line = {"instructions": round(count)}
            lines[f"census, {lane}: {what}"] = line
    return lines


def child(*arguments):
    """What this script prints as JSON in a process of its own."""
    command = [sys.executable, __file__, *arguments]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        sys.exit(f"failed: {' '.join(arguments)}")
    return json.loads(done.stdout.splitlines()[-1])


def table(only):
    """All lines by name, a process a section; of those whose names begin so."""
    names = [n for n in child("--section", "names") if n.startswith(only)]

    def run(name):
        started = time.perf_counter()
        lines = child("--section", name)
        seconds = time.perf_counter() - started
        print(f"{name}: {len(lines)} lines, {seconds:.0f} s", file=sys.stderr)
        return lines

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        parts = list(pool.map(run, names))
    lines = {name: line for part in parts for name, line in part.items()}
    assert len(lines) == sum(map(len, parts)), "two lines of one name"
    return lines


def provenance():
    """The commit that last changed the package, versions, processor."""
    import census
    from measure import machine

    about = machine()
    names = ("commit", "python", "jax", "jaxlib", "diffrax", "cores")
    return {
        **{name: about[name] for name in names},
        "numpy": metadata.version("numpy"),
        "processor": about["cpu"] or "unknown",
        "vector": census.width(),
        "obstacle": census.obstacle(),
    }


# ---- comparing


def floats(texts):
    return np.array([float.fromhex(text) for text in texts])


def shown(line):
    """A line's value, short."""
    if "hex" in line:
        return f"{float.fromhex(line['hex']):.10g}"
    for key in ("digest", "whole", "instructions"):
        if key in line:
            return str(line[key])
    return "-"


def apart(before, after):
    """The largest difference, relative to the largest number; NaN agrees with NaN."""
    if before.shape != after.shape or (np.isnan(before) != np.isnan(after)).any():
        return np.inf
    finite = np.isfinite(before) & np.isfinite(after)
    if (before[~finite] != after[~finite])[~np.isnan(before[~finite])].any():
        return np.inf
    before, after = before[finite], after[finite]
    scale = max(np.abs(before).max(initial=0), np.abs(after).max(initial=0))
    return float(np.abs(before - after).max(initial=0) / (scale or 1.0))


def judged(before, after):
    """Difference and verdict of one line."""
    if SKIP in before or SKIP in after:
        return np.nan, "not compared"
    if before.keys() != after.keys():
        return np.inf, "DIFFERS"
    if "whole" in before:
        same = before["whole"] == after["whole"]
        return float(after["whole"] - before["whole"]), "bit-equal" if same else (
            "DIFFERS"
        )
    if "instructions" in before:
        old, new = before["instructions"], after["instructions"]
        difference = new / old - 1 if old else np.inf
        if old == new:
            return 0.0, "bit-equal"
        fine = "within 1 %" if new <= 1.01 * old else "DIFFERS"
        return difference, "fewer" if new < old else fine
    if "hex" in before:
        bits = before["hex"] == after["hex"]
        difference = apart(floats([before["hex"]]), floats([after["hex"]]))
    else:
        bits = all(before[k] == after[k] for k in ("digest", "shape"))
        kept = [(floats(before[k]), floats(after[k])) for k in ("sample", "quantiles")]
        difference = max(apart(*pair) for pair in kept)
        if before["shape"] != after["shape"]:
            difference = np.inf
    tolerance = after["tolerance"]
    fine = tolerance > 0 and difference <= tolerance  # 0: bits or nothing
    verdict = "bit-equal" if bits else "equal to rounding" if fine else "DIFFERS"
    return difference, verdict


ORDER = ("bit-equal", "fewer", "within 1 %", "new", "equal to rounding", "not compared")


def compared(before, after):
    """Print all lines, the equal ones first; whether none differs."""
    rows = []
    for name in {**before, **after}:
        old, new = before.get(name, {}), after.get(name, {})
        if not old:
            difference, verdict = np.nan, "new"
        elif not new:
            difference, verdict = np.nan, "DIFFERS"
        else:
            difference, verdict = judged(old, new)
        rows.append((name, shown(old), shown(new), f"{difference:.1e}", verdict))
    rank = {verdict: i for i, verdict in enumerate(ORDER)}
    rows.sort(key=lambda row: rank.get(row[-1], len(ORDER)))
    for row in rows:
        print("{:52s} {:>18s} {:>18s} {:>8s}  {}".format(*row))
    found = [row[-1] for row in rows]
    tally = [f"{found.count(v)} {v}" for v in (*ORDER, "DIFFERS") if v in found]
    print(", ".join(tally))
    return "DIFFERS" not in found


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--write", type=Path, metavar="FILE")
    parser.add_argument("--against", type=Path, metavar="FILE", action="append")
    parser.add_argument(
        "--only", nargs="+", metavar="SECTION", help="beginnings of names of sections"
    )
    parser.add_argument("--section", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.section:
        print(json.dumps(part_of(options.section)))
        return 0
    if not (options.write or options.against):
        parser.error("give --write FILE or --against FILE")
    here = provenance()
    stored = {path: json.loads(path.read_text()) for path in options.against or []}
    for path in [p for p, s in stored.items() if s["about"]["jax"] != here["jax"]]:
        print(f"{path} is of jax {stored.pop(path)['about']['jax']}: passed over.")
    if options.against and not stored:
        print(f"No file is of jax {here['jax']}: nothing was compared.")
        return 2
    if here["obstacle"]:
        print(here["obstacle"])
    held = {}
    if options.write and options.write.exists():
        held = json.loads(options.write.read_text())
    if options.write and options.only and held.get("about") != here:
        parser.error("--write with --only takes a file of this package and processor")
    only = tuple(options.only or [""])
    found = table(only)
    if options.write:
        lines = held["lines"] if options.only else {}
        new = {"about": here, "lines": {**lines, **found}}
        options.write.write_text(json.dumps(new, indent=0) + "\n")
    good = True
    for path, old in stored.items():
        about = old["about"]
        for what in ("python", "jaxlib", "diffrax", "numpy", "processor", "vector"):
            if about[what] != here[what]:
                print(f"{path}: {what} was {about[what]}, is {here[what]}.")
        print(f"{path}, commit {about['commit']}, against {here['commit']}:")
        lines = old["lines"]
        if options.only:
            lines = {name: line for name, line in lines.items() if name in found}
        good &= compared(lines, found)
    return 0 if good else 1


def part_of(name):
    """What a child computes."""
    if name == "names":
        begun()
        return list(sections())
    return section(name)


if __name__ == "__main__":
    sys.exit(main())
