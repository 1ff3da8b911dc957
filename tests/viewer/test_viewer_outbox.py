"""The queue in front of a sink: bounded, and every loss has a number."""

from __future__ import annotations

import threading
import time

import pytest

from conveyor.counters import CounterSet
from viewer.outbox import Outbox
from viewer.scene.primitives import Entry, Lane, LogLine, Moment, NewRun, Number


def light(n: int) -> Entry:
    return Entry("/log", LogLine(str(n), "INFO"), Moment(n))


def heavy(path: str, n: int) -> Entry:
    return Entry(path, Number(float(n)), Moment(n), heavy=True)


def outbox(**limits: int) -> tuple[Outbox, CounterSet]:
    counters = CounterSet()
    return Outbox(name="x", counters=counters, **limits), counters


def test_light_entries_keep_their_order_and_heavy_ones_only_their_newest() -> None:
    box, counters = outbox()
    for n in range(5):
        box.put(light(n))
        box.put(heavy("/depth", n))
    batch = box.take(0.0)
    assert [e.moment.captured_ns for e in batch if e.moment and not e.heavy] == [0, 1, 2, 3, 4]
    assert [e.primitive for e in batch if e.heavy] == [Number(4.0)]
    assert counters.get("x_dropped_superseded") == 4
    assert box.take(0.0) == []


@pytest.mark.parametrize("count", [1, 7, 8, 9, 100])
def test_conservation_when_nobody_takes(count: int) -> None:
    """offered = taken + drops by reason, with both kinds of room driven over their limit."""
    box, counters = outbox(light_capacity=8, heavy_capacity=3)
    for n in range(count):
        box.put(light(n))
        box.put(heavy(f"/cloud/{n % 5}", n))
    drops = counters.get("x_dropped_superseded") + counters.get("x_dropped_full")
    batch = box.take(0.0)
    assert counters.get("x_offered") == 2 * count == len(batch) + drops
    assert sum(not e.heavy for e in batch) == min(count, 8)
    assert sum(e.heavy for e in batch) <= 3
    if count > 8:
        assert counters.get("x_dropped_full") > 0


def test_a_new_run_discards_the_pictures_of_the_old_one() -> None:
    box, counters = outbox()
    box.put(heavy("/depth", 1))
    box.put(Entry("run", NewRun("two"), None))
    assert [e.primitive for e in box.take(0.0)] == [NewRun("two")]
    assert counters.get("x_dropped_superseded") == 1


def test_what_always_holds_and_another_run_are_never_what_gives_way() -> None:
    """They were the oldest, for a hub that was away: its pictures came without a lens, which ended Foxglove's sink; a
    run was drawn into the recording of the one before.
    """
    box, counters = outbox(light_capacity=4)
    kept = [Entry("/lane", Lane(), None), Entry("run", NewRun("two"), None)]
    for entry in kept:
        box.put(entry)
    for n in range(5):
        box.put(light(n))
    batch = box.take(0.0)
    assert batch[:2] == kept
    assert [e.moment.captured_ns for e in batch if e.moment] == [3, 4]
    assert counters.get("x_dropped_full") == 3


def test_taking_wakes_up_for_an_entry_and_for_the_end() -> None:
    box, _ = outbox()
    threading.Timer(0.05, box.wake).start()
    started = time.monotonic()
    assert box.take(10.0) == []
    assert time.monotonic() - started < 5
    threading.Timer(0.05, lambda: box.put(light(1))).start()
    assert len(box.take(10.0)) == 1
