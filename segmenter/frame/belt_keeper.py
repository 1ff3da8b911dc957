"""Where a camera's belt is, frame after frame: given or fitted, checked again and again, and followed where wanted."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from statistics import median

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.geometry import TYPICAL_BELT_SD_M, belt_distance_m
from conveyor.messages import Frame
from conveyor.resting import RestingLevel
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.constants import (
    AGREE_M,
    BELT_PATIENCE,
    CHECK_EVERY,
    CLEAR_SHARE,
    FITTED_OVER,
    REFUSE_M,
    SEEN_SD_M,
)
from segmenter.frame.plane import BeltCheck, PlaneFit, check_belt, fit_plane, given_or_fitted, support_share
from segmenter.gauge.web import check_web
from segmenter.outline.correction import NOTHING_OFF

LEAST_EXPLAINED_M = 0.002
"""A belt that is seen no farther off is where it was measured, by whatever depth."""


class BeltKeeper:
    """The belt of one camera.

    A fitted belt is the mean of the first `FITTED_OVER` fits. A given one stays as given; with `follow_m` above 0 it is
    moved to where the median of the last `FITTED_OVER` checks sees it, where most see it, where these agree, and where
    that is at most `follow_m` off: what is farther off is no wear and is left to the alarm. It moves as far as what is
    given is less well known than what is seen: a belt that is stated to be known well hardly does.

    A web of rods (`web`) stays as given: its rods are compared with it, and what is seen between them is the ground.

    What of a drift the camera's own distances explain (`camera`) is no move of the belt: a given belt, a web too, is
    looked for where they put it, however far off that is.

    A look that contradicts the belt given is a hand, a sheet or a board in front of it, or a camera that was knocked:
    there is no belt until it is seen again. Where the first `BELT_PATIENCE` looks of a run do, or all of a shorter one,
    it is an error.

    Args:
        in_use: the belt was in use before, by an earlier process of the run.

    Attributes:
        belt: the belt in use, None before the first.
        check: what the newest check said, against the belt as given and as the camera should see it.
        camera: how far its distances are off, where that is known. A belt that was measured otherwise is seen where
            this puts it; one measured by the same depth, where it is given.
        hidden: what is seen in place of the belt, in words; empty while the belt is seen.
    """

    def __init__(
        self,
        follow_m: float = 0.0,
        *,
        given_sd_m: float = TYPICAL_BELT_SD_M,
        web: RestingLevel | None = None,
        in_use: bool = False,
    ) -> None:
        self.belt: BeltGeometry | None = None
        self.check = BeltCheck(None, None)
        self.hidden = ""
        self.camera = NOTHING_OFF
        self._followed_by_per_m = 0.0
        self._in_use = in_use
        self._hidden_looks = 0
        self._contradicted = 0
        self._web = web if web is not None and web.surface == "rods" else None
        self._follow_m = 0.0 if self._web else follow_m
        self._trust = given_sd_m**2 / (given_sd_m**2 + SEEN_SD_M**2)
        self._pose: NDArray[np.float64] | None = None
        self._fits: list[PlaneFit] = []
        self._drifts_m: deque[float] = deque(maxlen=FITTED_OVER)
        self._seen: deque[bool] = deque(maxlen=FITTED_OVER)
        self._fitted = False
        self._frames = 0
        self._beltless = 0

    def belt_of(self, frame: Frame) -> BeltGeometry | None:
        """The belt to use for this frame; None where none is given and none was seen yet, and while it is hidden.

        Raises:
            InputError: the belt seen contradicts the calibration in all of the first looks, or there is neither after
                many frames.
        """
        if self.belt is None or self.hidden or self._due():
            self._look(frame)
        elif self.camera.drift_per_m != self._followed_by_per_m:
            self._follow()
        if self.belt is None or self.hidden:
            return None
        self._frames += 1
        return self.belt

    def finish(self) -> None:
        """No frame comes any more.

        Raises:
            InputError: something else than the belt given was seen in all of them.
        """
        if self._contradicted and not self._in_use:
            raise InputError(self.hidden)

    def may_follow(self, reach_m: float) -> None:
        """Follow a given belt by `reach_m` at least from now on: a gauge says that the mount moved.

        So what was given is known no better than anything else: the belt goes all the way to where it is seen.
        """
        if self._follow_m > 0:
            self._follow_m = max(self._follow_m, reach_m)
            self._trust = 1.0

    def _due(self) -> bool:
        fitting = self._fitted and len(self._fits) < FITTED_OVER
        learning = self._follow_m > 0 and self._frames < FITTED_OVER
        return self._frames % CHECK_EVERY == 0 or fitting or learning

    def _look(self, frame: Frame) -> None:
        fit = fit_plane(frame.depth, depth_scale_m=frame.depth_scale_m, intrinsics=frame.intrinsics, mask=frame.mask)
        if self._pose is None:
            given = frame.belt_from_camera is not None or frame.belt_distance_m is not None
            if self._web is not None and not given:
                raise InputError(
                    f"camera '{frame.camera}' looks at a web of rods, between which it sees the ground, so where the "
                    "belt is must be given: belt_distance_m, from the camera to the rods' tops"
                )
            if fit is None and not given:
                self._beltless += 1
                if self._beltless < BELT_PATIENCE or self._in_use:
                    return
            self._pose = given_or_fitted(frame.belt_from_camera, frame.belt_distance_m, fit, camera=frame.camera)
            self._fitted = not given
            self.belt = BeltGeometry(frame.intrinsics, self._pose)
        self._judge(frame, fit, self._pose)
        if self._fitted and not self.hidden and fit is not None and len(self._fits) < FITTED_OVER:
            self._pose = self._mean_with(fit, frame.camera)
            self.belt = BeltGeometry(frame.intrinsics, self._pose)
            self._judge(frame, fit, self._pose)
        if self.hidden:
            return
        self._seen.append(self.check.drift_m is not None)
        if self._fitted or self.check.drift_m is None:
            return
        self._drifts_m.append(self.check.drift_m)
        if explained_m := self._explained_m(self.check.drift_m, self._pose):
            self.check = replace(self.check, drift_m=self.check.drift_m - explained_m)
        self._follow()

    def _mean_with(self, fit: PlaneFit, camera: str) -> NDArray[np.float64]:
        self._fits.append(fit)
        a, b, c = (float(value) for value in np.mean([f.inverse_depth for f in self._fits], axis=0))
        mean = PlaneFit((a, b, c), 1 / c, fit.tilt_deg, fit.residual_m, fit.share)
        return given_or_fitted(None, None, mean, camera=camera)

    def _judge(self, frame: Frame, fit: PlaneFit | None, pose: NDArray[np.float64]) -> None:
        """Whether the belt is where it is said to be; once something else was seen there, only where it is seen again.

        Raises:
            InputError: something else was seen there in all of the first looks.
        """
        try:
            check, share = self._compared(frame, fit, pose)
        except InputError as error:
            if not self._in_use:
                self._contradict(error)
                return
            if fit is not None and self._hidden_looks % CHECK_EVERY == 0:  # as often as a belt that is seen is checked
                self.check = BeltCheck(fit, fit.distance_m - belt_distance_m(pose))
            self.hidden = str(error)
            self._hidden_looks += 1
            return
        if self.hidden and share < CLEAR_SHARE and (check.drift_m is None or abs(check.drift_m) > REFUSE_M):
            return
        self.check, self.hidden, self._hidden_looks, self._in_use = check, "", 0, True

    def _contradict(self, error: InputError) -> None:
        """A look at the start of a run that contradicts the belt given. What was seen says nothing of the pose."""
        self._contradicted += 1
        if self._contradicted >= BELT_PATIENCE:
            raise error
        self.hidden, self.belt, self._pose = str(error), None, None

    def _compared(self, frame: Frame, fit: PlaneFit | None, pose: NDArray[np.float64]) -> tuple[BeltCheck, float]:
        """The belt seen against the one at `pose`, and the share of the frame that bears that out."""
        if self._web is not None:
            return check_web(frame, BeltGeometry(frame.intrinsics, pose), self._web, fit), 1.0
        share = support_share(
            pose, frame.depth, depth_scale_m=frame.depth_scale_m, intrinsics=frame.intrinsics, mask=frame.mask
        )
        check = check_belt(pose, fit, given_share=share, camera=frame.camera, depth_scale_m=frame.depth_scale_m)
        return check, share

    def _follow(self) -> None:
        """Put a given belt where the last looks see it."""
        if self.belt is not None and self._pose is not None and self._drifts_m:
            self._followed_by_per_m = self.camera.drift_per_m
            self.belt = BeltGeometry(self.belt.intrinsics, self._followed(self._pose))

    def _followed(self, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """(4, 4) the given pose with its height over the belt as seen; drifts are along the optical axis."""
        drift_m = median(self._drifts_m)
        scatter_m = float(np.mean(np.abs(np.array(self._drifts_m) - drift_m)))
        often = 2 * sum(self._seen) >= len(self._seen)
        explained_m = self._explained_m(drift_m, pose)
        left_m = drift_m - explained_m
        sure = abs(left_m) <= self._follow_m and scatter_m <= AGREE_M and often
        moved = pose.copy()
        moved[2, 3] -= pose[2, 2] * (explained_m + (left_m * self._trust if sure else 0.0))
        return moved

    def _explained_m(self, drift_m: float, pose: NDArray[np.float64]) -> float:
        """What of a drift is the camera's depth, along the optical axis; 0 where the belt was measured by it, too, and
        where it is so little that it makes no difference.
        """
        given_m = belt_distance_m(pose)
        off_m = self.camera.seen_m(given_m) - given_m
        return off_m if abs(drift_m) > LEAST_EXPLAINED_M and abs(drift_m - off_m) < abs(drift_m) else 0.0
