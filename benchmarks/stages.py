"""Processor time of a frame in the segmenter's core and of a view in a regressor, stage by stage, over a recording.

    python -m benchmarks stages RECORDING [--exact] [--rounds 3]

Times are those of the thread, so that other work on the machine counts only by what it takes of the caches. The core
runs as on a live line over every frame of the first camera, some rounds, and each step of it is timed; the views that
it chose are then weighed one by one, by the shipped weights in the form that a live line takes on this machine, or in
the exact one.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.options import parser_of, whole_number
from conveyor.config import LineConfig
from conveyor.config_camera import CameraConfig
from conveyor.formats import camera_names, open_source
from conveyor.heap import keep_buffers
from conveyor.messages import Frame, View
from conveyor.threads import use_threads
from regressor.serve.form import fastest
from regressor.weigh.prepare import prepare_view
from regressor.weigh.weigher import Weigher, weigh_views
from segmenter.belt_segmenter import BeltSegmenter
from segmenter.frame.plane import fit_plane
from segmenter.pipeline import Segmenter
from segmenter.setup import core_settings
from segmenter.warmup import warm_up

STEPS = {
    "_heights": "heights over the belt",
    "_instances": "instances",
    "_track": "tracks",
    "_collect": "top views to classify, crops to weigh",
    "_decide": "decisions: classifier, views, sizes",
}
"""Steps of `BeltSegmenter.step`, and what they are called in the table."""
FIRST = 15
"""Frames in which a followed belt is looked at every time."""
ROUNDS = 3


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print both tables."""
    parser = parser_of("stages", __doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--exact", action="store_true")
    parser.add_argument(
        "--rounds", type=whole_number(1), default=3, help="over all frames; tables are of each frame's best round"
    )
    options = parser.parse_args(arguments)
    use_threads(1)
    keep_buffers()  # as segmenters and regressors do
    frames = [
        replace(item, color_jpeg=None)
        for item in open_source(
            options.recording, camera=camera_names(options.recording)[0], ignore_masks=True
        ).frames(run="time")
        if isinstance(item, Frame)
    ]  # fmt: skip
    config = LineConfig(cameras={"front": CameraConfig(waits=False)})
    settings = core_settings(config, live=True)
    warm_up(settings.split.pixel_mm)
    _frames(frames, settings, options.rounds)
    weigher = Weigher.load()
    _views(_chosen(frames, settings), weigher if options.exact else weigher.in_form(fastest(weigher)))
    print(f"\nload average {os.getloadavg()[0]:.1f} at the end; {os.cpu_count()} cores.")
    return 0


def _frames(frames: list[Frame], settings: Any, rounds: int) -> None:
    measured = np.array([_round(frames, settings) for _ in range(rounds)])
    best = measured.min(axis=0)
    ms = best[:, 0]
    slowest = ms >= np.percentile(ms, 95)
    every = max(1, len(frames) // 40)
    plane = [
        min(
            _ms(lambda f: fit_plane(f.depth, depth_scale_m=f.depth_scale_m, intrinsics=f.intrinsics), frame)
            for _ in range(rounds)
        )
        for frame in frames[::every]
    ]
    print("| a frame | mean ms | p50 | p99 | mean of the first 15 | check of the belt, median |")
    print("| --- | --- | --- | --- | --- | --- |")
    print(
        f"| {len(frames)} of {frames[0].depth.shape[1]}x{frames[0].depth.shape[0]} | {ms.mean():.1f} | "
        f"{np.median(ms):.1f} | {np.percentile(ms, 99):.1f} | {ms[:FIRST].mean():.1f} | {np.median(plane):.1f} |\n"
    )
    means, slow = measured[:, :, 0].mean(axis=1), np.percentile(measured[:, :, 0], 99, axis=1)
    print(
        f"Single rounds: mean {means.min():.1f} to {means.max():.1f} ms, p99 {slow.min():.1f} to {slow.max():.1f} ms.\n"
    )
    print("| step | ms, mean | ms, mean of the slowest 5 % |\n| --- | ---: | ---: |")
    rest = best[:, 0] - best[:, 1:].sum(axis=1)
    for name, took in [*zip(STEPS.values(), best[:, 1:].T, strict=True), ("belt, noise, outlines and the rest", rest)]:
        print(f"| {name} | {took.mean():.2f} | {took[slowest].mean():.2f} |")
    print()


def _round(frames: list[Frame], settings: Any) -> list[list[float]]:
    """Milliseconds of each frame: the whole of it, then its `STEPS`."""
    core, rows, took = Segmenter(settings), [], dict.fromkeys(STEPS, 0.0)
    with ExitStack() as patches:
        for name in STEPS:
            plain = getattr(BeltSegmenter, name)
            patches.enter_context(patch.object(BeltSegmenter, name, _timed(plain, name, took)))
        for frame in frames:
            took.update(dict.fromkeys(STEPS, 0.0))
            rows.append([_ms(core.step, frame), *took.values()])
    return rows


def _timed(plain: Callable[..., Any], name: str, took: dict[str, float]) -> Callable[..., Any]:
    def timed(*arguments: Any) -> Any:
        begun = time.thread_time()
        try:
            return plain(*arguments)
        finally:
            took[name] += 1e3 * (time.thread_time() - begun)

    return timed


def _chosen(frames: list[Frame], settings: Any) -> list[View]:
    """The views of all tracks, as a regressor receives them."""
    core = Segmenter(settings)
    views = [view for frame in frames for track in core.step(frame).closed for view in track.views]
    return [View.decode(view.encode()) for view in views]


def _views(views: list[View], weigher: Weigher) -> None:
    for view in views[:3]:
        weigh_views(weigher, [view], regressor="time")
    clouds = {id(view): prepare_view(view) for view in views}
    network = weigher._network
    assert network is not None
    prepare = _best(prepare_view, views)
    net = _best(lambda v: network.weigh(weigher._group(clouds[id(v)].points), weigher._height_m(clouds[id(v)])), views)
    whole = _best(lambda v: weigh_views(weigher, [v], regressor="time"), views)
    form = weigher.form
    print(f"Weighed in {form.precision}, {form.centroids or 'all'} centroids.\n")
    print("| a view | prepared ms | network | sizes, rules, interval, flags | all |\n| --- | --- | --- | --- | --- |")
    print(f"| {len(views)} | {prepare:.2f} | {net:.2f} | {whole - prepare - net:.2f} | {whole:.2f} |")


def _best(work: Callable[[View], Any], views: list[View]) -> float:
    """Mean over the views of each one's best of a few rounds, milliseconds."""
    return float(np.mean(np.min([[_ms(work, view) for view in views] for _ in range(ROUNDS)], axis=0)))


def _ms(work: Callable[[Any], Any], item: Any) -> float:
    begun = time.thread_time()
    work(item)
    return 1e3 * (time.thread_time() - begun)
