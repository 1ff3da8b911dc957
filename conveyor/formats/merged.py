"""Frames of several cameras in one order."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence

from conveyor.formats.source import Refused, Source
from conveyor.messages import Frame


def in_time(sources: Sequence[Source], *, run: str) -> Iterator[Frame | Refused]:
    """Frames of all cameras, merged by the newest capture time of each camera; each camera's own order is kept."""

    def timed(n: int, source: Source) -> Iterator[tuple[int, int, int, Frame | Refused]]:
        newest = 0
        for count, item in enumerate(source.frames(run=run)):
            newest = max(newest, item.captured_ns) if isinstance(item, Frame) else newest
            yield newest, n, count, item

    for _, _, _, item in heapq.merge(*(timed(n, source) for n, source in enumerate(sources)), key=lambda t: t[:3]):
        yield item
