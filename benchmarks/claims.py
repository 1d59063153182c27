"""The project's own claims: a sentence, the line that computes its numbers, a bound.

    python benchmarks/claims.py            # each claim, its numbers, whether it holds
    python benchmarks/claims.py --write    # the numbers into README.md and the pages

A sentence stands word for word on a page, with a field such as `{0:.0f}` for each
number. Its line computes these from what the benchmarks left in `results/`; the
claim's function is the rule that they must keep. So a number cannot drift: the tests
compute each anew, and look for the sentence on its page.
"""

import argparse
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
FIELD = re.compile(r"\{(\d)(?::([^}]*))?\}")
# thousands are parted by a space
NUMBER = r"([-+]?(?:\d{1,3}(?:\s\d{3})+|\d+)(?:\.\d+)?(?:e[-+]?\d+)?)"


class Claim(NamedTuple):
    """A sentence of a page, and where its numbers come from."""

    page: str
    sentence: str
    line: str
    holds: Callable[..., Any]

    def numbers(self) -> tuple:
        """From the results."""
        value = eval(self.line, {"rows": rows, "one": one, "over": over})
        return tuple(value) if isinstance(value, tuple | list) else (value,)

    def shown(self) -> list[str]:
        """The numbers as the sentence writes them, one a field."""
        values = self.numbers()
        fields = FIELD.findall(self.sentence)
        texts = [format(values[int(index)], spec) for index, spec in fields]
        return [re.sub(r"e([-+])0", r"e\1", t.replace(",", " ")) for t in texts]

    def place(self, text: str) -> re.Match:
        """Where the sentence stands in a text, with any numbers; each is a group.

        **Raises:** `ValueError` where it stands nowhere.
        """
        parts = [re.escape(part) for part in FIELD.split(self.sentence)[::3]]
        words = NUMBER.join(parts).replace(r"\ ", r"\s+")
        there = re.search(words, text)
        if not there:
            raise ValueError(f"{self.page} does not say: {self.sentence}")
        return there

    def stands(self) -> bool:
        """Whether its page shows the numbers as they are."""
        there = self.place((ROOT / self.page).read_text())
        return [" ".join(number.split()) for number in there.groups()] == self.shown()

    def put(self, text: str) -> str:
        """The text with the numbers as they are."""
        there = self.place(text)
        for i, number in reversed(list(enumerate(self.shown(), 1))):
            start, end = there.span(i)
            text = text[:start] + number + text[end:]
        return text


def rows(name: str, **like: Any) -> list[dict]:
    """The lines of `results/<name>.jsonl` that have these values."""
    lines = (RESULTS / f"{name}.jsonl").read_text().splitlines()
    records = [json.loads(line) for line in lines if line.strip()]
    return [r for r in records if all(r.get(k) == v for k, v in like.items())]


def one(name: str, **like: Any) -> dict:
    """The last such line."""
    return rows(name, **like)[-1]


def over(other: str, error: float, scene: str) -> float:
    """A contestant's time over the package's fastest method's, at equal error.

    Of `b0_work_precision.py`: medians of time, between tolerances by their logarithms.
    """
    times = {}
    for record in rows("b0_work_precision", scene=scene):
        points = [p for p in record.get("points", ()) if p["median"] > 0]
        if points:
            errors = [np.log(p["median"]) for p in points[::-1]]
            seconds = [np.log(np.median(p["microseconds"])) for p in points[::-1]]
            at = np.interp(np.log(error), errors, seconds, np.nan, np.nan)
            times[record["contestant"]] = float(np.exp(at))
    own = [t for name, t in times.items() if name.startswith("ziegler_jax")]
    return times[other] / np.nanmin(own)


CLAIMS: list[Claim] = []


def claim(page: str, sentence: str, line: str):
    """Add a claim; the function decorated is its rule."""

    def add(holds):
        CLAIMS.append(Claim(page, sentence, line, holds))
        return holds

    return add


# ---- README.md


@claim(
    "README.md",
    "the map of {0:,d} columns over load, static and kinetic friction",
    "one('a6_certainty')['cells']",
)
def _(cells):
    return cells > 100_000


@claim(
    "README.md",
    "Of {0:,d} certified cycles of the map {1:d} were false when another code followed "
    "them on.",
    "[sum(r[key] for r in rows('a5_certificates', sample='map') "
    "if 'steps_by_windows' not in r) for key in ('certified', 'false')]",
)
def _(certified, false):
    return certified > 20_000 and false == 0


@claim(
    "README.md",
    "A motion at the default tolerance is off by {0:.0e} after 100 time units, the "
    "median.",
    "[p['median'] for p in one('b0_work_precision', scene='smooth', "
    "contestant='ziegler_jax Tsit5')['points'] if p['tolerance'] == 1e-6][0]",
)
def _(error):
    return error < 1e-4


@claim(
    "README.md",
    "{0:.1f} % of the map's cells stay undecided, and are called so.",
    "100 * one('a6_certainty')['undecided_share']",
)
def _(share):
    return share < 4


@claim(
    "README.md",
    "| this package, a step of a column | {0:.0f} ns |",
    "one('a0_throughput', scene='smooth')['ns_per_lane_step']",
)
def _(nanoseconds):
    return nanoseconds < 40


@claim(
    "README.md",
    "| plain diffrax, `jit(vmap(diffeqsolve))` | {0:.1f} |",
    "one('a0_throughput', scene='smooth')['ratio_naive']",
)
def _(ratio):
    return ratio > 15


@claim(
    "README.md",
    "| C++ with AVX-512, the C library's functions | {0:.2f} |",
    "1 / one('a0_throughput', scene='smooth')['ratio_cpp']",
)
def _(ratio):
    return ratio > 1.4


@claim(
    "README.md",
    "| the same, its functions in tables | {0:.2f} |",
    "1 / one('a0_throughput', scene='smooth')['ratio_cpp_tables']",
)
def _(ratio):
    return ratio > 0.5


@claim(
    "README.md",
    "| heyoka, at an error of {0:.0e} | {1:.1f} |",
    "1e-6, over('heyoka', 1e-6, 'smooth')",
)
def _(error, ratio):
    return error == 1e-6 and ratio > 1.5


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--write", action="store_true", help="the numbers into pages")
    write = parser.parse_args().write
    broken = 0
    for each in CLAIMS:
        holds = bool(each.holds(*each.numbers()))
        if write:
            page = ROOT / each.page
            page.write_text(each.put(page.read_text()))
        words = FIELD.sub("{}", each.sentence).format(*each.shown())
        state = "holds" if holds else "BROKEN"
        print(f"{state}{'' if each.stands() else ', not as written'}: {words}")
        broken += not holds
    sys.exit(f"{broken} claims are broken" if broken else 0)


if __name__ == "__main__":
    main()
