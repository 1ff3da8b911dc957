"""Data of one's own in the layout of 3DPotatoTwin: what is read is what lies there, and parts stay apart."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from regressor.training.cloudset import load_cloudset
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
