"""Data of one's own in the layout of 3DPotatoTwin: what is read is what lies there, and parts stay apart."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from regressor.training.cloudset import CloudSet, load_cloudset
from regressor.training.run import RunOptions, load_sets
from tests.regressor.twin_folder import write_parts, write_twin


def test_the_cache_notices_other_splits_and_another_camera(tmp_path: Path) -> None:
    """Neither was part of the cache's name: a test tuber of the new splits.csv stayed in the training set."""
    labels = write_twin(tmp_path / "crop", tubers=4)
    write_parts(tmp_path / "crop", {"train": labels[:3], "test": labels[3:]})
    first = load_cloudset(tmp_path / "crop", split="train", cache=tmp_path / "cache")
    write_parts(tmp_path / "crop", {"train": labels[1:], "test": labels[:1]})
    second = load_cloudset(tmp_path / "crop", split="train", cache=tmp_path / "cache")
    assert first.tuber.tolist() == labels[:3]
    assert second.tuber.tolist() == labels[1:]
    (camera,) = (tmp_path / "crop" / "1_rgbd" / "0_camera_intrinsics").iterdir()
    told = json.loads(camera.read_text(encoding="utf-8"))
    told["intrinsic_matrix"][0] *= 2
    camera.write_text(json.dumps(told), encoding="utf-8")
    third = load_cloudset(tmp_path / "crop", split="train", cache=tmp_path / "cache")
    assert np.ptp(third.points[0], axis=0)[0] == pytest.approx(np.ptp(second.points[0], axis=0)[0] / 2, rel=0.02)


def _sets(data: Path, validation: Path, out: Path) -> tuple[CloudSet, CloudSet]:
    options = RunOptions(data, validation, out, "x", False, 9.0, 9.0, 200, "tuberline train")
    return load_sets(options, lambda what, done: None)


def test_tubers_of_one_weight_are_not_one_tuber(tmp_path: Path) -> None:
    """Without a volume two tubers of 120 g were taken for one: with a scale that shows 5 g, a quarter of a training set
    was thrown away as being in the validation set too, and nothing counted it.
    """
    labels = write_twin(tmp_path / "crop", tubers=6, weights_g=["120"] * 6)
    write_parts(tmp_path / "crop", {"train": labels[:4], "val": labels[4:]})
    data, validation = _sets(tmp_path / "crop", tmp_path / "crop", tmp_path / "out")
    assert data.tuber.tolist() == labels[:4]
    assert validation.tuber.tolist() == labels[4:]
    assert data.refused == {}


def test_tubers_of_the_validation_set_are_counted_where_they_are_left_out(tmp_path: Path) -> None:
    """docs/train.md says that a training tells of them; nothing did."""
    write_twin(tmp_path / "crop", tubers=4)
    write_twin(tmp_path / "part", tubers=2)
    data, _ = _sets(tmp_path / "crop", tmp_path / "part", tmp_path / "out")
    assert data.tuber.tolist() == ["t002", "t003"]
    assert data.refused == {"in_validation": 2}
