"""View packs and belt packs: what is written comes back, whatever is added to it; newer versions are refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conveyor.errors import InputError
from conveyor.formats.packs.belts import ARRAYS as BELT_ARRAYS
from conveyor.formats.packs.belts import BeltPackWriter, PackedBelt, PackedFrame, belt_shards, pack_belt, read_belt
from conveyor.formats.packs.views import ARRAYS, PackedView, ViewPackWriter, read_views, view_shards
from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from regressor.training.labelled import read_labelled
from segmenter.training.pack import pack_frames
from tests.formats.consumers import add_byte_order_mark

K = Intrinsics(64, 48, 60.0, 61.0, 31.5, 23.5)


def _view(n: int) -> PackedView:
    rng = np.random.default_rng(n)
    depth = rng.integers(300, 340, (5 + n, 4)).astype(np.uint16)
    return PackedView(
        depth=depth,
        u0=10 + n,
        v0=20,
        intrinsics=K,
        depth_scale_m=0.001,
        belt_distance_m=0.345,
        belt_sd_m=0.001,
        weight_g=100.0 + n,
        volume_ml=90.0,
        length_mm=80.0,
        width_mm=60.0,
        height_mm=50.0,
        tuber=n // 2,
        cultivar="Sayaka",
        season="2023",
        v_centre=24.0,
    )


def _view_pack(folder: Path, views: list[PackedView]) -> Path:
    with ViewPackWriter(folder, meta={"seed": 3}) as writer:
        for view in views:
            writer.add([view])
    return folder


def _same(one: PackedView, two: PackedView) -> bool:
    return np.array_equal(one.depth, two.depth) and all(
        getattr(one, name) == getattr(two, name) for name in PackedView.__slots__ if name not in ("depth", "more")
    )


def test_a_view_pack_comes_back(tmp_path: Path) -> None:
    views = [_view(n) for n in range(5)]
    (shard,) = view_shards(_view_pack(tmp_path, views))
    assert all(_same(one, two) for one, two in zip(views, read_views(shard), strict=True))
    assert json.loads((tmp_path / "meta.json").read_text())["version"] == 1
    with np.load(shard) as file:
        assert set(file.files) == {array.name for array in ARRAYS}
    labelled = list(read_labelled(tmp_path))
    assert [view.tuber for view in labelled] == [f"{tmp_path.name}/{view.tuber}" for view in views]
    assert labelled[1].cx == K.cx - 11


def test_arrays_that_the_format_does_not_name_come_back_by_name(tmp_path: Path) -> None:
    views = [replace(_view(n), more={"rim": f"kind-{n}", "resting_mm": 7.0 + n}) for n in range(3)]
    (shard,) = view_shards(_view_pack(tmp_path, views))
    read = list(read_views(shard))
    assert [dict(view.more) for view in read] == [{"rim": f"kind-{n}", "resting_mm": 7.0 + n} for n in range(3)]


def test_what_tells_a_resting_level_is_told_whole(tmp_path: Path) -> None:
    """Without a recording or a preset beside it, it ended an evaluation in a KeyError."""
    resting = dict.fromkeys(("stated_resting_mm", "stated_resting_sd_mm", "resting_recording_mm", "resting_mm"), 1.0)
    whole = {**resting, "recording": 3, "calibrated": False, "preset": "field"}
    for changed, text in (
        ({"preset": None, "recording": None}, "has stated_resting_mm and lacks recording, preset: "),
        ({"resting_mm": np.nan}, "'resting_mm' holds what is no number of millimetres"),
        ({"recording": -1}, "'recording' is int64; allowed are whole numbers from 0"),
        ({"soil_mm": "thick"}, "view 0: could not convert string to float"),
    ):
        more = {name: value for name, value in (whole | changed).items() if value is not None}
        _view_pack(tmp_path, [replace(_view(0), more=more)])
        with pytest.raises(InputError, match=text):
            list(read_labelled(tmp_path))


def test_a_pack_without_a_version_or_optional_arrays_stays_readable(tmp_path: Path) -> None:
    """As they were written before packs had a version; the depth scale may be one number for all."""
    bare = replace(_view(0), belt_sd_m=None, volume_ml=None, length_mm=None, width_mm=None, height_mm=None)
    (shard,) = view_shards(_view_pack(tmp_path, [bare]))
    (tmp_path / "meta.json").write_text('{"seed": 3}')
    add_byte_order_mark(tmp_path / "meta.json")
    with np.load(shard) as file:
        arrays = {name: file[name] for name in file.files} | {"depth_scale_m": np.array(0.001)}
    assert "volume_ml" not in arrays
    np.savez(shard, **arrays)
    (view,) = read_labelled(tmp_path)
    assert np.isnan(view.volume_ml)
    assert (view.depth_scale_m, view.belt_sd_m) == (0.001, 0.002)


def test_a_newer_view_pack_is_refused_by_name_and_number(tmp_path: Path) -> None:
    _view_pack(tmp_path, [_view(0)])
    (tmp_path / "meta.json").write_text('{"version": 2}')
    with pytest.raises(InputError, match=r"meta\.json is a view pack of version 2; .* reads up to version 1"):
        list(read_labelled(tmp_path))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda a: a.pop("weight_g"), r"lacks weight_g; it has"),
        (lambda a: a.update(belt_distance_m=np.zeros(7)), r"array 'belt_distance_m' has shape \(7,\); 2 rows"),
        (lambda a: a["depth_offset"].__setitem__(1, 3), r"view 0: 3 depths for a crop of 5x4"),
        (lambda a: a.update(notes=np.zeros(9)), r"array 'notes' has shape \(9,\); 2 rows"),
        (lambda a: a.update(intrinsics=a["intrinsics"][:, :3]), r"'intrinsics' has shape \(2, 3\); \(2, 4\) is needed"),
        (lambda a: a.update(crop=np.zeros(2)), r"'crop' has shape \(2,\); \(2, 4\) is needed"),
        (lambda a: a.update(tuber=np.array(["A1", "A2"])), r"'tuber' is <U2; allowed are whole numbers, the same in"),
        (lambda a: a.update(tuber=np.array([1.2, 1.7])), r"'tuber' is float64; allowed are whole numbers"),
        (lambda a: a.update(crop=np.full((2, 4), np.inf)), r"view 0: cannot convert float infinity"),
        (lambda a: a.update(depth=np.array(3, np.uint16)), r"view 0: too many indices"),
        (lambda a: a.update(depth=a["depth"] * np.nan), r"'depth' is float64; allowed are whole units of depth"),
        (lambda a: a.update(depth=-a["depth"].astype(int)), r"'depth' is int64; allowed .* 0 to 65535"),
        (lambda a: a.update(depth_scale_m=np.zeros(2)), r"view 0: depth_scale_m is 0; allowed are 1e-06 to 1 metres"),
        (lambda a: a.update(belt_distance_m=np.array([0.3, np.nan])), r"view 1: belt_distance_m is nan; allowed"),
        (lambda a: a.update(belt_sd_m=np.array([-0.001, 0.1])), r"view 0: belt_sd_m is -0.001; allowed are 0 to 0.1"),
    ],
)
def test_shards_that_contradict_themselves_are_refused(tmp_path: Path, change: object, text: str) -> None:
    (shard,) = view_shards(_view_pack(tmp_path, [_view(0), _view(1)]))
    with np.load(shard) as file:
        arrays = {name: file[name] for name in file.files}
    change(arrays)  # type: ignore[operator]
    np.savez(shard, **arrays)
    with pytest.raises(InputError, match=text):
        list(read_views(shard))
    shard.write_bytes(shard.read_bytes()[:200])
    with pytest.raises(InputError, match="cannot be read"):
        list(read_views(shard))


def test_two_tubers_of_one_number_are_refused(tmp_path: Path) -> None:
    """Shards of two packs that both count from 0 were taken for more views of the same tubers: per tuber, and for what
    an interval counts as independent, each was the mean of two.
    """
    _view_pack(tmp_path, [_view(0), _view(1), _view(2)])  # 100 and 101 g are of one tuber
    assert [view.tuber.rpartition("/")[2] for view in read_labelled(tmp_path)] == ["0", "0", "1"]
    other = _view_pack(tmp_path / "other", [replace(_view(0), weight_g=160.0)])
    (other / "views-00000.npz").rename(tmp_path / "views-00001.npz")
    with pytest.raises(InputError, match=r"views-00001.npz: tuber 0 weighs 160 g, and 100 g in views-00000.npz before"):
        list(read_labelled(tmp_path))


def _belt(n: int) -> PackedBelt:
    rng = np.random.default_rng(n)
    images = [rng.integers(1, 9, (48, 64)).astype(np.uint16) for _ in range(4)]
    shown = (PackedFrame(images[0], images[1], 0.1), PackedFrame(images[2], images[3], 0.2))
    return PackedBelt(K, straight_down_belt_from_camera(0.46), 0.001, ("tuber", "clod"), shown)


def test_a_belt_pack_comes_back_to_training(tmp_path: Path) -> None:
    with BeltPackWriter(tmp_path, meta={"seed": 4}) as writer:
        for n in range(2):
            writer.add(_belt(n))
    assert (writer.belts, writer.frames) == (2, 4)
    for n, shard in enumerate(belt_shards(tmp_path)):
        read, made = read_belt(shard), _belt(n)
        assert (read.intrinsics, read.kinds, read.depth_scale_m) == (made.intrinsics, made.kinds, made.depth_scale_m)
        for one, two in zip(read.frames, made.frames, strict=True):
            assert np.array_equal(one.depth, two.depth)
            assert np.array_equal(one.labels, two.labels)
    assert [(frame.belt_number, frame.travel_m) for frame in pack_frames(tmp_path)] == [
        (0, 0.1), (0, 0.2), (1, 0.1), (1, 0.2)
    ]  # fmt: skip
    for broken in ({"image_size": np.array([np.inf, 48])}, {"depth": np.array(1, np.uint8)}):
        np.savez(tmp_path / "belts-00009.npz", **(pack_belt(_belt(0)) | broken))
        with pytest.raises(InputError, match=r"belts-00009\.npz cannot be used: .*make the pack again"):
            read_belt(tmp_path / "belts-00009.npz")
    (tmp_path / "meta.json").write_text('{"version": 7}')
    with pytest.raises(InputError, match=r"belt pack of version 7; .* reads up to version 1"):
        next(pack_frames(tmp_path))


def test_the_docs_name_every_array() -> None:
    page = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")
    for array in (*ARRAYS, *BELT_ARRAYS):
        assert f"| `{array.name}`{'' if array.needed else ' *'} | {array.shape} | {array.says} |" in page, array.name
