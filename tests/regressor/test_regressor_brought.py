"""What people bring to `weigh`: clouds of other programs, folders, frames with instances, checkpoints in wrappings."""

from __future__ import annotations

import argparse
import csv
import io
import json
from pathlib import Path

import cv2
import laspy
import numpy as np
import pytest
import torch
from pypcd4 import Encoding, PointCloud
from rich.console import Console

from conveyor.errors import InputError
from conveyor.extras import missing_package, needed
from conveyor.formats.clouds import read_cloud
from regressor.network.checkpoint import load_checkpoint
from regressor.network.sidecar import Sidecar
from regressor.weigh.files import FileOptions, FileResult, files_within, weigh_file
from regressor.weigh.instances import weigh_instances
from regressor.weigh.weigher import Weigher
from tests.regressor.ellipsoids import D405, ellipsoid_depth_m
from tuberline.cli.weigh import weigh
from tuberline.cli.weigh_table import COLUMNS, weight_csv, weight_table

POINTS = np.array([[0.0, 0.1, 0.3], [0.25, -0.5, 0.125], [0.5, 0.25, 0.75]])
OPTIONS = FileOptions(belt_distance_m=0.345)
BY_VOLUME = Weigher(None, Sidecar(name="none"))


def las(path: Path) -> None:
    header = laspy.LasHeader(point_format=0, version="1.2")
    header.scales = np.array([1e-5] * 3)
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = POINTS.T
    cloud.write(path)


def pcd(path: Path, encoding: Encoding) -> None:
    with_gap = np.vstack([POINTS, [[np.nan] * 3]]).astype(np.float32)  # PCL's word for a pixel without depth
    PointCloud.from_xyz_points(with_gap).save(path, encoding)


def german(path: Path) -> None:
    np.savetxt(path, POINTS)
    path.write_text(path.read_text(encoding="utf-8").replace(".", ","), encoding="utf-8")


WRITERS = {
    "a.las": las,
    "a.laz": las,
    "ascii.pcd": lambda path: pcd(path, Encoding.ASCII),
    "binary.pcd": lambda path: pcd(path, Encoding.BINARY),
    "packed.pcd": lambda path: pcd(path, Encoding.BINARY_COMPRESSED),
    "plain.xyz": lambda path: np.savetxt(path, POINTS),
    "named.xyz": lambda path: np.savetxt(path, POINTS, delimiter=",", header="X,Y,Z", comments="//"),
    "german.xyz": german,
    "coloured.xyz": lambda path: np.savetxt(path, np.hstack([POINTS, 255 * np.ones((3, 3))]), delimiter=";"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_clouds_of_other_programs_are_read(name: str, tmp_path: Path) -> None:
    WRITERS[name](tmp_path / name)
    assert read_cloud(tmp_path / name) == pytest.approx(POINTS, abs=2e-5)


@pytest.mark.parametrize("name", [name for name in WRITERS if not name.endswith("xyz")])
@pytest.mark.parametrize("share", [0.3, 0.97])
def test_clouds_that_are_cut_short_are_one_sentence(name: str, share: float, tmp_path: Path) -> None:
    WRITERS[name](tmp_path / name)
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match=name) as refused:
        read_cloud(tmp_path / name)
    assert "\n" not in str(refused.value)


def test_a_line_that_is_no_point_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("0 0 1\n0 zero 1\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"a\.xyz has a line that does not begin with x, y, z"):
        read_cloud(tmp_path / "a.xyz")
    (tmp_path / "e.xyz").write_text("", encoding="utf-8")
    assert read_cloud(tmp_path / "e.xyz").shape == (0, 3)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ModuleNotFoundError("", name="rosbags"), r"needs the package rosbags; in the clone.*\[bags\]"),
        (ModuleNotFoundError("", name="rosbags.serde"), r"needs the package rosbags; "),
        (
            ModuleNotFoundError("", name="backports.zstd"),
            r"needs the package backports\.zstd \(which rosbags needs\); ",
        ),
        (
            ImportError("undefined symbol", name="rosbags"),
            r"rosbags, which is there and cannot be loaded \(undefined symbol\); in the clone.*\[bags\]",
        ),
        (
            ImportError("libusb-1.0.so.0: cannot open shared object file: No such file or directory"),
            r"^a bag needs the system's library libusb-1\.0\.so\.0, which rosbags is built on .*"
            r"\(Debian, Ubuntu: sudo apt-get install libusb-1\.0-0\)$",
        ),
        (
            ImportError("libodd.so.3: cannot open shared object file: No such file or directory"),
            r"library libodd\.so\.3, which rosbags is built on and which is not on this machine; install it$",
        ),
    ],
)
def test_the_package_that_is_missing_is_named(error: ImportError, words: str) -> None:
    """rosbags without backports.zstd was told as rosbags missing, and pyrealsense2 without libusb as a package that pip
    would bring.
    """
    import re

    assert re.search(words, missing_package(error, "rosbags", extra="bags", what="a bag"))


