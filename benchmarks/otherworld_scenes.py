"""Recordings of the other world: bodies laid on a belt, a camera above it, and the folder with its truth."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.matched_camera import Matcher
from benchmarks.otherworld_camera import Camera, Sensor
from benchmarks.otherworld_shapes import Body, clod, stone, tuber

DIRECTIONS = np.stack([np.cos(t := np.linspace(0, 2 * np.pi, 48, endpoint=False)), np.sin(t)], 1)


@dataclass(frozen=True, slots=True)
class Scene:
    """One recording."""

    name: str
    seed: int
    cameras: tuple[Camera, ...]
    sensor: Sensor | Matcher
    layout: str = "touching"  # singulated, touching, crowded
    families: tuple[str, ...] = ("smooth",)
    tubers: int = 50
    foreign: int = 0
    lane_m: float = 0.4
    speed_mps: float = 0.3
    fps: int = 15
    travel: bool = True
    origin_m: float = 0.0  # what the encoder says at the beginning
    bare: bool = True  # bare belt before and after; else tubers are in view from the first to the last frame
    colour: bool = False
    swing: float = 0.0  # share by which the speed swings
    lost_frames: tuple[int, ...] = ()


@dataclass(slots=True)
class Lying:
    """A body at its place on the belt: x (m) where the belt's travel is 0, and y."""

    body: Body
    x_m: float
    y_m: float
    seen_by: list[str] = field(default_factory=list)


def support(body: Body) -> np.ndarray:
    """How far the body's outline reaches in each of DIRECTIONS, m."""
    return np.asarray((body.vertices_m[:, :2] @ DIRECTIONS.T).max(0))


