"""Export to ONNX: the fast form with shared neighbours, for any batch size, in one fixed shape per cloud.

Input `groups` (B, 256, 3) float32: 64 neighbours, 64 first-stage and 128 second-stage centroids, centred, metres, as
`regressor.network.fast.groups_tensor` lays them out; `height_m` (B,) float32. Output `weight_g` (B,). Clouds whose
radius binds (`grouping.GatheredGroups`) are not for this form: weigh them with `regressor.network.fast`.
"""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import torch
from torch import Tensor, nn

from conveyor.errors import InputError
from regressor.network.checkpoint import Sidecar
from regressor.network.grouping import CENTROIDS_2
from regressor.network.pointraft import NEIGHBOURS, PointRaft, SharedMlp
from regressor.network.reduced import edge_features, global_feature

POINTS = 1024
OPSET = 17


class ExportedPointRaft(nn.Module):
    """Grams of B clouds from their groups."""

    def __init__(self, model: PointRaft) -> None:
        super().__init__()
        self.model = model
        # All of it: the exporter puts the whole back into the mode it found it in.
        self.eval()

    def forward(self, groups: Tensor, height_m: Tensor) -> Tensor:
        """(B,) grams of (B, 256, 3) groups and (B,) heights."""
        neighbours, centroids1, centroids2 = torch.split(groups, [NEIGHBOURS, NEIGHBOURS, CENTROIDS_2], dim=1)
        stage1 = edge_features(_mlp(self.model.sa1_module.conv), neighbours, centroids1, None)
        pairs = torch.cat([stage1, centroids1], dim=2)
        stage2 = edge_features(_mlp(self.model.sa2_module.conv), pairs, centroids2, None)
        described = global_feature(self.model.sa3_module.nn, torch.cat([stage2, centroids2], dim=2), None)
        if self.model.height_embed is not None:
            described = torch.cat([described, self.model.height_embed(height_m[:, None])], dim=1)
        weight: Tensor = self.model.regression_head(described)[:, 0]
        return weight


def _mlp(conv: nn.Module) -> SharedMlp:
    mlp = conv.local_nn
    assert isinstance(mlp, SharedMlp)
    return mlp


def export_onnx(path: Path, model: PointRaft, sidecar: Sidecar, *, batch: int | None = None) -> None:
    """Write `path` (.onnx) and the sidecar beside it as JSON. `batch` fixes the batch size; None leaves it open.

    Raises:
        InputError: the extra 'export' is not installed.
    """
    if sidecar.input.points != POINTS:
        raise InputError(f"{sidecar.model_id} takes {sidecar.input.points} points; export knows networks of {POINTS}")
    try:
        import onnx  # noqa: F401
    except ImportError as error:
        raise InputError("export needs the package onnx: install the extra 'export'") from error
    count = batch or 2
    example = (torch.zeros(count, 2 * NEIGHBOURS + CENTROIDS_2, 3), torch.zeros(count))
    open_axes = {name: {0: "batch"} for name in ("groups", "height_m", "weight_g")}
    path.parent.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        # The tracing exporter is deprecated in favour of one that needs a further package for the same graph.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            ExportedPointRaft(model),
            example,
            str(path),
            input_names=["groups", "height_m"],
            output_names=["weight_g"],
            dynamic_axes=None if batch else open_axes,
            opset_version=OPSET,
            dynamo=False,
        )
    text = json.dumps(sidecar.model_dump(mode="json"), indent=1, allow_nan=False)
    path.with_suffix(".json").write_text(text + "\n", encoding="utf-8")
