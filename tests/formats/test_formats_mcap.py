"""MCAP recordings: nothing changes on the way in and out, and a killed writer's file can be saved."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SceneSettings
from conveyor.errors import InputError
from conveyor.formats import Refused, describe_recording, open_source
from conveyor.formats.conversion import convert_recording
from conveyor.formats.inspection import inspect_recording
from conveyor.formats.mcap.reader import rate_of
from conveyor.formats.mcap.recovery import recover
from conveyor.formats.mcap.writer import McapFrameWriter
from conveyor.formats.target import TargetFormat
from conveyor.messages import Frame
from tuberline.cli.recordings import convert, info
from tuberline.cli.simulate import simulate


def _hashes(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture
def mcap(small_recording: Path, tmp_path: Path) -> Path:
    convert_recording(small_recording, tmp_path / "r.mcap")
    return tmp_path / "r.mcap"


def test_folder_to_mcap_and_back_is_byte_for_byte(small_settings: SceneSettings, tmp_path: Path) -> None:
    record_scene(tmp_path / "r", replace(small_settings, scene="two-cameras"), masks=True, color=True)
    there = convert_recording(tmp_path / "r", tmp_path / "r.mcap")
    back = convert_recording(tmp_path / "r.mcap", tmp_path / "back")
    assert _hashes(tmp_path / "back") == _hashes(tmp_path / "r")
    assert there.frames == back.frames == sum(c.frames for c in describe_recording(tmp_path / "r").cameras)
    assert (there.refused, back.refused) == ({}, {})


@pytest.mark.parametrize("unit_m", [0.001, 0.0001])
def test_there_and_back_over_ros_2_topics_nothing_is_lost(
    small_settings: SceneSettings, tmp_path: Path, unit_m: float
) -> None:
    """Numbers with gaps, clock jumps, travel, masks, colour, unit, belt distance, truth: all of it comes back."""
    pytest.importorskip("rosbags")
    settings = replace(small_settings, scene="two-cameras", unit_m=unit_m)
    record_scene(tmp_path / "r", settings, masks=True, color=True, faults=("dropped", "clock-jump"))
    there = convert_recording(tmp_path / "r", tmp_path / "ros.mcap", form="ros2")
    assert describe_recording(tmp_path / "ros.mcap").kind == "ros2-export"
    back = convert_recording(tmp_path / "ros.mcap", tmp_path / "back")
    assert _hashes(tmp_path / "back") == _hashes(tmp_path / "r")
    assert (there.frames, there.refused) == (back.frames, back.refused)


def test_ros_2_topics_are_what_ros_expects(small_recording: Path, tmp_path: Path) -> None:
    """Read as a bag of somebody else's, by the topics alone, the depth is the same in metres."""
    pytest.importorskip("rosbags")
    from conveyor.formats.rosbag.reader import RosBagSource

    convert_recording(small_recording, tmp_path / "ros.mcap", form="ros2")
    own, bag = open_source(small_recording), RosBagSource(tmp_path / "ros.mcap", "front")
    assert bag.description.intrinsics == own.description.intrinsics
    for one, two in zip(own.frames(run="x"), bag.frames(run="x"), strict=True):
        assert isinstance(one, Frame)
        assert isinstance(two, Frame)
        assert np.array_equal(one.depth, two.depth)
        assert (one.captured_ns, one.depth_scale_m) == (two.captured_ns, two.depth_scale_m)


@pytest.mark.parametrize("form", ["auto", "ros2"])
def test_simulated_straight_to_mcap_is_the_same_recording(
    small_settings: SceneSettings, tmp_path: Path, form: TargetFormat
) -> None:
    settings = replace(small_settings, scene="two-cameras", tubers=3)
    truth = record_scene(tmp_path / "r.mcap", settings, masks=True, form=form)
    record_scene(tmp_path / "r", settings, masks=True)
    convert_recording(tmp_path / "r.mcap", tmp_path / "unpacked")
    assert _hashes(tmp_path / "unpacked") == _hashes(tmp_path / "r")
    assert json.loads((tmp_path / "r.truth.json").read_text()) == truth


