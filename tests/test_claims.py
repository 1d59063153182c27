"""The project's own numbers are those of its benchmarks, and stand on its pages."""

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "benchmarks"))
from claims import CLAIMS, Claim  # noqa: E402

CODE = re.compile(
    r"```.*?```|\$\$.*?\$\$|\$[^$]*\$|`[^`]*`|\]\([^)]*\)|<!--.*?-->", re.S
)
TOKEN = re.compile(r"[\w./^-]*\d[\w./^-]*")
# What a page says that is neither measured nor computed: names, versions, the model,
# and rules that the code follows.
GIVEN = {
    "README.md": [
        r"Python 3\.11", r"joint\s+[12]", r"m l\^2", r"Apache-2\.0", r"q = 2\.54",
        r"the 3240 motions",
        r"8192 columns to t = 100 on two cores", r"^## .*$",
    ],
    "docs/index.md": [r"Python 3\.11", r"55 claims of a paper"],
    "docs/theory/certificates.md": [
        r"^[123]\. ", r"to 1e-5,", r"below 0\.999", r"within 2\.5 % of the orbit",
        r"is 2e-4 of the orbit", r"for 20 time units", r"at 95 %",
        r"40\s+time units instead", r"must agree to 2e-4",
    ],
    "docs/theory/equations.md": [
        r"\(?(joint|rod) [12]\)?", r"^- .*$", r"\| the same, equal rods .*$",
        r"\| the same, Ziegler's .*$", r"as 1/n", r"for 2, 4, 8, 16 of",
        r"integration at 1e-17",
    ],
    "docs/theory/friction.md": [
        r"(joint|rod) [12]", r"at q = 2\.6", r"At q = 2\.6", r"q = 1\.8",
        r"from a kick of 1e-6", r"\| 0\.01 \| 0\.03 \| 0\.1 \| 0\.26 \|",
        r"0\.3 \| 0\.1 \| 0\.03 \| 0\.01 \| 0\.003",
    ],
    "docs/theory/linear.md": [r"masses 2 and 1", r"2\.0858 and 4\.9142"],
    "docs/theory/trust.md": [
        r"steps of 1e-10", r"heyoka at 1e-16", r"steps at 1e-6 lead",
        r"settled after t = 200",
        r"above about 0\.4",
    ],
    "docs/reference/command_line.md": [r"= 5\."],
    "benchmarks/README.md": [
        r"commit, c1965e6, with jax 0\.10\.2", r"of 9a4f636",
        r"phi' = \(0, 0\.2\), 4096",
        r"512 where stiff", r"q_cr = 2\.5417", r"^\|.*\d\.\.\d.*$", r"of a5be1ba",
        r"from 64 to a", r"of 64 lanes", r"DOP853", r"1000 times a shift",
        r"at\s+1e-16", r"95th percentile", r"at 1e-13", r"of its start \(1e-9\)",
        r"numba \(.*Dopri5\)", r"on 8 lanes", r"\(512 lanes in", r"AVX-512",
        r"for  at 1e-6",
        r"5, 4 and 2 times as long", r"3e-4, 1e-5 and 1e-10", r"is of order 9",
        r"err by 1e-4", r"That\s+90 %", r"from 1e-3 down",
        r"errors 3e-4, 1e-5, 1e-7 and 1e-10", r"million(th)?",
    ],
    "examples/studies/README.md": [
        r"^Joint friction log-normal \(20 %(.|\n)*?64 draws each\.", r"^151 samples",
        r"at 40 dB,", r"joint(\s+)[12]", r"its direction \(1, 1, -1, 0, 0\)",
    ],
    "docs/learn/chains.py": [r"1/n", r"springs of 1,"],
    "docs/learn/design.py": [r"rod 2", r"of 0 is a dead load", r"; 1 is the follower"],
    "docs/learn/device.py": [
        r"0\.1 kg and 0\.2 m", r"0\.[58] N m/rad", r"4 mm radius", r"of 0\.15",
        r"(rod|joint) [12]", r"Joint 1",
    ],
    "docs/learn/export.md": [r"version [34]"],
    "docs/learn/long_sweeps.py": [r"^256 at least, 16 000 at", r"One batch in 256"],
    "docs/learn/onset.py": [r"of rod 2", r"are 1 at the fold"],
    "docs/learn/optimise.py": [
        r"joint 1", r"mass of 2 and a damping of 0\.1", r"Rod 1", r"20 % to 80 %",
        r"rod 2",
    ],
    "docs/learn/own_column.py": [r"rod 1", r"joint 2", r"at q = 1\.8", r"64 bits"],
    "docs/learn/scope.md": [r"of 1/n", r"these are 3/2 and 1/2", r"from 2 n .* to 2 n"],
    "docs/learn/stick_slip.py": [r"\(0\s+sticks, 1 and -1 slip"],
    "docs/learn/tasks.md": [r"32 or 64 bits\? \| 64"],
    "docs/reference/column.md": [r"has 2 to 16 rods"],
    "docs/reference/index.md": [r"rod 1", r"joint 2", r"64 bits"],
    "docs/reference/results.md": [r"\(0\) at points"],
    "docs/reference/stores.md": [r"Zarr [23]", r"crc32c", r"version 0\.2 or 0\.1"],
}  # fmt: skip
# Numbers of other codes and closed forms, and the test that compares with them.
COMPARED = {
    "docs/theory/equations.md": {
        "tests/linear/test_linear_chains.py": "10.17 14.99 17.51 18.78 20.05",
    },
    "docs/theory/friction.md": {
        "tests/model/test_first_principles.py": "0.27 0.91 0.03 0.93",
        "tests/curves/test_bifurcation_curves.py": "1.28802 1.32807 1.57105 1.86140 "
        "1.61206",
        "tests/motion/test_long_runs.py": "0.64249 0.63443 0.63214 0.63133 0.63112 "
        "0.6631 0.6664 0.6728 0.6760 0.6782",
        "tests/motion/test_stick_and_slip.py": "0.63105 0.6798",
        "tests/analysis/test_cycles.py": "14/11",
        "tests/linear/test_spectra.py": "2.5417",
    },
    "docs/theory/linear.md": {
        "tests/linear/test_spectra.py": "2.5417",
    },
}


