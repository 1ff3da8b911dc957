"""The volume rule and its blend with a trained network, fitted on worlds that the network has not seen.

A network answers its own training views too well: a blend fitted there would trust it too much. So it is fitted on
other recordings, and the rule's answers there come from fits that left their recording out. Tubers under soil are left
out: their truth is their weight without it, nothing in a view tells it, and clean tubers would read light for it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from conveyor.errors import InputError
from regressor.network.checkpoint import load_checkpoint, save_sidecar
from regressor.network.sidecar import Sidecar
from regressor.studies.metrics import scores
from regressor.training.answers import answers, asked_while_read
from regressor.training.calibration import check_unlearned
from regressor.training.cloudset import CloudSet, identity, joined, load_cloudset, without
from regressor.training.labelled import part_of
from regressor.training.plausible import refused_told
from regressor.training.work import Told, Work, no_work, not_told, preparing
from regressor.weigh.blend import SEEN, BlendRule, best_share, fit_blend
from regressor.weigh.quadratic import QuadraticRule, fit_quadratic
from regressor.weigh.view_features import VIEW_NAMES
from regressor.weigh.volume import fit_volume_rule

FOLDS = 5
MIN_RECORDINGS = 20


def restack(
    weights: Path,
    data: Path,
    unseen: Path,
    *,
    cache: Path | None,
    correction: bool = True,
    compute: torch.dtype | None = None,
    on_work: Work = no_work,
    on_left_out: Told = not_told,
) -> Sidecar:
    """Fit volume rule and blend of saved weights again and write their sidecar; the tensors stay as they are.

    Of a folder with a splits.csv its part is read: 'train' of `data`, 'val' of `unseen`. Tubers of `unseen` that are in
    `data`, too, are left out there: the rule is judged on them.

    Args:
        data: views that the rule alone is fitted on, those of the training say. unseen: views of other recordings, for
            the rule and the blend. correction: for weight, rim and pose; else the blend is its share alone. compute:
            dtype of the network's wide products; None is its own.

    Raises:
        InputError: weights without a sidecar of their own, too few recordings, views that cannot be used, or `unseen`
            ones that the network was trained on.
    """
    model, sidecar = load_checkpoint(weights, any_target=True)
    if weights.suffix != ".safetensors" or not weights.with_suffix(".json").is_file():
        raise InputError(f"{weights} has no sidecar to write to: `tuberline import-checkpoint` makes one")
    seen, views = (
        load_cloudset(
            folder, split=split, cache=cache, asked=asked, progress=preparing(folder, on_work, split=split)
        ).with_target(sidecar.target)
        for folder, split, asked in (
            (data, part_of(data, "train"), None),
            (unseen, part_of(unseen, "val"), asked_while_read(model, sidecar, compute=compute)),
        )
    )
    check_unlearned(
        views, sidecar, f"--unseen {unseen} is what {weights} were trained on", "a blend would trust it too much"
    )
    seen = without(seen, np.isin(identity(seen), identity(views)), "in_unseen")
    seen, views = (without(part, ~part.clean, "under_soil") for part in (seen, views))
    for folder, part in ((data, seen), (unseen, views)):
        if left_out := refused_told(part.refused, part.refused_first):
            on_left_out(folder, left_out)
    if len(np.unique(views.recording)) < MIN_RECORDINGS:
        raise InputError(
            f"{unseen} holds {len(np.unique(views.recording))} recordings without soil on the tubers; at least "
            f"{MIN_RECORDINGS} are needed: a blend is fitted over recordings, each of which shares one belt and one "
            "camera"
        )
    network_g = answers(model, sidecar, views, compute=compute, on_work=on_work)
    known = all(np.isfinite(getattr(part, name)).all() for part in (seen, views) for name in SEEN)
    volume_g, found = cross_fitted(seen, views, with_seen=known and correction)
    everything = joined([seen, views])
    if correction:
        rule = fit_blend(
            network_g,
            volume_g,
            views.weight_g,
            world=views.preset,
            found=found,
            truth=_truth(views) if known else None,
            seen=_rules_of_seen(everything) if known else (),
        )
    else:
        rule = BlendRule(best_share(network_g, volume_g, views.weight_g))
    volume_rule = fit_volume_rule(everything.view_features, everything.weight_g)
    weight_g = rule.weights_g(network_g, volume_g, views.view_features)
    changes = {
        "volume_share": rule.share,
        "blend": rule.to_json(),
        "volume_rule": volume_rule.to_json(),
        "metrics": {**sidecar.metrics, "blend": scores(weight_g, views.weight_g, views.tuber)},
    }
    return save_sidecar(weights, sidecar.model_copy(update=changes))


def cross_fitted(
    seen: CloudSet, views: CloudSet, *, with_seen: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """((n,) grams of the volume rule on `views`, (n, k) what views show of `blend.SEEN`, or None).

    Each by a fit on `seen` and on the other recordings of `views`.
    """
    names, owner = np.unique(views.recording, return_inverse=True)
    fold = np.random.default_rng(0).permutation(len(names))[owner] % FOLDS
    grams, found = np.empty(len(views)), np.empty((len(views), len(SEEN)))
    for which in range(FOLDS):
        rest, rows = joined([seen, views.subset(fold != which)]), fold == which
        grams[rows] = fit_volume_rule(rest.view_features, rest.weight_g).weights_g(views.view_features[rows])
        if with_seen:
            fits = _rules_of_seen(rest)
            found[rows] = np.column_stack([fit.values(views.view_features[rows]) for fit in fits])
    return grams, found if with_seen else None


def _rules_of_seen(data: CloudSet) -> tuple[QuadraticRule, ...]:
    """What shows each of `blend.SEEN`, from views where it is known."""
    return tuple(fit_quadratic(data.view_features, column, names=VIEW_NAMES) for column in _truth(data).T)


def _truth(data: CloudSet) -> NDArray[np.float64]:
    return np.column_stack([getattr(data, name) for name in SEEN])
