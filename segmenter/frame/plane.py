"""The belt plane of a camera: taken as given, or fitted to what is seen; and the check of one against the other.

A plane is linear in inverse depth, 1/z = a x + b y + c with x = (u - cx)/fx and y = (v - cy)/fy, so the fit is a
trimmed least-squares problem in three unknowns. Belt-height calibration matters more than any sensor noise: three
millimetres cost as much accuracy as all the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conveyor.camera_place import CameraPlace
from conveyor.errors import InputError
from conveyor.geometry import Intrinsics, belt_distance_m, straight_down_belt_from_camera
from segmenter.frame.constants import (
    BAND_M,
    BELOW_M,
    BELT_QUANTILE,
    CLEAR_SHARE,
    CLEAR_SPAN,
    CONSENSUS_FAR,
    CONSENSUS_SCORED,
    CONSENSUS_TRIES,
    DRIFT_M,
    FIT_BANDS_M,
    FLOOR_BELOW_M,
    LEAST_BELT_ROWS,
    LOAD_M,
    MIN_FIT_SAMPLES,
    MIN_SAMPLES,
    MIN_SHARE,
    MOSTLY,
    REFUSE_M,
    ROW_SAMPLES,
    SAMPLE_STRIDE,
    TILT_OFF_DEG,
    TILT_SURE_DEG,
    TILT_WORTH_DEG,
)
from segmenter.frame.plane_kernels import (
    best_plane,
    far_samples,
    heights_over,
    planes_through,
    quantile,
    row_means,
    samples_of,
    support,
    trimmed,
    triples_of,
)

Plane = NDArray[np.float64]
"""(3,) of 1/z = a x + b y + c."""
Samples = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""(n,) each: normalised image coordinates x and y, and inverse depth, 1/metres."""


@dataclass(frozen=True, slots=True)
class PlaneFit:
    """A plane seen in a frame.

    Attributes:
        inverse_depth: (a, b, c) of 1/z = a x + b y + c in normalised image coordinates, 1/metres.
        distance_m: along the optical axis; tilt_deg: between the optical axis and the plane's normal.
        residual_m: RMS distance of the supporting samples; share: how many of all samples support it.
    """

    inverse_depth: tuple[float, float, float]
    distance_m: float
    tilt_deg: float
    residual_m: float
    share: float


@dataclass(frozen=True, slots=True)
class BeltCheck:
    """What the frame says about a given belt. `drift_m` is seen minus given, `tilt_off_deg` the angle between the two;
    None where too little belt shows.
    """

    seen: PlaneFit | None
    drift_m: float | None
    tilt_off_deg: float | None = None

    @property
    def alarm(self) -> bool:
        """The belt seen lies or leans off the belt given by more than calibration and fit explain."""
        moved = self.drift_m is not None and abs(self.drift_m) > DRIFT_M
        return moved or (self.tilt_off_deg is not None and self.tilt_off_deg > TILT_OFF_DEG)


def fit_plane(
    depth: NDArray[np.uint16],
    *,
    depth_scale_m: float,
    intrinsics: Intrinsics,
    mask: NDArray[np.uint16] | None = None,
) -> PlaneFit | None:
    """The dominant far plane of a frame, or None where no plane is supported by `MIN_SHARE` of the samples.

    Args:
        depth: (H, W) uint16, units of `depth_scale_m` metres, 0 = no depth.
        depth_scale_m: metres per unit.
        intrinsics: of this image.
        mask: (H, W) labels of tubers, which are left out, or None.
    """
    x, y, q = samples = _samples(depth, depth_scale_m, intrinsics, mask)
    if len(q) < MIN_SAMPLES:
        return None
    found = _fit(samples)
    middle = np.abs(x) < intrinsics.width / intrinsics.fx / 4
    inner = _fit((x[middle], y[middle], q[middle])) if middle.sum() >= MIN_SAMPLES else None
    if found is not None and inner is not None and inner.share > MOSTLY:
        beside_a_floor = found.distance_m - inner.distance_m > FLOOR_BELOW_M
        return _summary(np.array(inner.inverse_depth), samples) if beside_a_floor else found
    return found


def between_cleats(plane: Plane, samples: Samples) -> Plane:
    """The plane moved to where the belt lies between its cleats, and under most of its soil.

    Least squares through all that is near take cleats and the feet of tubers for the belt. Cleats lie across the
    travel, so they are whole rows of samples: of the rows' mean heights a low quantile is the belt.
    """
    mean = row_means(samples[1], heights_over(plane, *samples), BAND_M, ROW_SAMPLES)
    if len(mean) < LEAST_BELT_ROWS:
        return plane
    distance_m = 1.0 / float(np.linalg.norm(plane))
    return np.asarray(plane * distance_m / (distance_m - quantile(mean, BELT_QUANTILE)))


