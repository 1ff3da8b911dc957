"""A viewer process writes an .rrd of a real (small) line; the values are read back from the file."""

from __future__ import annotations

import logging
import os
import signal
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import viewer_line as line
from viewer_line import column

from conveyor import topics
from conveyor.counters import CounterSet
from conveyor.delivery import KeptPublisher, LatestPublisher, ReliablePublisher
from conveyor.formats.rvl import decode_ros_rvl

pytest.importorskip("rerun")

from viewer.rerun.file_sink import FileSink

pytestmark = pytest.mark.graph

FRAMES = 30


LABELS = "Points3D:labels"


def entities(path: Path) -> Counter[str]:
    """Rows per entity path."""
    from rerun.chunk import RrdReader

    rows: Counter[str] = Counter()
    for chunk in RrdReader(path).stream():
        rows[chunk.entity_path] += chunk.num_rows
    return rows


def values(path: Path, entity: str, component: str) -> list[float]:
    return [float(value[0]) for _, value in column(path, entity, component)]


def show_a_load(watcher: line.ViewerProcess, tubers: list[line.Potato], by: topics.Topic = topics.FRAME) -> None:
    """Publish frames, views, tubers and totals, and wait until the viewer has taken them in."""
    node = watcher.observer
    info = KeptPublisher(node, topics.CAMERA_INFO, camera="front")
    frames = LatestPublisher(node, by, camera="front")
    views = LatestPublisher(node, topics.VIEW, regressor="r1")
    counted = ReliablePublisher(node, topics.TUBER)
    totals = KeptPublisher(node, topics.TOTALS)
    in_view = LatestPublisher(node, topics.IN_VIEW, camera="front")
    info.put(line.camera_info())
    line.within(10, lambda: frames.has_listener and views.has_listener, "the viewer subscribes to frames")
    for seq in range(FRAMES):
        frames.put(line.frame(seq, tubers))
        time.sleep(1 / line.FPS)
    for seq, grams in ((FRAMES - 6, None), (FRAMES - 1, 77.0)):
        in_view.put(line.in_view(seq, (tubers[0], grams)))
    line.within(10, lambda: watcher.counter("in_view_received") == 2, "what is in view arrives")
    for tuber in tubers:
        views.put(line.view(line.crossing_seq(tuber), tuber, tubers))
        counted.put(line.counted(tuber))
    totals.put(line.totals(tubers[:1]))
    line.within(10, lambda: watcher.counter("tuber_shown") == len(tubers), "all tubers are shown")
    totals.put(line.totals(tubers, final=True))
    line.within(10, lambda: watcher.counter("frame_front_received") > FRAMES / 2, "the frames arrive")
    line.within(10, lambda: watcher.counter("totals_shown") >= 2, "the last totals are shown")
    line.within(10, lambda: watcher.settled("file"), "the file has everything")


def check_conservation(watcher: line.ViewerProcess) -> int:
    """Received = shown + drops by reason; published = handled + gaps. Returns how many pictures were offered."""
    count = watcher.counter
    shown = count("frame_shown")
    drops = [count(f"frame_{why}") for why in ("skipped_rate", "dropped_other_run", "front_dropped_overwritten")]
    assert count("frame_front_received") == shown + sum(drops) + count("frame_front_refused")
    lost_on_link = count("frame_gaps") - count("frame_front_dropped_overwritten")
    assert count("frame_front_received") + lost_on_link <= FRAMES
    assert count("view_received") == count("view_shown") + count("view_skipped_profile")
    return shown


def check_file(path: Path, tubers: list[line.Potato], *, shown: int, superseded: int, stride: int) -> None:
    """Everything a person would look at is in the file, with the right values."""
    weights = values(path, "/tuber/weight_g", "Scalars:scalars")
    assert sorted(weights) == pytest.approx(sorted(t.weight_g for t in tubers))
    assert sorted(values(path, "/tuber/weight_g", "tuber_id")) == [t.n + 1 for t in tubers]
    total_kg = sum(t.weight_g for t in tubers) / 1000
    assert values(path, "/load/weight_kg", "Measurements:values")[-1] == pytest.approx(total_kg)
    assert values(path, "/load/count", "Scalars:scalars")[-1] == len(tubers)
    page = column(path, "/load/page", "TextDocument:text")[-1][1][0]
    assert f"# {total_kg:.2f} kg" in page
    assert "The load is complete" in page
    boxes = [column(path, f"/belt/riding/tuber/{n:02d}", LABELS) for n in range(len(tubers))]
    assert [box[-1][1][0] for box in boxes] == [f"{t.weight_g:.0f} g" for t in tubers]
    provisional = [(at, label[0]) for at, label in boxes[0] if label[0].startswith("≈")]
    assert provisional == [(line.moment_ns(FRAMES - 1), "≈ 77 g")]
    assert [label[0] for at, label in boxes[0] if at == line.moment_ns(FRAMES - 1)][-1] == boxes[0][-1][1][0]
    pictures = column(path, "/belt/camera/front/image/depth", "EncodedDepthImage:blob", "frame")
    assert shown - superseded <= len(pictures) <= shown
    seq, blob = pictures[-1]
    depth = decode_ros_rvl(bytes(blob[0]))
    assert np.array_equal(depth, line.frame(seq, tubers).depth[::stride, ::stride])


