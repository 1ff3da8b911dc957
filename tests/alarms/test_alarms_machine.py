"""The laws of alarms: each beginning has one end, none comes back too soon, nothing ends that no one could see."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.alarms.alarm_words import seen
from tuberline.alarms.machine import MOST_BEGINNINGS_PER_MIN, AlarmMachine, Timing
from tuberline.alarms.message import AlarmMessage
from tuberline.alarms.outbox import Outbox

TIMING = Timing(after_s=5.0, clear_s=10.0, again_after_s=30.0)
DAY = 1_800_000_000.0
KEYS = ("camera-left-belt", "stalled-segmenter/left", "disk-ledger")
MOMENT = st.tuples(
    st.frozensets(st.sampled_from(KEYS)),
    st.floats(0.1, 12.0),
    st.frozensets(st.sampled_from(KEYS)),
    st.sampled_from(("run", "run", "run", "restart")),
)


def machine() -> AlarmMachine:
    return AlarmMachine("north", TIMING, "box")


@settings(max_examples=40)
@given(story=st.lists(MOMENT, min_size=1, max_size=60))
def test_each_beginning_has_one_end_and_begins_no_sooner_than_it_may(
    story: list[tuple[frozenset[str], float, frozenset[str], str]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Whatever is seen, unknown or restarted in between, from the outbox's file and back."""
    folder = tmp_path_factory.mktemp("outbox")
    now_s, sent = 1000.0, []
    box = Outbox(folder, channels=["c"], keep=1000).__enter__()
    lives = box.machine("north", timing=TIMING, now_s=now_s, unix_s=DAY + now_s)
    quiet = [(frozenset[str](), 1.0, frozenset[str](), "run")] * 15
    for there, pause_s, unknown, what in story + quiet:
        now_s += pause_s
        if what == "restart":
            box.__exit__()
            box = Outbox(folder, channels=["c"], keep=1000).__enter__()
            lives = box.machine("north", timing=TIMING, now_s=now_s, unix_s=DAY + now_s)
        told = lives.step(map(seen, sorted(there)), now_s=now_s, unix_s=DAY + now_s, unknown=unknown - there)
        box.put(told, lives, now_s=now_s, unix_s=DAY + now_s)
        sent += [(now_s, message) for message in told]
    kept = _drained(box)
    box.__exit__()
    assert [message for _, message in sent] == kept
    assert len({message.id for _, message in sent}) == len(sent)
    by_key = defaultdict(list)
    for when_s, message in sent:
        by_key[message.key].append((when_s, message))
    for told in by_key.values():
        assert [m.event for _, m in told] == ["begin", "end"] * (len(told) // 2)
        assert [m.alarm for _, m in told[::2]] == [m.alarm for _, m in told[1::2]]
        begun = [when_s for when_s, m in told if m.event == "begin"]
        assert all(later - sooner >= TIMING.again_after_s - 1e-6 for sooner, later in pairwise(begun))
    assert not lives.active


def _drained(box: Outbox) -> list[AlarmMessage]:
    messages = []
    while (head := box.head("c")) is not None:
        messages.append(head[1])
        box.done("c", head[0])
    return messages


def test_what_flaps_is_one_alarm_and_what_is_brief_is_none() -> None:
    lives = machine()
    told = []
    for second in range(120):
        flapping = [seen("flaps")] if second < 60 and (second < 10 or second % 2) else []
        brief = [seen("brief")] if second in (3, 4, 5) else []
        told += lives.step(flapping + brief, now_s=second, unix_s=DAY + second)
    assert [(m.key, m.event) for m in told] == [("flaps", "begin"), ("flaps", "end")]
    begin, end = told
    assert (begin.since_unix_s, end.since_unix_s, end.ended_unix_s) == (DAY, DAY, DAY + 59)
    assert (begin.id, end.id) == ("box-0-begin", "box-0-end")


def test_nothing_ends_while_nothing_is_known_of_it() -> None:
    """A line that cannot be reached may still be in trouble: its alarms last until they are seen to have ended."""
    lives = machine()
    for second in range(10):
        lives.step([seen("belt")], now_s=second, unix_s=DAY + second)
    for second in range(10, 3600):
        assert lives.step([], now_s=second, unix_s=DAY + second, unknown=frozenset(lives.active)) == []
    ends = [m.event for s in range(3600, 3620) for m in lives.step([], now_s=s, unix_s=DAY + s)]
    assert ends == ["end"]


def test_names_without_end_begin_few_alarms_and_are_not_remembered() -> None:
    lives = machine()
    begun = 0
    for second in range(300):
        names = [seen(f"stalled-camera/forged{n}") for n in range(second // 8 * 500, second // 8 * 500 + 500)]
        begun += sum(m.event == "begin" for m in lives.step(names, now_s=second, unix_s=DAY + second))
        assert len(lives.active) <= MOST_BEGINNINGS_PER_MIN
        assert len(lives.recent_s) <= 1024
    assert 0 < begun <= MOST_BEGINNINGS_PER_MIN * 5


def test_a_wall_clock_that_steps_changes_no_decision_and_no_text_is_forged() -> None:
    lives = machine()
    told = []
    for second in range(60):
        there = [seen("belt", text="drift\nalarm over\x1b[2J" + "x" * 5000)] if second < 20 else []
        told += lives.step(there, now_s=second, unix_s=DAY + (-86400 if second % 2 else 86400) + second)
    assert [m.event for m in told] == ["begin", "end"]
    assert "\n" not in told[0].text
    assert "\x1b" not in told[0].text
    assert len(told[0].text) < 500
    assert told[1].title.startswith("north: over after ")


def test_a_message_survives_the_outbox_and_says_what_a_person_needs(tmp_path: Path) -> None:
    lives = machine()
    told = [m for s in range(7) for m in lives.step([seen("belt", camera="left")], now_s=s, unix_s=DAY + s)]
    with Outbox(tmp_path, channels=["c"], keep=10) as box:
        box.put(told, lives, now_s=7, unix_s=DAY + 7)
    with Outbox(tmp_path, channels=["c"], keep=10) as box:
        kept = box.head("c")
    assert kept is not None
    assert kept[1] == told[0]
    shown = kept[1].as_dict(lost_before=3)
    assert shown["title"] == "north, camera left: belt is wrong."
    assert (shown["event"], shown["line"], shown["camera"], shown["fix"]) == ("begin", "north", "left", "Repair it.")
    assert (shown["since"], shown["ended"], shown["lost_before"]) == ("2027-01-15T08:00:00+00:00", None, 3)