def lay(scene: Scene, rng: np.random.Generator) -> list[Lying]:
    """Lay the bodies on the belt one behind the other, from x = 0 upstream, so that no two outlines overlap."""
    bodies = [tuber(rng, scene.families[int(rng.integers(len(scene.families)))]) for _ in range(scene.tubers)]
    bodies += [(clod if rng.random() < 0.5 else stone)(rng) for _ in range(scene.foreign)]
    bodies = [bodies[i] for i in rng.permutation(len(bodies))]
    tries = {"singulated": 1, "touching": 2, "crowded": 8}[scene.layout]
    lying: list[Lying] = []
    reach: list[np.ndarray] = []
    for body in bodies:
        outline = support(body)
        half = len(DIRECTIONS) // 2
        gap = rng.uniform(0.025, 0.08) if scene.layout == "singulated" else rng.uniform(0.0, 0.004)
        if scene.layout == "touching" and rng.random() < 0.15:
            gap += 0.03
        best = (-1e9, 0.0)
        for _ in range(tries):
            free = scene.lane_m / 2 - outline[[len(DIRECTIONS) // 4, 3 * len(DIRECTIONS) // 4]]
            y = rng.uniform(-free[1], free[0])
            x = -float(outline[0])
            if scene.layout == "singulated" and lying:
                x = lying[-1].x_m - float(reach[-1][half]) - gap - float(outline[0])
            x = _clear(x, y, outline, lying, reach, gap)
            best = max(best, (x, y))
        lying.append(Lying(body, *best))
        reach.append(outline)
    return lying


def _clear(x: float, y: float, outline: np.ndarray, lying: list[Lying], reach: list[np.ndarray], gap: float) -> float:
    """The first x upstream at which some direction parts the convex outline from each other one by `gap`."""
    if not lying:
        return x
    need = np.array(reach) + np.roll(outline, len(DIRECTIONS) // 2) + gap
    places = np.array([(one.x_m, one.y_m) for one in lying])
    while not (need <= ([x, y] - places) @ DIRECTIONS.T).any(1).all():
        x -= 0.002
    return x


def times(scene: Scene, lying: list[Lying]) -> tuple[float, np.ndarray]:
    """Travel at the first frame, and the frames' times in seconds."""
    ahead, behind = zip(*(_view_m(camera) for camera in scene.cameras), strict=True)
    front = max(one.x_m + 0.09 for one in lying)
    back = min(one.x_m - 0.09 for one in lying)
    if scene.bare:
        first, last = min(behind) - front - 0.05, max(ahead) - back + 0.05
    else:
        first, last = max(ahead) - front + 0.1, min(behind) - back - 0.1
    return first, np.arange(int((last - first) / scene.speed_mps * scene.fps) + 1) / scene.fps


def _view_m(camera: Camera) -> tuple[float, float]:
    """Belt x at the image's last and first row."""
    depth, pose = camera.belt_depth_m(), camera.belt_from_camera
    cx, cy = camera.centre_px
    ends = []
    for row in (-1, 0):
        v = (camera.height - 1 if row else 0) - cy
        u = np.arange(camera.width) - cx
        rays = np.stack([u, np.full(len(u), v), np.full(len(u), camera.focal_px)], 1) / camera.focal_px
        ends.append((rays * depth[row][:, None]) @ pose[0, :3] + pose[0, 3])
    return float(ends[0].max()), float(ends[1].min())


def travelled(scene: Scene, first_m: float, t: float) -> float:
    swing = scene.swing * scene.speed_mps * (1 - np.cos(2 * np.pi * t / 3.0)) * 3.0 / (2 * np.pi)
    return float(first_m + scene.speed_mps * t + swing)


def write(scene: Scene, folder: Path) -> dict[str, Any]:
    """Write the recording with its truth, and return the truth."""
    rng = np.random.default_rng(scene.seed)
    lying = lay(scene, rng)
    first_m, clock = times(scene, lying)
    for camera in scene.cameras:
        _write_camera(
            scene, camera, folder / camera.name, lying, first_m, clock, np.random.default_rng([scene.seed, 7])
        )
    if len(scene.cameras) > 1:
        line = {"cameras": [camera.name for camera in scene.cameras], "belt_speed_mps": None}
        (folder / "line.json").write_text(json.dumps(line))
    shift = first_m if not scene.travel else first_m - scene.origin_m
    truth = _truth(lying, shift)
    (folder / "truth.json").write_text(json.dumps(truth, indent=1))
    return truth


def _truth(lying: list[Lying], shift_m: float) -> dict[str, Any]:
    tubers, foreign = [], []
    for number, one in enumerate(lying):
        place = {"place_x_m": one.x_m + shift_m, "place_y_m": one.y_m, "weight_g": one.body.weight_g}
        if one.body.kind in ("clod", "stone"):
            foreign.append({"kind": one.body.kind, **place})
        elif one.seen_by:
            length, width, height = one.body.lwd_mm
            size = {"length_mm": length, "width_mm": width, "height_mm": height, "volume_ml": one.body.volume_ml}
            tubers.append({"id": number, **place, **size, "cameras": one.seen_by, "family": one.body.kind})
    return {"tubers": tubers, "foreign": foreign, "distractors": len(foreign)}


def _write_camera(
    scene: Scene,
    camera: Camera,
    folder: Path,
    lying: list[Lying],
    first_m: float,
    clock: np.ndarray,
    rng: np.random.Generator,
) -> None:
    (folder / "depth").mkdir(parents=True)
    if scene.colour:
        (folder / "color").mkdir()
    view = scene.sensor.view(camera, rng)
    ahead, behind = _view_m(camera)
    rows = []
    before: dict[int, float] = {}
    for seq, late in enumerate(clock + camera.late_s):
        now_m = travelled(scene, first_m, late)
        near = [one for one in lying if behind - 0.15 < one.x_m + now_m < ahead + 0.15]
        for one in near:
            _cross(camera, one, now_m, before)
        if seq in scene.lost_frames:
            continue
        moved = [(one.body.vertices_m + np.array([one.x_m + now_m, one.y_m, 0]), one.body.triangles) for one in near]
        depth_m, label = view.exact(moved)
        measured = view.measured(depth_m, label, moved, now_m)
        cv2.imwrite(str(folder / f"depth/{seq:06d}.png"), measured, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        if scene.colour:
            cv2.imwrite(str(folder / f"color/{seq:06d}.jpg"), _paint(depth_m, label, rng))
        travel = f"{now_m - first_m + scene.origin_m:.5f}" if scene.travel else ""
        rows.append([seq, 1_700_000_000_000_000_000 + round(late * 1e9), travel])
    with (folder / "frames.csv").open("w", newline="") as out:
        csv.writer(out).writerows([["seq", "captured_ns", "travel_m"], *rows])
    _write_info(scene, camera, folder)


def _write_info(scene: Scene, camera: Camera, folder: Path) -> None:
    cx, cy = camera.centre_px
    info = {
        "name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "fx": camera.focal_px,
        "fy": camera.focal_px,
        "cx": cx,
        "cy": cy,
        "depth_scale_m": scene.sensor.unit_m,
        "belt_distance_m": camera.belt_distance_m,
        "belt_from_camera": None if camera.straight else camera.belt_from_camera.tolist(),
        "fps": scene.fps,
    }
    (folder / "camera.json").write_text(json.dumps(info))


def _cross(camera: Camera, one: Lying, now_m: float, before: dict[int, float]) -> None:
    """Note the camera with a body whose centre passes its image's centre row at this frame."""
    cx, cy = camera.centre_px
    centre = np.array([[one.x_m + now_m, one.y_m, one.body.centre_z_m]])
    x, y, z = camera.in_camera(centre)[0]
    row, column = y / z * camera.focal_px + cy, x / z * camera.focal_px + cx
    earlier = before.get(id(one))
    if earlier is not None and earlier < cy <= row and 0 <= column < camera.width:
        one.seen_by.append(camera.name)
    before[id(one)] = float(row)


def _paint(depth_m: np.ndarray, label: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A picture in colour: grey belt, brown bodies, darker where they are steep. BGR uint8 (H, W, 3)."""
    steep = np.clip(np.abs(np.gradient(depth_m, axis=0)) * 300, 0, 0.6)
    base = np.where((label > 0)[..., None], [90.0, 140.0, 185.0], [60.0, 60.0, 58.0])
    return np.asarray(np.clip(base * (1 - steep)[..., None] + rng.normal(size=base.shape) * 6, 0, 255), np.uint8)
