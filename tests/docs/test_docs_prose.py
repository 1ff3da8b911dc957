"""Pages are plain: prose wraps at 100 characters, and words that only we understood stay out of pages and sentences."""

from __future__ import annotations

import re
import subprocess
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WIDTH = 100
MADE = ("api.md", "commands.md", "config.md", "evaluation.md", "topics.md")
"""Pages made from the code."""
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *(page for page in sorted((ROOT / "docs").glob("*.md")) if page.name not in MADE),
]
PRIVATE = re.compile(
    r"\b(anew|nobody|whoever|mend(?:s|ed|ing)?|portraits?|sitters?|heirs?|sewn?"
    r"|errs|erred|oftener|likelier|surer|surest|reckon(?:s|ed|ing)?|middling|astray|fray(?:s|ed)?|untold)\b",
    re.IGNORECASE,
)
"""Say again, no one, the person who, fix or repair; training sample, patch, successor, merge; is off, more often, more
likely, more certain, calculate, medium, damaged, ragged, unclear."""


NAMES_FORMER = ("segmenter/training/samples.py", "tuberline/cli/commands.py")
"""Name what was renamed."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_prose_wraps_at_100_characters(page: Path) -> None:
    assert [line for line in prose(page) if len(line) > WIDTH] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_paragraph_and_no_item_stands_twice(page: Path) -> None:
    """A merge that takes both sides leaves them so."""
    parts = [part for part in re.split(r"\n\n|\n(?=\* )", page.read_text(encoding="utf-8")) if len(part) > 80]
    assert [part[:80] for part, count in Counter(parts).items() if count > 1] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages_use_the_words_of_the_field(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    if page.name == "CHANGELOG.md":
        text = re.sub(r"`[^`]*`", "", text)  # it names what was renamed
    assert PRIVATE.findall(text) == []


def test_sentences_and_docstrings_use_them_too() -> None:
    listed = subprocess.run(
        ["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.split()
    if not listed:
        pytest.skip("not a git checkout: there is no list of files")
    found = {
        name: words
        for name in listed
        if not name.startswith(("tests/", *NAMES_FORMER)) and (ROOT / name).is_file()
        if (words := sorted({word.lower() for word in PRIVATE.findall((ROOT / name).read_text(encoding="utf-8"))}))
    }
    assert found == {}


def prose(page: Path) -> list[str]:
    """Lines of a page that are neither table, code, heading, picture nor one unbreakable word."""
    lines, fenced = [], False
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("```"):
            fenced = not fenced
        elif not fenced and not line.startswith(("|", "    ", "#", "![")) and " " in line.strip():
            lines.append(line)
    return lines
