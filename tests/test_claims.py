"""The project's own numbers are those of its benchmarks, and stand on its pages."""

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "benchmarks"))
from claims import CLAIMS, Claim  # noqa: E402

CODE = re.compile(r"```.*?```|`[^`]*`|\]\([^)]*\)", re.S)
# what README says that no benchmark measures: names, versions, the model
GIVEN = [
    r"Python 3\.11", r"joint\s+[12]", r"m l\^2", r"Apache-2\.0", r"q = 2\.54",
    r"the 3240 motions",
    r"8192 columns to t = 100 on two cores", r"^## .*$",
]  # fmt: skip


def named(claim):
    return " ".join(claim.sentence.split()[:6])


@pytest.mark.parametrize("claim", CLAIMS, ids=named)
def test_a_claim_holds_and_its_page_shows_its_numbers(claim):
    assert claim.holds(*claim.numbers())
    assert claim.stands(), f"write {claim.shown()}: `benchmarks/claims.py --write`"


def test_every_number_of_the_readme_is_a_claims():
    text = (ROOT / "README.md").read_text()
    for claim in CLAIMS:
        if claim.page == "README.md":
            there = claim.place(text)
            text = text[: there.start()] + text[there.end() :]
    for given in GIVEN:
        assert re.search(given, text, re.M), given
        text = re.sub(given, "", text, flags=re.M)
    left = CODE.sub("", text)
    assert not re.findall(r"\S*\d\S*", left)


def test_a_number_that_has_drifted_is_seen_and_mended():
    """The rule itself: a page with another number does not stand, and is written."""
    claim = Claim("README.md", "Of {0:,d} cells {1:.1f} % are.", "20176, 3.75", bool)
    old = "Say: Of 20\n177 cells 3.8 % are."
    assert claim.place(old).groups() == ("20\n177", "3.8")
    assert claim.put(old) == "Say: Of 20 176 cells 3.8 % are."
    with pytest.raises(ValueError, match=r"README\.md does not say: Of"):
        claim.place("Of many cells 3.8 % are.")
