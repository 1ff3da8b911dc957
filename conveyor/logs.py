"""Structured logs on stderr: one line an event, `key=value` after the text; JSON lines with TUBERLINE_LOG=json.

What a line says may come from outside: control characters and forged line ends are shown as what they are, lines have a
length, and of one place in the program only so many lines a minute are written; how many were left out is written too.
"""

from __future__ import annotations

import json
import logging
import os
import re
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TextIO

MOST_TEXT = 4000
"""Characters of one event; a line's error with all its advice has some hundreds."""
MOST_TRACEBACK_LINES = 200
LINES_PER_MIN = 60
"""Of one logger and template; a node writes a few lines a minute."""
MOST_PLACES = 512
"""Loggers and templates told apart; what comes beyond them shares one limit."""
MINUTE_S = 60.0
_OTHERS = ("", "")
_CONTROL = re.compile(r"[\x00-\x08\x0a-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""Everything but tab that moves a terminal's cursor, colours it, turns its text around or ends a line."""


def one_line(text: str, *, most: int = MOST_TEXT) -> str:
    """`text` on one line of at most about `most` characters, control characters shown by their numbers."""
    shown = text if len(text) <= most else f"{text[:most]}... ({len(text)} characters)"
    return _CONTROL.sub(_escaped, shown)


def _escaped(match: re.Match[str]) -> str:
    return match[0].encode("unicode_escape", "surrogatepass").decode("ascii")


class RateLimit:
    """At most `per_min` lines a minute of each logger and message template; the others are counted.

    Errors and tracebacks are limited as well: they repeat most. Texts without arguments count as one template.
    """

    def __init__(self, *, per_min: int = LINES_PER_MIN, clock: Callable[[], float] = time.monotonic) -> None:
        self._per_min = per_min
        self._clock = clock
        self._places: dict[tuple[str, str], _Minute] = {}

    def __len__(self) -> int:
        """Places that are remembered."""
        return len(self._places)

    def admit(self, logger: str, template: str) -> bool:
        """Whether one more line of this place is written."""
        place = (logger, template)
        if place not in self._places and len(self._places) >= MOST_PLACES:
            place = _OTHERS
        minute = self._places.setdefault(place, _Minute(self._clock()))
        if minute.written >= self._per_min:
            minute.left_out += 1
            return False
        minute.written += 1
        return True

    def over(self, *, all_of_them: bool = False) -> list[tuple[str, str, int]]:
        """(logger, template, lines left out) of every minute that is over; those places begin again."""
        now_s = self._clock()
        ended = [p for p, minute in self._places.items() if all_of_them or now_s - minute.begun_s >= MINUTE_S]
        counted = [(*place, self._places.pop(place).left_out) for place in ended]
        return [(logger, template, n) for logger, template, n in counted if n]


@dataclass(slots=True)
class _Minute:
    begun_s: float
    written: int = 0
    left_out: int = 0


class LimitedHandler(logging.StreamHandler):  # type: ignore[type-arg, unused-ignore]
    """Writes what `limit` admits, and after each minute how many lines it left out of which kind."""

    def __init__(self, stream: TextIO, *, limit: RateLimit) -> None:
        super().__init__(stream)
        self._limit = limit

    def emit(self, record: logging.LogRecord) -> None:
        """Write it or count it. `logging` holds this handler's lock."""
        self._tell_left_out()
        if self._limit.admit(record.name, str(record.msg) if record.args else ""):
            super().emit(record)

    def close(self) -> None:
        """Tell what was left out, at the latest at the end."""
        self._tell_left_out(all_of_them=True)
        super().close()

    def _tell_left_out(self, *, all_of_them: bool = False) -> None:
        for logger, template, n in self._limit.over(all_of_them=all_of_them):
            text = "%d lines %s were left out: more than %d in a minute"
            kind = f"like '{one_line(template, most=80)}'" if template else "without a template"
            args = (n, kind, LINES_PER_MIN)
            super().emit(logging.LogRecord(logger or "logs", logging.WARNING, __file__, 0, text, args, None))


def _traceback(record: logging.LogRecord, formatter: logging.Formatter) -> str:
    """Lines of a traceback, each of its own and indented: an exception's text cannot look like an event."""
    if record.exc_info is None:
        return ""
    lines = formatter.formatException(record.exc_info).split("\n")
    if len(lines) > MOST_TRACEBACK_LINES:
        half = MOST_TRACEBACK_LINES // 2
        left_out = f"... {len(lines) - 2 * half} lines left out ..."
        lines = [*lines[:half], left_out, *lines[-half:]]
    return "\n".join(f"  {one_line(line)}" for line in lines)


class _TextFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        when = datetime.fromtimestamp(record.created, UTC).strftime("%H:%M:%S.%f")[:-3] + "Z"  # as ISO 8601 says UTC
        text = f"{when} {record.levelname.lower():7} {one_line(record.name)}: {one_line(record.getMessage())}"
        traceback = _traceback(record, self)
        return f"{text}\n{traceback}" if traceback else text


class _JsonFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        event = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(),
            "level": record.levelname.lower(),
            "node": one_line(record.name),
            "text": one_line(record.getMessage()),
        }
        if record.exc_info is not None:
            event["traceback"] = _traceback(record, self)
        return json.dumps(event)


def setup_logs() -> None:
    """Send all logs to stderr, once per process. Level from TUBERLINE_LOG_LEVEL, default info."""
    handler = LimitedHandler(sys.stderr, limit=RateLimit())
    handler.setFormatter(_JsonFormatter() if os.environ.get("TUBERLINE_LOG") == "json" else _TextFormatter())
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(os.environ.get("TUBERLINE_LOG_LEVEL", "info").upper())
    for chatty in ("numba", "matplotlib", "asyncio"):
        logging.getLogger(chatty).setLevel(logging.WARNING)


def say(text: str) -> None:
    """Write to stderr now, where it takes it: a full disk under a log must not keep a process from ending."""
    with suppress(OSError, ValueError):
        sys.stderr.write(text)
    flush_outputs()


def flush_outputs() -> None:
    """What stdout and stderr still hold goes out, where they take it."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
