"""The page's words, of one table: static/words.json has each text in each language, for the server and the browser.

A text holds values as `{name}`; `{name:span}` is a time, `{name:1}` a number with one decimal, `{name:+2}` one with two
and its sign. A reason without words is shown by its own name.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from functools import cache
from importlib import resources

from conveyor.reasons import FrameDrop, ViewLoss

Value = str | int | float
_VALUE = re.compile(r"\{(\w+)(?::([^}]+))?\}")
FRAME_DROPS = tuple(sorted(FrameDrop))
VIEW_LOSSES = tuple(sorted(set(ViewLoss) - {ViewLoss.NOT_CHOSEN, ViewLoss.REFUSED}))
"""Reasons that have words; what was not chosen is missed by no one."""
AGGREGATOR_REFUSALS = (
    "entries_conflicting",
    "entries_refused_other_run",
    "entries_refused_unknown_camera",
    "entries_refused_malformed",
    "entries_set_aside",
    "entries_dropped_waiting_full",
)


@cache
def table() -> dict[str, dict[str, str]]:
    """Text by key and language."""
    file = resources.files("viewer.page") / "static" / "words.json"
    found: dict[str, dict[str, str]] = json.loads(file.read_text(encoding="utf-8"))
    return found


def said(key: str, values: Mapping[str, Value] | None = None, *, language: str = "en") -> str:
    """The text `key` with its values."""
    given = values or {}

    def fill(found: re.Match[str]) -> str:
        return _told(given[found[1]], found[2] or "", language)

    return _VALUE.sub(fill, table()[key][language])


def _told(value: Value, how: str, language: str) -> str:
    if isinstance(value, str) or not how:
        return str(value)
    if how == "span":
        return span(value, language=language)
    digits = int(how.removeprefix("+"))
    return f"{value:+.{digits}f}" if how.startswith("+") else f"{value:.{digits}f}"


def plain(reason: str) -> str:
    """A reason by its own name."""
    return reason.replace("_", " ")


def span(seconds: float, *, language: str = "en") -> str:
    """A time for a person: '12 s', '3 min', '2 h 5 min'."""
    whole = int(seconds)
    if whole < 120:
        return said("span.s", {"n": whole}, language=language)
    if whole < 7200:
        return said("span.min", {"n": whole // 60}, language=language)
    return said("span.h", {"h": whole // 3600, "m": whole % 3600 // 60}, language=language)
