"""Reports in Markdown, shown in a terminal of any width: a table folds its names at blanks and never cuts a word."""

from __future__ import annotations

from itertools import groupby

from rich.console import Console, RenderableType
from rich.markdown import Markdown
from rich.table import Table
from rich.text import Text

PADDING = 2


def print_markdown(text: str, console: Console | None = None) -> None:
    """Print a report; a table that cannot fit is told row by row."""
    shown = console or Console()
    for is_table, lines in groupby(text.splitlines(), key=lambda line: line.startswith("|")):
        part = list(lines)
        shown.print(_table([_cells(line) for line in part], shown.width) if is_table else Markdown("\n".join(part)))


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def _table(rows: list[list[str]], width: int) -> RenderableType:
    """The first row is the header, the second its rule."""
    header, body = rows[0], rows[2:]
    words = [max(len(word) for row in rows[:1] + body for word in row[i].split() or [""]) for i in range(len(header))]
    if sum(words) + PADDING * len(header) > width:
        return Text("\n".join(_told(header, row) for row in body))
    table = Table(box=None, padding=(0, PADDING, 0, 0), pad_edge=False)
    for name, longest in zip(header, words, strict=True):
        table.add_column(name, min_width=longest, overflow="fold")
    for row in body:
        table.add_row(*map(Text, row))
    return table


def _told(header: list[str], row: list[str]) -> str:
    """A row of a table that is too wide: its name, and below it what the columns say."""
    return "\n".join([row[0], *(f"  {name or ' '}: {cell}" for name, cell in zip(header[1:], row[1:], strict=True))])