def test_a_name_that_contradicts_the_format_is_refused(small_recording: Path, tmp_path: Path) -> None:
    for name, form in (("r.mcap", "folder"), ("r", "mcap"), ("r", "ros2")):
        with pytest.raises(InputError, match=rf"for --format {form} the name must"):
            convert_recording(small_recording, tmp_path / name, form=form)


def test_an_mcap_source_is_like_the_folder_it_came_from(small_recording: Path, mcap: Path) -> None:
    one, two = open_source(small_recording), open_source(mcap)
    for field in ("name", "intrinsics", "depth_scale_m", "belt_distance_m", "fps", "frames"):
        assert getattr(one.description, field) == getattr(two.description, field)
    frames = zip(one.frames(run="x"), two.frames(run="x"), strict=True)
    assert all(a.encode() == b.encode() for a, b in frames)
    assert [item.seq for item in two.frames(run="x", after=5)][:2] == [6, 7]


def test_a_clock_that_jumps_back_does_not_reorder_frames(small_recording: Path, tmp_path: Path) -> None:
    frames = [item for item in open_source(small_recording).frames(run="x") if isinstance(item, Frame)]
    with McapFrameWriter(tmp_path / "jump.mcap") as writer:
        for frame in frames:
            jump = -3_600_000_000_000 if frame.seq >= 8 else 0
            writer.write(replace(frame, captured_ns=frame.captured_ns + jump))
    read = list(open_source(tmp_path / "jump.mcap").frames(run="x"))
    assert [item.seq for item in read] == [frame.seq for frame in frames]
    report = inspect_recording(tmp_path / "jump.mcap").cameras[0]
    assert report.clock_faults == 1
    assert any("step backwards" in warning for warning in report.warnings)


def test_an_undecodable_message_is_refused_by_number_and_the_rest_goes_on(mcap: Path, tmp_path: Path) -> None:
    from mcap.reader import make_reader
    from mcap.writer import Writer

    with mcap.open("rb") as source, (tmp_path / "bad.mcap").open("wb") as target:
        writer = Writer(target)
        writer.start("tuberline")
        channel = writer.register_channel("camera/front/frame", "tuberline", 0)
        for n, (_, _, message) in enumerate(make_reader(source).iter_messages()):
            data = message.data[:-1] if n == 4 else message.data
            writer.add_message(channel, message.log_time, data, message.log_time, message.sequence)
        writer.finish()
    items = list(open_source(tmp_path / "bad.mcap").frames(run="x"))
    refused = [item for item in items if isinstance(item, Refused)]
    assert [(item.seq, item.reason) for item in refused] == [(4, "undecodable")]
    assert "truncated" in refused[0].text
    assert isinstance(items[5], Frame)


@pytest.mark.parametrize("kept", [0.5, 0.9, 0.999])
def test_a_cut_file_is_refused_with_the_way_out_and_saved_up_to_the_cut(
    mcap: Path, tmp_path: Path, kept: float
) -> None:
    whole = [item.encode() for item in open_source(mcap).frames(run="x")]
    data = mcap.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(len(data) * kept)])
    with pytest.raises(InputError, match=r"tuberline recover"):
        open_source(cut)
    saved = recover(cut, tmp_path / "saved.mcap")
    assert not saved.whole
    count = saved.messages["camera/front/frame"]
    assert count >= max(1, int(kept * len(whole)) - 10)  # at most one chunk of 1 MiB is lost
    assert [item.encode() for item in open_source(tmp_path / "saved.mcap").frames(run="x")] == whole[:count]


