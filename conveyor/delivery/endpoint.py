"""What the delivery classes need of the process they live in: a `Node`, or an `Observer` that only looks."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import zenoh

    from conveyor.counters import CounterSet


class Endpoint(Protocol):
    """An open session on one line, with counters and a log."""

    session: zenoh.Session
    line: str
    counters: CounterSet
    log: logging.Logger
