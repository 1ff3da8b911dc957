"""One finding: what was looked at, how it is, and how to fix it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum


class Level(StrEnum):
    """How bad it is: a fault stops the line or makes its numbers wrong, a warning will."""

    OK = "ok"
    WARNING = "warning"
    FAULT = "fault"


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check. `fix` is empty only where nothing is to be done."""

    check: str
    level: Level
    text: str
    fix: str = ""

    def __post_init__(self) -> None:
        if (self.level is Level.OK) != (self.fix == ""):
            raise ValueError(f"finding '{self.check}': a fix belongs to a warning or a fault, and to each of them")


def ok(check: str, text: str) -> Finding:
    """Nothing to fix."""
    return Finding(check, Level.OK, text)


def warning(check: str, text: str, fix: str) -> Finding:
    """Will hurt later."""
    return Finding(check, Level.WARNING, text, fix)


def fault(check: str, text: str, fix: str) -> Finding:
    """Hurts now."""
    return Finding(check, Level.FAULT, text, fix)


def worst(findings: Iterable[Finding]) -> Level:
    """The worst level among `findings`."""
    order = list(Level)
    return max((f.level for f in findings), key=order.index, default=Level.OK)
