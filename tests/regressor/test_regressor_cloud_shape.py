"""What is no cloud of shape (N, 3) is refused with what to take in its place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tuberline
from conveyor.errors import InputError
from conveyor.formats.clouds import read_cloud
from regressor.weigh.files import files_within
from regressor.weigh.prepare import RefusedCloud, prepare_cloud

TABLE = np.zeros(9, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("red", "u1")])
OTHERWISE: dict[str, tuple[Any, str]] = {
    "turned": (np.ones((3, 40)), r"float64 \(3, 40\): take its transpose, cloud\.T"),
    "coloured": (
        np.ones((40, 6)),
        r"float64 \(40, 6\): take cloud\[:, :3\], where its first three columns are x, y, z",
    ),
    "both": (np.ones((6, 40)), r"float64 \(6, 40\): take cloud\[:3\]\.T, where its first three rows are x, y, z"),
    "flat": (np.ones(120), r"float64 \(120,\): take cloud\.reshape\(-1, 3\)"),
    "one-of-many": (np.ones((1, 40, 3)), r"float64 \(1, 40, 3\): take cloud\[0\]"),
    "image-of-points": (np.ones((8, 9, 3)), r".*take the points of one tuber: cloud\[mask\] with its mask"),
    "depth": (np.ones((48, 64), np.uint16), r"uint16 \(48, 64\): .*; a depth image is for weigh_depth, its file for"),
    "places": (np.ones((40, 2)), r"float64 \(40, 2\): .* without z nothing can be weighed"),
    "table": (TABLE, r"columns x, y, z, red: take np\.stack\(\[cloud\['x'\]"),
    "truth": (np.ones((40, 3), bool), r"bool \(40, 3\): take real numbers, float64, in metres"),
    "several": (np.ones((2, 3, 4, 5)), r"float64 \(2, 3, 4, 5\): take an array of two axes"),
}


@pytest.mark.parametrize("name", OTHERWISE)
def test_how_to_make_a_cloud_of_another_array_is_said(name: str, tmp_path: Path) -> None:
    """It was only said that they are no cloud of shape (N, 3)."""
    array, words = OTHERWISE[name]
    np.save(tmp_path / "a.npy", array)
    np.savez(tmp_path / "a.npz", points=array, weight_g=120.0)
    with pytest.raises(RefusedCloud, match=rf"not an array of shape \(N, 3\); given is {words}") as refusal:
        prepare_cloud(array, belt_distance_m=0.345)
    assert refusal.value.reason == "not_a_cloud"
    for file in ("a.npy", "a.npz"):
        with pytest.raises(InputError, match=rf"{file} .*{words}.*, and save it again"):
            read_cloud(tmp_path / file)


def test_what_is_no_array_is_no_cloud(tmp_path: Path) -> None:
    for other, words in ((None, "given is a NoneType: .*np.asarray"), ([[1, 2, 3], [1, 2]], "inhomogeneous")):
        with pytest.raises(RefusedCloud, match=words):
            prepare_cloud(other, belt_distance_m=0.345)  # type: ignore[arg-type]
    np.savez(tmp_path / "two.npz", a=np.ones((40, 3)), b=np.ones((40, 3)))
    with pytest.raises(InputError, match=r"a \(40, 3\), b \(40, 3\): save the one that is meant as 'points'"):
        read_cloud(tmp_path / "two.npz")
    (tmp_path / "texts").mkdir()
    (tmp_path / "texts" / "t1.csv").write_text("x,y,z\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"holds no cloud and no pair .* rename it; pairs of images are named"):
        files_within([tmp_path / "texts"])


def test_masked_values_are_not_read_as_if_they_were_there() -> None:
    """NumPy's mask fell off: points that their owner had masked out were weighed."""
    cloud = np.random.default_rng(1).uniform(-0.02, 0.02, (60, 3)) + np.array([0.0, 0.0, 0.32])
    hidden = np.ma.masked_array(cloud, mask=np.zeros(cloud.shape, bool))
    whole = prepare_cloud(hidden, belt_distance_m=0.345)  # nothing is masked
    assert np.array_equal(whole.points, prepare_cloud(cloud, belt_distance_m=0.345).points)
    hidden[7, 2] = np.ma.masked
    with pytest.raises(RefusedCloud, match=r"a masked array, 1 of its values masked: take cloud\[~np.ma") as refusal:
        prepare_cloud(hidden, belt_distance_m=0.345)
    assert refusal.value.reason == "not_a_cloud"
    k = tuberline.Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    depth, inside = np.full((48, 64), 300, np.uint16), np.ones((48, 64), bool)
    half = np.zeros((48, 64), bool)
    half[:10] = True
    for image, mask, words in (
        (np.ma.masked_array(depth, mask=half), inside, r"depth is a masked array, 640 .*: take depth.filled\(0\)"),
        (depth, np.ma.masked_array(inside, mask=half), r"mask is a masked array, 640 .*: take mask.filled\(False\)"),
    ):
        with pytest.raises(tuberline.TuberlineError, match=words):
            tuberline.weigh_depth(image, mask=mask, intrinsics=k, depth_scale_m=0.001, belt_distance_m=0.345)


def test_what_is_no_image_is_told_how_to_become_one() -> None:
    k = tuberline.Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    depth = np.full((48, 64), 300, np.uint16)
    wrong: tuple[tuple[Any, Any, str], ...] = (
        (depth / 1000, None, r"float64 \(48, 64\); .* np.round\(depth_m / depth_scale_m\).astype\(np.uint16\)"),
        (depth[None], None, r"uint16 \(1, 48, 64\); .* take depth\[0\]"),
        (depth[..., None], None, r"uint16 \(48, 64, 1\); .* take depth\[..., 0\]"),
        (depth.astype(np.int32), None, r"int32 \(48, 64\); .* depth.astype\(np.uint16\)"),
        (depth, np.ones((48, 64)), r"mask is float64 \(48, 64\); .* mask > 0"),
    )
    for image, mask, words in wrong:
        with pytest.raises(tuberline.TuberlineError, match=words):
            tuberline.weigh_depth(image, mask=mask, intrinsics=k, depth_scale_m=0.001, belt_distance_m=0.345)
