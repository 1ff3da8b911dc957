"""Two cameras without an encoder on two hosts whose clocks differ: their belts lie side by side all the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aggregator.core.camera_clocks import AGREE_S, ENOUGH, CameraClocks
from aggregator.core.coverage import Moment, coverage
from aggregator.core.sight import CameraSight
from aggregator.ledger.writer import Ledger
from conveyor.geometry import Intrinsics
from conveyor.messages import CameraInfo, Tuber
from tests.aggregator.belt_story import CLOCK_S, Stop, Story, tell
from tests.aggregator.looking_story import look, positions_m
from tests.aggregator.virtual_line import Aggregator

SECOND_NS = 1_000_000_000


@pytest.mark.parametrize("ahead_s", [0.0, 0.03, -2.0, 0.3, 3600.0, -86400.0])
def test_the_quickest_of_many_reports_tells_what_clocks_differ(ahead_s: float, rng: np.random.Generator) -> None:
    """On a busy host reports come a second late; that is no difference of clocks, not even at first."""
    for _ in range(20):
        clocks = CameraClocks()
        for at_s in range(60):
            found_ns = clocks.ahead_ns("b", of="a")
            assert at_s >= ENOUGH or found_ns is None
            if found_ns is not None and abs(ahead_s) < AGREE_S:
                assert abs(found_ns) / SECOND_NS <= (0.1 if ahead_s else 0.0)
            elif found_ns is not None:
                assert found_ns / SECOND_NS == pytest.approx(ahead_s, abs=1.0 if at_s < 10 else 0.2)
            for camera, own_s in (("a", 0.0), ("b", ahead_s)):
                sent_s = at_s + rng.random()
                late_s = 0.002 + rng.exponential(0.2)
                clocks.reported(camera, CLOCK_S + own_s + sent_s, host=camera, arrived_s=sent_s + late_s)
                clocks.reported(camera, CLOCK_S + own_s + sent_s, host=camera, arrived_s=sent_s + late_s + 1.0)  # again
        last_ns = clocks.ahead_ns("b", of="a")
        assert last_ns is not None
        assert last_ns / SECOND_NS == (pytest.approx(ahead_s, abs=0.03) if abs(ahead_s) > AGREE_S else 0.0)


def test_one_host_has_one_clock_however_late_its_frames_are() -> None:
    """Under overload the quickest frames of two cameras of one host were 0.4 s apart for a minute."""
    clocks = CameraClocks()
    for at_s in range(10):
        clocks.reported("a", CLOCK_S + at_s, host="farm", arrived_s=at_s)
        clocks.reported("b", CLOCK_S + at_s - 0.4, host="farm", arrived_s=at_s)
        assert clocks.ahead_ns("b", of="a") == 0


@pytest.mark.parametrize("camera_s", [1e300, -1e300, 1e10])
def test_an_absurd_clock_is_no_clock(camera_s: float) -> None:
    clocks = CameraClocks()
    for at_s in range(2 * ENOUGH):
        clocks.reported("a", CLOCK_S + at_s, host="h1", arrived_s=at_s)
        clocks.reported("b", camera_s + at_s, host="h2", arrived_s=at_s)
    assert clocks.ahead_ns("b", of="a") is None


def shifted(told: Story, camera: str, by_s: float) -> Story:
    """The same belt, one camera's clock ahead of the other's."""
    by_ns = round(by_s * SECOND_NS)
    log = []
    for entry in told.logs[camera]:
        track, mark = entry.track, entry.mark
        log.append(
            replace(
                entry,
                track=track and replace(track, crossed_ns=track.crossed_ns + by_ns),
                mark=mark and replace(mark, captured_ns=mark.captured_ns + by_ns, complete_ns=mark.complete_ns + by_ns),
            )
        )
    return replace(told, logs={**told.logs, camera: log})


def counted(told: Story, folder: Path, *, ahead_s: float, reported: bool = True) -> list[Tuber]:
    """The tubers of a live line that hears entries when they are due, and each segmenter's reports."""
    return counted_on_belt(told, folder, ahead_s=ahead_s, reported=reported)[0]


