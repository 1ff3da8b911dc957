"""The recorder's process: what it wrote is whole, and survives its own death."""

from __future__ import annotations

import resource
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from camera_sim.recorder import stated_resting
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SceneSettings
from conveyor import topics
from conveyor.config import BeltConfig, LinkConfig
from conveyor.delivery import LatestPublisher, ReliablePublisher
from conveyor.errors import PASSING
from conveyor.files import free_name
from conveyor.formats import describe_recording, open_source
from conveyor.formats.beside import is_taken
from conveyor.formats.conversion import convert_recording
from conveyor.formats.mcap.recovery import recover
from conveyor.formats.positions import read_positions
from conveyor.messages import Frame, Position
from conveyor.node import Node
from tests.camera_sim.camera_process import OtherSide, line, other_side, process
from tests.conftest import wait_until
from tuberline.replayer import take_positions

pytestmark = pytest.mark.graph
POSITIONS = [Position("gnss", "r", n, 10**18 + n * 10**9, 10**18, 52.7 + n * 1e-5, 5.75, 4, 0.7, 14) for n in range(3)]


def _wait_for_recorder(side: OtherSide) -> None:
    """Until it listens: its first word comes before it does, and a frame that is published between is lost to it."""
    wait_until(lambda: (c := side.counters("recorder")) and "frames_written" in c.values, what="the recorder")


def _always_ready(side: OtherSide) -> None:
    """Be a segmenter that is done with everything at once, after it has seen the first frame."""
    side.done(-1)
    wait_until(lambda: side.take(), what="the first frame")
    side.done(10**6)


def test_what_a_camera_published_is_recorded_frame_by_frame(
    link: LinkConfig, small_recording: Path, tmp_path: Path
) -> None:
    config, out = line(link, path=small_recording, speed=2.0, waits=True), tmp_path / "line.mcap"
    config = config.model_copy(update={"belt": BeltConfig(resting_offset_mm=5.5, resting_sd_mm=1.5)})
    with other_side(config) as side, process(config, tmp_path, "recorder", "--out", str(out)) as recorder:
        _wait_for_recorder(side)
        with (
            process(config, tmp_path, "camera", "--camera", "front"),
            Node("gnss", "gnss", config=config, run="r") as gnss,
        ):
            drive = ReliablePublisher(gnss, topics.POSITION, receiver="gnss")
            for at in POSITIONS:
                drive.put(at)
            _always_ready(side)
            info = side.wait_for_state("ended")
            wait_until(
                lambda: (c := side.counters("recorder")) and c.values.get("frames_written") == info.published,
                what="all frames on disk",
            )
            wait_until(
                lambda: (c := side.counters("recorder")) and c.values["positions_written"] == len(POSITIONS),
                what="all positions on disk",
            )
        counters = side.counters("recorder")
        recorder.send_signal(signal.SIGTERM)
        assert recorder.wait(30) == 0
    assert counters is not None
    assert counters.values["frames_missing"] == counters.values["frame_dropped_overwritten"] == 0
    recorded = [frame for frame in open_source(out).frames(run="r") if isinstance(frame, Frame)]
    original = [frame for frame in open_source(small_recording).frames(run="r") if isinstance(frame, Frame)]
    assert [frame.encode() for frame in recorded] == [frame.encode() for frame in original]
    (camera,) = describe_recording(out).cameras
    assert camera.fps == 10.0
    assert (camera.resting_offset_mm, camera.resting_sd_mm) == (5.5, 1.5), "its replay read 9 % light at 5 mm"
    assert stated_resting(BeltConfig()) == stated_resting(BeltConfig(surface="rods", resting_offset_mm=1.0)) == {}
    _positions_go_with_it(out, tmp_path)


def _positions_go_with_it(recorded: Path, folder: Path) -> None:
    """Into other formats, through a repair, and into the run that replays it."""
    places = [(at.time_ns, at.lat_deg, at.lon_deg, at.quality) for at in POSITIONS]
    convert_recording(recorded, folder / "plain")
    convert_recording(folder / "plain", folder / "again.mcap")
    recover(recorded, folder / "repaired.mcap")
    for source in (recorded, folder / "plain", folder / "again.mcap", folder / "repaired.mcap"):
        (out := folder / f"run of {source.name}").mkdir()
        take_positions(source, out)
        found = read_positions(out / "positions.csv")
        assert [(at.time_ns, at.lat_deg, at.lon_deg, at.quality) for at in found] == places, source


