"""What a recording holds and what is suspicious about it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import ConfigError
from conveyor.formats.beside import recording_files
from conveyor.formats.detect import camera_names, open_unchecked, recording_kind, unnamed_cameras
from conveyor.formats.positions import POSITIONS_FILE
from conveyor.formats.scale_check import expected_distance_m, median_depth_m, scale_fault
from conveyor.formats.source import CameraDescription, FrameKey, RecordedSource, Refused
from conveyor.geometry import Intrinsics, belt_distance_m, height_coefficients
from conveyor.messages import Frame
from conveyor.stated import level_fault
from conveyor.topics import check_name

SAMPLES = 8
BELT_QUANTILE = 0.75
"""Of a frame's depths: the belt is the farthest thing, and most frames show more of it than of tubers."""
BELT_DIFFERS_M = 0.015
TOLD_TWICE_M = 0.005
MOST_ASIDE, MOST_OBLONG = 0.2, 1.05
"""Of an image's side, from its middle, and one focal length by the other: a depth camera's own differ by a percent or
two, those of an image that was squeezed from 16:10 into 16:9 by eleven."""
RATE_DIFFERS = 100.0
"""Times the rate given. What a camera leaves out, or a recorder, is less; a wrong unit is a thousand."""
NEAREST_M, FARTHEST_M = 0.15, 2.5
"""Where cameras hang over belts; depth of another distance has a wrong unit, or shows no belt."""
UNITS_M = (0.001, 0.0001, 0.00025, 0.00005)
"""That cameras give: most, the D405 and SR300, the L515, some structured light."""
LIKELY_M = (0.25, 1.5)
COARSE_M = 0.002
"""Metres; a depth unit of so much or more is told. On ten simulated belts of 14 to 20 tubers whose depth was rounded to
it, loads moved by 1 % at 1.5 mm, by up to 4 % at 2 mm (one stone more), 6 % at 3 mm and 25 % at 5 mm. At 7 and 10 mm up
to 11 and 13 of 14 tubers were taken for clods."""


@dataclass(frozen=True, slots=True)
class CameraReport:
    """One camera of a recording.

    Attributes:
        frames: named by the recording; gaps: numbers missing between the first and the last; refused: frames among the
            samples that cannot be read, by reason.
        fps_seen: from the median step of capture times; clock_faults: steps backwards or longer than 2 s.
        belt_seen_m: median over samples of each frame's 75 % quantile of depth, or, where a pose is given, of how far
            what is seen lies below the belt, beyond the distance given; belt_given_m: what the recording says.
        travel, masks, color: whether frames have them; None where none of the samples can be read.
    """

    name: str
    width: int
    height: int
    frames: int
    gaps: int
    refused: dict[str, int]
    fps_given: float
    fps_seen: float | None
    duration_s: float
    clock_faults: int
    depth_scale_m: float
    belt_given_m: float | None
    belt_seen_m: float | None
    travel: bool | None
    masks: bool | None
    color: bool | None
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class RecordingReport:
    """A recording of one or more cameras; `positions`: of the machine, beside the frames. `warnings`: of no camera
    alone.
    """

    path: str
    kind: str
    cameras: tuple[CameraReport, ...]
    positions: int = 0
    warnings: tuple[str, ...] = ()


def inspect_recording(path: Path) -> RecordingReport:
    """Look at every camera of the recording: all numbers and times, eight frames spread over it.

    Raises:
        InputError: no recording, or one that cannot be opened at all.
    """
    kind = recording_kind(path)
    cameras = tuple(_inspect(open_unchecked(path, kind, name)) for name in camera_names(path))
    positions = recording_files(path).get(POSITIONS_FILE, b"")
    told = tuple(unnamed_cameras(path))
    return RecordingReport(str(path), kind, cameras, max(positions.count(b"\n") - 1, 0), told)


