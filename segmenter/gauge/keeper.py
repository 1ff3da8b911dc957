"""The gauge of one camera in a run: looks at it now and then, corrects depth by what it says."""

from __future__ import annotations

from dataclasses import replace

from conveyor.camera_flags import DEPTH_DRIFT, DEPTH_DRIFT_BEYOND, MOUNT_MOVED, RODS_UNSEEN
from conveyor.gauge import Gauge
from conveyor.geometry import straight_down_belt_from_camera
from conveyor.messages import Frame
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.constants import CHECK_EVERY
from segmenter.frame.plane import fit_plane
from segmenter.gauge.drift import without_drift
from segmenter.gauge.estimate import REFERENCE_LOOKS, Cause, GaugeEstimate, GaugeReading
from segmenter.gauge.look import look_at

LEARNING_EVERY = 5
"""Frames between the first looks: the belt may be empty then, and the gauge seen well."""
CAUSES = {Cause.NONE: 0.0, Cause.MOUNT: 1.0, Cause.DRIFT: 2.0, Cause.BOTH: 3.0}
"""As levels tell them."""


class GaugeKeeper:
    """Looks by the count of frames, so a replay does again what it did. Needs a belt that is calibrated: what was
    fitted to the same depth cannot tell that this drifted.
    """

    def __init__(self, gauge: Gauge | None) -> None:
        self.reading: GaugeReading | None = None
        self._gauge = gauge
        self._estimate: GaugeEstimate | None = None
        self._belt: BeltGeometry | None = None
        self._frames = 0
        self._tried = self._looks = 0
        self._moved: tuple[float, BeltGeometry] | None = None

    def corrected(self, frame: Frame) -> Frame:
        """The frame with its depth as it was before disparity drifted; looks at the gauge where it is due.

        Its unit of depth is the same in all frames of a run, finer than the camera's where that is coarse.
        """
        if self._gauge is None:
            return frame
        every = LEARNING_EVERY if self._looks < 2 * REFERENCE_LOOKS else CHECK_EVERY
        if self._frames % every == 0:
            self.look(frame)
        self._frames += 1
        drift_per_m = 0.0 if self.reading is None else self.reading.correction_per_m
        depth, unit_m = without_drift(frame.depth, depth_scale_m=frame.depth_scale_m, drift_per_m=drift_per_m)
        return frame if depth is frame.depth else replace(frame, depth=depth, depth_scale_m=unit_m)

    @property
    def _unseen(self) -> bool:
        """Many looks have not found it once."""
        return self._tried >= REFERENCE_LOOKS and not self._looks

    @property
    def moved(self) -> bool:
        """The mount moved, as far as the gauge knows."""
        return self.reading is not None and self.reading.cause in (Cause.MOUNT, Cause.BOTH)

    def belt_of(self, belt: BeltGeometry | None) -> BeltGeometry | None:
        """The belt to use: of rods, between which one sees the ground, where their pitch says that they are."""
        if belt is None or self.reading is None or self._belt is None or self._gauge is None:
            return belt
        if self._gauge.kind != "rods":
            return belt
        if self._moved is None or self._moved[0] != self.reading.shift_m:
            pose = self._belt.belt_from_camera.copy()
            pose[2, 3] -= pose[2, 2] * self.reading.shift_m
            self._moved = self.reading.shift_m, BeltGeometry(self._belt.intrinsics, pose)
        return self._moved[1]

    def flags(self) -> tuple[str, ...]:
        """What is wrong with the camera, for the tubers that pass now."""
        if self.reading is None:
            return (RODS_UNSEEN,) if self._unseen and self._gauge is not None and self._gauge.kind == "rods" else ()
        cause = self.reading.cause
        drifted = DEPTH_DRIFT_BEYOND if self.reading.beyond else DEPTH_DRIFT
        return (
            *((drifted,) if cause in (Cause.DRIFT, Cause.BOTH) else ()),
            *((MOUNT_MOVED,) if cause in (Cause.MOUNT, Cause.BOTH) else ()),
        )

    def gauges(self) -> dict[str, float]:
        """The levels that are known; 'gauge_unseen' is 1 where many looks have not found it once."""
        unseen = {"gauge_unseen": float(self._unseen)} if self._tried >= REFERENCE_LOOKS else {}
        if self.reading is None:
            return unseen
        return unseen | {
            "gauge_cause": CAUSES[self.reading.cause],
            "gauge_drift_px": self.reading.drift_px,
            "gauge_shift_mm": 1000 * self.reading.shift_m,
            "gauge_beyond": float(self.reading.beyond),
        }

    def look(self, frame: Frame) -> None:
        """Look at the gauge in a frame as the camera gave it."""
        gauge = self._gauge
        if gauge is None:
            return
        self._tried += 1
        if self._belt is None:
            pose = frame.belt_from_camera
            if pose is None and frame.belt_distance_m is not None:
                pose = straight_down_belt_from_camera(frame.belt_distance_m)
            if pose is None:
                return
            self._belt = BeltGeometry(frame.intrinsics, pose)
            self._estimate = GaugeEstimate(gauge, given_m=self._belt.distance_m, focal_px=frame.intrinsics.fx)
        fit = None
        if gauge.kind != "rods":
            fit = fit_plane(
                frame.depth, depth_scale_m=frame.depth_scale_m, intrinsics=frame.intrinsics, mask=frame.mask
            )
        look = look_at(frame, self._belt, gauge, seen_m=None if fit is None else fit.distance_m)
        if look is not None and self._estimate is not None:
            self._looks += 1
            self._estimate.add(look)
            self.reading = self._estimate.reading()
