"""Evaluation on views with known weights: the network as it is shipped, and the baselines, in the same tables."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conveyor.camera_flags import CAMERA_UNLIKE
from conveyor.errors import InputError
from conveyor.load_spread import shared_sd_share
from conveyor.statistics import NORMAL_90
from regressor.studies.alone import Scale
from regressor.studies.baselines import cross_validated, fit_linear, fit_product, oriented_box_m
from regressor.studies.metrics import scores
from regressor.training.labelled import UNKNOWN, LabelledView, Resting, read_labelled
from regressor.training.plausible import Seen
from regressor.weigh.prepare import PreparedCloud, RefusedCloud
from regressor.weigh.surface import NAMES
from regressor.weigh.weigher import Weighed

NETWORK = "PointRAFT"
SHIPPED = "PointRAFT with visible volume (as weighed)"
VOLUME_RULE = "volume rule (fallback)"
LINEAR_BOX = "linear on box L, W, h (the paper's baseline)"
PRODUCT = "k L W h"
VISIBLE_VOLUME = "linear on visible volume"
LOAD_TUBERS = 300
LOADS = 2000


DISTANCE_STEP_M = 0.05
"""Belt distances are grouped in steps of this."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """n views, weighed by every method.

    Attributes:
        predicted: method to (n,) grams. low_g, high_g: (n,) the 90 % interval as weighed.
        weight_g: (n,) truth. tuber, recording, and `groups` (name of a grouping to (n,) labels): (n,) str.
        level_sd_m: (n,) how well the resting level is known, standard deviation.
        flags: how many views carried each. refused: views that could not be weighed, by reason;
            refused_first: the name of the first of them.
        unlike: (n,) whether a view was flagged as one of a camera unlike a good one.
        shared_sd_share, shared_bias_share, shared_level_share_per_mm, shared_other_share: of the weights' sidecar, for
            the intervals of fused tubers and of loads.
    """

    predicted: dict[str, NDArray[np.float64]]
    low_g: NDArray[np.float64]
    high_g: NDArray[np.float64]
    weight_g: NDArray[np.float64]
    tuber: NDArray[np.str_]
    recording: NDArray[np.str_]
    level_sd_m: NDArray[np.float64]
    unlike: NDArray[np.bool_]
    groups: dict[str, NDArray[np.str_]]
    flags: dict[str, int]
    refused: dict[str, int]
    shared_sd_share: float
    shared_bias_share: float
    shared_level_share_per_mm: float
    shared_other_share: float
    model: str
    target: str = "weight_g"
    refused_first: dict[str, str] = field(default_factory=dict)


def evaluate(
    folder: Path,
    weigher: Scale,
    *,
    split: str | None = None,
    season: str | None = None,
    max_views: int | None = None,
    resting: Resting = "calibrated",
    progress: Callable[[int], None] | None = None,
) -> Evaluation:
    """Weigh all labelled views of `folder`, of one `season` alone where it is given (or the first `max_views`).

    `resting`: with which resting level, see `labelled.Resting`.

    Raises:
        InputError: unreadable, or nothing to weigh.
    """
    views = read_labelled(folder, split=split, resting=resting)
    views = views if season is None else _of_season(views, season, where=folder)
    where = f"{folder}, season {season}" if season else str(folder)
    return evaluate_views(islice(views, max_views), weigher, where=where, progress=progress)


def _of_season(views: Iterable[LabelledView], season: str, *, where: Path) -> Iterator[LabelledView]:
    """Raises InputError: there is none of it; names those that there are."""
    found, others = False, set()
    for view in views:
        if view.season == season:
            found = True
            yield view
        else:
            others.add(view.season)
    if not found:
        raise InputError(f"{where} holds no view of season {season}; it has views of {', '.join(sorted(others))}")


def evaluate_views(
    labelled: Iterable[LabelledView],
    weigher: Scale,
    *,
    where: str,
    progress: Callable[[int], None] | None = None,
) -> Evaluation:
    """Weigh `labelled` views; `where` they are from. Views whose truth no one knows are refused.

    Raises:
        InputError: nothing to weigh, most views are off their belts, or weights are no grams.
    """
    views: list[LabelledView] = []
    answers: list[Weighed] = []
    alone_g: list[float] = []
    target = weigher.sidecar.target
    features: list[list[float]] = []
    refused: Counter[str] = Counter()
    seen = Seen(where)
    for done, view in enumerate(labelled, start=1):
        if not 0 < getattr(view, target) < math.inf:
            refused[f"no_{target}"] += 1
            continue
        try:
            cloud = view.prepare()
        except RefusedCloud as refusal:
            refused[refusal.reason] += 1
            seen.refused(view.tuber, view.weight_g, refusal, name=view.name)
            continue
        seen.usable(view.tuber, view.weight_g, cloud)
        length, width, _ = oriented_box_m(cloud.points)
        views.append(view)
        answer = weigher.weigh(cloud, belt_sd_m=view.belt_sd_m, resting_sd_m=view.resting_sd_m)
        answers.append(answer)
        alone_g.append(_network_g(weigher, cloud, answer))
        features.append([*cloud.surface.as_array(), 1e3 * length, 1e3 * width, 1e3 * cloud.height_m])
        if progress is not None:
            progress(done)
    seen.check(refused)
    result = _collect(views, answers, np.array(alone_g), np.array(features), dict(refused), weigher)
    return replace(result, refused_first=seen.first)


def _network_g(weigher: Scale, cloud: PreparedCloud, answer: Weighed) -> float:
    """What the network alone says, though the scale did not believe it: its errors are its own. Without one, the
    weight.
    """
    alone_g = weigher.network_g(cloud) if answer.network_g is None else answer.network_g
    return answer.weight_g if alone_g is None else alone_g


def _collect(
    views: list[LabelledView],
    answers: list[Weighed],
    alone_g: NDArray[np.float64],
    features: NDArray[np.float64],
    refused: dict[str, int],
    weigher: Scale,
) -> Evaluation:
    weight_g = np.array([getattr(view, weigher.sidecar.target) for view in views])
    tuber = np.array([view.tuber for view in views])
    surface, box = features[:, : len(NAMES)], features[:, len(NAMES) :]
    predicted = {
        SHIPPED: np.array([answer.weight_g for answer in answers]),
        NETWORK: alone_g,
        VOLUME_RULE: np.array([answer.volume_g for answer in answers]),
    }
    if len(np.unique(tuber)) > 1:  # each rule is fitted without the tubers that it is judged by
        predicted |= {
            VISIBLE_VOLUME: cross_validated(fit_linear, surface[:, :1], weight_g, tuber),
            PRODUCT: cross_validated(fit_product, surface[:, 2:5], weight_g, tuber),
            LINEAR_BOX: cross_validated(fit_linear, box, weight_g, tuber),
        }
    return Evaluation(
        predicted=predicted,
        low_g=np.array([answer.low_g for answer in answers]),
        high_g=np.array([answer.high_g for answer in answers]),
        weight_g=weight_g,
        tuber=tuber,
        recording=np.array([view.recording for view in views]),
        level_sd_m=np.array([view.level_sd_m for view in views]),
        unlike=np.array([CAMERA_UNLIKE in answer.flags for answer in answers]),
        groups=_groups(views),
        flags=dict(Counter(flag for answer in answers for flag in answer.flags)),
        refused=refused,
        shared_sd_share=weigher.sidecar.shared_sd_share,
        shared_bias_share=weigher.sidecar.shared_bias_share,
        shared_level_share_per_mm=weigher.sidecar.shared_level_share_per_mm,
        shared_other_share=weigher.sidecar.shared_other_share,
        model=weigher.sidecar.model_id,
        target=weigher.sidecar.target,
    )


def _groups(views: list[LabelledView]) -> dict[str, NDArray[np.str_]]:
    def weight_class(view: LabelledView) -> str:
        lower = min(int(view.weight_g // 50) * 50, 450)
        return f"{lower:03d} g and more" if lower == 450 else f"{lower:03d} to {lower + 50} g"

    def position(view: LabelledView) -> str:
        if not np.isfinite(view.row_share):
            return "unknown"
        return ("upstream third", "middle third", "downstream third")[min(2, max(0, int(3 * view.row_share)))]

    world = {
        name: labels
        for name in ("preset", "pose", "rim", "surface", "soil", "calibrated")
        if not ((labels := np.array([getattr(view, name) for view in views])) == UNKNOWN).all()
    }
    return {
        **world,
        "weight class": np.array([weight_class(view) for view in views]),
        "cultivar": np.array([view.cultivar for view in views]),
        "season": np.array([view.season for view in views]),
        "image position": np.array([position(view) for view in views]),
        "belt distance": np.array(
            [f"{round(view.belt_distance_m / DISTANCE_STEP_M) * DISTANCE_STEP_M:.2f} m" for view in views]
        ),
    }


def method_scores(result: Evaluation) -> dict[str, dict[str, float]]:
    """Figures of every method over all views and tubers, with the spread of a 300-tuber load's bias."""
    return {
        name: {**scores(values, result.weight_g, result.tuber), **load_bias(values, result.weight_g, result.tuber)}
        for name, values in result.predicted.items()
    }


