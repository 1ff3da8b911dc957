"""A recording that plays by the clock: what no one took in time is gone, as with a camera."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from camera_sim.clocked import ClockedSource
from camera_sim.configured import configured_source
from camera_sim.flow import LONGEST_STEP_S
from conveyor.config import parse_config
from conveyor.errors import ConfigError
from conveyor.formats import Refused, open_source
from conveyor.formats.source import FrameKey, RecordedSource
from conveyor.messages import Frame
from tuberline.doctor.examine import examine


def played(recording: Path, *, began_s_ago: float, after: int = -1, sleep_at: int | None = None) -> list[int]:
    """Numbers of the frames that come of the left camera; this process stands still for 1 s at frame `sleep_at`."""
    camera = {"path": str(recording), "waits": False, "starts_at_s": time.time() - began_s_ago, "speed": 1.0}
    source = configured_source(parse_config({"cameras": {"left": camera}}, where="here"), "left")
    assert source.description.live
    seqs = []
    for frame in source.frames(run="r", after=after):
        assert isinstance(frame, Frame)
        seqs.append(frame.seq)
        if frame.seq == sleep_at:
            time.sleep(1.0)
    return seqs


class Still:
    """A clock that goes on only while someone sleeps: what a busy machine does in between takes no time."""

    def __init__(self) -> None:
        self.now_s = 1.7e9

    def monotonic(self) -> float:
        return self.now_s

    def time(self) -> float:
        return self.now_s

    def time_ns(self) -> int:
        return round(self.now_s * 1e9)

    def sleep(self, seconds: float, /) -> None:
        self.now_s += seconds


def test_late_frames_are_gone_and_the_last_one_stays(recording: Path) -> None:
    inner = open_source(recording, camera="left")
    keys = inner.keys()
    lasts_s = (keys[-1].captured_ns - keys[0].captured_ns) / 1e9
    last = keys[-1].seq
    assert played(recording, began_s_ago=lasts_s + 60) == [last]
    assert played(recording, began_s_ago=lasts_s + 60, after=last) == []
    due_s = [(key.captured_ns - keys[0].captured_ns) / 1e9 for key in keys]
    clock = Still()
    source = ClockedSource(inner, starts_at_s=clock.now_s - (lasts_s - 2.0), speed=1.0, clock=clock)
    seqs = [frame.seq for frame in source.frames(run="r")]
    assert seqs == list(range(seqs[0], last + 1))
    assert due_s[seqs[0]] == pytest.approx(lasts_s - 2.5, abs=0.1), "half a second of frames is kept by a device"


@pytest.mark.parametrize("set_s", [3600, -3600])
def test_a_clock_that_was_set_while_it_was_recorded_stops_nothing(recording: Path, set_s: int) -> None:
    """It played nothing for an hour; where it was set back, all frames before the last passed for long gone."""
    inner = open_source(recording, camera="left")
    keys = inner.keys()
    before = keys[:2] + keys[34:]  # those between are missing by their numbers
    stepped = [replace(key, captured_ns=key.captured_ns + (key.seq > 36) * set_s * 10**9) for key in before]

    class Set:
        description = inner.description

        def keys(self) -> list[FrameKey]:
            return stepped

        def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
            return (frame for frame in inner.frames(run=run, after=after) if not 2 <= frame.seq < 34)

    clock = Still()
    source = ClockedSource(Set(), starts_at_s=clock.now_s, speed=1.0, clock=clock)
    came = [(frame.seq, clock.now_s - 1.7e9) for frame in source.frames(run="r")]
    assert [seq for seq, _ in came] == [key.seq for key in before]
    lasts_s = (before[-1].captured_ns - before[0].captured_ns) / 1e9
    assert came[-1][1] == pytest.approx(lasts_s, abs=LONGEST_STEP_S + 0.1)
    assert dict(came)[34] == pytest.approx(34 / inner.description.fps, abs=0.05)


def test_what_passes_a_process_that_stands_still_is_a_gap_in_the_numbers(recording: Path) -> None:
    last = open_source(recording, camera="left").keys()[-1].seq
    seqs = played(recording, began_s_ago=0.0, after=last - 25, sleep_at=last - 20)
    gaps = [b - a for a, b in pairwise(seqs)]
    assert max(gaps) >= 4, "0.5 s of 15 frames a second are gone"
    assert seqs[-1] == last


def test_a_machine_that_is_slow_enough_still_gets_frames(recording: Path) -> None:
    """Each frame was read for so long that it was gone by then: there was none, for 13 minutes of six cameras."""

    class Slow:
        def __init__(self, inner: RecordedSource) -> None:
            self.inner = inner
            self.description = inner.description
            self.keys = inner.keys

        def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
            for frame in self.inner.frames(run=run, after=after):
                time.sleep(0.6)
                yield frame

    inner = open_source(recording, camera="left")
    last = inner.keys()[-1].seq
    source = ClockedSource(Slow(inner), starts_at_s=time.time(), speed=1.0)
    seqs = [frame.seq for frame in source.frames(run="r")]
    assert len(seqs) >= 2
    assert seqs[-1] == last
    assert max(b - a for a, b in pairwise(seqs)) >= 4


def test_a_time_that_is_far_off_is_told_and_one_in_milliseconds_refused(recording: Path) -> None:
    """A camera waited in silence for years, or showed one frame; `doctor` never came to an end."""

    def notes(in_s: float) -> tuple[str, ...]:
        clock = Still()
        source = ClockedSource(inner, starts_at_s=clock.now_s + in_s, speed=1.0, clock=clock)
        return source.description.notes[len(inner.description.notes) :]

    inner = open_source(recording, camera="left")
    assert notes(7200) == ("starts_at_s = 1700007200 is 2023-11-15 00:13:20 UTC: its first frame comes in 2.0 h",)
    told = "starts_at_s = 1699992800 is 2023-11-14 20:13:20 UTC: it was over 2.0 h ago, only its last frame comes"
    assert notes(-7200) == (told,)
    assert (notes(5.0), notes(-5.0)) == ((), ())
    camera = {"path": str(recording), "waits": False, "starts_at_s": time.time() + 86400}
    found = examine(parse_config({"cameras": {"left": camera}}, where="here"), offline=True)
    assert [f.level.value for f in found if "its first frame comes in 24.0 h" in f.text] == ["warning"]
    camera["starts_at_s"] = 1000 * time.time()
    with pytest.raises(ConfigError, match=r"cameras\.left\.starts_at_s: must be at most 4000000000 s \(got 1\d+\."):
        parse_config({"cameras": {"left": camera}}, where="here")


def test_it_needs_a_camera_that_waits_for_no_one() -> None:
    with pytest.raises(ConfigError, match="waits = false"):
        parse_config({"cameras": {"left": {"path": "x", "starts_at_s": 1.0}}}, where="here")
