"""Reading folder recordings, and everything that can be wrong with them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SceneSettings, build_world, layout_named
from camera_sim.sim.source import simulated_sources
from conveyor.errors import InputError
from conveyor.formats import Refused, describe_recording, open_source
from conveyor.messages import Frame


def _items(recording: Path, **options: Any) -> list[Frame | Refused]:
    return list(open_source(recording, **options).frames(run="test"))


def _edit(recording: Path, **changes: Any) -> None:
    path = recording / "front" / "camera.json"
    camera = json.loads(path.read_text())
    for key, value in changes.items():
        camera.pop(key, None)
        if value is not ...:
            camera[key] = value
    path.write_text(json.dumps(camera))


def test_what_was_simulated_is_what_is_read(small_recording: Path, small_settings: SceneSettings) -> None:
    layout = layout_named("touching")
    source = simulated_sources(build_world(small_settings, layout), small_settings, layout, masks=True)[0]
    items = _items(small_recording)
    wanted = list(source.frames(run="test"))
    assert len(items) == len(wanted) > 15
    for item, frame in zip(items, wanted, strict=True):
        assert isinstance(item, Frame)
        assert np.array_equal(item.depth, frame.depth)
        assert np.array_equal(item.mask, frame.mask)
        assert (item.seq, item.captured_ns, item.travel_m) == (frame.seq, frame.captured_ns, frame.travel_m)
        assert item.intrinsics == frame.intrinsics
        assert item.color_jpeg is not None
        assert cv2.imdecode(item.color_jpeg, cv2.IMREAD_COLOR).shape[:2] == item.depth.shape


def test_reading_may_start_in_the_middle(small_recording: Path) -> None:
    source = open_source(small_recording)
    assert [item.seq for item in source.frames(run="test", after=9)] == list(range(10, source.description.frames))


def test_the_line_names_the_camera_and_may_override(small_recording: Path) -> None:
    first = _items(small_recording, name="belt-2", belt_distance_m=0.470)[0]
    assert isinstance(first, Frame)
    assert (first.camera, first.belt_distance_m) == ("belt-2", 0.470)


def test_a_truncated_png_is_refused_by_name_and_the_rest_goes_on(small_recording: Path) -> None:
    """OpenCV decodes a cut PNG without a word and leaves black rows: that frame must not reach the line."""
    path = small_recording / "front" / "depth" / "000004.png"
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 3 // 4])
    items = _items(small_recording)
    refused = [item for item in items if isinstance(item, Refused)]
    assert [(item.seq, item.reason) for item in refused] == [(4, "broken_png")]
    assert "depth/000004.png is truncated" in refused[0].text
    assert len(items) == describe_recording(small_recording).cameras[0].frames


def test_a_missing_file_is_a_gap_with_its_name(small_recording: Path) -> None:
    (small_recording / "front" / "depth" / "000002.png").unlink()
    refused = [item for item in _items(small_recording) if isinstance(item, Refused)]
    assert [(item.seq, item.reason) for item in refused] == [(2, "missing_file")]
    assert "depth/000002.png does not exist" in refused[0].text


def test_an_8_bit_image_and_a_wrong_size_are_refused(small_recording: Path) -> None:
    depth = small_recording / "front" / "depth"
    cv2.imwrite(str(depth / "000001.png"), np.zeros((180, 320), np.uint8))
    cv2.imwrite(str(depth / "000003.png"), np.zeros((90, 320), np.uint16))
    refused = {item.seq: item for item in _items(small_recording) if isinstance(item, Refused)}
    assert refused[1].reason == "not_16_bit"
    assert refused[3].reason == "wrong_size"
    assert "is 320x90, camera.json says 320x180" in refused[3].text
    mask = small_recording / "front" / "mask"
    for seq, image in ((5, np.zeros((180, 320, 3), np.uint8)), (6, np.zeros((90, 320), np.uint16))):
        cv2.imwrite(str(mask / f"{seq:06d}.png"), image)
    refused = {item.seq: item for item in _items(small_recording) if isinstance(item, Refused)}
    assert refused[5].reason == refused[6].reason == "bad_mask"
    way_out = "; or ignore the masks (`replay --ignore-masks`, or ignore_masks in a line's file)"
    assert refused[5].text.endswith(
        f"mask/000005.png is no PNG of one channel with 16 or 8 bits; write a label for each tuber as uint16{way_out}"
    )
    assert refused[6].text.endswith(f"mask/000006.png is 320x90, its depth 320x180{way_out}")
    unmasked = {item.seq: item for item in _items(small_recording, ignore_masks=True)}
    assert {seq for seq, item in unmasked.items() if isinstance(item, Refused)} == {1, 3}, "masks that are not used"


def test_masks_of_8_bits_are_labels_too(small_recording: Path) -> None:
    """Masks of other programs are; they were refused, each with its frame."""
    (before,) = (item for item in _items(small_recording) if isinstance(item, Frame) and item.seq == 5)
    assert before.mask is not None
    assert before.mask.max() < 256
    cv2.imwrite(str(small_recording / "front" / "mask" / "000005.png"), before.mask.astype(np.uint8))
    (after,) = (item for item in _items(small_recording) if isinstance(item, Frame) and item.seq == 5)
    assert np.array_equal(after.mask, before.mask)
    assert after.mask.dtype == np.uint16


def test_masks_that_are_no_frames_by_their_names_are_told(small_recording: Path) -> None:
    """Masks saved as .PNG were left out without a word."""
    assert not open_source(small_recording).description.notes
    (small_recording / "front" / "mask" / "000003.png").rename(small_recording / "front" / "mask" / "000003.PNG")
    (note,) = open_source(small_recording).description.notes
    assert note.startswith("mask/ lacks the masks of 1 of ")
    assert "(000003.png is the first): tubers of these are found on depth" in note
    assert not open_source(small_recording, ignore_masks=True).description.notes
    for path in (small_recording / "front" / "mask").glob("*.png"):
        path.rename(path.with_suffix(".PNG"))
    (note,) = open_source(small_recording).description.notes
    assert "as its frame's depth (000000.png), but '000000.PNG': tubers are found on depth" in note


def test_camera_json_without_intrinsics_names_what_is_missing(small_recording: Path) -> None:
    _edit(small_recording, fx=..., cy=...)
    with pytest.raises(InputError, match=r"(?s)camera\.json cannot be used.*fx: missing.*cy: missing"):
        open_source(small_recording)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"fx": -3}, r"fx: must be more than 0 \(got -3\)"),
        ({"width": "wide"}, r"width: must be a whole number"),
        ({"fx": True}, r"fx: .*true and false are no numbers"),
        ({"depth_scale_m": None}, r"depth_scale_m: missing"),
        ({"belt_distance_m": 0}, r"belt_distance_m: "),
        ({"belt_from_camera": [[1, 0], [0, 1]]}, r"4 rows of 4 numbers"),
        ({"belt_from_camera": np.diag([1.0, 1.0, 2.0, 1.0]).tolist()}, r"no rigid transform"),
    ],
)
def test_camera_json_with_a_wrong_value_says_which(small_recording: Path, changes: Any, text: str) -> None:
    _edit(small_recording, **changes)
    with pytest.raises(InputError, match=text):
        open_source(small_recording)


def test_a_rate_that_is_not_known_is_the_usual_one(small_recording: Path) -> None:
    _edit(small_recording, fps=None)
    assert describe_recording(small_recording).cameras[0].fps == 30.0


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("4,12", r"line 6: 3 values .* are needed"),
        ("four,12,0.1", r"line 6: .*'four'"),
        ("1,12,0.1", r"line 6: seq 1 after 3; numbers must rise"),
        ("4,12,nan", r"line 6: .*finite"),
    ],
)
def test_frames_csv_faults_have_their_line(small_recording: Path, line: str, text: str) -> None:
    path = small_recording / "front" / "frames.csv"
    lines = path.read_text().splitlines()
    lines[5] = line
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=text):
        open_source(small_recording)


def _reordered(recording: Path, change: Callable[[list[list[str]]], list[list[str]]]) -> None:
    path = recording / "front" / "frames.csv"
    head, *rows = path.read_text().splitlines()
    changed = change([row.split(",") for row in rows])
    path.write_text("\n".join([head, *(",".join(cells) for cells in changed)]) + "\n")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda rows: [*rows[:3], rows[4], rows[3], *rows[5:]],
            r"line 6: seq 3 after 4; numbers must rise: sort the rows",
        ),
        (
            lambda rows: [*rows[:6], rows[2], *rows[6:]],
            r"line 8: seq 2 after 5; numbers must rise\. Lines 4 and 8 have seq 2: remove the rows that are too many",
        ),
        (
            lambda rows: [*rows[:6], *([str(n), *cells[1:]] for n, cells in enumerate(rows[6:9]))],
            r"line 8: seq 0 after 5; .* Lines 2 and 8 have seq 0, and 2 other numbers several times: .* number the "
            r"later rows on, and their files \(depth/000000\.png\)",
        ),
        (
            lambda rows: [[seq[0], *cells[1:]] for seq, cells in zip(reversed(rows), rows, strict=True)],
            r"Sorted by seq, captured_ns would fall: number the frames in the order of captured_ns, rows and files",
        ),
    ],
    ids=["rows out of order", "a row twice", "counted from 0 again", "numbers against the clock"],
)
def test_rows_out_of_order_are_told_with_what_to_do(
    change: Callable[[list[list[str]]], list[list[str]]], words: str, small_recording: Path
) -> None:
    """It was only said that numbers must rise."""
    _reordered(small_recording, change)
    with pytest.raises(InputError, match=words):
        open_source(small_recording)


def test_frames_csv_needs_its_header(small_recording: Path) -> None:
    path = small_recording / "front" / "frames.csv"
    path.write_text("0,1,2\n")
    with pytest.raises(InputError, match=r"line 1: the header must be 'seq,captured_ns,travel_m'"):
        open_source(small_recording)


@pytest.mark.parametrize(("scale", "right"), [(0.01, 0.001), (0.0001, 0.001)])
def test_a_depth_scale_wrong_by_ten_is_refused_with_both_numbers(
    small_recording: Path, scale: float, right: float
) -> None:
    _edit(small_recording, depth_scale_m=scale)
    with pytest.raises(InputError, match=rf"median depth is .* m but the belt is said to be .*should be {right:g}"):
        _items(small_recording)
    mended = _items(small_recording, depth_scale_m=right)
    assert all(isinstance(item, Frame) and item.depth_scale_m == right for item in mended)


def test_travel_may_be_absent(small_settings: SceneSettings, tmp_path: Path) -> None:
    record_scene(tmp_path / "r", replace(small_settings, tubers=1, given_travel=False))
    assert all(isinstance(item, Frame) and item.travel_m is None for item in _items(tmp_path / "r"))


def test_travel_that_is_set_back_goes_on(small_recording: Path) -> None:
    """The tubers behind lay where those before had lain, and were taken for the same: half a belt was not counted."""
    folder = next(small_recording.glob("*/frames.csv")).parent
    head, *rows = (folder / "frames.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    travel_m = [float(cell[2]) for cell in cells]
    half = len(cells) // 2
    back_m = travel_m[half]
    assert back_m > 0.3
    for cell in cells[half:]:
        cell[2] = repr(float(cell[2]) - back_m)
    (folder / "frames.csv").write_text("\n".join([head, *(",".join(cell) for cell in cells)]) + "\n")
    source = open_source(small_recording)
    read_m = [item.travel_m for item in source.frames(run="r") if isinstance(item, Frame)]
    assert read_m == pytest.approx(travel_m, abs=0.001), "what the belt moved in between is its median step"
    assert f"sets travel_m back at seq {half}: it is taken to go on" in source.description.notes[0]


def _with_travel(recording: Path, change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> NDArray[np.float64]:
    """Change travel_m of the recording's frames.csv; (frames,) metres as it was."""
    folder = next(recording.glob("*/frames.csv")).parent
    head, *rows = (folder / "frames.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    before = np.array([float(cell[2]) for cell in cells])
    for cell, travel_m in zip(cells, change(before.copy()).tolist(), strict=True):
        cell[2] = repr(travel_m)
    (folder / "frames.csv").write_text("\n".join([head, *(",".join(cell) for cell in cells)]) + "\n")
    return before


def _read_travel(recording: Path) -> tuple[list[float | None], str]:
    source = open_source(recording)
    read_m = [item.travel_m for item in source.frames(run="r") if isinstance(item, Frame)]
    return read_m, " ".join(source.description.notes)


@pytest.mark.parametrize(
    ("change", "note"),
    [
        (lambda m: np.where(np.arange(len(m)) >= 9, m - 0.16, m), "sets travel_m back at seq 9"),
        (lambda m: np.where(np.arange(len(m)) >= 9, m + 5.0, m), "lets travel_m jump at seq 9"),
        (lambda m: np.where(np.isin(np.arange(len(m)), (9, 10)), -1.0, m), "sets travel_m back at seq 9"),
    ],
    ids=["a little back", "5 m on", "two frames of nothing"],
)
def test_travel_that_no_belt_runs_goes_on(
    change: Callable[[NDArray[np.float64]], NDArray[np.float64]], note: str, small_recording: Path
) -> None:
    """A counter that wrapped every 20 cm left no tuber of 40, one that jumped 5 m left six of 25 counted twice."""
    travel_m = _with_travel(small_recording, change)
    read_m, notes = _read_travel(small_recording)
    assert read_m == pytest.approx(travel_m.tolist(), abs=0.002)
    assert f"frames.csv {note}" in notes


@pytest.mark.parametrize(
    "change",
    [
        lambda m: np.concatenate([m[:8], m[8] - (m[8:] - m[8])]),
        lambda m: np.floor(m / 0.05) * 0.05,
        lambda m: 1000.0 * m,
    ],
    ids=["a belt that is turned back", "an encoder of 5 cm steps", "millimetres"],
)
def test_travel_that_a_belt_may_run_stays_as_it_is(
    change: Callable[[NDArray[np.float64]], NDArray[np.float64]], small_recording: Path
) -> None:
    travel_m = _with_travel(small_recording, change)
    read_m, notes = _read_travel(small_recording)
    assert read_m == change(travel_m.copy()).tolist()
    assert "travel_m" not in notes


def test_what_is_no_recording_lists_what_was_looked_for(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    for path in (tmp_path, tmp_path / "notes.txt"):
        with pytest.raises(InputError, match=r"is no recording .*looked for: a folder recording .*MCAP.*3DPotatoTwin"):
            open_source(path)
    with pytest.raises(InputError, match="does not exist"):
        open_source(tmp_path / "nowhere")


def test_cameras_are_chosen_by_name(small_settings: SceneSettings, tmp_path: Path) -> None:
    record_scene(tmp_path / "r", replace(small_settings, scene="two-cameras", tubers=2))
    names = [camera.name for camera in describe_recording(tmp_path / "r").cameras]
    assert names == ["left", "right"]
    with pytest.raises(InputError, match="several cameras: name one of left, right"):
        open_source(tmp_path / "r")
    with pytest.raises(InputError, match="no camera 'middle'; known: left, right"):
        open_source(tmp_path / "r", camera="middle")
    (tmp_path / "r" / "right" / "camera.json").unlink()
    with pytest.raises(InputError, match=r"line\.json names camera 'right'"):
        open_source(tmp_path / "r", camera="left")
