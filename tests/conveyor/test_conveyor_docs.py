"""Pages of docs/ that are made from the code are what the code says today."""

from __future__ import annotations

from pathlib import Path

from conveyor.cli.topics import markdown_table

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_topics_page_is_the_table() -> None:
    assert markdown_table() in (DOCS / "topics.md").read_text(), "run: tuberline topics --markdown, and paste it"