def _inspect(source: RecordedSource) -> CameraReport:
    d, keys = source.description, source.keys()
    refused: Counter[str] = Counter()
    texts: list[str] = []
    frames: list[Frame] = []
    for key in _samples(keys):
        item = next(source.frames(run="inspected", after=key.seq - 1))
        if isinstance(item, Refused):
            refused[item.reason] += 1
            texts.append(item.text)
        else:
            frames.append(item)
    steps_s = np.diff([key.captured_ns for key in keys]) / 1e9
    seen = [_belt_seen_m(frame) for frame in frames if frame.depth.any()]
    belt_seen_m = float(np.median(seen)) if seen else None
    faults = (steps_s <= 0) | (steps_s > 2.0)
    gaps = keys[-1].seq - keys[0].seq + 1 - len(keys)
    return CameraReport(
        name=d.name,
        width=d.intrinsics.width,
        height=d.intrinsics.height,
        frames=len(keys),
        gaps=gaps,
        refused=dict(refused),
        fps_given=d.fps,
        fps_seen=round(1 / float(np.median(steps_s)), 3) if len(steps_s) and np.median(steps_s) > 0 else None,
        duration_s=round(float(keys[-1].captured_ns - keys[0].captured_ns) / 1e9, 3),
        clock_faults=int(faults.sum()),
        depth_scale_m=d.depth_scale_m,
        belt_given_m=expected_distance_m(frames[0]) if frames else d.belt_distance_m,
        belt_seen_m=None if belt_seen_m is None else round(belt_seen_m, 4),
        travel=any(frame.travel_m is not None for frame in frames) if frames else None,
        masks=any(frame.mask is not None for frame in frames) if frames else None,
        color=any(frame.color_jpeg is not None for frame in frames) if frames else None,
        warnings=(
            *texts,
            *described_doubtfully(d),
            *_scale_warnings(frames, belt_seen_m, d, others=max(0, len(keys) - SAMPLES)),
            *_time_warnings(gaps, keys, faults),
            *_rate_warnings(d.fps, steps_s),
        ),
    )


def _belt_seen_m(frame: Frame) -> float:
    """How far away the belt seems to be: a camera that looks aslant sees half of it nearer than its middle."""
    v, u = np.nonzero(frame.depth)
    z = frame.depth[v, u] * frame.depth_scale_m
    if frame.belt_from_camera is None:
        return float(np.quantile(z, BELT_QUANTILE))
    a, b, c, t = height_coefficients(frame.intrinsics, frame.belt_from_camera)
    low_m = float(np.quantile(z * (a * u + b * v + c) + t, 1 - BELT_QUANTILE))
    return belt_distance_m(frame.belt_from_camera) - low_m


def told_at_once(path: Path, *, masks: bool = True, part: int | None = None) -> list[str]:
    """For people: what is suspicious about the recording at `path` before any frame is looked at, each camera's with
    its name. Every command that reads a recording tells it.

    Args:
        masks: whether the recording's own masks are asked for.
        part: which run of an MCAP file that holds several.

    Raises:
        InputError: no recording, or one that cannot be opened at all.
    """
    kind = recording_kind(path)
    cameras = [open_unchecked(path, kind, name, part=part, masks=masks).description for name in camera_names(path)]
    return [
        *unnamed_cameras(path),
        *(f"camera '{d.name}': {doubt}" for d in cameras for doubt in described_doubtfully(d)),
    ]


def described_doubtfully(d: CameraDescription) -> tuple[str, ...]:
    """What is suspicious about a camera before any frame is looked at, in words."""
    return (
        *d.notes,
        *_name_warnings(d.name),
        *_unit_warnings(d.depth_scale_m),
        *_intrinsics_warnings(d.intrinsics),
        *_pose_warnings(d),
        *_resting_warnings(d),
    )


def _samples(keys: list[FrameKey]) -> list[FrameKey]:
    at = np.unique(np.linspace(0, len(keys) - 1, min(SAMPLES, len(keys))).astype(int))
    return [keys[i] for i in at]


def _scale_warnings(frames: list[Frame], belt_seen_m: float | None, d: CameraDescription, *, others: int) -> list[str]:
    """`frames`: what could be read of those looked at. `others`: how many were not looked at."""
    if not frames:
        so = f"{others} others were not looked at" if others else "a replay would count nothing"
        return [f"none of the frames looked at can be read: {so}"]
    given = expected_distance_m(frames[0])
    if given is None and belt_seen_m is not None and not NEAREST_M <= belt_seen_m <= FARTHEST_M:
        return [impossible_distance(belt_seen_m, d.depth_scale_m)]
    if given is None:
        return ["the belt distance is not given: it has to be fitted, or set belt_distance_m in the line's config"]
    medians = [seen for seen in (median_depth_m(frame) for frame in frames) if seen is not None]
    if not medians or belt_seen_m is None:
        return ["no depth in the sampled frames"]
    fault = scale_fault(float(np.median(medians)), given, d.depth_scale_m)
    if fault:
        return [fault]
    masked_only = all(float(np.mean(frame.depth > 0)) < 0.25 for frame in frames)
    if not masked_only and abs(belt_seen_m - given) > BELT_DIFFERS_M:
        web = "; or what is seen is the ground under a web of rods" if belt_seen_m > given else ""
        return [
            f"the belt seems {belt_seen_m:.3f} m away but {given:.3f} m are given: 10 mm cost about 10 % of each "
            f"weight{web}"
        ]
    return []


