"""Structured logs on stderr: one line an event, `key=value` after the text; JSON lines with TUBERLINE_LOG=json."""

from __future__ import annotations

import json
import logging
import os
import sys
from datetime import UTC, datetime


class _TextFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        when = datetime.fromtimestamp(record.created, UTC).strftime("%H:%M:%S.%f")[:-3]
        text = f"{when} {record.levelname.lower():7} {record.name}: {record.getMessage()}"
        return text if record.exc_info is None else f"{text}\n{self.formatException(record.exc_info)}"


class _JsonFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        event = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(),
            "level": record.levelname.lower(),
            "node": record.name,
            "text": record.getMessage(),
        }
        if record.exc_info is not None:
            event["traceback"] = self.formatException(record.exc_info)
        return json.dumps(event)


def setup_logs(level: str | None = None) -> None:
    """Send all logs to stderr, once per process. Level from TUBERLINE_LOG_LEVEL, default info."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_JsonFormatter() if os.environ.get("TUBERLINE_LOG") == "json" else _TextFormatter())
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel((level or os.environ.get("TUBERLINE_LOG_LEVEL", "info")).upper())
    for chatty in ("numba", "matplotlib", "asyncio"):
        logging.getLogger(chatty).setLevel(logging.WARNING)
