"""What is not sent yet is kept: bounded, in order, across kills, on a full disk and beside a damaged file."""

from __future__ import annotations

import sqlite3
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from conveyor.errors import TakenError
from tests.alarms.alarm_words import message, seen
from tuberline.alarms.machine import AlarmMachine, Timing
from tuberline.alarms.outbox import FILE, Outbox

MACHINE = AlarmMachine("north", Timing(), "box")


def put(box: Outbox, *numbers: int) -> None:
    box.put([message(n) for n in numbers], MACHINE, now_s=0.0, unix_s=1.8e9)


def drained(box: Outbox, channel: str) -> list[str]:
    ids = []
    while (head := box.head(channel)) is not None:
        ids.append(head[1].id)
        box.done(channel, head[0], lost=head[2])
    return ids


def test_each_channel_has_its_own_order_and_the_oldest_are_given_up_with_a_count(tmp_path: Path) -> None:
    with Outbox(tmp_path, channels=["a", "b"], keep=10) as box:
        put(box, *range(5))
        assert drained(box, "b") == [f"box-{n}-begin" for n in range(5)]
        put(box, *range(5, 25))
    with Outbox(tmp_path, channels=["a", "b"], keep=10) as box:
        head = box.head("a")
        assert head is not None
        assert (head[1].id, head[2]) == ("box-15-begin", 15)
        assert drained(box, "a") == [f"box-{n}-begin" for n in range(15, 25)]
        assert box.head("a") is None
        put(box, 30)
        assert box.head("a")[2] == 0  # type: ignore[index]


def test_a_message_that_was_taken_is_not_there_after_a_kill(tmp_path: Path) -> None:
    """Nothing is closed here, as after kill -9: what was put and done stands in the file."""
    box = Outbox(tmp_path, channels=["a"], keep=10).__enter__()
    put(box, 1, 2, 3)
    box.done("a", box.head("a")[0])  # type: ignore[index]
    files = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    there = tmp_path / "copy"
    there.mkdir()
    for name, content in files.items():
        (there / name).write_bytes(content)
    with Outbox(there, channels=["a"], keep=10) as again:
        assert drained(again, "a") == ["box-2-begin", "box-3-begin"]
    box.__exit__()


def test_a_message_given_up_while_it_is_under_way_is_not_mistaken_for_the_next(tmp_path: Path) -> None:
    with Outbox(tmp_path, channels=["a"], keep=10) as box:
        put(box, 0)
        under_way = box.head("a")
        assert under_way is not None
        put(box, *range(1, 11))
        box.done("a", under_way[0])
        assert drained(box, "a") == [f"box-{n}-begin" for n in range(1, 11)]


def test_a_channel_that_is_no_longer_configured_holds_nothing(tmp_path: Path) -> None:
    with Outbox(tmp_path, channels=["a", "b"], keep=10) as box:
        put(box, 1)
    with Outbox(tmp_path, channels=["b", "c"], keep=10) as box:
        assert (box.waiting("b"), box.waiting("c")) == (1, 0)
    with Outbox(tmp_path, channels=["a"], keep=10) as box:
        assert box.waiting("a") == 0


