"""Processor time of each stage of the segmenter per frame, on one core."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from conveyor.formats import camera_names, open_source
from conveyor.messages import Frame
from segmenter.classify.patch import observe_instance
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.heights import height_map
from segmenter.frame.plane import fit_plane, given_or_fitted
from segmenter.perception import Perception
from segmenter.pipeline import Segmenter, Settings
from segmenter.warmup import warm_up

STAGES = ("message", "heights", "instances", "classes", "rest", "step")
"""`message`: decoding the frame's message; `classes`: one observation for the patches of all instances, 0 without a
classifier; `step`: everything the segmenter does with a frame; `rest`: without heights and instances, so centres,
travel, tracks, choice and cutting out of views, at times the network, and every 30th frame the check of the belt."""


def stage_times(recording: Path, settings: Settings) -> dict[str, dict[str, float]]:
    """Median, mean and 99th percentile of each stage in milliseconds of processor time, over all frames."""
    warm_up(settings.split.pixel_mm)
    rows: list[tuple[float, ...]] = []
    for name in camera_names(recording):
        core, belt = Segmenter(settings), None
        perception = Perception(settings.perception, settings.split)
        for item in open_source(recording, camera=name, ignore_masks=True).frames(run="time"):
            if isinstance(item, Frame):
                frame = replace(item, color_jpeg=None)
                belt = belt or _belt(frame)
                rows.append(_timed(frame, core, perception, belt, settings.split.pixel_mm))
    times = dict(zip(STAGES, np.array(rows).T, strict=True))
    return {
        stage: {
            "median_ms": float(np.median(ms)),
            "mean_ms": float(np.mean(ms)),
            "p99_ms": float(np.percentile(ms, 99)),
        }
        for stage, ms in times.items()
    }


def _timed(
    frame: Frame, core: Segmenter, perception: Perception, belt: BeltGeometry, pixel_mm: float
) -> tuple[float, ...]:
    payload = frame.encode()
    marks = [time.thread_time()]
    frame = Frame.decode(payload)
    marks.append(time.thread_time())
    heights = height_map(frame.depth, depth_scale_m=frame.depth_scale_m, belt=belt, pixel_mm=pixel_mm)
    marks.append(time.thread_time())
    instances = perception.find(heights, belt)
    marks.append(time.thread_time())
    if perception.classifies:
        for n in range(len(instances)):
            x_m, y_m = instances.centre_m[n].tolist()
            observe_instance(heights, instances, n, belt, x_m=x_m, y_m=y_m)
    marks.append(time.thread_time())
    core.step(frame)
    marks.append(time.thread_time())
    message, mapped, found, asked, step = (1000 * (b - a) for a, b in pairwise(marks))
    return message, mapped, found, asked, step - mapped - found, step


def _belt(frame: Frame) -> BeltGeometry:
    fit = fit_plane(frame.depth, depth_scale_m=frame.depth_scale_m, intrinsics=frame.intrinsics)
    pose = given_or_fitted(frame.belt_from_camera, frame.belt_distance_m, fit, camera=frame.camera)
    return BeltGeometry(frame.intrinsics, pose)