def test_the_file_holds_weights_totals_and_pictures(tmp_path: Path) -> None:
    rrd, tubers = tmp_path / "load.rrd", line.potatoes(4, seed=11)
    with line.router() as link, line.viewer(link, tmp_path, "--rrd", str(rrd), "--profile", "remote") as watcher:
        show_a_load(watcher, tubers, by=topics.FRAME_FEW)
        shown, superseded = check_conservation(watcher), watcher.counter("file_dropped_superseded")
        assert 0 < shown <= FRAMES / 6 + 2
        assert watcher.counter("frame_skipped_rate") > 0
        watcher.stop()
    check_file(rrd, tubers, shown=shown, superseded=superseded, stride=2)
    paths = entities(rrd)
    assert paths["/health/viewer/test"] > 0
    assert paths["/belt/surface"] == 1
    assert any(path.startswith("/belt/riding/cloud/") for path in paths)


def test_the_file_is_readable_after_kill_9(tmp_path: Path) -> None:
    rrd, tubers = tmp_path / "load.rrd", line.potatoes(4, seed=12)
    with line.router() as link, line.viewer(link, tmp_path, "--rrd", str(rrd), "--profile", "full") as watcher:
        show_a_load(watcher, tubers)
        shown, superseded = check_conservation(watcher), watcher.counter("file_dropped_superseded")
        watcher.process.send_signal(signal.SIGKILL)
        watcher.process.wait(30)
    with pytest.warns(match="footer"):
        check_file(rrd, tubers, shown=shown, superseded=superseded, stride=1)


def test_light_subscribes_to_nothing_heavy_and_follows_the_line_into_its_next_run(tmp_path: Path) -> None:
    rrd, tubers = tmp_path / "load.rrd", line.potatoes(3, seed=13)
    with line.router() as link, line.viewer(link, tmp_path, "--rrd", str(rrd), "--profile", "light") as watcher:
        node = watcher.observer
        frames = LatestPublisher(node, topics.FRAME, camera="front")
        views = LatestPublisher(node, topics.VIEW, regressor="r1")
        info = KeptPublisher(node, topics.CAMERA_INFO, camera="front")
        counted = ReliablePublisher(node, topics.TUBER)
        for runs, run in enumerate((line.RUN, "load-8")):
            info.put(line.camera_info(run=run))
            line.within(10, lambda n=runs: watcher.counter("runs_followed") == n, f"run {run} is followed")  # type: ignore[misc]
            for tuber in tubers[runs:]:
                counted.put(line.counted(tuber, run=run))
            shown = (3, 5)[runs]
            line.within(10, lambda n=shown: watcher.counter("tuber_shown") == n, f"{shown} tubers")  # type: ignore[misc]
        counted.put(line.counted(tubers[0], run=line.RUN))
        line.within(10, lambda: watcher.counter("tuber_dropped_other_run") == 1, "an old run's tuber is refused")
        assert not frames.has_listener
        assert not views.has_listener
        line.within(10, lambda: watcher.settled("file"), "the file has everything")
        watcher.stop()
    first = values(rrd, "/tuber/weight_g", "Scalars:scalars")
    second = values(tmp_path / "load-load-8.rrd", "/tuber/weight_g", "Scalars:scalars")
    assert sorted(first) == pytest.approx(sorted(t.weight_g for t in tubers))
    assert sorted(second) == pytest.approx(sorted(t.weight_g for t in tubers[1:]))


def test_a_full_disk_share_stops_the_pictures_and_not_the_numbers(tmp_path: Path) -> None:
    rrd, tubers = tmp_path / "load.rrd", line.potatoes(4, seed=14)
    options = ("--rrd", str(rrd), "--profile", "full", "--rrd-limit-mb", "0")
    with line.router() as link, line.viewer(link, tmp_path, *options) as watcher:
        show_a_load(watcher, tubers)
        assert watcher.counter("file_dropped_size_limit") > 0
        watcher.stop()
    assert len(values(rrd, "/tuber/weight_g", "Scalars:scalars")) == len(tubers)
    assert entities(rrd)["/belt/camera/front/image/depth"] <= 1


def test_each_earlier_file_is_kept_also_of_two_within_a_second(tmp_path: Path) -> None:
    """The second took the name of the first, which was gone."""
    rrd = tmp_path / "load.rrd"
    for earlier in (b"one", b"two", b"three"):
        rrd.write_bytes(earlier)
        os.utime(rrd, (1_790_000_000.5, 1_790_000_000.5))
        sink = FileSink(rrd, limit_bytes=1, run="r", tick_s=0.1, counters=CounterSet(), log=logging.getLogger("file"))
        sink.ask_stop()
        sink.start()
        assert sink.join(30)
    names = ["load-until-20260921T141320Z", "load-until-20260921T141320Z-2", "load-until-20260921T141320Z-3"]
    assert [(tmp_path / f"{name}.rrd").read_bytes() for name in names] == [b"one", b"two", b"three"]
    assert len([*tmp_path.iterdir()]) == 4
