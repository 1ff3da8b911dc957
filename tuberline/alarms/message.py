"""What is sent of an alarm: its beginning or its end, as a person reads it and as a program takes it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any, Literal, Self

from viewer.page.words import span

SCHEMA = 1
MOST_TEXT = 400
"""Characters of one text: names in it may come from outside."""


@dataclass(frozen=True, slots=True)
class AlarmMessage:
    """One alarm begins or ends.

    Attributes:
        id: of this message; the same one however often it has to be sent again.
        alarm: what beginning and end have in common.
        event: whether it begins or ends.
        line, camera: where; `camera` is empty where it concerns no single one.
        key: what is wrong, in a word that stays the same, e.g. 'camera-left-belt'.
        level: 'trouble', 'warning' or 'note'.
        text, fix: what is wrong when it begins, and what to do.
        since_unix_s, ended_unix_s: when it was first seen, and, at its end, last seen.
    """

    id: str
    alarm: str
    event: Literal["begin", "end"]
    line: str
    camera: str
    key: str
    level: str
    text: str
    fix: str
    since_unix_s: float
    ended_unix_s: float | None = None

    def as_dict(self, *, lost_before: int = 0) -> dict[str, Any]:
        """For JSON; `lost_before` messages had to be given up before this one."""
        ended = None if self.ended_unix_s is None else _iso(self.ended_unix_s)
        return {
            "schema": SCHEMA,
            **{name: value for name, value in asdict(self).items() if not name.endswith("_unix_s")},
            "since": _iso(self.since_unix_s),
            "ended": ended,
            "lost_before": lost_before,
            "title": self.title,
        }

    @property
    def title(self) -> str:
        """One line for a person's phone."""
        where = f"{self.line}, camera {self.camera}" if self.camera else self.line
        if self.ended_unix_s is None:
            return f"{where}: {self.text}"
        return f"{where}: over after {span(max(0.0, self.ended_unix_s - self.since_unix_s))}: {self.text}"

    def body(self, *, lost_before: int = 0) -> str:
        """The rest for a person: what to do, since when."""
        lines = [] if self.event == "end" else [self.fix]
        lines.append(f"Since {_iso(self.since_unix_s)}.")
        if lost_before:
            lines.append(f"{lost_before} older messages were given up while nothing could be sent.")
        return "\n".join(lines)

    def encode(self) -> str:
        """As the outbox keeps it; `decode` reads it back to an equal one."""
        return json.dumps(asdict(self))

    @classmethod
    def decode(cls, text: str) -> Self:
        """What `encode` wrote."""
        return cls(**json.loads(text))


def _iso(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, UTC).isoformat(timespec="seconds")
