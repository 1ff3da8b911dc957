"""How well found masks agree with given ones: F1 at IoU 0.5 and 0.75, panoptic quality, count bias, stage times.

Masks are scored frame by frame, before any track is decided: a distractor found is a false positive there. What the
tracks make of it, with the classifier, is counted beside it where the recording's truth has its distractors' places.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from conveyor.errors import InputError
from conveyor.formats.cameras import OnFrame, open_cameras
from conveyor.islands import labels_apart
from conveyor.messages import Frame
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.heights import height_map
from segmenter.frame.instances import full_resolution
from segmenter.frame.plane import fit_plane, given_or_fitted
from segmenter.perception import Perception
from segmenter.pipeline import Segmenter, Settings
from segmenter.studies.distractors import LoadScore, load_truth

LEAST_AREA_MM2 = 300.0
"""Given masks smaller than this (slivers at the border) are neither asked for nor held against what was found."""


@dataclass(slots=True)
class Agreement:
    """Sums over frames. `ious`: of all pairs that overlap by more than half."""

    truths: int = 0
    found: int = 0
    ious: list[float] = field(default_factory=list)

    def add(self, other: Agreement) -> None:
        """Add another frame's sums."""
        self.truths += other.truths
        self.found += other.found
        self.ious += other.ious

    def f1(self, least_iou: float) -> float:
        """F1 over instances at an IoU threshold of at least 0.5."""
        hits = sum(iou >= least_iou for iou in self.ious)
        return 2 * hits / (self.truths + self.found) if self.truths + self.found else 1.0

    @property
    def panoptic_quality(self) -> float:
        """Sum of the matched pairs' IoU over (TP + FP/2 + FN/2)."""
        return 2 * sum(self.ious) / (self.truths + self.found) if self.truths + self.found else 1.0

    @property
    def count_bias(self) -> float:
        """Found over given, less one."""
        return self.found / self.truths - 1 if self.truths else 0.0


def agreement(truth: NDArray[np.uint16], found: NDArray[np.uint16], *, least_px: float) -> Agreement:
    """Compare two (H, W) label images; given masks under `least_px` pixels, and what mostly covers them, are left
    out.
    """
    pairs, counts = np.unique(truth.astype(np.int64) << 32 | found.astype(np.int64), return_counts=True)
    t_of, f_of = pairs >> 32, pairs & 0xFFFFFFFF
    t_names, f_names = np.unique(t_of[t_of > 0]), np.unique(f_of[f_of > 0])
    t_size = {int(t): int(counts[t_of == t].sum()) for t in t_names}
    f_size = {int(f): int(counts[f_of == f].sum()) for f in f_names}
    small = {t for t, size in t_size.items() if size < least_px}
    on_small: dict[int, int] = {}
    overlap = np.zeros((len(t_names), len(f_names)))
    for t, f, n in zip(t_of.tolist(), f_of.tolist(), counts.tolist(), strict=True):
        if t > 0 and f > 0:
            overlap[np.searchsorted(t_names, t), np.searchsorted(f_names, f)] = n / (t_size[t] + f_size[f] - n)
            if t in small:
                on_small[f] = on_small.get(f, 0) + n
    ignored = {f for f, n in on_small.items() if n > 0.5 * f_size[f]}
    rows = [i for i, t in enumerate(t_names.tolist()) if t not in small]
    columns = [j for j, f in enumerate(f_names.tolist()) if f not in ignored]
    overlap = overlap[np.ix_(rows, columns)]
    i, j = linear_sum_assignment(-overlap)
    ious = [float(value) for value in overlap[i, j] if value > 0.5]
    return Agreement(len(rows), len(columns), ious)


@dataclass(frozen=True, slots=True)
class SegmentationScore:
    """Result for one recording; times are medians, milliseconds of processor time of one core per frame.

    `mean_step_ms` is the mean: the classifier works in some frames only. `load`: None where the truth does not say
    where the distractors are. `unreadable`: frames that the recording names but cannot give, by reason.
    `masks_merged`: frames in which a given label lies in several places, and can be no tuber.
    """

    recording: str
    method: str
    frames: int
    unreadable: dict[str, int]
    instances_given: int
    instances_found: int
    precision: float
    recall: float
    f1_50: float
    f1_75: float
    panoptic_quality: float
    count_bias: float
    heights_ms: float
    split_ms: float
    whole_step_ms: float
    mean_step_ms: float
    size: str
    load: LoadScore | None
    distractors_counted_share: float | None
    tubers_rejected_share: float | None
    masks_merged: int = 0


@dataclass(frozen=True, slots=True)
class _Seen:
    """One frame's labels, and the milliseconds of heights and split."""

    labels: NDArray[np.uint16]
    heights_ms: float
    split_ms: float


