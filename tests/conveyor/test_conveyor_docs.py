"""Pages of docs/ that are made from the code are what the code says today; links between pages lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from conveyor.cli.reference import pages

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("name", ["commands.md", "topics.md"])
def test_a_page_made_from_the_code_is_up_to_date(name: str) -> None:
    assert (ROOT / "docs" / name).read_text(encoding="utf-8") == pages()[name], "run: make docs"


def test_links_lead_somewhere() -> None:
    dead = [
        f"{page.relative_to(ROOT)}: {target}"
        for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
        for target in re.findall(r"\]\((?!https?:|#)([^)#\s]+)", page.read_text(encoding="utf-8"))
        if not (page.parent / target).exists()
    ]
    assert dead == []
