"""Export to ONNX: the fast form with shared neighbours and all rules around it, in one fixed shape per cloud.

Inputs (B clouds): `groups` (B, 256, 3) float32: 64 neighbours, 64 first-stage and 128 second-stage centroids, centred,
metres, as `regressor.network.fast.groups_tensor` lays them out; `height_m` (B,) float32 above the resting level;
`features` (B, 35) float64 of the visible surface; `belt_sd_m`, `noise_px` and `belt_distance_m` (B,) float64. Outputs,
(B,) float64 grams: `weight_g` with its 90 % interval `low_g` and `high_g` as a ledger has them, and what it is made of,
`network_g` and `volume_g`.
Clouds whose radius binds (`grouping.GatheredGroups`) are not for this form.
"""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import torch
from torch import Tensor, nn

from conveyor import __version__
from conveyor.errors import InputError
from conveyor.extras import needed
from regressor.network.architecture import NEIGHBOURS
from regressor.network.grouping import CENTROIDS_2
from regressor.network.pointraft import PointRaft, SharedMlp
from regressor.network.reduced import edge_features, global_feature
from regressor.network.sidecar import Sidecar
from regressor.weigh.surface import NAMES

POINTS = 1024
OPSET = 17
LICENCE = "Apache-2.0"
PREPARATION = (
    "tuberline.prepare(cloud, belt_distance_m{weights}).feed() makes all inputs of one tuber's cloud, in metres, from "
    "a camera that looks straight down. groups (256, 3): of the cleaned cloud, centred on the mean of its points, z "
    "away from the camera, {groups}. height_m: of the highest point above the level where undersides lie. "
    "features: of the visible surface, in the order that 'features' names. belt_sd_m: standard deviation of that "
    "level. noise_px: local noise of the depth, pixels of disparity at a baseline of 18 mm; 0 where it is not known. "
    "belt_distance_m: from the camera to the belt; the interval is wider where that is out of 'ranges'."
)
GROUPS = {
    "prefix": "farthest-point sampling from the first point gives 64 neighbours, the first 64 centroids and the first "
    "128 centroids, one after the other",
    "random": "64 neighbours, 64 and 128 centroids, one after the other, each by a farthest-point sampling of its own "
    "that begins at a random point; of at most 1024 points the neighbours are the first 64 as they stand",
}
WEIGHTS = {"prefix": "", "random": ", weights=tuberline.load_weights(FILE)"}
"""What `prepare` must be told: how sampling starts is of the weights that were exported."""
OUTPUTS_TOLD = (
    "grams, one per cloud. weight_g with its 90 % interval low_g to high_g as a ledger has a single view; network_g is "
    "the network alone, volume_g the visible volume alone. Outside 'ranges' no one knows how good they are."
)


class ExportedPointRaft(nn.Module):
    """Grams of B clouds from their groups."""

    def __init__(self, model: PointRaft) -> None:
        super().__init__()
        self.model = model
        # All of it: the exporter puts the whole back into the mode it found it in.
        self.eval()

    def forward(self, groups: Tensor, height_m: Tensor) -> Tensor:
        """(B,) grams of (B, 256, 3) groups and (B,) heights."""
        neighbours, centroids1 = groups[:, :NEIGHBOURS], groups[:, NEIGHBOURS : 2 * NEIGHBOURS]
        centroids2 = groups[:, 2 * NEIGHBOURS :]
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
    from regressor.weigh.graph import INPUTS, OUTPUTS, WeighingGraph

    if sidecar.input.points != POINTS:
        raise InputError(f"{sidecar.model_id} takes {sidecar.input.points} points; export knows networks of {POINTS}")
    onnx = needed("onnx", extra="export", what="export")
    count = batch or 2
    example = (
        torch.zeros(count, 2 * NEIGHBOURS + CENTROIDS_2, 3),
        torch.zeros(count),
        torch.ones(count, len(NAMES), dtype=torch.float64),
        torch.zeros(count, dtype=torch.float64),
        torch.zeros(count, dtype=torch.float64),
        torch.ones(count, dtype=torch.float64),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    # No gradients: a training's steps go through edges in a way that no graph holds.
    with warnings.catch_warnings(), torch.no_grad():
        # The tracing exporter is deprecated in favour of one that needs a further package for the same graph.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            WeighingGraph(ExportedPointRaft(model), sidecar),
            example,
            str(path),
            input_names=list(INPUTS),
            output_names=list(OUTPUTS),
            dynamic_axes=None if batch else {name: {0: "batch"} for name in (*INPUTS, *OUTPUTS)},
            opset_version=OPSET,
            dynamo=False,
        )
    exported = onnx.load(str(path))
    exported.producer_name, exported.producer_version = "tuberline", __version__
    onnx.helper.set_model_props(exported, described(sidecar))
    onnx.save(exported, str(path))
    text = json.dumps(sidecar.model_dump(mode="json"), indent=1, allow_nan=False)
    path.with_suffix(".json").write_text(text + "\n", encoding="utf-8")


def described(sidecar: Sidecar) -> dict[str, str]:
    """What the file says of itself to a program that has never heard of us; values are text, some of it JSON."""
    ranges = {name: getattr(sidecar, name).model_dump() for name in ("belt_distance_m", "weight_g", "length_mm")}
    kind = sidecar.start.kind
    return {
        "name": sidecar.name,
        "model": sidecar.model_id,
        "weights_sha256": sidecar.sha256,
        "licence": LICENCE,
        "ranges": json.dumps(ranges),
        "input": json.dumps(sidecar.input.model_dump(mode="json")),
        "start": kind,
        "features": json.dumps(NAMES),
        "preparation": PREPARATION.format(weights=WEIGHTS[kind], groups=GROUPS[kind]),
        "outputs": OUTPUTS_TOLD,
    }
