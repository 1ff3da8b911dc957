"""Export: ONNX gives torch's grams within 0.01 g, with a fixed and an open batch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from regressor.network.checkpoint import load_checkpoint
from regressor.network.export import export_onnx
from regressor.network.fast import FastPointRaft, groups_tensor
from regressor.network.grouping import SharedGroups, group_prefix
from regressor.weigh.prepare import prepare_view
from tests.regressor.ellipsoids import ellipsoid_view

pytest.importorskip("onnx")
runtime = pytest.importorskip("onnxruntime")


@pytest.mark.parametrize("batch", [None, 3])
def test_onnx_gives_the_same_grams(tmp_path: Path, batch: int | None) -> None:
    model, sidecar = load_checkpoint()
    fast = FastPointRaft(model)
    clouds = [prepare_view(ellipsoid_view((0.03 + 0.005 * i, 0.03, 0.026))) for i in range(3)]
    groups = [group_prefix(cloud.points) for cloud in clouds]
    heights = np.array([cloud.clamped_height_m() for cloud in clouds], np.float32)
    expected = [fast.weigh(group, float(height)) for group, height in zip(groups, heights, strict=True)]
    export_onnx(tmp_path / "net.onnx", model, sidecar, batch=batch)
    options = runtime.SessionOptions()
    options.intra_op_num_threads = 1
    session = runtime.InferenceSession(tmp_path / "net.onnx", options, providers=["CPUExecutionProvider"])
    stacked = np.stack([groups_tensor(group) for group in groups if isinstance(group, SharedGroups)])
    (weights,) = session.run(None, {"groups": stacked, "height_m": heights})
    assert weights == pytest.approx(expected, abs=0.01)
    if batch is None:
        (alone,) = session.run(None, {"groups": stacked[:1], "height_m": heights[:1]})
        assert alone == pytest.approx(expected[:1], abs=0.01)
