"""The profile of each camera of a recording, with what it means for given weights."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from conveyor.camera_range import CameraRange
from conveyor.errors import InputError
from conveyor.formats.detect import camera_names, open_unchecked, recording_kind
from conveyor.formats.scale_check import ScaleCheck
from conveyor.formats.source import RecordedSource, Refused
from conveyor.messages import Frame
from segmenter.profile.profile import CameraProfile, OnFrame, profile_frames
from segmenter.profile.verdict import Finding, judge

FRAMES = 12


@dataclass(frozen=True, slots=True)
class ProfiledCamera:
    """One camera: what was measured, and how it compares. `first`: the frame to draw, with depth; `unread`: what was
    said of frames that were to be looked at and cannot be used.
    """

    profile: CameraProfile
    findings: tuple[Finding, ...]
    first: Frame
    unread: tuple[str, ...] = ()

    @property
    def outside(self) -> tuple[Finding, ...]:
        """Findings outside the trained range."""
        return tuple(finding for finding in self.findings if finding.verdict == "outside")

    @property
    def unseen(self) -> tuple[Finding, ...]:
        """Findings that the recording does not show."""
        return tuple(finding for finding in self.findings if finding.verdict == "not seen")

    def as_dict(self) -> dict[str, Any]:
        """For machines: numbers beside the words."""
        p = self.profile
        return {
            "camera": p.camera,
            "frames": p.frames,
            "blank_frames": p.blank,
            "unread": list(self.unread),
            "width": p.width,
            "height": p.height,
            "depth_unit_mm": 1000 * p.depth_scale_m,
            "baseline_mm": round(1000 * p.baseline_m, 2),
            "baseline_by": p.baseline_by,
            "step_px": None if p.step is None else 1 / p.step.steps_per_px,
            "step_match": None if p.step is None else round(p.step.match, 3),
            "noise_px": _named(p.noise_px, ("p10", "p50", "p90")),
            "neighbour_step_px": _named(p.neighbour_px, ("p99", "p99.9", "max")),
            "plane_m": None if p.plane_m is None else round(p.plane_m, 4),
            "mid_px": None if p.field is None else round(p.field.mid_px, 4),
            "bow_px": None if p.field is None or p.field.bow_px is None else round(p.field.bow_px, 4),
            "outline_width_px": _named(p.outline_px, ("p50", "p90")),
            "missing_share": round(p.missing, 4),
            "islands_per_frame": round(p.islands_per_frame, 3),
            "islands_per_megapixel": round(p.islands_per_megapixel, 3),
            "island_off_px": _named(
                tuple(np.quantile(np.abs(p.island_px), [0.5, 1.0])) if len(p.island_px) else None, ("p50", "max")
            ),
            "findings": [asdict(finding) for finding in self.findings],
        }


def profile_recording(
    path: Path,
    trained: CameraRange,
    *,
    frames: int = FRAMES,
    baseline_m: float | None = None,
    belt_m: tuple[float, float] | None = None,
    on_frame: OnFrame = lambda done, total: None,
) -> list[ProfiledCamera]:
    """The profile of every camera of the recording at `path`, from `frames` spread over it.

    Args:
        belt_m: nearest and farthest belt that the weights were trained for, metres; None: not asked.
        on_frame: called with how many of a camera's frames are measured, and how many there are.

    Raises:
        InputError: no recording, a camera without a frame that can be read and has depth, or one whose depth scale
            contradicts its belt distance.
    """
    kind = recording_kind(path)
    result = []
    for name in camera_names(path):
        taken, unread = _spread(open_unchecked(path, kind, name, masks=False), frames, where=str(path))
        if not taken:
            raise InputError(
                f"{path}, camera '{name}': no frame can be read" + (f"; the first: {unread[0]}" if unread else "")
            )
        seen = [frame for frame in taken if frame.depth.any()]
        if not seen:
            raise InputError(
                f"{path}, camera '{name}': none of the {len(taken)} frames looked at has depth: nothing can be "
                "measured; look at its pictures (`tuberline watch`)"
            )
        profile = profile_frames(taken, baseline_m=baseline_m, on_frame=on_frame)
        findings = judge(profile, trained, belt_m=belt_m)
        result.append(ProfiledCamera(profile, findings, seen[len(seen) // 2], tuple(unread)))
    return result


def _spread(source: RecordedSource, count: int, *, where: str) -> tuple[list[Frame], list[str]]:
    """Frames spread over the recording, and what is said of those that cannot be used."""
    keys = source.keys()
    at = np.unique(np.linspace(0, len(keys) - 1, min(count, len(keys))).astype(int))
    scale = ScaleCheck(where)
    taken: list[Frame] = []
    unread: list[str] = []
    for i in at:
        item = next(source.frames(run="profile", after=keys[i].seq - 1))
        refused = item if isinstance(item, Refused) else scale.refusal(item)
        if refused is not None:
            unread.append(refused.text)
        elif isinstance(item, Frame):
            taken.append(item)
    if scale.against is not None:
        raise InputError(scale.against.text)
    return taken, unread


def _named(values: tuple[float, ...] | None, names: tuple[str, ...]) -> dict[str, float] | None:
    return None if values is None else {name: round(float(v), 4) for name, v in zip(names, values, strict=True)}
