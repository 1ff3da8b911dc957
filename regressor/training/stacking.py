"""The volume rule and its blend with a trained network, fitted on worlds that the network has not seen.

A network answers its own training views too well: a blend fitted there would trust it too much. So it is fitted on
other recordings, and the rule's answers there come from fits that left their recording out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from conveyor.errors import InputError
from regressor.network.checkpoint import Sidecar, load_checkpoint, save_checkpoint
from regressor.studies.metrics import scores
from regressor.training.cloudset import CloudSet, joined, load_cloudset
from regressor.training.train import SWIFT, predict
from regressor.weigh.blend import fit_blend
from regressor.weigh.volume import fit_volume_rule

FOLDS = 5
MIN_RECORDINGS = 20


def restack(
    weights: Path, data: Path, unseen: Path, *, cache: Path | None, compute: torch.dtype | None = None
) -> Sidecar:
    """Fit volume rule and blend of saved weights anew and write their sidecar; the tensors stay as they are.

    Args:
        data: views that the rule alone is fitted on, those of the training say. unseen: views of other recordings, for
            the rule and the blend. compute: dtype of the network's wide products; None is its own.

    Raises:
        InputError: weights without a sidecar of their own, too few recordings, or views that cannot be used.
    """
    model, sidecar = load_checkpoint(weights, any_target=True)
    if weights.suffix != ".safetensors" or not weights.with_suffix(".json").is_file():
        raise InputError(f"{weights} has no sidecar to write to: `tuberline import-checkpoint` makes one")
    seen = load_cloudset(data, cache=cache).with_target(sidecar.target)
    views = load_cloudset(unseen, cache=cache).with_target(sidecar.target)
    if len(np.unique(views.recording)) < MIN_RECORDINGS:
        raise InputError(
            f"{unseen} holds {len(np.unique(views.recording))} recordings; at least {MIN_RECORDINGS} are needed: a "
            "blend is fitted over recordings, each of which shares one belt and one camera"
        )
    network_g = predict(model, views, highest_m=sidecar.input.max_height_m, resolution=SWIFT, compute=compute)
    volume_g = cross_fitted(seen, views)
    rule = fit_blend(network_g, volume_g, views.features, views.weight_g)
    everything = joined([seen, views])
    volume_rule = fit_volume_rule(everything.features, everything.weight_g)
    weight_g = rule.weights_g(network_g, volume_g, views.features)
    changes = {
        "volume_share": rule.share,
        "blend": rule.to_json(),
        "volume_rule": volume_rule.to_json(),
        "metrics": {**sidecar.metrics, "blend": scores(weight_g, views.weight_g, views.tuber)},
    }
    return save_checkpoint(weights, model.state_dict(), sidecar.model_copy(update=changes))


def cross_fitted(seen: CloudSet, views: CloudSet) -> NDArray[np.float64]:
    """(n,) grams of the volume rule on `views`, each by a fit on `seen` and on the other recordings of `views`."""
    names, owner = np.unique(views.recording, return_inverse=True)
    fold = np.random.default_rng(0).permutation(len(names))[owner] % FOLDS
    out = np.empty(len(views))
    for which in range(FOLDS):
        rest = joined([seen, views.subset(fold != which)])
        rule = fit_volume_rule(rest.features, rest.weight_g)
        out[fold == which] = rule.weights_g(views.features[fold == which])
    return out
