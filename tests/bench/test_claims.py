"""Published figures: every claim is well formed, has a command, and agrees with the pages."""

from __future__ import annotations

import re
from pathlib import Path

import docpages

from benchmarks import claims as index
from benchmarks.claims import claims, numbers_of

ROOT = Path(__file__).parents[2]
DOCS = re.compile(r"python -m benchmarks check ([\w. ]+)")
FENCE = re.compile(r"^```.*?^```$", re.M | re.S)
# An error such as 3e-7, or a number of dB, seconds, per cent or bytes a second.
MEASURED = re.compile(
    r"(?<![\w.])(?:\d+\.?\d*|\.\d+)(?:e-\d+| (?:dB|[mu]?s|%|G(?:B|ray)/s)(?![\w/^]))"
)
# Pages whose figures are limits, options and formulas, not measurements.
GIVEN = {
    "docs/batch.md",
    "docs/coherence.md",
    "docs/formats.md",
    "docs/howto/compare_designs.md",
    "docs/howto/four_f_filter.md",
    "docs/howto/psf_of_a_lens.md",
    "docs/howto/stereo_and_lenticular.md",
    "docs/howto/white_image_not_found.md",
    "docs/tutorials/exercises.md",
    "docs/tutorials/partial_coherence.md",
    "docs/tutorials/two_cameras.md",
}


def faults(scripts: set[str]) -> list[str]:
    """Sentences on rows of the index that are wrong."""
    found = []
    for claim in claims():
        words = claim.command.split()
        if bool(claim.command) == bool(claim.test):
            found.append(f"{claim.name} has no command, or a test beside it")
        elif claim.test:
            if claim.test not in index.tests():
                found.append(f"{claim.name}: no test has the name {claim.test}")
        elif words[:3] == ["python", "-m", "benchmarks"] and words[3] not in scripts:
            found.append(f"{claim.name}: there is no benchmark {words[3]}")
        elif words[0].endswith((".py", ".sh")) or (words[0] == "python" and words[1] != "-m"):
            file = words[1] if words[0] == "python" else words[0]
            if not (ROOT / file).is_file():
                found.append(f"{claim.name}: there is no {file}")
        if claim.find and re.compile(claim.find).groups == 0:
            found.append(f"{claim.name}: its pattern has no group")
        if claim.pages and not claim.figures:
            found.append(f"{claim.name} names pages, but no figures")
        for page in claim.pages:
            text = (ROOT / page).read_text(encoding="utf-8")
            shown = "{claims} " + claim.group in text
            quoted = {abs(n) for n in numbers_of(text)}
            missing = [n for n in claim.numbers if abs(n) not in quoted]
            if missing and not shown:
                found.append(f"{claim.name}: {page} does not hold {missing}")
    return found


def test_claims_are_well_formed_and_agree_with_the_pages() -> None:
    scripts = {f"{f.parent.name}/{f.stem}" for f in (ROOT / "benchmarks").glob("*/*.py")}
    assert faults(scripts) == []
    names = [claim.name for claim in claims()]
    assert len(names) == len(set(names))


def test_pages_with_measured_figures_have_claims() -> None:
    claimed = {page for claim in claims() for page in claim.pages}
    measured = {
        page
        for page in docpages.PAGES
        if MEASURED.search(FENCE.sub("", (ROOT / page).read_text(encoding="utf-8")))
    }
    assert measured - claimed == GIVEN, "name the page in the claims of its figures"


def test_pages_name_groups_of_claims() -> None:
    known = {claim.name for claim in claims()} | {claim.group for claim in claims()}
    for page in (ROOT / "docs").rglob("*.md"):
        for name in " ".join(DOCS.findall(page.read_text(encoding="utf-8"))).split():
            assert name in known | {"GROUP"}, f"{page.name} names {name}"
