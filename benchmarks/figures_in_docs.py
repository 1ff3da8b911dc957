"""Puts a table that a benchmark made into a page, between its marks: a figure stands in one place."""

from __future__ import annotations

from pathlib import Path

from conveyor.errors import InputError


def mark_of(name: str, which: str) -> str:
    """The mark before ('begin') or after ('end') a table in a page."""
    return f"<!-- {name}: {which} -->"


def put_table(page: Path, name: str, text: str) -> None:
    """Replace what stands between `<!-- NAME: begin -->` and `<!-- NAME: end -->`.

    Raises:
        InputError: the page has no such marks.
    """
    begin, end = mark_of(name, "begin") + "\n", mark_of(name, "end")
    before, found, rest = page.read_text(encoding="utf-8").partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise InputError(f"page {page} has no marks {begin.strip()} and {end}: put them where the table shall stand")
    page.write_text(f"{before}{begin}\n{text}\n\n{end}{after}", encoding="utf-8")
