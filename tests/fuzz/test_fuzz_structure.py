"""Headers built field by field from the message classes: taken within all declared ranges, or refused."""

from __future__ import annotations

import random
import tracemalloc
from collections import Counter
from dataclasses import fields, is_dataclass
from typing import Any, get_args, get_type_hints

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from aggregator.core.load_sums import LoadSums
from aggregator.core.merge import Group, PlacedTrack
from aggregator.core.totals import LoadTotals
from aggregator.core.tubers import make_tuber
from conveyor import messages as m
from conveyor.messages.base import Message
from conveyor.ranges import Items, Range, Text
from regressor.serve.messages import WeightsParcel
from tests.fuzz.damage import EFFORT, bounded_memory, quick
from tests.fuzz.structure import CLASSES, build, read

UNSHRUNK = (Phase.reuse, Phase.generate)
"""Shrinking a message of a thousand choices takes minutes, and its error names the field as it is."""
MOST_BYTES_EACH = 160 << 20
"""Twice the arrays' limit, and 32 MiB: an array and its compressed bytes, a header and the errors about it."""


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_every_field_says_what_it_may_hold(cls: type[Message]) -> None:
    def walk(hint: Any, where: str) -> None:
        marks = [mark for mark in getattr(hint, "__metadata__", ()) if isinstance(mark, Range | Text | Items)]
        kind = get_args(hint)[0] if hasattr(hint, "__metadata__") else hint
        if is_dataclass(kind):
            hints = get_type_hints(kind, include_extras=True)
            for f in fields(kind):
                if f.name not in getattr(kind, "ARRAYS", {}):
                    walk(hints[f.name], f"{where}.{f.name}")
        elif kind in (int, float, str):
            assert marks, f"{where} is any {kind.__name__}"
            if isinstance(marks[0], Range):
                assert kind is float or all(type(limit) is int for limit in (marks[0].low, marks[0].high)), where
        elif getattr(kind, "__origin__", None) in (dict, tuple):
            assert any(isinstance(mark, Items) for mark in marks), f"{where} holds any number of items"
        for inner in get_args(kind):
            if not isinstance(inner, str) and inner is not Ellipsis:
                walk(inner, where)

    walk(cls, cls.__name__)


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_headers_at_and_beyond_their_limits(cls: type[Message]) -> None:
    seen: set[str] = set()

    @settings(quick(120), phases=UNSHRUNK)
    @given(st.data())
    def decode(data: st.DataObject) -> None:
        seen.add(read(cls, build(cls, lambda options: data.draw(st.sampled_from(options)))))

    with bounded_memory():
        decode()
    assert "value" in seen


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_many_headers_at_and_beyond_their_limits(cls: type[Message]) -> None:
    seed = random.SystemRandom().randrange(1 << 32) if EFFORT else 5
    rng = random.Random(f"{seed} {cls.__name__}")
    count = int(400 * (EFFORT or 1))
    seen = Counter(read(cls, build(cls, rng.choice)) for _ in range(count))
    assert seen["value"] > count / 10, (seed, seen)
    assert seen["range"] > count / 100 or cls is WeightsParcel, (seed, seen)
    assert seen["field"], (seed, seen)


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_reading_takes_no_more_memory_than_it_may(cls: type[Message]) -> None:
    rng = random.Random(cls.__name__)
    samples = [build(cls, rng.choice) for _ in range(60)]
    tracemalloc.start()
    try:
        for built in samples:
            read(cls, built)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < MOST_BYTES_EACH


def test_any_tracks_that_are_taken_make_a_tuber_and_totals_that_can_be_sent() -> None:
    """Each value at a limit of its range: fusion must not make one of them that ends the aggregator."""
    seed = random.SystemRandom().randrange(1 << 32) if EFFORT else 11
    rng = random.Random(seed)
    tracks: list[m.Track] = []
    while len(tracks) < int(300 * (EFFORT or 1)):
        built = build(m.TrackEntry, rng.choice)
        if not built.wrong and (track := m.TrackEntry.decode(built.data).track) is not None:
            tracks.append(track)
    sums = LoadSums(50.0)
    for n, track in enumerate(tracks, start=1):
        others = [track, *rng.sample(tracks, rng.choice((0, 1, 2, 5)))]
        members = [PlacedTrack(f"c{k % 2}", n, seen, seen.place_x_m, seen.y_m) for k, seen in enumerate(others)]
        tuber = make_tuber(Group(members), run="r", tuber_id=n)
        tuber.check()
        sums.add(tuber)
        LoadTotals(sums).message(
            "r", coverage=rng.choice((None, 0.0, 5e-324, 1e-9, 0.5, 1.0)), cameras={}, final=False
        ).check()
