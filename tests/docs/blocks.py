"""The blocks of a page that its test runs, in the order in which a reader meets them.

The convention (CONTRIBUTING.md, "Docs that run"): indented and `console` blocks are typed, a fenced block with
`title="NAME"` is saved as NAME, a `python` block is run, every other fenced block is only shown.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass

SIZES = {
    "--tubers": ("TUBERLINE_DOCS_TUBERS", "12"),
    "--views": ("TUBERLINE_DOCS_VIEWS", "6"),
    "--minutes": ("TUBERLINE_DOCS_MINUTES", "0.1"),
    "--epochs": ("TUBERLINE_DOCS_EPOCHS", "1"),
    "--belts": ("TUBERLINE_DOCS_BELTS", "2"),
    "--frames": ("TUBERLINE_DOCS_FRAMES", "12"),
}
"""Options that say how much is made: the variable that limits each one in the test, and its default."""
CLOCKED = ("train", "ablate")
"""Commands that get --minutes where the page gives none."""
SMALL = {
    "aggregate": "--tubers 500",
    "clods": "--tubers 6 --only 0",
    "day": "--loads 2 --box-kg 14 --delay-s 9 --cell-m 1 --workers 1 --database none",
    "dispatch": "--per-s 50 --seconds 2 --workers 2",
    "follow": "--tubers 6 --only 0",
    "foreign": "--tubers 6 --only 0",
    "frames": "--frames 20",
    "gauge": "--worlds 1 --loads 1 --only rods --tubers 4",
    "heights": "--lines 3 --pool 100",
    "layers": "--tubers 8 --only 0",
    "line": "--seconds 5 --warm-up-s 5 --tubers-per-s 2 --tubers 8 --cameras 1",
    "line_virtual": "--seconds 5",
    "load_intervals": "--recordings 1 --tubers 6",
    "matched": "--scenes small-image --tubers 3",
    "otherworld": "--scenes exact-singulated --tubers 6",
    "perception": "--scenes singulated --tubers 6 --every 30",
    "regressor": "--batches 1 --rounds 1",
    "site": "--hosts 1 --undisturbed --tubers 6",
    "sizes": "--tubers 6 --only 0",
    "training": "--rounds 1",
    "yield_map": "--seeds 1",
}
"""What a benchmark is given in the test after the page's own arguments."""


@dataclass(frozen=True, slots=True)
class File:
    """A file that the page tells its reader to save."""

    name: str
    text: str


@dataclass(frozen=True, slots=True)
class Command:
    """A command line as the page has it, without its remark; a shell loop is one."""

    line: str


@dataclass(frozen=True, slots=True)
class Code:
    """Lines of Python."""

    text: str


def blocks(page: str) -> Iterator[File | Command | Code]:
    """Files, commands and Python of a page in its own order."""
    kind: str | None = None
    fence: list[str] = []
    title, before, unfinished = "", "", ""
    for line in page.splitlines():
        if line.startswith("```"):
            if kind is None:
                named = re.search(r'title="([^"]+)"', line)
                kind, fence, title = line[3:].split(" ")[0], [], named[1] if named else ""
            else:
                if title:
                    yield File(title, "\n".join(fence) + "\n")
                elif kind == "python":
                    yield Code("\n".join(fence) + "\n")
                kind = None
            continue
        typed = kind == "console"
        if kind is None and line.startswith("    ") and not re.match(r"\s*(?:[-*]|\d+\.) ", before):
            typed = True
        elif kind is None:
            before = line
        else:
            fence.append(line)
        if typed and (command := re.sub(r"\s+#.*", "", line).strip()):
            unfinished = f"{unfinished}\n{command}" if unfinished else command
            loop = unfinished.startswith("for ") and not unfinished.endswith("done")
            if not loop and not command.endswith("\\"):
                yield Command(unfinished.replace("\\\n", ""))
                unfinished = ""


def made_small(line: str) -> str:
    """The command line with the sizes of the test instead of the page's, where those are larger."""
    words = line.split()
    if words[:3] == ["python", "-m", "benchmarks"]:
        return f"{line} {SMALL.get(words[3], '')}".strip()
    for option, (variable, default) in SIZES.items():
        limit = os.environ.get(variable, default)
        if found := re.search(rf"{option} ([\d.]+)", line):
            line = line[: found.start(1)] + min(found[1], limit, key=float) + line[found.end(1) :]
    if words[:1] == ["tuberline"] and words[1] in CLOCKED and "--minutes" not in words:
        line += f" --minutes {os.environ.get(*SIZES['--minutes'])}"
    return line
