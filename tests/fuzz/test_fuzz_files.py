"""Every file that Tuberline reads, damaged: a value or an error of ours, in bounded memory."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from aggregator.scoring.truth import read_truth
from conveyor.config import LineConfig, dump_toml, load_config, parse_config
from conveyor.formats import CameraDescription, describe_recording, open_source
from conveyor.formats.clouds import read_cloud
from conveyor.formats.folder.writer import FolderWriter
from conveyor.formats.mcap.writer import McapFrameWriter
from conveyor.formats.rosbag.foxglove import from_json
from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from conveyor.messages import Frame, TrackEntry
from regressor.network.checkpoint import load_checkpoint
from regressor.network.stored import SHIPPED
from segmenter.tracklog import TrackLog
from tests.fuzz.damage import ANY_JSON, bounded_memory, damaged, outcome, quick
from tests.fuzz.test_fuzz_messages import MARK, TRACK

INTRINSICS = Intrinsics(width=16, height=12, fx=15.0, fy=15.5, cx=7.5, cy=5.5)
DESCRIPTION = CameraDescription(
    name="front", origin="here", intrinsics=INTRINSICS, depth_scale_m=0.001, belt_distance_m=0.46,
    belt_from_camera=straight_down_belt_from_camera(0.46), fps=30.0,
    frames=3,
)  # fmt: skip
CLOUD = np.random.default_rng(3).uniform(-0.1, 0.5, (40, 3)).astype(np.float32)


def frame(seq: int) -> Frame:
    depth = np.full((12, 16), 460, np.uint16)
    pose = straight_down_belt_from_camera(0.46)
    return Frame("front", "r", seq, 10**9 + seq, 0.1 * seq, 0.001, INTRINSICS, 0.46, depth, pose)


def read_all(path: Path) -> None:
    """Describe a recording and read every frame of every camera."""
    for camera in describe_recording(path).cameras:
        for item in open_source(path, camera=camera.name).frames(run="r"):
            assert item.seq >= 0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("folder") / "recording"
    with FolderWriter(path, DESCRIPTION) as writer:
        for seq in range(3):
            writer.write(frame(seq))
    return path


def test_a_damaged_folder_recording(folder: Path) -> None:
    files = {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
    assert len(files) >= 5
    seen: set[str] = set()

    @quick(250)
    @given(st.sampled_from(sorted(files)).flatmap(lambda path: st.tuples(st.just(path), damaged(files[path]))))
    def read(case: tuple[Path, bytes]) -> None:
        path, data = case
        path.write_bytes(data)
        try:
            seen.add(outcome(lambda: read_all(folder)))
        finally:
            path.write_bytes(files[path])

    with bounded_memory():
        read()
    assert seen == {"value", "InputError"}


@pytest.mark.parametrize("name", ["camera.json", "frames.csv"])
def test_a_table_with_other_contents(folder: Path, name: str) -> None:
    path = next(folder.rglob(name))
    good = path.read_bytes()

    @quick(100)
    @given(st.one_of(ANY_JSON.map(repr), st.text(max_size=60), st.just("[" * 100_000), st.just("seq," * 50_000)))
    def read(text: str) -> None:
        path.write_text(text.replace("'", '"'), encoding="utf-8", errors="replace")
        outcome(lambda: read_all(folder))

    try:
        with bounded_memory():
            read()
    finally:
        path.write_bytes(good)


def test_a_damaged_mcap(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    with McapFrameWriter(path) as writer:
        for seq in range(3):
            writer.write(frame(seq))
    good = path.read_bytes()
    seen = {outcome(lambda: read_all(path))}

    @quick(250)
    @given(damaged(good))
    def read(data: bytes) -> None:
        path.write_bytes(data)
        seen.add(outcome(lambda: read_all(path)))

    with bounded_memory():
        read()
    assert seen == {"value", "InputError"}


@pytest.mark.parametrize("lie", ["pixels", "bytes of a chunk"])
def test_a_picture_that_says_it_is_huge(folder: Path, lie: str) -> None:
    """OpenCV made room for up to 4 GB where a few bytes of a picture were damaged; found by fuzzing with atheris."""
    path = next(folder.rglob("*.png"))
    good = path.read_bytes()
    chunk = good.index(b"IDAT") - 4
    huge = {
        "pixels": good[:16] + (60_000).to_bytes(4, "big") * 2 + good[24:],
        "bytes of a chunk": good[:chunk] + (1_500_000_000).to_bytes(4, "big") + good[chunk + 4 :],
    }
    path.write_bytes(huge[lie])
    try:
        with bounded_memory():
            assert outcome(lambda: read_all(folder)) in ("value", "InputError")
    finally:
        path.write_bytes(good)


def test_a_damaged_ros_bag(tmp_path: Path) -> None:
    """Five kinds of exceptions of the library's came through; found by fuzzing with atheris."""
    bags = pytest.importorskip("tests.formats.test_formats_rosbag")
    good = bags._ros1(tmp_path / "good.bag", unit_m=0.001).read_bytes()
    path = tmp_path / "recording.bag"
    seen: set[str] = set()

    @quick(150)
    @given(damaged(good, head=200) | damaged(good[len(good) // 2 :]).map(lambda tail: good[: len(good) // 2] + tail))
    def read(data: bytes) -> None:
        path.write_bytes(data)
        seen.add(outcome(lambda: read_all(path)))

    with bounded_memory():
        read()
    assert seen == {"value", "InputError"}


def cloud_files() -> dict[str, bytes]:
    head = "ply\nformat {}\nelement vertex 40\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    rows = "\n".join(" ".join(str(value) for value in row) for row in CLOUD.tolist())
    npy, npz = io.BytesIO(), io.BytesIO()
    np.save(npy, CLOUD)
    np.savez_compressed(npz, points=CLOUD)
    return {
        "binary.ply": head.format("binary_little_endian 1.0").encode() + CLOUD.tobytes(),
        "ascii.ply": (head.format("ascii 1.0") + rows + "\n").encode(),
        "cloud.npy": npy.getvalue(),
        "cloud.npz": npz.getvalue(),
    }


@pytest.mark.parametrize("name", sorted(cloud_files()))
def test_a_damaged_cloud(name: str, tmp_path: Path) -> None:
    good = cloud_files()[name]
    path = tmp_path / name
    seen: set[str] = set()

    @quick(300)
    @given(damaged(good, head=200))
    def read(data: bytes) -> None:
        path.write_bytes(data)
        seen.add(outcome(lambda: read_cloud(path)))

    with bounded_memory():
        read()
    assert seen <= {"value", "InputError"}
    assert "InputError" in seen


PLY = b"ply\nformat binary_little_endian 1.0\n"
LIES = {
    "twice.ply": PLY
    + b"element vertex 1\n"
    + b"property float x\n" * 2
    + b"property float y\nend_header\n"
    + bytes(12),
    "many.ply": PLY + b"element vertex " + b"9" * 5000 + b"\nproperty float x\nend_header\n",
    "zip.npz": b"PK\x03\x04 but no zip file",
    "huge.npy": b"\x93NUMPY\x01\x00v\x00"
    + b"{'descr': '<f8', 'fortran_order': False, 'shape': (90000000000, 3), }".ljust(118),
}


def test_an_archive_that_is_called_an_array(tmp_path: Path) -> None:
    """It ended in an AttributeError; found by fuzzing with atheris."""
    (tmp_path / "cloud.npy").write_bytes(cloud_files()["cloud.npz"])
    assert np.array_equal(read_cloud(tmp_path / "cloud.npy"), CLOUD)
    (tmp_path / "cloud.npz").write_bytes(cloud_files()["cloud.npy"])
    assert np.array_equal(read_cloud(tmp_path / "cloud.npz"), CLOUD)


@pytest.mark.parametrize("name", sorted(LIES))
def test_clouds_that_lie_about_themselves(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(LIES[name])
    with bounded_memory():
        assert outcome(lambda: read_cloud(tmp_path / name)) == "InputError"


def test_a_damaged_config(tmp_path: Path) -> None:
    config = parse_config({"cameras": {"front": {"path": "belt", "belt_distance_m": 0.46}}}, where="here")
    path = tmp_path / "line.toml"
    seen: set[str] = set()

    @quick(250)
    @given(damaged(dump_toml(config).encode()))
    def read(data: bytes) -> None:
        path.write_bytes(data)
        seen.add(outcome(lambda: load_config(path)))

    read()
    assert seen == {"value", "ConfigError"}


@quick(250)
@given(st.dictionaries(st.sampled_from([*LineConfig.model_fields, "camera"]), ANY_JSON, max_size=4))
def test_a_config_of_other_types(raw: dict[str, Any]) -> None:
    assert outcome(lambda: parse_config(raw, where="here")) in ("value", "ConfigError")


TRUTH = '{"tubers": [{"id": 1, "place_x_m": -0.1, "place_y_m": 0.02, "weight_g": 170.5}]}'


def test_a_damaged_truth(tmp_path: Path) -> None:
    path = tmp_path / "truth.json"
    seen: set[str] = set()

    @quick(150)
    @given(damaged(TRUTH.encode()))
    def read(data: bytes) -> None:
        path.write_bytes(data)
        seen.add(outcome(lambda: read_truth(path)))

    read()
    assert seen == {"value", "InputError"}


@pytest.mark.parametrize("weight", ["9" * 400, "9" * 5000, "[" * 100_000, "NaN", "Infinity", "-1", "true"])
def test_a_truth_with_an_odd_weight(weight: str, tmp_path: Path) -> None:
    """Numbers of 400 and of 5000 digits and lists in lists came out as three kinds of tracebacks."""
    path = tmp_path / "truth.json"
    path.write_text(TRUTH.replace("170.5", weight))
    assert outcome(lambda: read_truth(path)) == "InputError"


@pytest.mark.parametrize("lie", ['"sec": ' + "9" * 30, '"sec": -1', '"sec": 1e400'])
def test_a_foxglove_message_of_no_time(lie: str) -> None:
    bags = pytest.importorskip("tests.formats.bag_messages")
    good = bags.foxglove_json(0)[0].decode()
    bad = good.replace(f'"sec": {bags.stamp_ns(0) // 10**9}', lie).encode()
    assert outcome(lambda: from_json("image", bad)) == "MessageError"


def test_a_config_nested_too_deep(tmp_path: Path) -> None:
    (tmp_path / "line.toml").write_text("a = " + "[" * 100_000)
    assert outcome(lambda: load_config(tmp_path / "line.toml")) == "ConfigError"


def test_a_damaged_checkpoint(tmp_path: Path) -> None:
    good, sidecar = SHIPPED.read_bytes(), SHIPPED.with_suffix(".json").read_bytes()
    path = tmp_path / "w.safetensors"
    seen: set[str] = set()

    @quick(40)
    @given(damaged(good, head=2000))
    def read(data: bytes) -> None:
        path.write_bytes(data)
        seen.add(outcome(lambda: load_checkpoint(path)))

    read()
    assert "InputError" in seen
    path.write_bytes(good)

    @quick(60)
    @given(damaged(sidecar) | ANY_JSON.map(lambda value: json.dumps(str(value)).encode()))
    def read_sidecar(data: bytes) -> None:
        path.with_suffix(".json").write_bytes(data)
        outcome(lambda: load_checkpoint(path))

    read_sidecar()


def test_a_damaged_upstream_checkpoint(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    torch.save({"a": torch.arange(12.0), "b": torch.zeros(3, 4)}, buffer)
    path = tmp_path / "w.pth"

    @quick(120)
    @given(damaged(buffer.getvalue()))
    def read(data: bytes) -> None:
        path.write_bytes(data)
        assert outcome(lambda: load_checkpoint(path)) == "InputError"

    with bounded_memory():
        read()


def test_a_damaged_track_log(tmp_path: Path) -> None:
    path = tmp_path / "front.log"
    with TrackLog(path, camera="c", run="r") as log:
        log.append([TRACK, MARK, TRACK])
        log.commit(1)
        log.append([TRACK])
    good = path.read_bytes()
    assert TrackEntry("c", "r", 4, track=TRACK).encode() in good
    seen: set[str] = set()

    def reopen() -> None:
        with TrackLog(path, camera="c", run="r") as log:
            assert [entry.n for entry in log.due(0.0)] == list(range(log.committed + 1, log.newest + 1))

    @quick(200)
    @given(damaged(good))
    def read(data: bytes) -> None:
        path.write_bytes(data)
        seen.add(outcome(reopen))

    read()
    assert seen == {"value", "LedgerError"}
