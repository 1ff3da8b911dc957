"""docs/api.md, made from the docstrings of the public names and from the examples."""

from __future__ import annotations

import dataclasses
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import tuberline

WIDTH = 100
HEAD = """# Python API

<!-- Made from the docstrings and from docs/examples by `make docs`. -->

`import tuberline` gives all that stands here, typed, and loads nothing heavy before it is used.
What is not listed here may change without notice. Arrays are given with shape, type, unit and frame; the frame of a
*camera* is x right, y down in the image, z away from the camera. Every error that is not the
program's own is a `tuberline.TuberlineError`; its text says what is wrong, where, which value, what
is allowed and how to fix it.

"""
FUNCTIONS = (
    "weigh",
    "weigh_depth",
    "load_weights",
    "prepare",
    "open_recording",
    "simulate",
    "replay",
    "read_ledger",
    "read_totals",
)
CLASSES = (
    "Weight",
    "Weights",
    "NetworkInputs",
    "PointRaft",
    "Recording",
    "Ledger",
    "Total",
    "Together",
    "Intrinsics",
    "TuberlineError",
)
_SECTIONS = {"Args:": "Arguments", "Attributes:": "Attributes", "Returns:": "Gives", "Raises:": "Raises"}


def api_page(examples: Path) -> str:
    """The page; `examples` is the folder docs/examples."""
    parts = [HEAD, "## Examples\n\nEach runs alone; a test runs them all.\n"]
    parts += [_example(path) for path in sorted(examples.glob("0*.py"))]
    parts.append("## Functions\n")
    parts += [_function(name, getattr(tuberline, name)) for name in FUNCTIONS]
    parts.append("## What they take and give\n")
    parts += [_class(name, getattr(tuberline, name)) for name in CLASSES]
    return "\n".join(parts)


def _example(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    about = re.match(r'"""(.*?)"""\n+', text, re.DOTALL)
    assert about is not None, path
    words, code = " ".join(about[1].split()), text[about.end() :]
    return f"### `docs/examples/{path.name}`\n\n{words}\n\n```python\n{code}```\n"


def _function(name: str, function: Callable[..., Any]) -> str:
    return f"### {name}\n\n```python\n{_signature(f'tuberline.{name}', function)}\n```\n\n{_prose(function)}\n"


def _class(name: str, kind: type[Any]) -> str:
    parts = [f"### {name}\n\n{_prose(kind)}\n"]
    if not issubclass(kind, Exception):
        for own, member in _members(kind):
            if isinstance(member, property):
                parts.append(f"`.{own}`: {_prose(member)}\n")
            else:
                parts.append(f"```python\n{_signature(f'.{own}', member)}\n```\n\n{_prose(member)}\n")
    return "\n".join(parts)


def _members(kind: type[Any]) -> Iterator[tuple[str, Any]]:
    """Own public methods and properties, in the order of the source; of a network its call alone."""
    fields = {field.name for field in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else set()
    for name, member in vars(kind).items():
        if name.startswith("_") or name in fields or not getattr(member, "__doc__", None):
            continue
        if isinstance(member, property) or inspect.isfunction(member):
            yield name, member


def _signature(name: str, function: Callable[..., Any]) -> str:
    found = inspect.signature(function)
    given = []
    for parameter in found.parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and "*" not in given:
            given.append("*")
        if parameter.name != "self":
            default = "" if parameter.default is parameter.empty else f" = {parameter.default!r}"
            given.append(f"{parameter.name}: {parameter.annotation}{default}")
    short = f"{name}({', '.join(given)}) -> {found.return_annotation}"
    if len(short) <= WIDTH:
        return short
    return f"{name}(\n" + "".join(f"    {text},\n" for text in given) + f") -> {found.return_annotation}"


def _prose(thing: object) -> str:
    """A docstring as Markdown: its sections as lists, wrapped."""
    blocks: list[str] = [""]
    section = ""
    for line in (inspect.getdoc(thing) or "").splitlines():
        if line.strip() in _SECTIONS and not line.startswith(" "):
            section = line.strip()
            blocks += [f"**{_SECTIONS[section]}**", "", ""]
        elif section in ("Args:", "Attributes:", "Raises:") and re.match(r"    \S", line):
            blocks.append(_item(line.strip()))
        elif not line.strip():
            blocks += ["", ""]
        else:
            blocks[-1] = f"{blocks[-1]} {line.strip()}".lstrip()
    text = "\n".join(_wrapped(block) for block in blocks)
    return re.sub(r"\n{3,}", "\n\n", text).strip()


def _wrapped(block: str) -> str:
    indent = "  " if block.startswith("* ") else ""
    return "\n".join(
        textwrap.wrap(shown(block), WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
    )


def _item(text: str) -> str:
    """A line of a section: 'name: what' as a list's item with the name as code."""
    names, colon, rest = text.partition(": ")
    if colon and re.fullmatch(r"[\w, ]+", names):
        return f"* {', '.join(f'`{name.strip()}`' for name in names.split(','))}: {rest}"
    return f"* {text}"


def shown(text: str) -> str:
    """Angle brackets are shown instead of being taken for HTML, outside of code."""
    return "".join(part if n % 2 else part.replace("<", "&lt;") for n, part in enumerate(re.split(r"(`[^`]*`)", text)))