def test_a_flipped_bit_loses_what_follows_and_nothing_silently(mcap: Path, tmp_path: Path) -> None:
    data = bytearray(mcap.read_bytes())
    data[len(data) // 2] ^= 0x10
    (tmp_path / "bad.mcap").write_bytes(data)
    with pytest.raises(InputError, match=r"cut or damaged.*tuberline recover"):
        list(open_source(tmp_path / "bad.mcap").frames(run="x"))
    saved = recover(tmp_path / "bad.mcap", tmp_path / "saved.mcap")
    assert saved.damage
    assert saved.lost_bytes > 0
    assert 0 < saved.messages["camera/front/frame"] < describe_recording(mcap).cameras[0].frames


def test_messages_of_a_channel_that_is_not_described_are_lost_and_told(tmp_path: Path) -> None:
    with (tmp_path / "x.mcap").open("wb") as file:
        writer = Writer(file, use_chunking=False, use_statistics=False)
        writer.start()
        known = writer.register_channel("/a", "json", writer.register_schema("s", "jsonschema", b"{}"))
        for channel in (known, known + 1, known):
            writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    saved = recover(tmp_path / "x.mcap", tmp_path / "saved.mcap")
    assert (saved.messages, saved.lost_bytes, saved.whole) == ({"/a": 2}, 2, False)
    assert "no record describes channel 2" in saved.damage


def test_a_whole_file_survives_recovery_unchanged(mcap: Path, tmp_path: Path) -> None:
    saved = recover(mcap, tmp_path / "again.mcap")
    assert (saved.whole, saved.lost_bytes, saved.damage) == (True, 0, "")
    convert_recording(mcap, tmp_path / "one")
    convert_recording(tmp_path / "again.mcap", tmp_path / "two")
    assert _hashes(tmp_path / "one") == _hashes(tmp_path / "two")


def test_what_is_no_mcap_is_refused(tmp_path: Path) -> None:
    for text in (b"hello, this is no recording at all", b"hello\n"):
        (tmp_path / "x.mcap").write_bytes(text)
        with pytest.raises(InputError, match=r"x\.mcap"):
            open_source(tmp_path / "x.mcap")
        with pytest.raises(InputError, match="is no MCAP file"):
            recover(tmp_path / "x.mcap", tmp_path / "y.mcap")
        assert not (tmp_path / "y.mcap").exists()


def test_recordings_are_not_overwritten(mcap: Path, small_recording: Path) -> None:
    with pytest.raises(InputError, match="exists"):
        convert_recording(small_recording, mcap)
    with pytest.raises(InputError, match="exists"):
        recover(mcap, mcap)
    with pytest.raises(InputError, match="exists"), McapFrameWriter(mcap):
        pass


def test_positions_of_a_recording_that_was_removed_become_no_others(small_recording: Path, tmp_path: Path) -> None:
    """Whoever removed line.mcap alone, and recorded again, had the tubers of the new drive where the old one went."""
    out, left = tmp_path / "line.mcap", tmp_path / "line.positions.csv"
    left.write_text("n,time_ns\n")
    for write in (lambda: convert_recording(small_recording, out), lambda: recover(small_recording, out)):
        with pytest.raises(InputError, match=r"line\.positions\.csv is of a recording that is not there any more"):
            write()
    with pytest.raises(InputError, match="add --force, or move it away"):
        simulate(out=out)
    assert not out.exists()


@pytest.mark.parametrize("force", [False, True])
def test_force_is_advised_where_it_helps(tmp_path: Path, force: bool) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"is no recording: it is not overwritten; choose another name$"):
        simulate(out=tmp_path, tubers=1, force=force)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_converting_says_what_it_could_not_read(
    small_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (small_recording / "front" / "depth" / "000002.png").write_bytes(b"\x89PNG")
    with pytest.raises(SystemExit) as left:
        convert(small_recording, tmp_path / "r.mcap", json=True)
    assert left.value.code == 1, "a lossless copy that is none"
    said = capsys.readouterr()
    report = json.loads(said.out)
    assert "frames that cannot be used: 1 broken png; the first: frame 2: " in said.err
    assert report["refused"] == {"broken_png": 1}
    assert report["frames"] == describe_recording(small_recording).cameras[0].frames - 1
    assert inspect_recording(tmp_path / "r.mcap").cameras[0].gaps == 1


@pytest.mark.parametrize("target", ["r.mcap", "folder"])
def test_of_a_recording_that_cannot_be_read_no_copy_is_made(small_recording: Path, tmp_path: Path, target: str) -> None:
    """It was an empty one, with exit code 0."""
    for image in (small_recording / "front" / "depth").iterdir():
        image.unlink()
    with pytest.raises(InputError, match=r"no frame can be read; the first: frame 0: .*000000\.png"):
        convert(small_recording, tmp_path / target)
    assert not (tmp_path / target).exists()


@pytest.mark.parametrize("target", ["r.mcap", "folder"])
def test_a_camera_that_no_line_can_call_so_is_named_before_anything_is_written(
    small_recording: Path, tmp_path: Path, target: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (small_recording / "front").rename(small_recording / "süd 1")
    (small_recording / "line.json").unlink()
    with pytest.raises(
        InputError, match=r"camera name 'süd 1' cannot be used: 1 to 64 letters.*rename the camera's fo"
    ):
        convert(small_recording, tmp_path / target)
    assert not (tmp_path / target).exists()
    info(small_recording)
    assert "no line can use it: camera name 'süd 1'" in " ".join(capsys.readouterr().out.split())


def test_info_says_of_frames_that_it_did_not_look_at_that_it_did_not(small_recording: Path) -> None:
    depth = small_recording / "front" / "depth"
    looked_at = set(np.linspace(0, len([*depth.iterdir()]) - 1, 8).astype(int).tolist())
    for n in looked_at:
        (depth / f"{n:06}.png").unlink()
    report = inspect_recording(small_recording).cameras[0]
    others = report.frames - 8
    assert others > 0
    assert f"none of the frames looked at can be read: {others} others were not looked at" in report.warnings


def test_info_tells_sizes_rates_gaps_and_the_belt(small_recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = (small_recording / "front" / "frames.csv").read_text().splitlines()
    (small_recording / "front" / "frames.csv").write_text("\n".join(rows[:4] + rows[6:]))
    report = inspect_recording(small_recording).cameras[0]
    assert (report.width, report.height, report.gaps, report.travel, report.masks) == (320, 180, 2, True, True)
    assert report.fps_seen == pytest.approx(10.0)
    assert report.belt_seen_m == pytest.approx(0.46, abs=0.006)
    info(small_recording)
    shown = capsys.readouterr().out
    assert "2 frame numbers are missing" in shown
    info(small_recording, json=True)
    assert json.loads(capsys.readouterr().out)["cameras"][0]["gaps"] == 2


def test_info_warns_of_a_belt_distance_that_is_not_seen(small_recording: Path) -> None:
    path = small_recording / "front" / "camera.json"
    camera = json.loads(path.read_text())
    for given, text in (
        (0.49, "10 mm cost about 10 % of each weight"),
        (0.40, "what is seen is the ground under a web of rods"),
        (4.6, "off by 10"),
        (None, "not given"),
    ):
        path.write_text(json.dumps(camera | {"belt_distance_m": given}))
        warnings = inspect_recording(small_recording).cameras[0].warnings
        assert any(text in warning for warning in warnings), (given, warnings)
    assert np.isclose(camera["belt_distance_m"], 0.46, atol=0.002)


def test_a_second_run_in_the_same_file_is_told_and_can_be_taken_out(small_recording: Path, tmp_path: Path) -> None:
    """A recorder once went on in one file when the line was started again; the second run was left out unsaid."""
    frames = [item for item in open_source(small_recording).frames(run="r") if isinstance(item, Frame)][:5]
    two = tmp_path / "two.mcap"
    with McapFrameWriter(two) as writer:
        for run in ("a", "b"):
            for frame in frames:
                if (run, frame.seq) != ("b", 1):
                    writer.write(replace(frame, run=run))
    for read in (
        lambda: list(open_source(two).frames(run="x")),
        lambda: info(two),
        lambda: convert(two, tmp_path / "c"),
    ):
        with pytest.raises(InputError, match=r"after frame 4 of camera 'front' the numbers begin at 0 again.*--part 1"):
            read()
    assert not (tmp_path / "c").exists()
    for part, numbers in ((1, [0, 1, 2, 3, 4]), (2, [0, 2, 3, 4])):
        convert(two, tmp_path / f"{part}.mcap", part=part)
        taken = list(open_source(tmp_path / f"{part}.mcap").frames(run="r"))
        assert [item.encode() for item in taken] == [frames[n].encode() for n in numbers]
    with pytest.raises(InputError, match="no part 3 of camera 'front': it holds 2"):
        convert(two, tmp_path / "3.mcap", part=3)
    with pytest.raises(InputError, match="has no parts: only MCAP"):
        convert(small_recording, tmp_path / "4.mcap", part=1)


def test_a_frame_that_is_late_or_there_twice_begins_no_second_run(small_recording: Path, tmp_path: Path) -> None:
    """It was read on where its number had passed: the folder made of it could not be read, `info` missed -1 frames."""
    frames = [item for item in open_source(small_recording).frames(run="r") if isinstance(item, Frame)][:5]
    mixed = [frames[n] for n in (0, 2, 1, 3, 3, 4)]
    with McapFrameWriter(tmp_path / "late.mcap") as writer:
        for frame in mixed:
            writer.write(replace(frame, run="a"))
    assert convert_recording(tmp_path / "late.mcap", tmp_path / "late").frames == 4
    for path in (tmp_path / "late.mcap", tmp_path / "late"):
        source = open_source(path)
        assert [item.encode() for item in source.frames(run="r")] == [frames[n].encode() for n in (0, 2, 3, 4)]
        numbered = source.keys()
        assert [key.seq for key in numbered] == [0, 2, 3, 4]
        assert inspect_recording(path).cameras[0].gaps == 1


def test_a_rate_that_no_camera_has_is_none(small_recording: Path, tmp_path: Path) -> None:
    """Times that were numbers made 1e9 frames a second: no camera could tell that, and a replay of it ended."""
    assert [rate_of(times) for times in ([0, 1, 2], [], [5, 5], [0, 10**8, 2 * 10**8])] == [30.0, 30.0, 30.0, 10.0]
    frame = next(item for item in open_source(small_recording).frames(run="r") if isinstance(item, Frame))
    with McapFrameWriter(tmp_path / "r.mcap") as writer:
        writer.add_camera(frame.camera, fps=1e9)
        writer.write(frame)
    assert open_source(tmp_path / "r.mcap").description.fps == 30.0


def test_a_time_that_ros_cannot_say_and_a_line_file_that_is_none(small_recording: Path, tmp_path: Path) -> None:
    """Both ended a conversion in a traceback: a camera's clock beyond 2038, and an attachment that no one had read."""
    frame = next(item for item in open_source(small_recording).frames(run="r") if isinstance(item, Frame))
    for name, line in (("list", b'["front"]'), ("cut", b'{"cameras": [')):
        with McapFrameWriter(tmp_path / f"{name}.mcap") as writer:
            writer.write(replace(frame, captured_ns=2**31 * 10**9))
            writer.attach("line.json", line)
        assert convert_recording(tmp_path / f"{name}.mcap", tmp_path / name).frames == 1
        assert json.loads((tmp_path / name / "line.json").read_text())["cameras"] == [frame.camera]
    pytest.importorskip("rosbags")
    with pytest.raises(InputError, match=r"captured at 2147483648 s; a ROS 2 time ends at 2147483647 s, in 2038"):
        convert_recording(tmp_path / "list.mcap", tmp_path / "ros.mcap", form="ros2")


@pytest.mark.parametrize("target", ["folder", "mcap", "ros2"])
def test_a_camera_of_which_nothing_could_be_read_spoils_no_conversion(
    small_recording: Path, tmp_path: Path, target: TargetFormat
) -> None:
    """A folder named it, and was refused for it; of ROS 2 topics `info` ended in a traceback."""
    pytest.importorskip("rosbags")
    frame = next(item for item in open_source(small_recording).frames(run="r") if isinstance(item, Frame))
    with McapFrameWriter(tmp_path / "two.mcap") as writer:
        for camera in ("broken", "front"):
            writer.write(replace(frame, camera=camera))
    convert_recording(tmp_path / "two.mcap", tmp_path / "two")
    next((tmp_path / "two" / "broken" / "depth").iterdir()).unlink()
    out = tmp_path / ("out" if target == "folder" else "out.mcap")
    done = convert_recording(tmp_path / "two", out, form=target)
    assert (done.frames, done.refused) == (1, {"missing_file": 1})
    assert [camera.name for camera in inspect_recording(out).cameras] == ["front"]