def test_a_stop_while_a_compiled_package_is_loaded_is_a_stop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As pyrealsense2 does where SIGTERM comes during its import: a camera that was stopped said to install it."""
    (tmp_path / "half_loaded.py").write_text("raise ImportError('initialization failed') from SystemExit(143)\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(SystemExit, match="143"):
        needed("half_loaded", extra="realsense", what="a live RealSense camera")


def test_a_folder_is_its_clouds_or_else_its_pairs(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    for name in ("b/2.xyz", "1.ply", "notes.txt", "a_depth_300.png", "a_rgb_300.png"):
        (tmp_path / name).write_text("", encoding="utf-8")
    assert [path.name for path in files_within([tmp_path])] == ["1.ply", "2.xyz"]
    (tmp_path / "1.ply").unlink()
    (tmp_path / "b" / "2.xyz").unlink()
    assert {path.name for path in files_within([tmp_path])} == {"a_depth_300.png", "a_rgb_300.png"}
    with pytest.raises(InputError, match=r"holds no cloud and no pair of images; clouds end in \.ply, "):
        files_within([tmp_path / "b"])
    (tmp_path / "b" / "camera.json").write_text("{}", encoding="utf-8")
    with pytest.raises(InputError, match="it is a recording: `tuberline replay`"):
        files_within([tmp_path / "b"])


@pytest.fixture
def frame(tmp_path: Path) -> tuple[Path, Path, Path]:
    """(depth, instances, intrinsics) of a belt with an ellipsoid (label 7), a part of one at the border (9) and a
    label on three pixels (12).
    """
    height_m = ellipsoid_depth_m((0.042, 0.033, 0.028))
    depth = np.round(height_m * 1000).astype(np.uint16)
    labels = np.where(depth > 0, 7, 0).astype(np.uint16)
    v, u = np.nonzero(depth)
    part = np.zeros_like(depth)
    part[v - v.min(), u] = depth[v, u]  # the same, moved up to the first row
    labels[(labels == 0) & (part > 0)] = 9
    depth = np.where(labels == 9, part, depth)
    labels[700, 1200:1203] = 12
    depth[depth == 0] = 345
    paths = tmp_path / "depth.png", tmp_path / "labels.png", tmp_path / "K.json"
    cv2.imwrite(str(paths[0]), depth)
    cv2.imwrite(str(paths[1]), labels)
    k = {"fx": D405.fx, "fy": D405.fy, "cx": D405.cx, "cy": D405.cy}
    paths[2].write_text(json.dumps(k), encoding="utf-8")
    return paths


def test_each_object_of_a_frame_is_a_row(frame: tuple[Path, Path, Path]) -> None:
    depth, labels, k = frame
    options = FileOptions(belt_distance_m=0.345, intrinsics=k)
    seven, nine, twelve = weigh_instances(depth, labels, options, BY_VOLUME)
    assert [result.object for result in (seven, nine, twelve)] == [7, 9, 12]
    assert seven.weighed is not None
    assert nine.weighed is not None
    assert ("cut" in seven.weighed.flags, "cut" in nine.weighed.flags) == (False, True)
    assert seven.height_mm == pytest.approx(56.0, abs=0.6)
    # Alone in its own file of points it weighs the same: an ellipsoid of 84 x 66 x 56 mm.
    v, u = np.nonzero(cv2.imread(str(labels), cv2.IMREAD_UNCHANGED) == 7)
    z = cv2.imread(str(depth), cv2.IMREAD_UNCHANGED)[v, u] / 1000
    cloud = depth.with_name("seven.npy")
    np.save(cloud, np.stack([(u - D405.cx) * z / D405.fx, (v - D405.cy) * z / D405.fy, z], axis=1))
    alone = weigh_file(cloud, OPTIONS, BY_VOLUME)
    assert alone.weighed is not None
    assert seven.weighed.weight_g == pytest.approx(alone.weighed.weight_g, rel=0.01)
    assert twelve.weighed is None
    assert "object 12: the cloud cannot be weighed: it has fewer than 30 points" in twelve.error
    # Masks of 0 and 255: several tubers were weighed as one.
    cv2.imwrite(str(labels), np.where(cv2.imread(str(labels), cv2.IMREAD_UNCHANGED) > 0, 255, 0).astype(np.uint8))
    (merged,) = weigh_instances(depth, labels, options, BY_VOLUME)
    assert merged.weighed is None
    assert "object 255: it lies in several places with bare belt between them" in merged.error


def test_decimal_metres_weigh_the_same(frame: tuple[Path, Path, Path]) -> None:
    depth, labels, k = frame
    options = FileOptions(belt_distance_m=0.345, intrinsics=k)
    expected = [result.weighed for result in weigh_instances(depth, labels, options, BY_VOLUME)]
    metres = depth.with_suffix(".npy")
    np.save(metres, cv2.imread(str(depth), cv2.IMREAD_UNCHANGED).astype(np.float32) / 1000)
    found = [result.weighed for result in weigh_instances(metres, labels, options, BY_VOLUME)]
    for one, other in zip(expected, found, strict=True):
        assert (one is None) is (other is None)
        assert one is None or other is None or one.weight_g == pytest.approx(other.weight_g, rel=1e-3)


def test_instances_that_do_not_fit_are_named(frame: tuple[Path, Path, Path]) -> None:
    depth, labels, k = frame
    options = FileOptions(belt_distance_m=0.345, intrinsics=k)
    image = cv2.imread(str(labels), cv2.IMREAD_UNCHANGED)
    wrong = {
        "small.png": (image[:100], "are 1280x100, the frame .* is 1280x720"),
        "colour.png": (np.zeros((720, 1280, 3), np.uint8), "expected one whole number per pixel"),
        "empty.png": (np.zeros_like(image), "mark no object"),
        "depth.png": (np.arange(720 * 1280).reshape(720, 1280).astype(np.uint16), "that is no mask of objects"),
    }
    for name, (picture, words) in wrong.items():
        path = labels.with_name(f"wrong_{name}")
        cv2.imwrite(str(path), picture)
        with pytest.raises(InputError, match=words):
            list(weigh_instances(depth, path, options, BY_VOLUME))
    with pytest.raises(InputError, match="--instances belong to one frame, 2 paths are given"):
        weigh([depth, depth], belt_distance_m=0.345, instances=labels)
    with pytest.raises(InputError, match=f"--instances belong to one frame, {depth.parent} is a folder"):
        weigh([depth.parent], belt_distance_m=0.345, instances=labels)
    with pytest.raises(InputError, match="--json or --csv, not both"):
        weigh([depth], belt_distance_m=0.345, json=True, csv=True)


def results(tmp_path: Path) -> list[FileResult]:
    """A cloud with a long name that was weighed, and one that was not."""
    long = tmp_path / ("a_name_that_is_long_" * 5 + "enough.npy")
    z = 0.345 - 0.03 - 0.03 * np.sqrt(np.maximum(0, 1 - np.linspace(-0.9, 0.9, 60) ** 2))
    x, y = np.meshgrid(np.linspace(-0.03, 0.03, 60), np.linspace(-0.04, 0.04, 60))
    np.save(long, np.stack([x.ravel(), y.ravel(), np.tile(z, 60)], axis=1))
    return [weigh_file(path, OPTIONS, BY_VOLUME) for path in (long, tmp_path / "none.ply")]


@pytest.mark.parametrize("width", [60, 80, 120])
def test_a_table_fits_the_terminal_and_cuts_no_name(width: int, tmp_path: Path) -> None:
    done = results(tmp_path)
    console = Console(width=width, file=io.StringIO(), record=True)
    console.print(weight_table(done))
    lines = console.export_text().splitlines()
    assert max(map(len, lines)) <= width
    assert done[0].path.name in "".join(line.split("│")[1].strip() for line in lines if line.startswith("│"))
    assert not any("…" in line for line in lines)


def test_what_is_not_there_is_said_before_anything_is_weighed_or_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A table with its head was printed first, and of many files the others were weighed first."""
    results(tmp_path)
    with pytest.raises(InputError, match=r"not there: .*/none\.ply, .*/too\.ply; nothing was weighed"):
        weigh([tmp_path, tmp_path / "none.ply", tmp_path / "too.ply"], belt_distance_m=0.345)
    (tmp_path / "torn.ply").write_bytes(b"ply\n")
    with pytest.raises(InputError, match=r"torn\.ply has no end_header"):
        weigh([tmp_path / "torn.ply"], belt_distance_m=0.345)
    assert capsys.readouterr().out == ""


