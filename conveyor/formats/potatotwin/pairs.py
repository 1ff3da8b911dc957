"""A depth image and the RGBA image whose alpha is the tuber's mask."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.formats.png16 import Refusal, is_whole_png, read_png16
from conveyor.formats.potatotwin.layout import pair_of
from conveyor.geometry import Intrinsics, at_border, box_around

MAX_DEPTH_M = 0.5
"""Beyond it the reference takes nothing for a tuber."""
UNDER_BELT_M = 0.05
"""Over a belt that hangs lower than the reference's, what lies so far under it may still be a tuber's depth."""
INSIDE = 255
"""Only full alpha is the tuber. The reference divides the mask by 255 in whole numbers before it deprojects, so what an
edge blends (alpha 1 to 254) is outside; half of such a pixel's depth is belt, and it would pull the rim down."""


class NoDepthError(InputError):
    """A pair that shows nothing of its tuber, though both images can be read."""


@dataclass(frozen=True, slots=True)
class Pair:
    """`depth` (H, W) uint16, units of the intrinsics file; `mask` (H, W) bool; `bgr` (H, W, 3) uint8."""

    depth: NDArray[np.uint16]
    mask: NDArray[np.bool_]
    bgr: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class MaskedDepth:
    """A tuber's depth crop. `depth` (h, w) uint16 is zero outside the mask; `intrinsics` are of the crop. `cut`: the
    mask touches the image's border.
    """

    depth: NDArray[np.uint16]
    intrinsics: Intrinsics
    cut: bool


def farthest_m(belt_distance_m: float) -> float:
    """Beyond it no depth is a tuber's: the reference's limit, or a little under a belt that is farther away."""
    return max(MAX_DEPTH_M, belt_distance_m + UNDER_BELT_M)


def read_images(depth_path: Path, rgb_path: Path, intrinsics: Intrinsics) -> Pair | Refusal:
    """Both images of a pair, or why not; the text names the file."""
    depth = read_png16(depth_path)
    if isinstance(depth, Refusal):
        return Refusal(depth.reason, f"{depth_path} {depth.text}")
    rgba = _read_rgba(rgb_path)
    if rgba is None:
        return Refusal("no_mask", f"{rgb_path} is no whole RGBA image of 8 bits whose alpha is the tuber's mask")
    size = (intrinsics.height, intrinsics.width)
    if depth.shape != size or rgba.shape[:2] != size:
        return Refusal(
            "wrong_size",
            f"{depth_path} is {depth.shape}, {rgb_path.name} is {rgba.shape[:2]}, the intrinsics are for {size} "
            "(rows, columns)",
        )
    return Pair(depth, rgba[..., 3] == INSIDE, rgba[..., :3])


def read_pair(path: Path, *, intrinsics: Intrinsics, depth_scale_m: float, max_depth_m: float) -> MaskedDepth:
    """The masked depth of a pair, cropped to its mask. As in the reference: alpha exactly 255, 0 < z < `max_depth_m`.

    Raises:
        InputError: unreadable, wrong type, other size.
        NoDepthError: no pixel of the mask has a depth.
    """
    depth_path, rgb_path = pair_of(path)
    pair = read_images(depth_path, rgb_path, intrinsics)
    if isinstance(pair, Refusal):
        raise InputError(pair.text)
    depth = pair.depth
    inside = pair.mask & (depth > 0) & (depth.astype(np.float64) * depth_scale_m < max_depth_m)
    if not inside.any():
        raise NoDepthError(_no_depth_said(pair, depth_path, rgb_path, depth_scale_m=depth_scale_m, most_m=max_depth_m))
    box = box_around(inside)
    rows, columns = box
    crop = np.where(inside, depth, 0)[box].astype(np.uint16)
    shifted = Intrinsics(
        width=crop.shape[1],
        height=crop.shape[0],
        fx=intrinsics.fx,
        fy=intrinsics.fy,
        cx=intrinsics.cx - columns.start,
        cy=intrinsics.cy - rows.start,
    )
    return MaskedDepth(crop, shifted, at_border(box_around(pair.mask), intrinsics))


def _no_depth_said(pair: Pair, depth_path: Path, rgb_path: Path, *, depth_scale_m: float, most_m: float) -> str:
    """What is missing: the mask, its depth, or a depth scale that puts it over the belt."""
    if not pair.mask.any():
        return f"{rgb_path} marks no tuber: no pixel has alpha {INSIDE}"
    depth = pair.depth[pair.mask & (pair.depth > 0)]
    if not len(depth):
        return f"{depth_path} has no depth where the alpha of {rgb_path.name} is {INSIDE}"
    return (
        f"{depth_path}: the tuber lies {float(np.median(depth)) * depth_scale_m:.4g} m away at a depth scale of "
        f"{depth_scale_m:g} m a unit, and depths count to {most_m:g} m: check the depth scale (--depth-scale-m: "
        "0.001 for 1 mm units, 0.0001 for the D405's own; depth_scale of an intrinsics file is units per metre) and "
        "the belt distance"
    )


def _read_rgba(path: Path) -> NDArray[np.uint8] | None:
    """(H, W, 4) uint8; None: missing, cut short, or without alpha."""
    try:
        data = np.fromfile(path, np.uint8)
    except OSError:
        return None
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if is_whole_png(data) else None
    if image is None or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 4:
        return None
    return np.asarray(image, np.uint8)
