"""When each tuber of a live line crossed, its view was sent and answered, it was logged, and committed: one wall clock.

A watcher beside the router stamps messages as they arrive. It takes no frames, so that it costs the line little.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

from conveyor import topics
from conveyor.config import LinkConfig
from conveyor.delivery.latest import LatestSubscriber
from conveyor.delivery.reliable import ReliableSubscriber
from conveyor.errors import TuberlineError
from conveyor.messages import TrackEntry, Tuber, View, Weight
from conveyor.observer import Observer

INBOX = 4096
HOPS = ("view sent", "first answer", "logged", "committed")
TOTAL = "crossing to ledger"


@dataclass(slots=True)
class Stamps:
    """Nanoseconds of the wall clock at which something was first seen, by id."""

    sent_ns: dict[str, int] = field(default_factory=dict)
    answered_ns: dict[str, int] = field(default_factory=dict)
    logged_ns: dict[str, tuple[int, int]] = field(default_factory=dict)
    """By track: when its entry came, and the capture time of its crossing, by the clock of the day."""
    committed: list[tuple[int, Tuber]] = field(default_factory=list)

    def view(self, view: View, now_ns: int) -> None:
        """A view went to a regressor."""
        self.sent_ns.setdefault(view.track_id, now_ns)

    def weight(self, weight: Weight, now_ns: int) -> None:
        """A view was answered."""
        self.answered_ns.setdefault(weight.track_id, now_ns)

    def entry(self, entry: TrackEntry, now_ns: int) -> None:
        """A camera logged something."""
        if entry.track is not None:
            self.logged_ns.setdefault(entry.track.track_id, (now_ns, entry.track.crossed_ns))

    def tuber(self, tuber: Tuber, now_ns: int) -> None:
        """A tuber was committed."""
        self.committed.append((now_ns, tuber))


class Watcher:
    """Listens in threads of its own; use as a context manager."""

    def __init__(self, link: LinkConfig, *, line: str) -> None:
        self.observer = Observer(link, line=line)
        self.stamps = Stamps()
        self._stop = threading.Event()
        self._threads: list[threading.Thread] = []

    def __enter__(self) -> Self:
        node = self.observer.__enter__()
        views = LatestSubscriber(node, topics.VIEW, View, capacity=INBOX, regressor="*")
        weights = ReliableSubscriber(node, topics.WEIGHT, Weight, camera="*")
        entries = ReliableSubscriber(node, topics.TRACK, TrackEntry, camera="*")
        tubers = ReliableSubscriber(node, topics.TUBER, Tuber)
        self._listen(views, self.stamps.view)
        self._listen(weights, self.stamps.weight)
        self._listen(entries, self.stamps.entry)
        self._listen(tubers, self.stamps.tuber)
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()
        self.observer.__exit__(*error)

    def _listen(self, inbox: Any, take: Callable[[Any, int], None]) -> None:
        def listen() -> None:
            while not self._stop.is_set():
                if (message := inbox.get(0.2)) is not None:
                    take(message, time.time_ns())

        self._start(listen)

    def _start(self, work: Callable[[], None]) -> None:
        self._threads.append(threading.Thread(target=work, daemon=True))
        self._threads[-1].start()


def latencies_s(stamps: Stamps, *, from_ns: int) -> dict[str, list[float]]:
    """Seconds of each hop, and of all of them, of every tuber committed at or after `from_ns` of the wall clock.

    Of a tuber that several cameras saw, the track logged last is followed: the others waited for it. Cameras stamp
    their frames with the time of the day, so its crossing needs no other clock.
    """
    found: dict[str, list[float]] = {hop: [] for hop in (*HOPS, TOTAL)}
    for committed_ns, tuber in stamps.committed:
        known = [track for track in tuber.tracks if track in stamps.logged_ns]
        if committed_ns < from_ns or not known:
            continue
        track = max(known, key=lambda name: stamps.logged_ns[name][0])
        logged_ns, crossed_ns = stamps.logged_ns[track]
        sent_ns, answered_ns = stamps.sent_ns.get(track), stamps.answered_ns.get(track)
        if sent_ns is None or answered_ns is None:
            continue
        moments = (crossed_ns, sent_ns, answered_ns, logged_ns, committed_ns)
        for hop, before_ns, after_ns in zip(HOPS, moments, moments[1:], strict=False):
            found[hop].append((after_ns - before_ns) / 1e9)
        found[TOTAL].append((committed_ns - moments[0]) / 1e9)
    return found


def percentile(values: Sequence[float], share: float) -> float:
    """The nearest-rank percentile; `share` from 0 to 1.

    Raises:
        TuberlineError: there is no value.
    """
    if not values:
        raise TuberlineError("nothing arrived in the measured time, so that there is no percentile: measure for longer")
    ordered = sorted(values)
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)]