def counted_on_belt(told: Story, folder: Path, *, ahead_s: float, reported: bool = True) -> tuple[list[Tuber], float]:
    """The same, and how much belt passed in all, metres."""
    lens = Intrinsics(10, 10, 10.0, 10.0, 5.0, 5.0)
    with Ledger(folder) as ledger:
        line = Aggregator(ledger, told)
        core = line.core
        for name in told.names:
            info = CameraInfo(name, told.run, "streaming", "t", 30, False, lens, 0.001, None, None, 0, {}, live=True)
            core.cameras.info(info, 0.0)
        waiting = {name: list(told.logs[name]) for name in told.names}
        now_s = 0.0
        while any(waiting.values()):
            now_s += 0.5
            for name in told.names:
                own_s = CLOCK_S + (ahead_s if name == "cam1" else 0.0)
                if reported and now_s % 1.0 == 0.0:
                    core.cameras.clock(name, own_s + now_s - 0.01, host=name, arrived_s=now_s)
                while waiting[name] and _due_s(waiting[name][0], own_s) <= now_s:
                    core.receive(waiting[name].pop(0), now_s=now_s)
            ledger.write(told.run, core.commit(now_s=now_s))
        ledger.write(told.run, core.commit(now_s=now_s + 100.0))
        assert core.finished
        looked = coverage(core.cameras.sights, seen_by={}, moment=core.cameras.moment(now_s, over=True))
        return line.tubers(), looked.belt_m


def _due_s(entry: object, own_s: float) -> float:
    mark = getattr(entry, "mark", None)
    return 0.0 if mark is None else mark.captured_ns / SECOND_NS - own_s


@pytest.mark.parametrize("ahead_s", [-0.4, 3600.0])
def test_tubers_of_two_hosts_are_those_of_one(ahead_s: float, tmp_path: Path) -> None:
    """A clock 0.4 s behind laid its camera's belt 0.12 m off: tubers that both saw counted twice."""
    told = tell(5, cameras=2, estimated=True, n=30, length_m=4.0)
    alike = counted(told, tmp_path / "one.db", ahead_s=0.0)
    apart = counted(shifted(told, "cam1", ahead_s), tmp_path / "two.db", ahead_s=ahead_s)
    assert len(alike) == len(told.seen())
    assert any(len(tuber.cameras) == 2 for tuber in alike)
    assert [t.cameras for t in apart] == [t.cameras for t in alike]
    assert [t.place_x_m for t in apart] == pytest.approx([t.place_x_m for t in alike], abs=1e-4)
    assert [t.weight_g for t in apart] == pytest.approx([t.weight_g for t in alike])


@pytest.mark.parametrize("ahead_s", [0.0, -2.0, 3600.0])
def test_a_belt_is_as_long_by_another_clock(ahead_s: float, tmp_path: Path) -> None:
    """The second camera ends 0.1 s after the first, which saw bare belt for a while: an hour of belt that never ran."""
    told = tell(5, cameras=2, estimated=True, n=30, length_m=4.0, stop=Stop(5.0, 1.0))
    later = shifted(told, "cam1", ahead_s + 0.1)
    _, belt_m = counted_on_belt(later, tmp_path / "ledger.db", ahead_s=ahead_s)
    last = told.logs["cam1"][-1].mark
    assert last is not None
    assert belt_m == pytest.approx(last.travelled_m, abs=0.2)


def test_without_reports_the_clocks_are_taken_to_agree(tmp_path: Path) -> None:
    """A segmenter of an older version says nothing of its camera's clock: its tubers are counted all the same."""
    told = tell(5, cameras=2, estimated=True, n=30, length_m=4.0)
    assert len(counted(told, tmp_path / "none.db", ahead_s=0.0, reported=False)) == len(told.seen())


def test_coverage_knows_of_no_clock(rng: np.random.Generator) -> None:
    belt_m = positions_m(rng, 30.0, steady=True)
    a = look(belt_m, [], estimated=True, final=True).sight
    b = look(belt_m[40:], [], estimated=True, final=True).sight
    alike = coverage({"a": a, "b": b}, seen_by={}, moment=Moment(over=True))
    for ahead_ns in (-700_000_000, 20 * SECOND_NS, 3600 * SECOND_NS):
        off = CameraSight.from_plain(b.plain())
        off.first_ns = (off.first_ns or 0) + ahead_ns
        off.curve = [(t_ns + ahead_ns, s) for t_ns, s in off.curve]
        off.complete_ns, off.ahead_ns = off.complete_ns + ahead_ns, ahead_ns
        for name in ("first_ns", "last_ns"):
            if (at := getattr(off.published, name)) is not None:
                setattr(off.published, name, at + ahead_ns)
        assert coverage({"a": a, "b": off}, seen_by={}, moment=Moment(over=True)) == alike
        assert CameraSight.from_plain(off.plain()) == off
    assert "ahead_ns" not in a.plain(), "a version before this one reads it"