def evaluate_recording(
    recording: Path, *, settings: Settings, every: int = 1, on_frame: OnFrame = lambda done, total: None
) -> SegmentationScore:
    """Score segmentation on all cameras of a recording with masks.

    Args:
        recording: of any kind, with masks.
        settings: of the core.
        every: use only every n-th frame; the tracker sees no others either.
        on_frame: told after each frame that is read.

    Raises:
        InputError: there are no masks.
    """
    total, times, sizes, merged = Agreement(), [], set(), 0
    load: LoadScore | None = LoadScore()
    unreadable: Counter[str] = Counter()
    for camera in open_cameras(recording, on_frame=on_frame):
        core = Segmenter(settings)
        perception = Perception(settings.perception, settings.split)
        counted: list[tuple[float, float]] = []
        rejected: list[tuple[float, float]] = []
        belt: BeltGeometry | None = None
        for index, frame in enumerate(camera):
            if index % every or frame.mask is None:
                continue
            belt = belt or _belt(frame)
            seen = _seen(frame, belt, perception, settings)
            least_px = LEAST_AREA_MM2 / belt.footprint_mm() ** 2
            merged += bool(labels_apart(frame.mask, cell_mm=belt.footprint_mm()))
            total.add(agreement(np.where(frame.depth > 0, frame.mask, 0), seen.labels, least_px=least_px))
            started = time.thread_time()
            closed = core.step(replace(frame, mask=None)).closed
            times.append((seen.heights_ms, seen.split_ms, (time.thread_time() - started) * 1000))
            sizes.add(f"{frame.intrinsics.width}x{frame.intrinsics.height}")
            counted += [(c.track.place_x_m, c.track.y_m) for c in closed]
            rejected += _taken(core)
        counted += [(c.track.place_x_m, c.track.y_m) for c in core.finish()]
        rejected += _taken(core)
        unreadable.update(camera.unreadable)
        truth = load_truth(recording, camera.description.name)
        if truth is None or load is None:
            load = None
        else:
            load.add(truth, np.array(counted).reshape(-1, 2), np.array(rejected).reshape(-1, 2))
    if not times:
        raise InputError(f"{recording} has no masks to compare with: simulate a recording with --masks")
    told = ", ".join(sorted(sizes))
    score = _summary(recording.name, settings, total, np.array(times), told, load, dict(unreadable))
    return replace(score, masks_merged=merged)


def _summary(
    name: str,
    settings: Settings,
    total: Agreement,
    times: NDArray[np.float64],
    size: str,
    load: LoadScore | None,
    unreadable: dict[str, int],
) -> SegmentationScore:
    hits = len(total.ious)
    heights_ms, split_ms, step_ms = (float(value) for value in np.median(times, axis=0))
    return SegmentationScore(
        recording=name,
        method=settings.perception.method,
        frames=len(times),
        unreadable=unreadable,
        instances_given=total.truths,
        instances_found=total.found,
        precision=hits / total.found if total.found else 1.0,
        recall=hits / total.truths if total.truths else 1.0,
        f1_50=total.f1(0.5),
        f1_75=total.f1(0.75),
        panoptic_quality=total.panoptic_quality,
        count_bias=total.count_bias,
        heights_ms=heights_ms,
        split_ms=split_ms,
        whole_step_ms=step_ms,
        mean_step_ms=float(times[:, 2].mean()),
        size=size,
        load=load,
        distractors_counted_share=None if load is None else load.distractors_counted_share,
        tubers_rejected_share=None if load is None else load.tubers_rejected_share,
    )


def _taken(core: Segmenter) -> list[tuple[float, float]]:
    """Places of the tracks rejected since the last call."""
    places = [(at.x_m - at.travel_m, at.y_m) for at in core.rejected]
    core.rejected.clear()
    return places


def _belt(frame: Frame) -> BeltGeometry:
    fit = fit_plane(frame.depth, depth_scale_m=frame.depth_scale_m, intrinsics=frame.intrinsics, mask=frame.mask)
    pose = given_or_fitted(frame.belt_from_camera, frame.belt_distance_m, fit, camera=frame.camera)
    return BeltGeometry(frame.intrinsics, pose)


def _seen(frame: Frame, belt: BeltGeometry, perception: Perception, settings: Settings) -> _Seen:
    started = time.thread_time()
    heights = height_map(frame.depth, depth_scale_m=frame.depth_scale_m, belt=belt, pixel_mm=settings.split.pixel_mm)
    mapped = time.thread_time()
    instances = perception.find(heights, belt)
    found = time.thread_time()
    return _Seen(full_resolution(instances, frame.depth), (mapped - started) * 1000, (found - mapped) * 1000)