def _fit(samples: Samples) -> PlaneFit | None:
    best = trimmed(_consensus(*samples), *samples, FIT_BANDS_M, MIN_FIT_SAMPLES)
    return _summary(between_cleats(best, samples), samples) if best.any() else None


def plane_pose(fit: PlaneFit) -> NDArray[np.float64]:
    """(4, 4) belt_from_camera of a fitted plane: x along the image's +v, origin on it right under the camera."""
    normal = -np.asarray(fit.inverse_depth) / np.linalg.norm(fit.inverse_depth)
    x_axis = np.array([0.0, 1.0, 0.0]) - normal[1] * normal
    x_axis /= np.linalg.norm(x_axis)
    rotation = np.stack([x_axis, np.cross(normal, x_axis), normal])
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[2, 3] = -normal[2] * fit.distance_m
    return pose


def check_belt(
    belt_from_camera: NDArray[np.float64],
    fit: PlaneFit | None,
    *,
    given_share: float,
    camera: str,
    depth_scale_m: float,
) -> BeltCheck:
    """Compare the belt given with the belt seen.

    Args:
        belt_from_camera: (4, 4) as given.
        fit: the plane seen, or None.
        given_share: share of the frame's samples that support the given plane (`support_share`).
        camera: name for the error.
        depth_scale_m: metres per unit, for the error.

    Raises:
        InputError: another plane is seen clearly, and nothing where the belt should be.
    """
    given_m = belt_distance_m(belt_from_camera)
    if fit is None:
        return BeltCheck(None, None)
    drift_m = fit.distance_m - given_m
    ratio = fit.distance_m / given_m
    if ratio > 3 or ratio < 1 / 3:
        raise InputError(_disagreement(camera, given_m, fit.distance_m, depth_scale_m))
    if abs(drift_m) > REFUSE_M and fit.share > CLEAR_SHARE and given_share < 0.05:
        raise InputError(_disagreement(camera, given_m, fit.distance_m, depth_scale_m))
    # A plane much farther off is the floor beside the belt, or the load upon it: it says nothing of the calibration.
    if fit.share <= CLEAR_SHARE or abs(drift_m) > FLOOR_BELOW_M:
        return BeltCheck(fit, None)
    return BeltCheck(fit, drift_m, _angle_deg(fit, belt_from_camera))


def support_share(
    belt_from_camera: NDArray[np.float64],
    depth: NDArray[np.uint16],
    *,
    depth_scale_m: float,
    intrinsics: Intrinsics,
    mask: NDArray[np.uint16] | None = None,
) -> float:
    """Share of a frame's samples within `BAND_M` of the given belt; 0 where nothing is seen.

    A belt that is full to its edges, with the floor seen beside it, is borne out by the load that stands on it.
    """
    x, y, q = _samples(depth, depth_scale_m, intrinsics, mask)
    if len(q) == 0:
        return 0.0
    row = belt_from_camera[2]
    height = (row[0] * x + row[1] * y + row[2]) / q + row[3]
    on_belt = float(np.mean(np.abs(height) < BAND_M))
    full = np.mean((height > BAND_M) & (height < LOAD_M)) > MOSTLY / 2 and np.mean(height < -FLOOR_BELOW_M) > MIN_SHARE
    return max(on_belt, MIN_SHARE) if full else on_belt


def given_or_fitted(
    belt_from_camera: NDArray[np.float64] | None, distance_m: float | None, fit: PlaneFit | None, *, camera: str
) -> NDArray[np.float64]:
    """The belt pose to work with: the given one; else straight down at the given distance; else the fitted one.

    A camera said to look straight down that visibly does not gets the tilt that is seen, about the given distance: a
    tilt of 3 degrees taken for none costs a fifth of all tubers. So does one whose given pose looks straight down to
    the last digit, as no measured one does, where the tilt is past doubt.

    Raises:
        InputError: nothing is given and no belt is seen.
    """
    tilt_deg = fit.tilt_deg if fit is not None and fit.share > 0.3 and fit.tilt_deg < 15 else 0.0
    if belt_from_camera is not None:
        assumed = not belt_from_camera[2, :2].any()
        if fit is None or not assumed or tilt_deg <= TILT_SURE_DEG:
            return belt_from_camera
        return CameraPlace.of(belt_from_camera).put(leaning_pose(fit, belt_distance_m(belt_from_camera)))
    if distance_m is not None:
        if fit is None or tilt_deg <= TILT_WORTH_DEG:
            return straight_down_belt_from_camera(distance_m)
        return leaning_pose(fit, distance_m)
    if fit is None:
        raise InputError(
            f"camera '{camera}' has neither belt_from_camera nor belt_distance_m, and no belt is seen in the frame "
            f"(a plane must carry {MIN_SHARE:.0%} of its pixels): give belt_distance_m in the recording or the config"
        )
    return plane_pose(fit) if tilt_deg > TILT_WORTH_DEG else straight_down_belt_from_camera(fit.distance_m)


