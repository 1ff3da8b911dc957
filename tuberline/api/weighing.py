"""Weigh one cloud or one depth image, load weights, prepare what the network takes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from conveyor.camera_flags import CUT
from conveyor.errors import InputError
from conveyor.formats.cloud_shape import masked_fault
from conveyor.formats.clouds import read_cloud
from conveyor.geometry import Intrinsics, at_border, box_around, straight_down_belt_from_camera
from conveyor.geometry import belt_distance_m as distance_of
from conveyor.pose import pose_fault
from conveyor.stated import BELT_DISTANCE_M, BELT_SD_MM, RESTING_OFFSET_MM, RESTING_SD_MM
from regressor.network import stored
from regressor.network.fast import groups_tensor
from regressor.network.grouping import SharedGroups, group_prefix, group_random
from regressor.network.sampling import farthest_points
from regressor.network.sidecar import Sidecar
from regressor.weigh.place import distance_fault
from regressor.weigh.prepare import PreparedCloud, RefusedCloud, prepare_cloud, prepare_depth
from regressor.weigh.weigher import Weigher
from tuberline.api.values import by_parameters, holds, in_range

if TYPE_CHECKING:
    from regressor.network.pointraft import PointRaft

DEPTH_SCALE_M = (1e-6, 0.01)


@dataclass(frozen=True, slots=True)
class Weight:
    """The weight of one tuber seen once.

    Attributes:
        weight_g: grams, as a line would book this view.
        low_g, high_g: the two ends of the 90 % interval of this view, grams.
        network_g: what PointRAFT alone says, grams; None where it was not asked or failed.
        volume_g: what the visible volume alone says, grams.
        method: 'pointraft' (the network with the volume rule), or 'volume'.
        model: name and digest of the weights, e.g. 'tuberline-sim@be603e39'.
        flags: what is unusual: 'few_points', 'extent', 'height_clamped', 'belt_distance', 'size', 'weight',
            'volume_disagrees', 'camera_unlike', 'rows_missing', 'in_parts', 'network_failed', 'cut' (at the image's
            border: a part of it may lie outside).
    """

    weight_g: float
    low_g: float
    high_g: float
    network_g: float | None
    volume_g: float
    method: Literal["pointraft", "volume"]
    model: str
    flags: tuple[str, ...]


@dataclass(frozen=True)
class Weights:
    """Trained weights, loaded. Several threads may weigh with them at once.

    Attributes:
        network: the readable network with these weights, in evaluation mode; asking for it imports torch.
        sidecar: what is known about them: ranges, interval, how they were trained.
    """

    sidecar: Sidecar = field(repr=False)
    weigher: Weigher = field(repr=False)

    @property
    def model(self) -> str:
        """Name and the first eight digits of the digest, as it stands in ledgers."""
        return self.sidecar.model_id

    @cached_property
    def network(self) -> PointRaft:
        """The readable network with these weights, in evaluation mode."""
        from regressor.network.checkpoint import model_of

        assert self.weigher.state is not None
        return model_of(self.weigher.state)


@dataclass(frozen=True, slots=True)
class NetworkInputs:
    """One tuber as PointRAFT takes it.

    Attributes:
        points: (n, 3) float32, n <= 1024, metres, level frame (z away from the camera along the belt's normal),
            centred on the mean of the cleaned cloud, in the order of farthest-point sampling from its first point.
        height_m: of the highest point above the belt, metres, clamped to what the weights were trained with.
        groups: (256, 3) float32, what a network of `tuberline export-onnx` takes as `groups`: 64 neighbours, 64
            first-stage and 128 second-stage centroids. None for a cloud so wide (0.2 m) that its points do not all
            share their neighbours; such a cloud is not for the exported network.
        features: (35,) float64, what the visible surface measures: volume, outline, how it lies.
        standing_m: height_m before it is clamped.
        noise_px: local noise of the depth, pixels of disparity at a baseline of 18 mm; 0 where it is not known, as of
            a cloud whose points are no pixels of a camera.
        belt_distance_m: from the camera to the belt.
    """

    points: NDArray[np.float32]
    height_m: float
    groups: NDArray[np.float32] | None
    features: NDArray[np.float64]
    standing_m: float
    noise_px: float = 0.0
    belt_distance_m: float = 0.0

    def feed(self, *, belt_sd_mm: float = 2.0, resting_sd_mm: float = 0.0) -> dict[str, NDArray[np.floating]]:
        """The inputs of a network of `tuberline export-onnx`, by name, for a batch of one; concatenate them for more.

        Args:
            belt_sd_mm, resting_sd_mm: as for `weigh`.

        Raises:
            TuberlineError: a cloud too wide for the exported network.
        """
        if self.groups is None:
            raise InputError("the cloud is 0.2 m wide or wider: the exported network does not take it, `weigh` does")
        in_range("belt_sd_mm", belt_sd_mm, BELT_SD_MM)
        in_range("resting_sd_mm", resting_sd_mm, RESTING_SD_MM)
        return {
            "groups": self.groups[None],
            "height_m": np.array([self.standing_m], np.float32),
            "features": self.features[None],
            "belt_sd_m": np.array([np.hypot(belt_sd_mm, resting_sd_mm) / 1000]),
            "noise_px": np.array([self.noise_px]),
            "belt_distance_m": np.array([self.belt_distance_m]),
        }


def load_weights(path: str | Path | None = None) -> Weights:
    """Load PointRAFT weights; the shipped ones where no path is given.

    Args:
        path: a .safetensors file with its .json beside it, or the authors' .pth.

    Raises:
        TuberlineError: missing, unreadable, damaged, or weights of another network or of another target.
    """
    if path is not None and not isinstance(path, str | Path):
        raise InputError(f"path is {_told(path)}; give that of a file of weights, or None for the shipped ones")
    state, sidecar = stored.load_weights(Path(path) if path is not None else None)
    return Weights(sidecar, Weigher(state, sidecar))


@lru_cache(maxsize=1)
def _shipped() -> Weights:
    return load_weights()


@by_parameters
def weigh(
    cloud: NDArray[np.floating] | str | Path,
    *,
    belt_distance_m: float,
    belt_sd_mm: float = 2.0,
    resting_offset_mm: float = 0.0,
    resting_sd_mm: float = 0.0,
    weights: Weights | None = None,
) -> Weight:
    """Weigh one tuber from the point cloud of its visible side.

    Args:
        cloud: (N, 3) in metres, at least 30 points of one tuber and nothing else, in the frame of a camera that looks
            straight down on the belt (x right, y down in the image, z away from the camera); or a file of it
            (.ply, .npy, .npz, .xyz, .pcd, .las).
        belt_distance_m: from the camera to the belt along the optical axis, metres: 0.05 to 5.
        belt_sd_mm: how well that distance is known, standard deviation in millimetres: 0 to 100. The worse, the wider
            the interval, and the less the height above the belt counts: up to 2.5 mm that moves the weight, too, most
            by less than 5 %.
        resting_offset_mm: how far the tuber's underside lies below that belt, millimetres: -20 to 40.
        resting_sd_mm: how well that is known, standard deviation in millimetres: 0 to 20, as `belt_sd_mm`.
        weights: from `load_weights`; None takes the shipped ones, which are loaded once.

    Returns:
        Grams with the 90 % interval and flags. The same cloud gives the same bits.

    Raises:
        TuberlineError: a file that holds no cloud, a cloud that cannot be weighed (empty, too few points, not finite,
            not (N, 3)), that floats above the belt or lies below it, or a distance out of range.
    """
    in_range("resting_offset_mm", resting_offset_mm, RESTING_OFFSET_MM)
    in_range("resting_sd_mm", resting_sd_mm, RESTING_SD_MM)
    prepared = _prepared(cloud, belt_distance_m, resting_offset_mm)
    return _weighed(prepared, belt_sd_mm, weights, resting_sd_mm)


@by_parameters
def weigh_depth(
    depth: NDArray[np.uint16],
    *,
    intrinsics: Intrinsics,
    depth_scale_m: float,
    belt_distance_m: float | None = None,
    belt_from_camera: NDArray[np.float64] | None = None,
    mask: NDArray[np.bool_] | None = None,
    u0: int = 0,
    v0: int = 0,
    belt_sd_mm: float = 2.0,
    weights: Weights | None = None,
) -> Weight:
    """Weigh one tuber from a depth image, or from a crop of one: what a line does with a view.

    Args:
        depth: (h, w) uint16 in units of `depth_scale_m` metres, 0 = no depth.
        intrinsics: of the full image, pixels.
        depth_scale_m: metres per unit, 1e-6 to 0.01: 0.001 where a unit is a millimetre, 0.0001 for the D405's own.
        belt_distance_m: from the camera to the belt along the optical axis, metres, of a camera that looks straight
            down; or else give `belt_from_camera`.
        belt_from_camera: (4, 4) rigid transform from the camera's frame to the belt's, of a tilted camera.
        mask: (h, w) bool, or whole numbers that are not 0 on the tuber's pixels; None takes all that have depth.
        u0, v0: column and row of the crop's first pixel in the full image, which holds the whole crop.
        belt_sd_mm, weights: as for `weigh`.

    Returns:
        As for `weigh`.

    Raises:
        TuberlineError: a depth image that cannot be weighed, neither or both of the belt's two forms, a transform that
            is not rigid or does not look down on the belt, or a value out of range.
    """
    _check_image(depth, mask, intrinsics, u0, v0)
    if (belt_distance_m is None) == (belt_from_camera is None):
        raise InputError("give belt_distance_m (a camera that looks straight down) or belt_from_camera, one of them")
    if not holds(depth_scale_m, DEPTH_SCALE_M):
        raise InputError(f"depth_scale_m is {depth_scale_m}; allowed is 0.000001 to 0.01 metres per unit")
    if belt_distance_m is not None:
        belt_from_camera = straight_down_belt_from_camera(in_range("belt_distance_m", belt_distance_m, BELT_DISTANCE_M))
    pose = _checked_pose(belt_from_camera)
    seen = depth if mask is None else np.where(mask, depth, 0).astype(np.uint16)
    box = box_around(seen > 0)
    rows, columns = box
    try:
        prepared = prepare_depth(
            seen[box],
            depth_scale_m=depth_scale_m,
            fx=intrinsics.fx,
            fy=intrinsics.fy,
            cx=intrinsics.cx - (u0 + columns.start),
            cy=intrinsics.cy - (v0 + rows.start),
            belt_from_camera=pose,
        )
    except RefusedCloud as error:
        if mask is None and error.reason == "below_belt":
            raise InputError(f"{error}; where the image shows belt, give the mask of the tuber's pixels") from error
        raise
    weight = _weighed(prepared, belt_sd_mm, weights)
    if at_border(box, intrinsics, u0=u0, v0=v0):
        weight = replace(weight, flags=(*weight.flags, CUT))
    return weight


@by_parameters
def prepare(
    cloud: NDArray[np.floating] | str | Path,
    belt_distance_m: float,
    *,
    resting_offset_mm: float = 0.0,
    weights: Weights | None = None,
) -> NetworkInputs:
    """Make of one cloud what PointRAFT takes: cleaned, level, centred, sampled.

    Args:
        cloud, belt_distance_m, resting_offset_mm: as for `weigh`.
        weights: for which; they say how sampling starts and where the height is clamped. None: the shipped ones.

    Raises:
        TuberlineError: as for `weigh`.
    """
    in_range("resting_offset_mm", resting_offset_mm, RESTING_OFFSET_MM)
    prepared = _prepared(cloud, belt_distance_m, resting_offset_mm)
    _check_place(prepared)
    sidecar = _loaded(weights).sidecar
    count = min(len(prepared.points), sidecar.input.points)
    if sidecar.start.kind == "prefix":
        groups = group_prefix(prepared.points, points=sidecar.input.points)
    else:
        groups = group_random(prepared.points, seed=sidecar.start.seed, points=sidecar.input.points)
    return NetworkInputs(
        points=prepared.points[farthest_points(prepared.points, count)],
        height_m=prepared.clamped_height_m(sidecar.input.max_height_m),
        groups=groups_tensor(groups) if isinstance(groups, SharedGroups) else None,
        features=prepared.surface.as_array(),
        standing_m=prepared.height_m,
        belt_distance_m=prepared.belt_distance_m,
        noise_px=prepared.noise_px or 0.0,
    )


def _prepared(
    cloud: NDArray[np.floating] | str | Path, belt_distance_m: float, resting_offset_mm: float = 0.0
) -> PreparedCloud:
    in_range("belt_distance_m", belt_distance_m, BELT_DISTANCE_M)
    points = read_cloud(Path(cloud)) if isinstance(cloud, str | Path) else cloud
    return prepare_cloud(points, belt_distance_m=belt_distance_m, resting_offset_m=resting_offset_mm / 1000)


def _check_image(depth: Any, mask: Any, intrinsics: Any, u0: int, v0: int) -> None:
    """Refuse what is no depth image, a mask of another one, and a crop that does not lie in the full image.

    Raises:
        InputError: with what was given and what is expected.
    """
    if not isinstance(depth, np.ndarray) or depth.ndim != 2 or depth.dtype != np.uint16:
        raise InputError(f"depth is {_told(depth)}; expected uint16 of shape (h, w){_image_of(depth)}")
    if mask is not None and (not isinstance(mask, np.ndarray) or mask.dtype.kind not in "bui"):
        made = "; take mask > 0" if isinstance(mask, np.ndarray) and mask.shape == depth.shape else ""
        raise InputError(f"mask is {_told(mask)}; expected bool of shape {depth.shape}{made}")
    if mask is not None and mask.shape != depth.shape:
        raise InputError(f"mask is {mask.shape}, the depth image {depth.shape}: they must have the same shape")
    if not isinstance(intrinsics, Intrinsics):
        raise InputError(
            f"intrinsics are {_told(intrinsics)}; expected tuberline.Intrinsics(width=..., height=..., ...)"
        )
    for name, array, none in (("depth", depth, 0), ("mask", mask, False)):
        if fault := masked_fault(array, f"{name}.filled({none})"):
            raise InputError(f"{name} is {fault}")
    (rows, columns), k = depth.shape, intrinsics
    if not (holds(u0, (0, k.width - columns), whole=True) and holds(v0, (0, k.height - rows), whole=True)):
        raise InputError(
            f"depth of {columns}x{rows} pixels from column u0={u0}, row v0={v0} does not lie in the image of "
            f"{k.width}x{k.height} that the intrinsics are of"
        )


def _checked_pose(belt_from_camera: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """(4, 4) float64 of a camera that looks down on a belt.

    Raises:
        InputError: no rigid transform, one that looks elsewhere, or from a distance out of range.
    """
    fault = pose_fault(belt_from_camera)  # type: ignore[arg-type]
    if fault:
        raise InputError(fault)
    pose = np.asarray(belt_from_camera, np.float64)
    in_range("belt_from_camera's distance to the belt along the optical axis", distance_of(pose), BELT_DISTANCE_M)
    return pose


def _loaded(weights: Weights | None) -> Weights:
    if weights is not None and not isinstance(weights, Weights):
        raise InputError(f"weights are {_told(weights)}; give what load_weights({weights!r}) returns, or None")
    return weights or _shipped()


def _told(value: object) -> str:
    """What was given in place of something else, in a word or two."""
    return f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__


def _image_of(depth: Any) -> str:
    """How to make a depth image of what is none: for people; empty where it cannot be told."""
    if not isinstance(depth, np.ndarray):
        return ""
    if depth.ndim == 3 and 1 in depth.shape[::2]:
        return f"; take depth[{'0' if depth.shape[0] == 1 else '..., 0'}]"
    if depth.ndim == 3 and depth.shape[2] == 3:
        return "; points are for weigh: the tuber's own, (N, 3)"
    if depth.ndim == 2 and depth.dtype.kind == "f":
        return "; of depth in metres take np.round(depth_m / depth_scale_m).astype(np.uint16), 0 where there is none"
    if depth.ndim == 2 and depth.dtype.kind in "iu" and depth.dtype.itemsize > 1:
        return "; take depth.astype(np.uint16) where no depth is beyond 65535 units"
    return ""


def _check_place(prepared: PreparedCloud) -> None:
    """Refuse a cloud that floats above its belt or hardly rises above it."""
    if fault := distance_fault(prepared):
        raise InputError(f"the cloud: {fault}")


def _weighed(prepared: PreparedCloud, belt_sd_mm: float, weights: Weights | None, resting_sd_mm: float = 0.0) -> Weight:
    in_range("belt_sd_mm", belt_sd_mm, BELT_SD_MM)
    _check_place(prepared)
    found = _loaded(weights).weigher.weigh(prepared, belt_sd_m=belt_sd_mm / 1000, resting_sd_m=resting_sd_mm / 1000)
    return Weight(
        weight_g=found.weight_g,
        low_g=found.low_g,
        high_g=found.high_g,
        network_g=found.network_g,
        volume_g=found.volume_g,
        method=found.method,
        model=found.model,
        flags=found.flags,
    )