def test_a_full_disk_holds_no_message_up_and_is_made_good_later(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with Outbox(tmp_path, channels=["a"], keep=1000) as box:
        pages = box._db.execute("PRAGMA page_count").fetchone()[0]
        box._db.execute(f"PRAGMA max_page_count = {pages}")  # SQLite's own 'database or disk is full'
        put(box, *range(200))
        assert box.waiting("a") == 200
        assert "cannot be kept" in caplog.text
        assert "full" in caplog.text
        box.done("a", box.head("a")[0])  # type: ignore[index]
        box._db.execute("PRAGMA max_page_count = 100000")
        put(box, 200)
    with Outbox(tmp_path, channels=["a"], keep=1000) as box:
        assert drained(box, "a") == [f"box-{n}-begin" for n in range(1, 201)]


@pytest.fixture
def small(tmp_path: Path) -> Iterator[Path]:
    """A file system of 200 kB; skipped, loudly, where none can be mounted."""
    mount = ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", str(tmp_path)]
    done = subprocess.run(mount, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"a disk that is full at the start is not tested: {done.stderr.strip()}")
    yield tmp_path
    subprocess.run(["umount", "-l", str(tmp_path)], check=True)


@pytest.mark.parametrize("known", [True, False])
def test_a_disk_that_is_full_at_the_start_keeps_no_message_back(known: bool, small: Path) -> None:
    """`tuberline alarms` that began again on a full disk ended each time, and no one was told of the disk."""
    if known:
        with Outbox(small, channels=["a"], keep=10) as box:
            put(box, 1)
    with (small / "ballast").open("wb", buffering=0) as ballast, suppress(OSError):
        while True:
            ballast.write(bytes(4096))
    with Outbox(small, channels=["a"], keep=10) as box:
        put(box, 2)
        with pytest.raises(TakenError):
            Outbox(small, channels=["a"], keep=10).__enter__()
        assert (head := box.head("a")) is not None
        assert head[1].id == ("box-1-begin" if known else "box-2-begin")
        (small / "ballast").unlink()
        put(box, 3)
    with Outbox(small, channels=["a"], keep=10) as box:
        assert drained(box, "a") == [f"box-{n}-begin" for n in ((1, 2, 3) if known else (2, 3))]


@pytest.mark.parametrize("known", [True, False])
def test_a_disk_that_is_read_only_at_the_start_keeps_no_message_back(
    known: bool, small: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A disk that the kernel made read-only is what alarms are for: `tuberline alarms` ended with 75 on it."""
    if known:
        with Outbox(small / "alarms", channels=["a"], keep=10) as box:
            put(box, 1)
    subprocess.run(["mount", "-o", "remount,ro", small], check=True)
    with Outbox(small / "alarms", channels=["a"], keep=10) as box:
        assert "its disk is read-only; they are sent all the same" in caplog.text
        put(box, 2)
        assert (head := box.head("a")) is not None
        assert head[1].id == ("box-1-begin" if known else "box-2-begin")
        subprocess.run(["mount", "-o", "remount,rw", small], check=True)
        put(box, 3)
        with pytest.raises(TakenError):
            Outbox(small / "alarms", channels=["a"], keep=10).__enter__()
    with Outbox(small / "alarms", channels=["a"], keep=10) as box:
        assert drained(box, "a") == [f"box-{n}-begin" for n in ((1, 2, 3) if known else (2, 3))]


def test_a_damaged_file_is_set_aside(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / FILE).write_bytes(b"no database at all, but long enough to be taken for one" * 100)
    with Outbox(tmp_path, channels=["a"], keep=10) as box:
        put(box, 1)
        assert drained(box, "a") == ["box-1-begin"]
    assert "damaged" in caplog.text
    assert len(list(tmp_path.glob("*.damaged-*"))) == 1


def test_a_file_with_rows_that_cannot_be_read_is_set_aside(tmp_path: Path) -> None:
    with Outbox(tmp_path, channels=["a"], keep=10) as box:
        put(box, 1)
    with sqlite3.connect(tmp_path / FILE) as db:
        db.execute("UPDATE waiting SET message = '{\"id\": 3}'")
    db.close()
    with Outbox(tmp_path, channels=["a"], keep=10) as box:
        assert box.waiting("a") == 0
    assert len(list(tmp_path.glob("*.damaged-*"))) == 1


def test_a_second_process_is_told_that_one_is_there(tmp_path: Path) -> None:
    with Outbox(tmp_path, channels=["a"], keep=10), pytest.raises(TakenError, match="another `tuberline alarms`"):
        Outbox(tmp_path, channels=["a"], keep=10).__enter__()


def test_an_alarm_that_lasts_over_a_restart_is_told_once(tmp_path: Path) -> None:
    timing = Timing(after_s=0.0, clear_s=5.0)
    with Outbox(tmp_path, channels=["a"], keep=10) as box:
        lives = box.machine("north", timing=timing, now_s=100.0, unix_s=1.8e9)
        box.put(lives.step([seen("belt")], now_s=101, unix_s=1.8e9 + 1), lives, now_s=101, unix_s=1.8e9 + 1)
    with Outbox(tmp_path, channels=["a"], keep=10) as box:
        lives = box.machine("north", timing=timing, now_s=7.0, unix_s=1.8e9 + 60)
        told = [
            m
            for s in range(7, 30)
            for m in lives.step([seen("belt")] if s < 15 else [], now_s=s, unix_s=1.8e9 + 53 + s)
        ]
        box.put(told, lives, now_s=30, unix_s=1.8e9 + 90)
        ids = drained(box, "a")
    assert [name.rsplit("-", 1)[1] for name in ids] == ["begin", "end"]
    assert len({name.rsplit("-", 1)[0] for name in ids}) == 1
