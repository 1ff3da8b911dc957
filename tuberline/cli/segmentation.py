"""The segmenter's commands: its process, pictures of what it finds, and the score of its masks."""

from __future__ import annotations

import itertools
import json as json_module
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from conveyor.errors import InputError
from tuberline.cli.numbers import within
from tuberline.cli.recordings import tell_doubts
from tuberline.recorded import not_counted_told

if TYPE_CHECKING:
    from rich.console import Console

    from segmenter.studies.offline import CameraResult


def segmenter(*, config: Path, camera: str, run: str | None = None) -> None:
    """Find and follow tubers in one camera's frames, and have them weighed.

    Parameters
    ----------
    config
        The line's TOML file.
    camera
        Name of the camera, as in the config.
    run
        Id of this run; default: the time of its start. The camera's own run id takes over when it differs.
    """
    from datetime import UTC, datetime

    from conveyor.config import load_config
    from conveyor.heap import keep_buffers
    from segmenter.node import SegmenterNode

    keep_buffers()
    line = load_config(config)
    run_id = run or datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    SegmenterNode(line, camera, run_id).run()


def segment(
    recording: Path,
    /,
    *,
    picture: Path | None = None,
    frame: Annotated[int | None, within(0, 2**53)] = None,
    masks: bool = False,
    json: bool = False,
) -> None:
    """Segment and track a recording without a line: what is counted where, and a picture of one frame.

    Parameters
    ----------
    recording
        Recording of any kind that `replay` takes.
    picture
        PNG to draw the chosen frame into, one per camera (the camera's name is added where there are several).
    frame
        Sequence number of the frame to draw; default: the middle one.
    masks
        Use the recording's own masks instead of finding instances.
    json
        Print the counted tracks as JSON on stdout.
    """
    from conveyor.files import check_picture
    from segmenter.studies.offline import segment_recording
    from tuberline.cli.progress import frames_bar

    if picture is not None:
        check_picture(picture, option="--picture")
    elif frame is not None:
        raise InputError(f"--frame {frame} is the one to draw: name the picture with --picture FILE.png")
    tell_doubts(recording, masks=masks)
    with frames_bar() as on_frame:
        results = segment_recording(recording, picture=picture, picture_seq=frame, masks=masks, on_frame=on_frame)
    if json:
        sys.stdout.write(json_module.dumps([r.as_dict() for r in results], indent=2) + "\n")
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table("camera", "frames", "counted", "discarded", "travel m", "looked at", "ms/frame")
    for r in results:
        discarded = ", ".join(f"{n} {reason}" for reason, n in sorted(r.discarded.items())) or "none"
        seen = f"{r.looked_at_m / r.travelled_m:.1%}" if r.travelled_m else "-"
        table.add_row(
            escape(r.camera),
            str(r.frames),
            str(len(r.tracks)),
            discarded,
            f"{r.travelled_m:.2f}",
            seen,
            f"{r.step_ms:.1f}",
        )
    console = Console(stderr=True)
    console.print(table)
    _warn_of_unreadable(console, results)
    uncounted = [r for r in results if not r.tracks]
    none = [not_counted_told(r.camera, r.discarded, frames=r.frames, travelled_m=r.travelled_m) for r in uncounted]
    for finding in itertools.chain(*(r.findings for r in results), *none):
        console.print(f"warning: {finding}", markup=False, highlight=False)


def evaluate_segmentation(
    recording: Path,
    /,
    *,
    every: Annotated[int, within(1, 100_000)] = 1,
    method: Literal["classical", "classes"] | None = None,
    weights: Path | None = None,
    json: bool = False,
) -> None:
    """Score found masks against a recording's own: F1, panoptic quality, distractors taken for tubers, time per frame.

    Parameters
    ----------
    recording
        Recording with masks, of any kind that `replay` takes.
    every
        Use every n-th frame only.
    method
        As segmenter.method of a line's file; default: the default there.
    weights
        An .onnx of `tuberline train-classifier` instead of the shipped one.
    json
        Print the score as JSON on stdout.
    """
    from dataclasses import asdict

    import cv2

    from segmenter.perception import PerceptionSettings
    from segmenter.pipeline import Settings
    from segmenter.studies.evaluate import evaluate_recording
    from segmenter.warmup import warm_up
    from tuberline.cli.progress import frames_bar

    if method == "classical" and weights is not None:
        raise InputError(f"--weights {weights}: `classical` asks no network; leave it out, or --method")
    cv2.setNumThreads(1)
    warm_up(Settings().split.pixel_mm)
    settings = Settings(perception=PerceptionSettings(method=method or PerceptionSettings().method, weights=weights))
    tell_doubts(recording)
    with frames_bar() as on_frame:
        score = asdict(evaluate_recording(recording, settings=settings, every=every, on_frame=on_frame))
    if merged := score["masks_merged"]:
        sys.stderr.write(
            f"warning: in {merged} of {score['frames']} frames a label of the masks lies in several places apart, and "
            "no figure means anything there: give each tuber a label of its own (1, 2, 3, ..., not 255 to all)\n"
        )
    if json:
        sys.stdout.write(json_module.dumps(score, indent=2) + "\n")
        return
    from rich.console import Console
    from rich.table import Table

    table = Table("what", "value")
    for name, value in (score | (score.pop("load") or {})).items():
        table.add_row(name, f"{value:.4g}" if isinstance(value, float) else str(value))
    Console(stderr=True).print(table)


def _warn_of_unreadable(console: Console, results: Sequence[CameraResult]) -> None:
    from conveyor.formats.cameras import told_unreadable

    for r in results:
        if text := told_unreadable(r.unreadable, r.first_fault):
            console.print(f"warning: camera {r.camera}: {text}", markup=False, highlight=False, soft_wrap=True)