def test_csv_has_a_row_for_each_and_every_column(tmp_path: Path) -> None:
    weighed, failed = csv.DictReader(io.StringIO(weight_csv(results(tmp_path))))
    assert tuple(weighed) == COLUMNS
    assert float(weighed["low_g"]) < float(weighed["weight_g"]) < float(weighed["high_g"])
    assert (failed["weight_g"], failed["error"]) == ("", f"cloud {tmp_path / 'none.ply'} does not exist")


def test_a_state_dict_in_a_wrapping_is_found(tmp_path: Path) -> None:
    model, _ = load_checkpoint()
    state = model.state_dict()
    wrapped = {
        "lightning.ckpt": {"epoch": 3, "state_dict": {f"model.{name}": value for name, value in state.items()}},
        "loop.pt": {"step": 9, "model_state_dict": {f"module.{name}": value for name, value in state.items()}},
        "compiled.pth": {f"_orig_mod.module.{name}": value for name, value in state.items()},
    }
    for name, saved in wrapped.items():
        torch.save(saved, tmp_path / name)
        found, _ = load_checkpoint(tmp_path / name)
        assert all(torch.equal(value, state[key]) for key, value in found.state_dict().items())


@pytest.mark.parametrize(
    ("saved", "words"),
    [
        ({"epoch": 3, "optimizer": {"lr": 1}}, "hold a checkpoint of epoch, optimizer, not a state dict of tensors"),
        ([1, 2], "hold a list, not a state dict"),
        ({"state_dict": {"encoder.weight": torch.zeros(2)}}, "not of PointRAFT's architecture: 'sa1_module"),
        ({"hyper_parameters": argparse.Namespace(lr=1)}, r"Python objects \(argparse\.Namespace\), and loading those"),
    ],
)
def test_a_checkpoint_without_one_is_refused_by_name(saved: object, words: str, tmp_path: Path) -> None:
    torch.save(saved, tmp_path / "w.ckpt")
    with pytest.raises(InputError, match=words) as refused:
        load_checkpoint(tmp_path / "w.ckpt")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("content", [b"label,weight\na,1\n", b"\x08\x07\x12\x07pytorch"])
def test_a_file_of_another_kind_is_no_checkpoint(content: bytes, tmp_path: Path) -> None:
    """Of a table and of an ONNX file it was said that they would run code when they are loaded."""
    (tmp_path / "w.pth").write_bytes(content)
    with pytest.raises(InputError, match=r"w\.pth are no safetensors file or PyTorch state dict") as refused:
        load_checkpoint(tmp_path / "w.pth")
    assert "\n" not in str(refused.value)
