"""What a saved network says of labelled views, as `weigh` says it: from the same points in the same order."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import torch
from numpy.typing import NDArray

from regressor.network.checkpoint import state_of
from regressor.network.fast import Form
from regressor.network.pointraft import PointRaft
from regressor.network.sidecar import Sidecar
from regressor.training.cloudset import Asked, CloudSet
from regressor.training.train import SWIFT, predict_swiftly
from regressor.training.work import Work, no_work
from regressor.weigh.weigher import Weigher


def asked_while_read(model: PointRaft, sidecar: Sidecar, *, compute: torch.dtype | None) -> Asked | None:
    """Who is asked of each whole cloud while a set is prepared; None where the points that a set keeps are enough.

    A set keeps points in the order of a sampling from the first one. A network whose samplings start at random (an
    imported checkpoint) reads others: from the kept ones its weights were up to 26 g off.
    """
    if sidecar.start.kind == "prefix":
        return None
    form = Form("bfloat16" if compute is torch.bfloat16 else "float32", SWIFT.centroids)
    weigher = Weigher(state_of(model), sidecar, form)
    reads = [sidecar.sha256, sidecar.start.model_dump(), sidecar.input.model_dump(), form.flags]
    return Asked(weigher.network_g, hashlib.sha256(json.dumps(reads).encode()).hexdigest())


def answers(
    model: PointRaft,
    sidecar: Sidecar,
    views: CloudSet,
    *,
    compute: torch.dtype | None = None,
    on_work: Work = no_work,
) -> NDArray[np.float64]:
    """(n,) grams of the network alone on `views`, which were loaded with `asked_while_read`; at `SWIFT` resolution."""
    if sidecar.start.kind == "random":
        return views.network_g
    highest_m, points = sidecar.input.max_height_m, sidecar.input.points
    return predict_swiftly(model, views, highest_m=highest_m, points=points, compute=compute, on_work=on_work)
