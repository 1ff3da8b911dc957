"""The segmenter's core over a recording, without a line: for looking at results and measuring them."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from conveyor.belt_findings import belt_findings
from conveyor.formats.cameras import CameraFrames, OnFrame, open_cameras
from conveyor.messages import Track
from segmenter.frame.picture import picture as draw
from segmenter.frame.picture import save_picture
from segmenter.frame.watch import BeltWatch
from segmenter.pipeline import Segmenter, Settings
from segmenter.warmup import warm_up


@dataclass(frozen=True, slots=True)
class CameraResult:
    """What one camera's frames led to; `unreadable` are frames that the recording names but cannot give, by reason, and
    `first_fault` is what was said of the first of them.
    """

    camera: str
    frames: int
    unreadable: dict[str, int]
    first_fault: str
    tracks: tuple[Track, ...]
    discarded: dict[str, int]
    refused: dict[str, int]
    looked_at_m: float
    travelled_m: float
    step_ms: float
    findings: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def segment_recording(
    recording: Path,
    *,
    picture: Path | None = None,
    picture_seq: int | None = None,
    masks: bool = False,
    settings: Settings | None = None,
    on_frame: OnFrame = lambda done, total: None,
) -> list[CameraResult]:
    """Run the core over every camera of a recording of any kind.

    Raises:
        InputError: the recording cannot be used.
    """
    settings = settings or Settings()
    warm_up(settings.split.pixel_mm)
    cameras = open_cameras(recording, ignore_masks=not masks, follow=True, on_frame=on_frame)
    results = []
    for camera in cameras:
        target = picture
        if picture is not None and len(cameras) > 1:
            target = picture.with_stem(f"{picture.stem}-{camera.description.name}")
        results.append(_camera(camera, settings, target, picture_seq))
    return results


def _camera(camera: CameraFrames, settings: Settings, target: Path | None, target_seq: int | None) -> CameraResult:
    core, watch = Segmenter(settings), BeltWatch()
    tracks: list[Track] = []
    frames, elapsed_s = 0, 0.0
    if target is not None and target_seq is None:
        seqs = [frame.seq for frame in camera]
        target_seq = seqs[len(seqs) // 2]
    for frame in camera:
        started = time.perf_counter()
        result = core.step(frame)
        elapsed_s += time.perf_counter() - started
        watch.step(core.belt_check, core.instances, travel_m=core.travel_m, told=core.told)
        frames += 1
        tracks += [closed.track for closed in result.closed]
        if target is not None and frame.seq == target_seq and core.instances is not None and core.belt is not None:
            save_picture(target, draw(frame, core.instances, core.belt, rejected=core.taken_for_distractors))
    tracks += [closed.track for closed in core.finish()]
    levels = watch.gauges() | core.gauges()
    return CameraResult(
        camera=camera.description.name,
        frames=frames,
        unreadable=dict(camera.unreadable),
        first_fault=camera.first_fault,
        tracks=tuple(tracks),
        discarded={str(reason): n for reason, n in core.discarded.items()},
        refused={str(reason): n for reason, n in core.refused.items()},
        looked_at_m=core.looked_at_m,
        travelled_m=core.travelled_m,
        step_ms=1000 * elapsed_s / max(frames, 1),
        findings=tuple(belt_findings(camera.description.name, levels).values()),
    )