def leaning_pose(fit: PlaneFit, distance_m: float) -> NDArray[np.float64]:
    """(4, 4) belt_from_camera of the plane seen, moved to a given distance along the optical axis."""
    scale = fit.distance_m / distance_m
    a, b, c = (value * scale for value in fit.inverse_depth)
    return plane_pose(PlaneFit((a, b, c), distance_m, fit.tilt_deg, fit.residual_m, fit.share))


def _samples(depth: NDArray[np.uint16], scale_m: float, k: Intrinsics, mask: NDArray[np.uint16] | None) -> Samples:
    """Every 64th pixel that has depth and no tuber."""
    start = SAMPLE_STRIDE // 2
    grid = depth[start::SAMPLE_STRIDE, start::SAMPLE_STRIDE].copy()
    if mask is not None:
        grid[mask[start::SAMPLE_STRIDE, start::SAMPLE_STRIDE] != 0] = 0
    samples: Samples = samples_of(grid, scale_m, (k.fx, k.fy, k.cx, k.cy), start, SAMPLE_STRIDE)
    return samples


def _consensus(x: NDArray[np.float64], y: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
    """A first plane by consensus among the far points of coarse cells: the belt is what lies behind the tubers."""
    far = far_samples(x, y, q, CONSENSUS_FAR)
    if len(far) < 3:
        far = np.arange(len(q))
    # The same draws every time: the same frame gives the same plane.
    rng = np.random.default_rng(20)
    scored = rng.permutation(len(q))[:CONSENSUS_SCORED]
    triples = far[triples_of(rng, len(far), CONSENSUS_TRIES)]
    planes = planes_through(triples, x, y, q, CLEAR_SPAN)
    # Nothing lies below the belt, so a plane through the tubers' tops loses by all the belt under it.
    best = best_plane(planes, x[scored], y[scored], q[scored], BAND_M, BELOW_M)
    return np.array([0.0, 0.0, float(np.median(q))]) if best < 0 else np.asarray(planes[best])


def _summary(plane: Plane, samples: Samples) -> PlaneFit | None:
    near, squares = support(heights_over(plane, *samples), BAND_M)
    share = near / len(samples[0])
    if share < MIN_SHARE or plane[2] <= 0:
        return None
    tilt = float(np.degrees(np.arccos(np.clip(plane[2] / np.linalg.norm(plane), -1, 1))))
    a, b, c = (float(value) for value in plane)
    return PlaneFit((a, b, c), 1.0 / c, tilt, float(np.sqrt(squares / near)), share)


def _angle_deg(fit: PlaneFit, belt_from_camera: NDArray[np.float64]) -> float:
    """Between the normals of the plane seen and the belt given."""
    normal = -np.asarray(fit.inverse_depth) / np.linalg.norm(fit.inverse_depth)
    return float(np.degrees(np.arccos(np.clip(normal @ belt_from_camera[2, :3], -1.0, 1.0))))


def _disagreement(camera: str, given_m: float, seen_m: float, scale_m: float) -> str:
    ratio = seen_m / given_m
    text = (
        f"camera '{camera}' is calibrated for a belt at {given_m:.3f} m, but the belt seen in the frame lies at "
        f"{seen_m:.3f} m"
    )
    if 6 < ratio < 15 or 1 / 15 < ratio < 1 / 6:
        right_m = scale_m / 10 if ratio > 1 else scale_m * 10
        return f"{text}: a factor of about ten, so the depth scale of {scale_m:g} m is wrong (try {right_m:g})"
    fix = "measure the belt again (`tuberline calibrate belt`) or correct belt_distance_m / belt_from_camera"
    web = '; or it is the ground under a web of rods: say surface = "rods" in [belt] then'
    return f"{text}: {fix}{web if seen_m > given_m else ''}"
