"""What pydantic finds wrong with a value, in plain words: for who wrote the value, not for who declared its field."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

_UNITS = {
    "mm2": "mm²",
    "mm": "mm",
    "ms": "ms",
    "us": "µs",
    "ns": "ns",
    "mw": "mW",
    "m": "m",
    "s": "s",
    "g": "g",
    "kg": "kg",
    "deg": "°",
    "percent": "%",
}
"""Unit by the last part of a field's name."""
OURS = "value_error"
"""Pydantic's name for what a validator of ours has said; those words stay as they are."""
_LIMITS = {
    "greater_than": ("gt", "must be more than"),
    "greater_than_equal": ("ge", "must be at least"),
    "less_than": ("lt", "must be less than"),
    "less_than_equal": ("le", "must be at most"),
}
_LENGTHS = {
    "string_too_short": ("min_length", "must have at least", "character"),
    "string_too_long": ("max_length", "must have at most", "character"),
    "too_short": ("min_length", "must have at least", "item"),
    "too_long": ("max_length", "must have at most", "item"),
}
_KINDS = {
    "missing": "is missing",
    "extra": "is unknown",
    "finite_number": "must be a finite number",
    "int": "must be a whole number",
    "float": "must be a number",
    "string": "must be text",
    "bool": "must be true or false",
    "path": "must be a path, written as text",
    "list": "must be a list",
    "tuple": "must be a list",
    "dict": "must be a table of names and values",
    "model": "must be a table of names and values",
}
"""By pydantic's name of the fault, or by its first part: int_type, int_parsing, int_from_float."""
_PATTERNS = {
    r"^[^\x00-\x1f\x7f]*$": "must be one line of text without control characters",
    r"^[^\x00-\x1f\x7f]{1,256}$": "must be one line of text, 1 to 256 characters without control characters",
    r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$": (
        "must be letters, digits, '.', '_' and '-', 64 at most, the first a letter or a digit"
    ),
    r"^[A-Za-z0-9._/-]{1,240}$": "must be letters, digits, '.', '_', '-' and '/', 240 at most",
    r"^(auto|off|unixsock-stream/.+|tcp/(127\.0\.0\.1|\[::1\]|localhost):\d{1,5})$": (
        "must be auto, off, unixsock-stream/PATH or tcp/127.0.0.1:PORT"
    ),
}
"""What a text must be, by its pattern; one that is not here is told as it is."""


def unit_of(name: str) -> str:
    """The unit of a field, by the last part of its name; empty where that is none."""
    return _UNITS.get(name.rpartition("_")[2], "")


def in_words(fault: Mapping[str, Any]) -> str:
    """What is wrong with the value, and what is allowed, with its unit where the field's name has one.

    Args:
        fault: of `ValidationError.errors()`.
    """
    kind, told = str(fault["type"]), fault.get("ctx", {})
    if kind == OURS:
        return str(fault["msg"]).removeprefix("Value error, ")
    if kind in _LIMITS:
        name, words = _LIMITS[kind]
        return f"{words} {_number(told[name])}{_unit(fault)}"
    if kind in _LENGTHS:
        name, words, what = _LENGTHS[kind]
        return f"{words} {told[name]} {what}{'' if told[name] == 1 else 's'}"
    if kind == "string_pattern_mismatch":
        return _PATTERNS.get(told["pattern"], f"must match the pattern {told['pattern']!r}")
    if kind in ("literal_error", "enum"):
        return f"must be {told['expected']}"
    return _KINDS.get(kind) or _KINDS.get(kind.partition("_")[0]) or str(fault["msg"])


def all_in_words(error: ValidationError) -> str:
    """Every fault of a value with the name of its field, on one line."""
    faults = error.errors(include_url=False)
    return "; ".join(f"{'.'.join(map(str, fault['loc'])) or 'it'} {in_words(fault)}" for fault in faults)


def _number(limit: Any) -> str:
    return f"{limit:.15g}" if isinstance(limit, float) else str(limit)


def _unit(fault: Mapping[str, Any]) -> str:
    """By the name of the field, or of the list that the number is in."""
    name = next((part for part in reversed(fault["loc"]) if isinstance(part, str)), "")
    unit = unit_of(name)
    return f" {unit}" if unit else ""
