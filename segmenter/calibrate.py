"""Belt calibration from a recording of the belt, empty or running: where the belt is, and how sure that is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from conveyor.errors import InputError
from conveyor.formats.cameras import CameraFrames, open_cameras
from conveyor.formats.scale_check import expected_distance_m
from segmenter.frame.depth_watch import share_without_depth
from segmenter.frame.plane import PlaneFit, fit_plane, plane_pose

LEAST_FITS = 3


@dataclass(frozen=True, slots=True)
class BeltCalibration:
    """Where one camera's belt lies.

    Attributes:
        frames: fitted ones; asked: frames looked at; unreadable: those before the last of them, by reason;
            first_fault: what was said of the first of those.
        belt_distance_m: along the optical axis; spread_mm: standard deviation of the single frames' distances.
        tilt_deg: between the optical axis and the belt's normal; residual_mm: RMS of the belt around the plane.
        belt_share: median share of what has depth that is belt; without_depth: median share of the image without.
        belt_from_camera: (4, 4) as nested lists, of the image as it was recorded; x along its +v, or along the side
            that the recording's own pose says.
        given_distance_m: what the recording says, or None; disagreement_mm: seen minus given.
    """

    camera: str
    frames: int
    asked: int
    belt_distance_m: float
    spread_mm: float
    tilt_deg: float
    residual_mm: float
    belt_share: float
    belt_from_camera: list[list[float]]
    given_distance_m: float | None
    disagreement_mm: float | None
    unreadable: dict[str, int]
    first_fault: str = ""
    without_depth: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def calibrate_recording(
    recording: Path, *, frames: int = 30, on_frame: Callable[[int, int], None] = lambda done, of: None
) -> list[BeltCalibration]:
    """One calibration per camera of a recording of any kind, from up to `frames` of its first frames. `on_frame` is
    told how many of a camera's frames are done, and of how many.

    Raises:
        InputError: the recording cannot be used, or too little belt is seen in it.
    """
    return [
        calibrate_camera(camera, frames=frames, on_frame=on_frame)[0]
        for camera in open_cameras(recording, ignore_masks=True)
    ]


def calibrate_camera(
    camera: CameraFrames, *, frames: int = 30, on_frame: Callable[[int, int], None] = lambda done, of: None
) -> tuple[BeltCalibration, PlaneFit]:
    """The calibration of one camera, and the plane that it rests on, of the image as it is read.

    Raises:
        InputError: too little belt is seen.
    """
    fits: list[PlaneFit] = []
    empty: list[float] = []
    asked, given_m = 0, None
    for frame in islice(camera, frames):
        on_frame(asked, frames)
        asked += 1
        given_m = expected_distance_m(frame)
        fit = fit_plane(frame.depth, depth_scale_m=frame.depth_scale_m, intrinsics=frame.intrinsics)
        if fit is not None:
            fits.append(fit)
            empty.append(share_without_depth(frame.depth))
    if len(fits) < min(LEAST_FITS, asked) or not fits:
        raise InputError(
            f"{camera.description.origin}: a belt is seen in {len(fits)} of {asked} frames only; "
            "record a stretch with a visible belt, best an empty one"
        )
    a, b, c = (float(value) for value in np.median([fit.inverse_depth for fit in fits], axis=0))
    tilt_deg = float(np.degrees(np.arccos(c / np.linalg.norm([a, b, c]))))
    residual_m = float(np.median([fit.residual_m for fit in fits]))
    share = float(np.median([fit.share for fit in fits]))
    middle = PlaneFit((a, b, c), 1 / c, tilt_deg, residual_m, share)
    calibration = BeltCalibration(
        camera=camera.description.name,
        frames=len(fits),
        asked=asked,
        belt_distance_m=middle.distance_m,
        spread_mm=float(np.std([fit.distance_m for fit in fits])) * 1000,
        tilt_deg=tilt_deg,
        residual_mm=residual_m * 1000,
        belt_share=share,
        belt_from_camera=camera.recorded_pose(plane_pose(middle)).round(9).tolist(),
        given_distance_m=given_m,
        disagreement_mm=None if given_m is None else (middle.distance_m - given_m) * 1000,
        unreadable=dict(camera.unreadable),
        first_fault=camera.first_fault,
        without_depth=float(np.median(empty)),
    )
    return calibration, middle