def test_a_killed_recorder_loses_at_most_its_last_chunk(
    link: LinkConfig, small_settings: SceneSettings, tmp_path: Path
) -> None:
    record_scene(tmp_path / "long", replace(small_settings, tubers=30, fps=30.0))
    config, out = line(link, path=tmp_path / "long", speed=1.0, waits=True), tmp_path / "line.mcap"
    with other_side(config) as side, process(config, tmp_path, "recorder", "--out", str(out)) as recorder:
        _wait_for_recorder(side)
        with process(config, tmp_path, "camera", "--camera", "front"):
            _always_ready(side)
            wait_until(
                lambda: (c := side.counters("recorder")) and c.values.get("frames_written", 0) > 30,
                what="30 frames written",
            )
            counters = side.counters("recorder")
            recorder.kill()
            recorder.wait(30)
    saved = recover(out, tmp_path / "saved.mcap")
    frames_per_chunk = (1 << 20) // (320 * 180 * 2) + 1
    assert not saved.whole
    assert counters is not None
    assert saved.messages["camera/front/frame"] >= counters.values["frames_written"] - frames_per_chunk
    original = {item.seq: item.encode() for item in open_source(tmp_path / "long").frames(run="r")}
    whole = list(open_source(tmp_path / "saved.mcap").frames(run="r"))
    assert [item.seq for item in whole] == sorted({item.seq for item in whole})
    assert all(item.encode() == original[item.seq] for item in whole)


def test_a_recorder_that_is_started_again_goes_on_in_a_new_part(
    link: LinkConfig, small_recording: Path, tmp_path: Path
) -> None:
    """It refused the file that it had begun itself, and a unit that systemd restarts stayed down."""
    out = tmp_path / "line.mcap"
    assert free_name(out) == out
    config = line(link, path=small_recording)
    with other_side(config) as side:
        for part in (out, tmp_path / "line-2.mcap"):
            with process(config, tmp_path, "recorder", "--out", str(out)) as recorder:
                wait_until(lambda: part.is_file() and side.counters("recorder"), what=f"{part.name}")  # noqa: B023
                recorder.send_signal(signal.SIGTERM)
                told, _ = recorder.communicate(timeout=30)
                assert (recorder.returncode, told) == (0, f"0 frames in {part}\n")
    assert free_name(out) == tmp_path / "line-3.mcap"
    (tmp_path / "line-3.positions.csv").write_text("of a recording that was removed")
    assert free_name(out, is_taken) == tmp_path / "line-4.mcap", "positions would be added to those of another drive"


def test_a_line_that_is_started_again_begins_a_new_part(
    link: LinkConfig, small_recording: Path, tmp_path: Path
) -> None:
    """Its numbers begin at 0 again: in one file the second run hid behind the first, and nothing told of it."""
    config, out = line(link, path=small_recording), tmp_path / "line.mcap"
    whole = next(item for item in open_source(small_recording).frames(run="r") if isinstance(item, Frame))
    size = replace(whole.intrinsics, width=32, height=18)
    small = replace(whole, intrinsics=size, depth=whole.depth[:18, :32], mask=None)
    with other_side(config) as side, process(config, tmp_path, "recorder", "--out", str(out)) as recorder:
        frames = LatestPublisher(side.node, topics.FRAME, camera="front")

        def count(counter: str) -> int:
            counters = side.counters("recorder")
            return 0 if counters is None else counters.values.get(counter, 0)

        def written(run: str, seq: int) -> int:
            """Frames in the files; this one is sent again, for a recorder that starts, or a full link, loses some."""
            frames.put(replace(small, run=run, seq=seq))
            return count("frames_written")

        for n, (run, seq) in enumerate([("a", 0), ("a", 1), ("b", 0), ("b", 1), ("b", 2)], 1):
            wait_until(lambda: written(run, seq) == n, what=f"{n} frames in the files")  # noqa: B023
            if n == 3:
                frames.put(replace(small, run="a", seq=2))
                wait_until(lambda: count("frames_of_another_run"), what="the frame of a run that was left")
        recorder.send_signal(signal.SIGTERM)
        told, _ = recorder.communicate(timeout=30)
        counters = side.counters("recorder")
    assert told == f"2 frames in {out}\n3 frames in {tmp_path / 'line-2.mcap'}\n"
    assert counters is not None
    assert counters.values["frames_of_another_run"] == 1, "a run that was left does not come back"
    assert [item.seq for item in open_source(out).frames(run="r")] == [0, 1]
    assert [item.seq for item in open_source(tmp_path / "line-2.mcap").frames(run="r")] == [0, 1, 2]


def test_a_recorder_without_room_is_tried_again_and_leaves_no_empty_parts(
    link: LinkConfig, small_recording: Path, tmp_path: Path
) -> None:
    out = tmp_path / "line.mcap"
    config = line(link, path=small_recording)
    with other_side(config), process(config, tmp_path, "recorder", "--out", str(out)) as recorder:
        wait_until(out.is_file, what="its file")
        resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (0, 0))
        _, said = recorder.communicate(timeout=30)
    assert recorder.returncode == PASSING, said
    assert f"recording {out}: File too large" in said
    assert "Traceback" not in said
    assert not out.exists()
