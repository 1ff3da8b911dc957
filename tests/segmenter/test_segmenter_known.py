"""What is known of a camera, from one run, one process or one look to the next."""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from segmenter_scene import MEDIUM, SMALL, Scene, scattered, seen_px, worn

from conveyor.camera_flags import OUTLINE_GROWN
from conveyor.config import LineConfig, parse_config
from conveyor.formats import CameraDescription
from conveyor.formats.folder.writer import FolderWriter
from conveyor.geometry import straight_down_belt_from_camera
from conveyor.messages import Frame
from segmenter.camera_run import CameraRun
from segmenter.classify.prior import Prior
from segmenter.first_look import ENOUGH, look_first
from segmenter.known import Known
from segmenter.memory import KEEP_EVERY_S, CameraMemory
from segmenter.pipeline import ClosedTrack, Segmenter, Settings
from segmenter.setup import run_settings

STEP_M = 0.03
FRAMES = 66
GROWN_PX = 3.0
LOG = logging.getLogger("segmenter/front")


def counted(frames: list[Frame], known: Known | None = None) -> tuple[Segmenter, list[ClosedTrack]]:
    core, closed = Segmenter(Settings(), known=known), []
    for frame in frames:
        closed += core.step(frame).closed
    return core, closed + core.finish()


def flagged(closed: list[ClosedTrack]) -> list[bool]:
    return [OUTLINE_GROWN in one.track.flags for one in closed]


def live(folder: Path, **sections: Any) -> LineConfig:
    raw = {"cameras": {"front": {"source": "realsense", "belt_distance_m": 0.46}}, **sections}
    raw["segmenter"] = {"state_dir": str(folder), **raw.get("segmenter", {})}
    return parse_config(raw, where="of the test")


def remembered(config: LineConfig, run: str) -> Known | None:
    """What a process knows that starts with this run."""
    memory = CameraMemory(config, "front", LOG)
    memory.look(go_on=lambda: True)
    return memory.known_in(run)


@pytest.fixture(scope="module")
def grown() -> list[Frame]:
    """A belt with fifteen tubers before a camera that lets outlines grow."""
    scene = Scene([replace(b, place_x_m=2 * b.place_x_m) for b in scattered(15, seed=4)], MEDIUM, noise_m=0.0003)
    clear = replace(scene, noise_m=0.0)
    return [
        worn(scene.frame(seq, seq * STEP_M), (clear.render(seq * STEP_M)[1] > 0).astype(np.uint8), GROWN_PX)
        for seq in range(FRAMES)
    ]


@pytest.fixture(scope="module")
def first(grown: list[Frame]) -> tuple[Segmenter, list[ClosedTrack]]:
    return counted(grown)


@pytest.fixture(scope="module")
def known(first: tuple[Segmenter, list[ClosedTrack]]) -> Known:
    known = first[0].known
    assert known is not None
    return known


@pytest.fixture(scope="module")
def recording(grown: list[Frame], tmp_path_factory: pytest.TempPathFactory) -> Path:
    description = CameraDescription(
        name="front",
        origin="test",
        intrinsics=MEDIUM,
        depth_scale_m=0.001,
        fps=30.0,
        belt_distance_m=0.46,
        belt_from_camera=straight_down_belt_from_camera(0.46),
        frames=None,
    )
    folder = tmp_path_factory.mktemp("known") / "recording"
    with FolderWriter(folder, description) as writer:
        for frame in grown:
            writer.write(frame)
    return folder


def replayed(recording: Path, **segmenter: Any) -> LineConfig:
    raw = {"cameras": {"front": {"path": str(recording)}}, "segmenter": segmenter}
    return parse_config(raw, where="of the test")


def test_what_one_load_has_said_is_taken_off_the_next_from_its_first_tuber(
    grown: list[Frame], first: tuple[Segmenter, list[ClosedTrack]], known: Known
) -> None:
    core, again = counted(grown, known)
    assert len(again) == len(first[1]) == 15
    assert not flagged(first[1])[0]
    assert all(flagged(again))
    assert core.unlike_known == ""
    by_place, cut = seen_px([c for c in first[1] if not flagged([c])[0]]), seen_px(again)
    assert by_place
    assert all(cut[place] < 0.95 * pixels for place, pixels in by_place.items())


def test_the_tubers_that_pass_take_the_place_of_those_that_are_known(grown: list[Frame], known: Known) -> None:
    core, _ = counted(grown, known)
    after = core.known
    assert after is not None
    assert len(known.outlines) < len(after.outlines) <= 2 * len(known.outlines)
    assert after.outlines[: len(known.outlines)] == known.outlines
    assert len(after.flanks_mm) > len(known.flanks_mm)


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"intrinsics": SMALL}, "its image or its intrinsics are others"),
        ({"scale_m": 0.0005}, "its depth unit is 0.0005 m and was 0.001 m"),
        (
            {"belt_from_camera": straight_down_belt_from_camera(0.50)},
            "it sees the belt 0.500 m away, and saw it 0.460 m away",
        ),
    ],
)
def test_another_camera_is_learned_afresh(known: Known, changed: dict[str, Any], why: str) -> None:
    core = Segmenter(Settings(), known=known)
    core.step(replace(Scene(scattered(4, seed=4), MEDIUM), **changed).frame(0, 0.0))
    assert core.unlike_known == why
    assert core.outlines is None
    assert core.flanks is None


def test_a_segmenter_that_saw_no_belt_knows_what_it_was_told(known: Known) -> None:
    assert Segmenter(Settings()).known is None
    assert Segmenter(Settings(), known=known).known is known