def group_scores(result: Evaluation) -> dict[str, dict[str, dict[str, float]]]:
    """Figures of the weights per grouping and label, with the coverage of its intervals."""
    values = result.predicted[SHIPPED]
    held = (result.weight_g >= result.low_g) & (result.weight_g <= result.high_g)
    table: dict[str, dict[str, dict[str, float]]] = {}
    for grouping, labels in result.groups.items():
        table[grouping] = {}
        for label in np.unique(labels):
            rows = labels == label
            figures = scores(values[rows], result.weight_g[rows], result.tuber[rows])
            table[grouping][str(label)] = {**figures, "coverage": round(float(held[rows].mean()), 4)}
    return table


def coverage(result: Evaluation) -> dict[str, float]:
    """Share of views, of fused tubers and of loads of 300 drawn tubers whose truth lies in the 90 % interval."""
    middle, truth, below, above = fused_tubers(result)
    held = (result.weight_g >= result.low_g) & (result.weight_g <= result.high_g)
    # A load's own errors shrink with the count; what its tubers have in common does not.
    drawn = np.random.default_rng(0).integers(0, len(truth), (LOADS, LOAD_TUBERS))
    total = middle[drawn].sum(1)
    shared = load_half_share(result, np.ones(len(result.tuber), np.bool_)) * total
    low = total - np.hypot(np.sqrt((below[drawn] ** 2).sum(1)), shared)
    high = total + np.hypot(np.sqrt((above[drawn] ** 2).sum(1)), shared)
    of_loads = truth[drawn].sum(1)
    return {
        "views": round(float(held.mean()), 4),
        "tubers": round(float(((truth >= middle - below) & (truth <= middle + above)).mean()), 4),
        "loads": round(float(((of_loads >= low) & (of_loads <= high)).mean()), 4),
        "mean_width_g": round(float((result.high_g - result.low_g).mean()), 2),
        "load_half_width_percent": round(100 * float(((high - low) / (2 * total)).mean()), 3),
    }