def impossible_distance(seen_m: float, depth_scale_m: float) -> str:
    """Where a belt cannot be, and which depth unit would put it where one can be."""
    fitting = [unit for unit in UNITS_M if LIKELY_M[0] <= seen_m * unit / depth_scale_m <= LIKELY_M[1]]
    told = " and ".join(f"{unit:g} ({seen_m * unit / depth_scale_m:.3g} m)" for unit in fitting)
    fix = f"a unit that fits is {told}" if told else "no usual unit fits: is a belt in view?"
    return (
        f"the belt seems {seen_m:.4g} m away, and cameras hang {NEAREST_M:g} to {FARTHEST_M:g} m over belts: "
        f"depth_scale_m {depth_scale_m:g} may be wrong; {fix}"
    )


def _time_warnings(gaps: int, keys: list[FrameKey], faults: NDArray[np.bool_]) -> list[str]:
    """`faults`: (frames - 1,) where the step to the next frame is one."""
    warnings = []
    if gaps:
        warnings.append(f"{gaps} frame numbers are missing: they count as gaps")
    if faults.any():
        before, at = keys[int(faults.argmax())], keys[int(faults.argmax()) + 1]
        warnings.append(
            f"{faults.sum()} capture times step backwards or by more than 2 s, the first at frame {at.seq} "
            f"({(at.captured_ns - before.captured_ns) / 1e9:+.3g} s): counts do without the clock, times of tubers and "
            "their places in the field do not. Where the clock was set, correct captured_ns; where frames are out of "
            "order, number them as they were taken"
        )
    return warnings


def _rate_warnings(fps: float, steps_s: NDArray[np.float64]) -> list[str]:
    """Where capture times are in another unit: counting does without them, places of the clock do not."""
    step_s = float(np.median(steps_s)) if len(steps_s) else 0.0
    if step_s <= 0 or 1 / RATE_DIFFERS < step_s * fps < RATE_DIFFERS:
        return []
    return [
        f"capture times are {step_s:.3g} s apart but {fps:g} frames a second are given: captured_ns must be in "
        "nanoseconds, and fps the camera's own"
    ]


def _unit_warnings(depth_scale_m: float) -> list[str]:
    """Where depth was rounded until a tuber is a few steps of it."""
    if depth_scale_m < COARSE_M:
        return []
    return [
        f"depth_scale_m says {depth_scale_m:g}: depth in steps of {1000 * depth_scale_m:.3g} mm. At "
        f"{1000 * COARSE_M:g} mm loads read up to 4 % off, at 5 mm up to 25 %, and tubers are refused as clods. Record "
        "again in the camera's own unit (0.001, a D405's 0.0001), what was rounded stays so; or correct depth_scale_m"
    ]


def _intrinsics_warnings(k: Intrinsics) -> list[str]:
    """Where they seem to be of another image: all sizes are wrong then, and the centre row may not be in view."""
    aside = max(abs(k.cx - (k.width - 1) / 2) / k.width, abs(k.cy - (k.height - 1) / 2) / k.height)
    warnings = []
    if aside > MOST_ASIDE:
        warnings.append(
            f"the principal point (cx {k.cx:g}, cy {k.cy:g}) lies far from the middle of {k.width}x{k.height} pixels: "
            "intrinsics of another resolution? Those of a cut-out are right so"
        )
    if not 1 / MOST_OBLONG < k.fx / k.fy < MOST_OBLONG:
        warnings.append(
            f"fx {k.fx:g} and fy {k.fy:g} differ, but depth cameras have square pixels: correct one of them, unless "
            "this one leaves out rows or columns"
        )
    return warnings


def _name_warnings(name: str) -> list[str]:
    """Where no line can call a camera so: its name becomes part of topics, ids and files."""
    try:
        check_name(name, what="camera")
    except ConfigError as error:
        return [f"no line can use it: {error}"]
    return []


def _resting_warnings(d: CameraDescription) -> list[str]:
    """Where metres were taken for millimetres; a recording's own reader may state as little, so it is not refused."""
    stated = {"resting_offset_mm": d.resting_offset_mm, "resting_sd_mm": d.resting_sd_mm}
    return [
        f"{key} says {value:g}: {fault}; taken for 0"
        for key, value in stated.items()
        if value and (fault := level_fault(value))
    ]


def _pose_warnings(d: CameraDescription) -> list[str]:
    """Where the belt's distance is told twice."""
    if d.belt_from_camera is None or d.belt_distance_m is None:
        return []
    by_pose_m = belt_distance_m(d.belt_from_camera)
    if abs(by_pose_m - d.belt_distance_m) <= TOLD_TWICE_M:
        return []
    return [
        f"belt_distance_m says {d.belt_distance_m:.3f} m along the optical axis, belt_from_camera {by_pose_m:.3f} m: "
        "the latter is taken; correct the wrong one"
    ]
