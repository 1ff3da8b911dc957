"""What is wrong with a TOML file, for who wrote it: the line, what stands there, and how to write it."""

from __future__ import annotations

import re

_PLACE = re.compile(r" \(at (?:line (\d+), column \d+|end of document)\)$")
_FIXES = (
    ("Cannot overwrite a value", "this key is given a second time: keep one of both"),
    ("Cannot mutate immutable", "this key is given a second time: keep one of both"),
    ("Cannot declare", "this section is begun a second time: put all of its keys below one heading"),
    ("Invalid statement", "a line is `key = value` or `[section]`, and a remark begins with #"),
    ("Expected '='", "a line is `key = value` or `[section]`, and a remark begins with #"),
    ("Invalid value", 'a value is text in "quotes", a number as 1.5, or true or false in small letters'),
    ("Expected newline", "one value ends here: a number is written as 1.5, without comma, unit or leading zero"),
    ("Invalid hex value", "in \"double quotes\" each \\ of a path is doubled; in 'single quotes' it stays as it is"),
    ("Unescaped '\\'", "in \"double quotes\" each \\ of a path is doubled; in 'single quotes' it stays as it is"),
    ("Illegal character '\\n'", "a text ends with its quote on the same line"),
    ("Unterminated string", "a text ends with its quote on the same line"),
    ('Expected "\'"', "a text ends with its quote on the same line"),
    ("Unclosed array", "a list that begins with [ ends with ]"),
)
"""How to write it, by how `tomllib` begins its message."""
_SHOWN = 80
"""Characters of a line that are shown."""


def toml_fault(text: str, error: Exception) -> str:
    """One sentence: line 6, `speed = 1,5`: .... A message that is not known stays as `tomllib` wrote it.

    Args:
        text: the whole file.
        error: what `tomllib.loads` raised for it.
    """
    message = str(error)
    place = _PLACE.search(message)
    fix = next((fix for begins, fix in _FIXES if message.startswith(begins)), "")
    if not place:
        return message
    lines = text.splitlines() or [""]
    filled = [n for n, line in enumerate(lines, 1) if line.strip()]
    number = int(place[1]) if place[1] else (filled or [1])[-1]
    line = "".join(c if c.isprintable() else " " for c in lines[min(number, len(lines)) - 1].strip())
    shown = line if len(line) <= _SHOWN else f"{line[:_SHOWN]}..."
    return f"line {number}, `{shown}`: {fix or message[: place.start()]}"