def load_half_share(result: Evaluation, rows: NDArray[np.bool_]) -> float:
    """Half of the 90 % interval of what all tubers of a load of these `rows` have in common, as a share of it.

    By the ledger's rule for a load before any ticket, with the resting level as well known as these rows say, and never
    less than what the weights' own calibration found in its recordings.
    """
    level_mm, other = 1e3 * float(np.sqrt(np.mean(result.level_sd_m[rows] ** 2))), float(result.unlike[rows].mean())
    found = math.hypot(
        result.shared_bias_share, result.shared_level_share_per_mm * level_mm, result.shared_other_share * other
    )
    return max(NORMAL_90 * shared_sd_share(level_mm, other_share=other), found)


def fused_tubers(
    result: Evaluation,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """(weight, truth, interval below, interval above), each (tubers,) grams, of the mean of each tuber's views.

    Views of a tuber share most of their error, so the interval shrinks by that and not by the root of their number.
    """
    values = result.predicted[SHIPPED]
    _, owner = np.unique(result.tuber, return_inverse=True)
    count = np.bincount(owner)
    share = result.shared_sd_share
    shrink = np.sqrt(share**2 + (1 - share**2) / count)
    middle, truth, low, high = (
        np.bincount(owner, weights=per_view) / count
        for per_view in (values, result.weight_g, result.low_g, result.high_g)
    )
    return middle, truth, shrink * (middle - low), shrink * (high - middle)


def load_bias(
    predicted_g: NDArray[np.float64], weight_g: NDArray[np.float64], tuber: NDArray[np.str_]
) -> dict[str, float]:
    """Bias of the total of loads of 300 tubers drawn from the set, percent: mean and the 5 % and 95 % quantiles."""
    _, owner = np.unique(tuber, return_inverse=True)
    count = np.bincount(owner)
    fused = np.bincount(owner, weights=predicted_g) / count
    truth = np.bincount(owner, weights=weight_g) / count
    drawn = np.random.default_rng(0).integers(0, len(truth), (LOADS, LOAD_TUBERS))
    bias = 100 * (fused[drawn].sum(1) / truth[drawn].sum(1) - 1)
    low, high = np.quantile(bias, [0.05, 0.95])
    return {
        "load_bias_percent": round(float(bias.mean()), 3),
        "load_bias_p05": round(float(low), 3),
        "load_bias_p95": round(float(high), 3),
    }
