"""Every claim of the paper, computed: `python audit/audit.py` writes audit.md.

A row is a claim, one line of Python that computes what decides it, and a rule that
turns its value into a verdict. So the verdicts follow the numbers; where the text alone
decides, the line is `None`. A line of the table
reruns in the folder `audit` after `from audit_scenes import *`;
`python audit/audit.py 12 13` computes these rows only and prints them.
"""

import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import audit_friction  # noqa: F401 - adds its rows
import audit_readings
import audit_scenes
import numpy as np
from audit_rows import CONFIRMED, OPEN, REFUTED, ROWS
from tqdm import tqdm

HEAD = """## Claim by claim

Each row reruns by its line, in the folder `audit` after
`from audit_scenes import *`; all of them by `python audit/audit.py`, which writes
this table. Times in sqrt(m l^2/k), torques in k, angles in rad; the column is the
paper's, two uniform rods.

"""
COLUMNS = ("", "the paper's claim", "computed", "verdict", "line")


class Judged(NamedTuple):
    """A row of the table."""

    number: int
    claim: str
    computed: str
    verdict: str
    line: str


def judged(number, row) -> Judged:
    names: dict[str, Any] = {x: getattr(audit_scenes, x) for x in audit_scenes.__all__}
    value = eval(row.line, names)
    computed, verdict = row.judge(value)
    return Judged(number, row.claim, computed, verdict, row.line)


def cells(row: Judged) -> str:
    *words, line = (str(x).replace("|", "\\|") for x in row)
    return f"| {' | '.join(words)} | `{line}` |"


def main(arguments):
    chosen = [int(x) for x in arguments] or range(1, len(ROWS) + 1)
    begun = time.perf_counter()
    if not arguments:
        audit_readings.begin()
    with np.errstate(all="ignore"):
        rows = [judged(n, ROWS[n - 1]) for n in tqdm(chosen, disable=None)]
    if arguments:
        print(*rows, sep="\n")
        return
    counts = ", ".join(
        f"{sum(row.verdict.startswith(v) for row in rows)} {v}"
        for v in (CONFIRMED, REFUTED, OPEN)
    )
    table = "\n".join(
        [f"| {' | '.join(COLUMNS)} |", "|---" * len(COLUMNS) + "|", *map(cells, rows)]
    )
    target = Path(__file__).with_suffix(".md")
    above, _, _ = target.read_text().partition(HEAD)  # the three systems, by hand
    target.write_text(f"{above}{HEAD}{table}\n\n{len(rows)} claims: {counts}.\n")
    print(f"{target.name}: {len(rows)} rows in {time.perf_counter() - begun:.0f} s")


if __name__ == "__main__":
    main(sys.argv[1:])
