"""Puts each fault of `table.toml` into a copy of the checkout, and runs tests on it.

    python tests/mutants/replay.py first           # column `first`: the first tier
    python tests/mutants/replay.py all --only 3 17 # column `all`: slow tests too
    python tests/mutants/replay.py old --tests ../old/tests  # another suite's

The tests of the fault's room run until one fails. Its name, or "passes", comes into the
fault's row of `results.md`, under the column. A test that fails without a fault would
count as one that sees it: run the suite before.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

HERE = Path(__file__).parent
CHECKOUT = HERE.parent.parent
TABLE, RESULTS = HERE / "table.toml", HERE / "results.md"
COLUMNS = ("first", "all", "old")
# a room's own tests, then those of the rooms that stand on it
TESTS = {
    "model": ["model", "motion", "linear"],
    "numerics": ["numerics", "motion"],
    "solvers": ["solvers", "motion"],
    "motion": ["motion", "analysis", "curves"],
    "steady": ["steady", "motion"],
    "analysis": ["analysis"],
    "curves": ["curves"],
    "sweep": ["sweep"],
    "units": ["test_si_units.py"],
}
LIMIT = 1200  # seconds, for a fault by which a test never ends; a room takes half of it


def faults():
    """Those of the table, by number."""
    rows = tomllib.loads(TABLE.read_text())["fault"]
    return {row["number"]: row for row in rows}


def with_fault(fault, root):
    """Put a fault into a checkout.

    **Raises:** `ValueError` where its place is gone: then it needs one like it.
    """
    path = root / fault["file"]
    text = path.read_text()
    if text.count(fault["old"]) != 1:
        raise ValueError(f"Fault {fault['number']} has lost its place in {path}.")
    path.write_text(text.replace(fault["old"], fault["new"]))


def verdict(fault, column, tests):
    """The first test that fails, or "passes"."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "checkout"
        ignore = shutil.ignore_patterns(".git", ".venv", "build", "__pycache__")
        shutil.copytree(CHECKOUT, root, ignore=ignore)
        if tests != CHECKOUT / "tests":
            shutil.rmtree(root / "tests")
            shutil.copytree(tests, root / "tests", ignore=ignore)
        with_fault(fault, root)
        rooms = TESTS[fault["file"].split("/")[1]]
        paths = [f"tests/{room}" for room in rooms]
        marks = [] if column == "first" else ["-m", ""]
        call = [sys.executable, "-m", "pytest", "-x", "-q", "-n0", *marks, *paths]
        environment = {**os.environ, "PYTHONPATH": str(root)}  # of what tests start
        try:
            run = subprocess.run(
                call, cwd=root, env=environment, capture_output=True, text=True,
                timeout=LIMIT,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return "does not end"
    if run.returncode == 0:
        return "passes"
    failed = re.search(r"^(?:FAILED|ERROR) tests/(\S+::\S+)", run.stdout, re.MULTILINE)
    if run.returncode == 1 and failed:
        return failed[1]
    if run.returncode == 3:  # an interrupt that a test of kills made came through
        return "stops the test runner"
    return f"no verdict: pytest ended with {run.returncode}"


def recorded():
    """The rows of `results.md`, by number and column."""
    cells = {}
    if RESULTS.exists():
        for line in RESULTS.read_text().splitlines():
            row = [cell.strip() for cell in line.strip("|").split("|")]
            if row[0].isdigit():
                cells[int(row[0])] = dict(zip(COLUMNS, row[2:], strict=True))
    return cells


def written(cells):
    """All rows again."""
    lines = ["| | fault | " + " | ".join(COLUMNS) + " |", "|---" * 5 + "|"]
    for number, fault in faults().items():
        row = [cells.get(number, {}).get(column, "") for column in COLUMNS]
        what = f"{fault['file'].removeprefix('ziegler_jax/')}: {fault['what']}"
        lines.append(f"| {number} | {what} | " + " | ".join(row) + " |")
    RESULTS.write_text("\n".join(lines) + "\n")


def main():
    """One column."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("column", choices=COLUMNS)
    parser.add_argument("--tests", type=Path, default=CHECKOUT / "tests")
    parser.add_argument("--only", type=int, nargs="*")
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    chosen = [f for n, f in faults().items() if not args.only or n in args.only]
    cells, tests = recorded(), args.tests.resolve()
    with ThreadPoolExecutor(args.jobs) as pool:
        found = pool.map(lambda fault: verdict(fault, args.column, tests), chosen)
        for fault, seen in zip(chosen, found, strict=True):
            print(fault["number"], fault["file"], seen, flush=True)
            cells.setdefault(fault["number"], {})[args.column] = seen
            written(cells)


if __name__ == "__main__":
    main()
