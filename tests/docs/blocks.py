"""The blocks of a page that its test runs, in the order in which a reader meets them.

The convention (CONTRIBUTING.md, "Docs that run"): an indented block is run, a fenced block with `title="NAME"` is
written to the file NAME, every other fenced block is only shown.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass

SIZES = {
    "--tubers": ("TUBERLINE_DOCS_TUBERS", "12"),
    "--views": ("TUBERLINE_DOCS_VIEWS", "4"),
    "--minutes": ("TUBERLINE_DOCS_MINUTES", "0.1"),
}
"""Options that say how much is made: the variable that limits each one in the test, and its default."""
CLOCKED = ("train", "ablate")
"""Commands that get --minutes where the page gives none."""


@dataclass(frozen=True, slots=True)
class File:
    """A file that the page tells its reader to save."""

    name: str
    text: str


@dataclass(frozen=True, slots=True)
class Command:
    """A command line as the page has it, without its remark."""

    line: str


def blocks(page: str) -> Iterator[File | Command]:
    """Files and commands of a page in its own order."""
    fence: list[str] | None = None
    title = ""
    before = ""
    for line in page.splitlines():
        if line.startswith("```"):
            if fence is None:
                named = re.search(r'title="([^"]+)"', line)
                fence, title = [], named[1] if named else ""
            else:
                if title:
                    yield File(title, "\n".join(fence) + "\n")
                fence = None
        elif fence is not None:
            fence.append(line)
        elif line.startswith("    ") and not re.match(r"\s*(?:[-*]|\d+\.) ", before):
            if command := re.sub(r"\s+#.*", "", line).strip():
                yield Command(command)
            continue
        before = line


def made_small(line: str) -> str:
    """The command line with the sizes of the test instead of the page's, where those are larger."""
    for option, (variable, default) in SIZES.items():
        limit = os.environ.get(variable, default)
        if found := re.search(rf"{option} ([\d.]+)", line):
            line = line[: found.start(1)] + min(found[1], limit, key=float) + line[found.end(1) :]
    words = line.split()
    if words[:1] == ["tuberline"] and words[1] in CLOCKED and "--minutes" not in words:
        line += f" --minutes {os.environ.get(*SIZES['--minutes'])}"
    return line
