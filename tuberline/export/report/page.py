"""What a report consists of, whatever it is written as: figures, tables, bars, pictures and plain sentences."""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass
from typing import Any, Literal

Align = Literal["left", "right"]

MAY_BREAK = "\u200b"
"""Has no width of its own; a line may end there."""
_LONG_WORD = re.compile(r"\S{12}(?=\S)")


def breakable(text: str) -> str:
    """`text` whose long words may be broken: one of a hundred letters, as a name may be, pushed all figures of its
    table off the page.
    """
    return _LONG_WORD.sub(lambda word: word[0] + MAY_BREAK, text)


@dataclass(frozen=True, slots=True)
class Figures:
    """A few numbers that stand first: (what it is, the number, what is to be known of it)."""

    items: tuple[tuple[str, str, str], ...]


@dataclass(frozen=True, slots=True)
class Grid:
    """A table. `columns` are (name, alignment); the last row is a sum where `summed`."""

    title: str
    columns: tuple[tuple[str, Align], ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    summed: bool = False


@dataclass(frozen=True, slots=True)
class Bars:
    """One bar for each row: (label, what stands behind it, shares that add up to 1).

    `parts` names the shares and says their colours.
    """

    title: str
    parts: tuple[tuple[str, str], ...]
    rows: tuple[tuple[str, str, tuple[float, ...]], ...]
    note: str = ""


@dataclass(frozen=True, slots=True)
class Picture:
    """A PNG."""

    title: str
    png: bytes
    note: str = ""


@dataclass(frozen=True, slots=True)
class Sentences:
    """One sentence a line; `warn` where they are about what went wrong."""

    title: str
    items: tuple[str, ...]
    warn: bool = False


Block = Figures | Grid | Bars | Picture | Sentences


@dataclass(frozen=True, slots=True)
class Report:
    """A whole report. `foot` stands at the end of each page."""

    title: str
    subtitle: str
    blocks: tuple[Block, ...]
    foot: str

    def as_dict(self) -> dict[str, Any]:
        """Plain values, pictures as base64."""
        return {
            "title": self.title,
            "subtitle": self.subtitle,
            "foot": self.foot,
            "blocks": [_plain(block) for block in self.blocks],
        }


def _plain(block: Block) -> dict[str, Any]:
    values = {name: getattr(block, name) for name in type(block).__slots__}
    if isinstance(block, Picture):
        values["png"] = base64.b64encode(block.png).decode()
    return {"kind": type(block).__name__.lower(), **values}