def named(claim):
    return " ".join(claim.sentence.split()[:6])


@pytest.mark.parametrize("claim", CLAIMS, ids=named)
def test_a_claim_holds_and_its_page_shows_its_numbers(claim):
    assert claim.holds(*claim.numbers())
    assert claim.stands(), f"write {claim.shown()}: `benchmarks/claims.py --write`"


def prose(page):
    """A page without its code: of a script what stands in its cells of text."""
    text = (ROOT / page).read_text()
    if not page.endswith(".py"):
        return text
    cells = re.split(r"^# %%", text, flags=re.M)
    words = [cell for cell in cells if cell.startswith(" [markdown]")]
    return re.sub(r"^# ?", "", "\n".join(words), flags=re.M)


# sources.md is a list of publications, audit.md is made from rows of its own
PAGES = [
    *(str(p.relative_to(ROOT)) for p in sorted((ROOT / "docs").glob("[lrt]*/*.*"))),
    "README.md", "docs/index.md", "benchmarks/README.md", "examples/studies/README.md",
]  # fmt: skip
PAGES.remove("docs/theory/sources.md")


@pytest.mark.parametrize("page", PAGES)
def test_every_number_of_a_page_is_a_claims_or_given_or_compared_by_a_test(page):
    text = prose(page)
    for claim in CLAIMS:
        if claim.page == page:
            there = claim.place(text)
            text = text[: there.start()] + text[there.end() :]
    text = CODE.sub("", text)
    for given in GIVEN.get(page, []):
        assert re.search(given, text, re.M), given
        text = re.sub(given, "", text, flags=re.M)
    left = {token.strip(".-") for token in TOKEN.findall(text)}
    for file, numbers in COMPARED.get(page, {}).items():
        code = (ROOT / file).read_text().replace(" / ", "/")
        for number in numbers.split():
            assert number in code, (file, number)
            left.discard(number)
    assert not left


def test_a_number_that_has_drifted_is_seen_and_mended():
    """The rule itself: a page with another number does not stand, and is written."""
    claim = Claim("README.md", "Of {0:,d} cells {1:.1f} % are.", "20176, 3.75", bool)
    old = "Say: Of 20\n177 cells 3.8 % are."
    assert claim.place(old).groups() == ("20\n177", "3.8")
    assert claim.put(old) == "Say: Of 20 176 cells 3.8 % are."
    with pytest.raises(ValueError, match=r"README\.md does not say: Of"):
        claim.place("Of many cells 3.8 % are.")