def test_what_a_live_camera_has_shown_outlives_its_process(tmp_path: Path, known: Known) -> None:
    config = live(tmp_path)
    memory = CameraMemory(config, "front", LOG)
    assert not memory.due(0.0)
    assert not memory.due(0.5 * KEEP_EVERY_S)
    assert memory.due(KEEP_EVERY_S)
    memory.keep(known, "monday", KEEP_EVERY_S)
    memory.over(known, "monday")
    back = remembered(config, "monday")
    assert back is not None
    assert back.outlines == known.outlines
    np.testing.assert_array_equal(back.flanks_mm, known.flanks_mm)
    assert back.intrinsics == known.intrinsics
    assert (back.belt_distance_m, back.depth_scale_m) == (known.belt_distance_m, known.depth_scale_m)
    assert back.belt.share == known.belt.share
    assert list(back.belt.newest) == list(known.belt.newest)


def test_another_day_begins_with_the_camera_and_without_the_belt(tmp_path: Path, known: Known) -> None:
    config = live(tmp_path)
    CameraMemory(config, "front", LOG).over(known, "monday")
    back = remembered(config, "tuesday")
    assert back is not None
    assert back.outlines == known.outlines
    assert back.belt.share == Prior().share
    assert back.belt.newest == known.belt.newest, "how low the camera makes answers is the camera's"


@pytest.mark.parametrize(
    "sections",
    [
        {"cameras": {"front": {"source": "realsense", "belt_distance_m": 0.47}}},
        {"encoder": {"source": "serial:///dev/ttyACM0", "metres_per_pulse": 0.001}},
        {"belt": {"resting_offset_mm": 3.0}},
        {"segmenter": {"pixel_mm": 1.5}},
    ],
)
def test_what_a_line_s_file_changes_is_not_taken_for_known(
    tmp_path: Path, known: Known, sections: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    CameraMemory(live(tmp_path), "front", LOG).over(known, "monday")
    with caplog.at_level(logging.INFO):
        assert remembered(live(tmp_path, **sections), "monday") is None
    assert "the camera's settings have changed" in caplog.text


@pytest.mark.parametrize("damage", ["cut short", "of nothing", "another version", "a key is missing", "no numbers"])
def test_a_damaged_file_costs_what_it_held_and_nothing_more(
    tmp_path: Path, known: Known, damage: str, caplog: pytest.LogCaptureFixture
) -> None:
    CameraMemory(live(tmp_path), "front", LOG).over(known, "monday")
    (path,) = tmp_path.glob("*.known")
    whole = path.read_bytes()
    raw = msgpack.unpackb(whole)
    path.write_bytes(
        {
            "cut short": whole[:100],
            "of nothing": b"",
            "another version": msgpack.packb({**raw, "version": 99}),
            "a key is missing": msgpack.packb({k: v for k, v in raw.items() if k != "outlines"}),
            "no numbers": msgpack.packb({**raw, "flanks_mm": [["?"] * 12]}),
        }[damage]
    )
    assert remembered(live(tmp_path), "monday") is None
    assert ("is damaged" in caplog.text) == (damage != "another version")


def test_a_disk_that_takes_nothing_is_told_once_and_stops_nothing(
    tmp_path: Path, known: Known, caplog: pytest.LogCaptureFixture
) -> None:
    memory = CameraMemory(live(tmp_path / "away"), "front", LOG)
    memory.over(known, "monday")
    memory.over(known, "monday")
    assert caplog.text.count("is not kept for the next start") == 1
    assert str(tmp_path / "away") in caplog.text


def test_a_replay_neither_keeps_nor_reads_such_a_file(tmp_path: Path, recording: Path, known: Known) -> None:
    """Its ledger must be the same each time."""
    config = replayed(recording, state_dir=str(tmp_path))
    CameraMemory(config, "front", LOG).over(known, "monday")
    assert list(tmp_path.iterdir()) == []
    assert remembered(config, "monday") is None


def test_a_recording_is_looked_at_before_it_is_counted(recording: Path, known: Known) -> None:
    look = look_first(replayed(recording, look_first=True), "front")
    assert look is not None
    assert (look.frames, look.bodies) == (FRAMES, 15)
    assert look.bodies < ENOUGH
    assert look.known is not None
    assert look.known.outlines == known.outlines
    assert remembered(replayed(recording, look_first=True), "r1") is not None
    assert look_first(replayed(recording), "front") is None


def test_a_live_camera_cannot_be_looked_at_first(tmp_path: Path) -> None:
    assert look_first(live(tmp_path, segmenter={"look_first": True}), "front") is None


def test_a_look_ends_where_its_process_is_told_to_stop(recording: Path) -> None:
    turns = iter([True, True, True, False])
    look = look_first(replayed(recording, look_first=True), "front", go_on=lambda: next(turns))
    assert look is not None
    assert look.frames == 3


def test_a_recording_that_cannot_be_read_is_left_to_who_counts_it(tmp_path: Path, recording: Path) -> None:
    (tmp_path / "front").mkdir()
    (tmp_path / "front" / "camera.json").write_text(json.dumps({"format": "?"}))
    look = look_first(replayed(tmp_path, look_first=True), "front")
    assert look is not None
    assert look.known is None


def test_a_camera_that_starts_again_within_its_run_knows_itself(
    tmp_path: Path, grown: list[Frame], known: Known
) -> None:
    """It carries on after the mark with what was known, where it learned camera and belt afresh before."""
    settings = run_settings(live(tmp_path), "front")
    for part in (grown[:20], grown[20:]):  # the second carries on after the first one's mark
        run = CameraRun("front", "r1", settings, tmp_path / "front.db", known=known)
        run.open()
        for n, frame in enumerate(part):
            run.frame(frame, n / 30)
            run.tick(n / 30, set())
        assert run.core.outlines is not None
        assert run.core.outlines.tubers >= 4
        assert run.log.last_mark is not None
        run.close()
