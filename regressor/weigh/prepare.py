"""From a view of a tuber to what the network takes: a clean, level, centred cloud and the tuber's height.

The order follows the reference: clean, height above the belt from the raw cloud, centre on the mean of all points,
sample. Two things are ours. A tilted camera's cloud is first turned so that its z axis is the
belt's normal (the identity for a camera that looks straight down). And strays are removed by a test on the depth
image instead of DBSCAN, where rows that its camera left out are filled before: see `conveyor.crop_depth`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from conveyor.crop_depth import clean_depth, fill_holes, filled_rows, in_parts, is_parted, pixel_width_m, step_units
from conveyor.depth_noise import crop_noise_px
from conveyor.errors import InputError
from conveyor.formats.cloud_shape import UNMASKED, cloud_fault, masked_fault
from conveyor.geometry import straight_down_belt_from_camera
from conveyor.kernels import kernel
from conveyor.messages import View
from regressor.weigh.finer import finer, times_finer
from regressor.weigh.grown import SCRAPS_CUT, cut_back, view_heights_m
from regressor.weigh.outline import angle_image
from regressor.weigh.pixel_grid import gridded
from regressor.weigh.place import HIGHEST_RIM_M, LOWEST_TOP_M, OFF_THE_BELT, distances_told
from regressor.weigh.surface import LEAST_HEIGHT_M, SurfaceFeatures, surface_features

MAX_HEIGHT_M = 0.08
MIN_POINTS = 30
NETWORK_POINTS = 1024
MAX_EXTENT_M = 0.2
MAX_POINTS = 60_000
VOXEL_M = 0.0005
MISSING = "rows_missing"
"""Flag of a view whose camera left out rows or columns; they were filled."""
PARTS = "in_parts"
"""Flag of a view that falls into parts, however small one is: each counts, and what lies between them does not."""
NEAREST_M, FARTHEST_M = 0.001, 1000.0
"""No camera over a belt sees so near, none so far: the one is left out of a cloud, the other is no number of a place.
"""
BEHIND = "most lie behind the camera, z is below 0: z must point away from it, y down; turn round those of OpenGL"


REASONS = {
    "empty_cloud": "it has no points",
    "too_few_points": f"it has fewer than {MIN_POINTS} points after cleaning",
    "not_finite": f"it has points that are not finite, or {FARTHEST_M:g} m away or more",
    "below_belt": f"no point of it lies {1e3 * LEAST_HEIGHT_M:g} mm or more above the level that it rests on",
    OFF_THE_BELT: f"it rises {1e3 * LOWEST_TOP_M:g} mm or less above its belt, or floats {1e2 * HIGHEST_RIM_M:g} cm or "
    "more over it",
    "out_of_range": "its weight is none that a tuber can have",
    "not_a_cloud": "it is not an array of shape (N, 3)",
}


class RefusedCloud(InputError):
    """A cloud that cannot be weighed; `reason` is what is counted and reported."""

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"the cloud cannot be weighed: {REASONS[reason]}{detail and '; '}{detail}")
        self.reason = reason


@dataclass(frozen=True, slots=True)
class PreparedCloud:
    """A cloud ready to be sampled.

    Attributes:
        points: (N, 3) float32, level frame (z away from the camera along the belt's normal), centred, metres.
        height_m: of the highest point above the resting level, not clamped.
        belt_distance_m: height of the optical centre above the belt.
        surface: volume under the visible surface and outline measures.
        flags: what is unusual about this cloud.
        resting_offset_m: how far the resting level lies below the belt.
        centre_m: where the mean of all points lies in the level frame, metres.
        noise_px: local noise of the depth on its skin, pixels of disparity at a baseline of 18 mm; None: not known.
    """

    points: NDArray[np.float32]
    height_m: float
    belt_distance_m: float
    surface: SurfaceFeatures
    flags: tuple[str, ...]
    resting_offset_m: float = 0.0
    centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    noise_px: float | None = None

    def clamped_height_m(self, highest_m: float = MAX_HEIGHT_M) -> float:
        """The height the network sees, metres: 0 to 80 mm as in the paper, or what its weights were trained with."""
        return min(max(self.height_m, 0.0), highest_m)


@dataclass(frozen=True, slots=True)
class _Look:
    """How a crop was seen: `prepare_depth`'s arguments about its camera and belt."""

    depth_scale_m: float
    fx: float
    fy: float
    cx: float
    cy: float
    belt_from_camera: NDArray[np.float64]
    resting_offset_m: float

    @property
    def pixel_m(self) -> float:
        """How wide a pixel is at the belt."""
        return pixel_width_m(self.belt_from_camera, self.fx)

    def filled(self, depth: NDArray[np.uint16]) -> tuple[NDArray[np.uint16], NDArray[np.bool_] | None]:
        """`depth` with the rows that its camera left out, and which those are."""
        return filled_rows(np.ascontiguousarray(depth), step_units(self.depth_scale_m, self.pixel_m))

    def clean(self, depth: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """`depth` without strays."""
        return clean_depth(depth, self.depth_scale_m, self.pixel_m)

    def divided(self, down: int, across: int) -> _Look:
        """Of an image with each pixel divided so."""
        cx, cy = across * self.cx + (across - 1) / 2, down * self.cy + (down - 1) / 2
        return replace(self, fx=across * self.fx, fy=down * self.fy, cx=cx, cy=cy)


def prepare_view(view: View) -> PreparedCloud:
    """The view's cloud, over its own resting level; scraps around its outline are cut off (`grown`).

    Raises:
        RefusedCloud: empty, too few points, or not above its resting level.
    """
    k = view.intrinsics
    look = _Look(
        view.depth_scale_m, k.fx, k.fy, k.cx - view.u0, k.cy - view.v0, view.belt_from_camera, view.resting_offset_m
    )
    depth, missing = look.filled(view.depth)
    kept = look.clean(depth)
    cut, parted = cut_back(depth, kept, view_heights_m(kept, view)), is_parted(depth)
    if cut is None:
        return _prepare_kept(kept, depth, missing, look, parted=parted)
    cloud = _prepare_kept(look.clean(cut), cut, missing, look, parted=parted)
    return replace(cloud, flags=(*cloud.flags, SCRAPS_CUT))


def prepare_depth(
    depth: NDArray[np.uint16],
    *,
    depth_scale_m: float,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    belt_from_camera: NDArray[np.float64],
    resting_offset_m: float = 0.0,
) -> PreparedCloud:
    """The cloud of all non-zero pixels of `depth`.

    Args:
        depth: (h, w) uint16, units of `depth_scale_m` metres, zero outside the tuber.
        fx, fy, cx, cy: intrinsics in pixels; cx, cy count from this crop's first pixel.
        belt_from_camera: (4, 4).
        resting_offset_m: how far the tuber's underside lies below that belt.

    Raises:
        RefusedCloud: empty, too few points, or not above its resting level.
    """
    look = _Look(depth_scale_m, fx, fy, cx, cy, belt_from_camera, resting_offset_m)
    depth, missing = look.filled(depth)
    return _prepare_kept(look.clean(depth), depth, missing, look, parted=is_parted(depth))


def _prepare_kept(
    kept: NDArray[np.uint16],
    depth: NDArray[np.uint16],
    missing: NDArray[np.bool_] | None,
    look: _Look,
    *,
    parted: bool,
) -> PreparedCloud:
    """As `prepare_depth`. `kept`: the pixels of `depth` that are clean; `missing`: those of rows that were filled;
    `parted`: a gap that is not filled parts it, also where cleaning took what lies beyond.
    """
    measured = kept if missing is None else np.where(missing, 0, kept)
    seen = int(np.count_nonzero(measured))
    if seen < MIN_POINTS:
        raise RefusedCloud("empty_cloud" if not depth.any() else "too_few_points")
    told = depth if missing is None else np.where(missing, 0, depth)
    noise_px = crop_noise_px(told, depth_scale_m=look.depth_scale_m, fx=look.fx)
    down, across = times_finer(look.pixel_m, kept.size, longer=look.fx / look.fy)
    filled = kept * np.float64(look.depth_scale_m)
    if down * across > 1:
        filled, look = finer(filled, (down, across)), look.divided(down, across)
    there = filled > 0
    holes = fill_holes(filled)
    inside, points, in_camera = _points(filled, there, look.fx, look.fy, look.cx, look.cy)
    level, distance_m = _level(in_camera, look.belt_from_camera)
    _stands_above(level, distance_m, look.resting_offset_m)
    area = _areas(in_camera, level, look.fx * look.fy)
    surface = surface_features(level, area, inside, distance_m=distance_m + look.resting_offset_m, holes=holes)
    cloud = _finish(level, points, distance_m, look.resting_offset_m, surface, seen=seen)
    seen_so = {MISSING: missing is not None, PARTS: parted or in_parts(inside)}
    flags = (*cloud.flags, *(flag for flag, so in seen_so.items() if so))
    return replace(cloud, noise_px=noise_px, flags=flags)


def prepare_cloud(
    points_in_camera: NDArray[np.floating], *, belt_distance_m: float, resting_offset_m: float = 0.0
) -> PreparedCloud:
    """A cloud that came without its image, from a camera that looks straight down.

    Where its points are pixels of a camera, it is that camera's image again (`pixel_grid`); else it is laid on a grid
    of about four points a cell.

    Args:
        points_in_camera: (N, 3), metres, one tuber. Millions are thinned out first.
        resting_offset_m: how far its underside lies below the belt.

    Raises:
        RefusedCloud: empty, too few points, not finite, no cloud at all, or not above its resting level.
    """
    try:
        given = np.asarray(points_in_camera)
    except (TypeError, ValueError) as error:  # lists of different lengths
        raise RefusedCloud("not_a_cloud", str(error)) from error
    if fault := masked_fault(points_in_camera, UNMASKED) or cloud_fault(given):
        raise RefusedCloud("not_a_cloud", f"given is {fault}")
    points = given.astype(np.float64)
    if not len(points):
        raise RefusedCloud("empty_cloud")
    if not (np.abs(points) < FARTHEST_M).all():
        raise RefusedCloud("not_finite", "" if np.isfinite(points).all() else "take cloud[np.isfinite(cloud).all(1)]")
    points, image = gridded(points, most=MAX_POINTS)
    if image is not None:
        return prepare_depth(
            image.depth,
            depth_scale_m=image.depth_scale_m,
            fx=image.fx,
            fy=image.fy,
            cx=image.cx,
            cy=image.cy,
            belt_from_camera=straight_down_belt_from_camera(belt_distance_m),
            resting_offset_m=resting_offset_m,
        )
    return _prepare_points(points, belt_distance_m=belt_distance_m, resting_offset_m=resting_offset_m)


def _prepare_points(points: NDArray[np.float64], *, belt_distance_m: float, resting_offset_m: float) -> PreparedCloud:
    """A cloud without pixels."""
    points = thinned(points)
    behind = len(points) > 0 and float(np.mean(points[:, 2] < 0)) > 0.5
    points = points[_without_strays(points) & (points[:, 2] > NEAREST_M)]
    if len(points) < MIN_POINTS:
        raise RefusedCloud("too_few_points", BEHIND if behind else "")
    _stands_above(points, belt_distance_m, resting_offset_m)
    image = angle_image(points)
    holes = fill_holes(image.depth_m)
    inside = image.depth_m > 0
    v, u = np.nonzero(inside)
    z = image.depth_m[v, u]
    level = np.stack([(image.x0 + u * image.pixel) * z, (image.y0 + v * image.pixel) * z, z], axis=1)
    # A cell that a hole's filling covers is whole.
    area = (z * image.pixel) ** 2 * np.where(image.share[v, u] > 0, image.share[v, u], 1.0)
    distance_m = belt_distance_m + resting_offset_m
    surface = surface_features(level, area, inside, distance_m=distance_m, holes=holes)
    every = np.ones(len(points), np.bool_)
    return _finish(points, every, belt_distance_m, resting_offset_m, surface, seen=len(points))


def _stands_above(level: NDArray[np.float64], distance_m: float, resting_offset_m: float) -> None:
    """Refuse a cloud of which nothing stands above its resting level: it has no top, and no body under it.

    Raises:
        RefusedCloud: below the belt.
    """
    nearest_m = float(level[:, 2].min())
    if not distance_m + resting_offset_m - nearest_m >= LEAST_HEIGHT_M:
        raise RefusedCloud("below_belt", distances_told(nearest_m, distance_m, resting_offset_m))


def thinned(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """At most `MAX_POINTS` points or so: the means of the points in voxels, which are doubled until they do.

    A tuber has 3,000 to 30,000 pixels; clouds of millions took minutes in the search for strays.
    """
    size_m = VOXEL_M
    while len(points) > MAX_POINTS:
        voxel = np.floor(points / size_m).astype(np.int64)
        voxel -= voxel.min(0)
        extent = voxel.max(0) + 1
        name = (voxel[:, 0] * extent[1] + voxel[:, 1]) * extent[2] + voxel[:, 2]
        _, owner, count = np.unique(name, return_inverse=True, return_counts=True)
        points = np.column_stack([np.bincount(owner, axis) / count for axis in points.T])
        size_m *= 2
    return points


def _level(
    points_in_camera: NDArray[np.float64], belt_from_camera: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Points turned so that +z points into the belt, by the smallest rotation; camera height above the belt, metres."""
    down = -belt_from_camera[2, :3]
    if down[2] > 1 - 1e-12:
        return points_in_camera, float(belt_from_camera[2, 3])
    axis = np.cross(down, [0.0, 0.0, 1.0])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    level_from_camera = np.eye(3) + cross + cross @ cross / (1 + down[2])
    return points_in_camera @ level_from_camera.T, float(belt_from_camera[2, 3])


@kernel(nogil=True, error_model="numpy")
def _points(
    filled: NDArray[np.float64], there: NDArray[np.bool_], fx: float, fy: float, cx: float, cy: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.float64]]:
    """(h, w) which pixels have depth, filled ones included; of these, row by row, (n,) which were measured and (n, 3)
    their places in the camera's frame, metres.
    """
    rows, columns = filled.shape
    inside, measured = np.empty((rows, columns), np.bool_), np.empty(rows * columns, np.bool_)
    places, n = np.empty((rows * columns, 3)), 0
    for v in range(rows):
        for u in range(columns):
            z = filled[v, u]
            inside[v, u] = z > 0
            if z > 0:
                places[n, 0], places[n, 1], places[n, 2] = (u - cx) * z / fx, (v - cy) * z / fy, z
                measured[n] = there[v, u]
                n += 1
    return inside, measured[:n], places[:n]


@kernel(nogil=True, error_model="numpy")
def _areas(in_camera: NDArray[np.float64], level: NDArray[np.float64], fx_fy: float) -> NDArray[np.float64]:
    """(n,) area on the level plane that a pixel covers: smaller than z^2/(fx fy) where the ray meets it obliquely."""
    areas = np.empty(len(in_camera))
    for n in range(len(in_camera)):
        z = in_camera[n, 2]
        areas[n] = z * z / fx_fy / max(level[n, 2] / z, 0.2)
    return areas


def _finish(
    level: NDArray[np.float64],
    measured: NDArray[np.bool_],
    distance_m: float,
    resting_offset_m: float,
    surface: SurfaceFeatures,
    *,
    seen: int,
) -> PreparedCloud:
    """`seen`: points that were measured, before they were laid out finer."""
    points, centre, box, nearest_m = _centred(level, measured)
    height_m = distance_m + resting_offset_m - nearest_m
    flags = []
    if seen <= NETWORK_POINTS:
        flags.append("few_points")
    if float(np.linalg.norm(box)) >= MAX_EXTENT_M:
        flags.append("extent")
    x_m, y_m, z_m = (float(value) for value in centre)
    return PreparedCloud(points, height_m, distance_m, surface, tuple(flags), resting_offset_m, (x_m, y_m, z_m))


@kernel(nogil=True)
def _centred(
    level: NDArray[np.float64], measured: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], float]:
    """(N, 3) float32 points, those of `level` that were measured, about the mean of all of them; that mean, the box
    around them, and the z of the nearest.
    """
    n, nearest_m = 0, np.inf
    for k in range(len(level)):
        n += measured[k]
    points, centre, box = np.empty((n, 3), np.float32), np.empty(3, np.float32), np.empty(3, np.float32)
    n = 0
    for k in range(len(level)):
        if measured[k]:
            points[n, 0], points[n, 1], points[n, 2] = level[k, 0], level[k, 1], level[k, 2]
            nearest_m = min(nearest_m, level[k, 2])
            n += 1
    for axis in range(3):
        total, low, high = 0.0, np.float32(np.inf), np.float32(-np.inf)
        for k in range(n):
            total += np.float64(points[k, axis])
        centre[axis] = np.float32(total / n)
        for k in range(n):
            points[k, axis] -= centre[axis]
            low, high = min(low, points[k, axis]), max(high, points[k, axis])
        box[axis] = high - low
    return points, centre, box, nearest_m


def _without_strays(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mask of points whose eighth neighbour is no farther than five times the median: free of the cloud's density."""
    if len(points) < MIN_POINTS:
        return np.ones(len(points), np.bool_)
    from scipy.spatial import cKDTree  # a fifth of a second: clouds from a camera do not come here

    distance = np.asarray(cKDTree(points).query(points, k=9)[0])[:, 8]
    kept: NDArray[np.bool_] = distance <= 5 * max(float(np.median(distance)), 1e-6)
    return kept
