"""A second, independent simulator: folder recordings as FORMATS describes them, made with nothing of `camera_sim`.

Tubers are bumpy superellipsoids that rest on the plane z = 0 of the belt; every pixel's ray is met with them by
bisection. Whatever the product's own simulator takes for granted (poses, clocks, file habits) is an option here.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SHAPE_EXPONENT = 2.23
DENSITY_G_ML = 1.07
LN_AXES_MM = {
    "sayaka": ((4.3176, 4.1307, 3.9462), ((467.3, 304.6, 245.2), (304.6, 260.6, 205.2), (245.2, 205.2, 208.9))),
    "corolle": ((4.4241, 3.8851, 3.7497), ((374.5, 260.3, 223.8), (260.3, 239.0, 208.6), (223.8, 208.6, 223.0))),
    "mayqueen": ((4.4928, 3.8703, 3.7272), ((875.9, 491.4, 475.9), (491.4, 347.1, 328.8), (475.9, 328.8, 374.2))),
}
"""Mean and covariance (1e-4) of the logarithms of length, width and thickness in mm (published, 280/30/50 tubers)."""


@dataclass(frozen=True)
class Tuber:
    """One tuber at rest. `place_m`: belt x - travel, y of its centre; `lift_m`: height of its centre; metres."""

    half_m: Array
    turn: Array
    bumps: Array
    amplitudes: Array
    place_m: tuple[float, float]
    lift_m: float
    height_m: float
    weight_g: float

    @property
    def radius_m(self) -> float:
        return float(self.half_m.max() * (1 + self.amplitudes.sum()))


@dataclass(frozen=True)
class View:
    """One camera of a scene; `told_pose`/`told_distance` say what camera.json gives away of `belt_from_camera`."""

    name: str = "cam"
    size: tuple[int, int] = (640, 480)
    focal: float = 480.0
    principal: tuple[float, float] | None = None
    belt_from_camera: Array = field(default_factory=lambda: straight_down(0.46))
    told_pose: bool = False
    told_distance: bool = True
    unit_m: float = 0.001
    fps: float = 30.0
    start_s: float = 0.0
    clock_ns: int = 1_700_000_000_000_000_000
    first_seq: int = 0

    @property
    def centre(self) -> tuple[float, float]:
        return self.principal or ((self.size[0] - 1) / 2, (self.size[1] - 1) / 2)


@dataclass(frozen=True)
class Habits:
    """How the files are written, and what the world does to the depth."""

    travel: bool = True
    noise_mm: float = 0.0
    holes: float = 0.0
    quantum_mm: float = 0.0
    blind_columns: int = 0
    drop: float = 0.0
    masks: bool = False
    colour: str = ""
    newline: str = "\n"
    spaces: bool = False
    extra_keys: bool = False
    rods_mm: float = 0.0
    belt_half_m: float | None = None
    floor_m: float = 0.2


def straight_down(distance_m: float) -> Array:
    """belt_from_camera of FORMATS' default: x along +v, y along +u, origin under the optical centre."""
    return np.array([[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, distance_m], [0, 0, 0, 1]], float)


def posed(
    distance_m: float, *, turn_deg: float = 0.0, tilt_deg: float = 0.0, roll_deg: float = 0.0,
    at_m: tuple[float, float] = (0.0, 0.0),
) -> Array:  # fmt: skip
    """A camera turned about the vertical, tilted along and rolled across the travel; `at_m`: belt x, y under it."""
    base = straight_down(distance_m)
    z, x, y = (np.radians(value) for value in (turn_deg, roll_deg, tilt_deg))
    about_z = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    pose = np.eye(4)
    pose[:3, :3] = about_z @ about_y @ about_x @ base[:3, :3]
    pose[:3, 3] = (*at_m, distance_m)
    return pose


def grow(rng: np.random.Generator, cultivar: str = "sayaka", *, bumpy: float = 0.03) -> Tuber:
    """A tuber from the published statistics, lying on its broad side at place (0, 0)."""
    mean, covariance = LN_AXES_MM[cultivar]
    axes = np.sort(np.exp(rng.multivariate_normal(mean, np.array(covariance) * 1e-4)))[::-1]
    half_m = axes / 2000.0
    bumps = rng.normal(size=(5, 3))
    bumps /= np.linalg.norm(bumps, axis=1, keepdims=True)
    amplitudes = rng.uniform(-0.3, 1.0, 5) * bumpy
    yaw, tilt = rng.uniform(0, np.pi), rng.normal(0, np.radians(6))
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]) @ np.array(
        [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]]
    )
    sphere = _sphere(6000)
    reach = 1 / _norm(sphere) * (1 + _bump(sphere, bumps, amplitudes))
    surface = (sphere * reach[:, None] * half_m) @ turn.T
    volume_ml = float(np.prod(half_m) * (reach**3).mean() * 4 / 3 * np.pi * 1e6)
    low, high = surface[:, 2].min(), surface[:, 2].max()
    return Tuber(half_m, turn, bumps, amplitudes, (0.0, 0.0), -low, high - low, volume_ml * DENSITY_G_ML)


def strew(
    rng: np.random.Generator, count: int, *, length_m: float, half_width_m: float, start_m: float, gap_m: float = 0.01,
    cultivar: str = "sayaka", bumpy: float = 0.03,
) -> list[Tuber]:  # fmt: skip
    """Up to `count` tubers over places `start_m` down to `start_m - length_m`, footprints at least `gap_m` apart."""
    laid: list[Tuber] = []
    outlines: list[Array] = []
    for _ in range(count * 40):
        if len(laid) == count:
            break
        tuber = grow(rng, cultivar, bumpy=bumpy)
        place = (start_m - rng.uniform(0, length_m), rng.uniform(-half_width_m, half_width_m))
        outline = _footprint(tuber) + place
        if all(_clearance(outline, other) > gap_m for other in outlines):
            laid.append(_at(tuber, place))
            outlines.append(outline)
    return laid


def rows(
    rng: np.random.Generator, count: int, *, per_row: int, start_m: float, half_width_m: float, cultivar: str = "sayaka"
) -> list[Tuber]:
    """Tubers pushed together: each row across the belt touches, and each row touches the one before it."""
    laid: list[Tuber] = []
    outlines: list[Array] = []
    while len(laid) < count:
        tuber = grow(rng, cultivar)
        y = -half_width_m + 2 * half_width_m * ((len(laid) % per_row) + 0.5) / per_row + rng.normal(0, 0.004)
        shape, recent = _footprint(tuber), outlines[-3 * per_row :]
        behind = np.arange(min((o[:, 0].min() for o in recent), default=start_m) - 0.1, start_m + 0.002, 0.002)
        moved = ((at, shape + np.array((at, y))) for at in behind)
        blocked = (at for at, outline in moved if any(_clearance(outline, other) < 0.0008 for other in recent))
        x = next(blocked, start_m) - 0.002
        place = (float(x), float(y))
        laid.append(_at(tuber, place))
        outlines.append(shape + place)
    return laid


def write(
    folder: Path, tubers: list[Tuber], views: list[View], *, travel_at: Callable[[float], float], seconds: float,
    habits: Habits | None = None, seed: int = 1, speed_mps: float | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Write the recording and return its truth. `travel_at`: metres of travel at a time in seconds."""
    habits = habits or Habits()
    rng = np.random.default_rng(seed)
    seen_by: dict[int, list[str]] = {}
    for view in views:
        times = view.start_s + np.arange(int(seconds * view.fps)) / view.fps
        _write_camera(folder / view.name, tubers, view, times, travel_at, habits, rng)
        for index in crossing_tubers(tubers, view, [travel_at(t) for t in times]):
            seen_by.setdefault(index, []).append(view.name)
    if len(views) > 1:
        line = {"cameras": [view.name for view in views], "belt_speed_mps": speed_mps}
        (folder / "line.json").write_text(json.dumps(line))
    truth = {"tubers": [_told(i, tubers[i], names) for i, names in sorted(seen_by.items())], "distractors": 0}
    (folder / "truth.json").write_text(json.dumps({**truth, "made_by": "foreign_belt"}))
    return truth


def crossing_tubers(tubers: list[Tuber], view: View, travels_m: list[float]) -> list[int]:
    """Tubers whose centre crosses v = cy between the first and last frame, inside the image's width.

    Where the belt runs along the image's columns, what crosses u = cx inside the image's height.
    """
    along = int(abs(view.belt_from_camera[0, 1]) >= abs(view.belt_from_camera[0, 0]))
    line, side = view.centre[along], view.size[1 - along] - 1
    found = []
    for index, tuber in enumerate(tubers):
        first, last = (_project(view, tuber, travel) for travel in (min(travels_m), max(travels_m)))
        if (first[along] - line) * (last[along] - line) < 0:
            share = (line - first[along]) / (last[along] - first[along])
            if 0 <= first[1 - along] + share * (last[1 - along] - first[1 - along]) <= side:
                found.append(index)
    return found


def render(view: View, tubers: list[Tuber], travel_m: float, habits: Habits) -> tuple[Array, NDArray[np.uint16]]:
    """(depth along the optical axis in metres, 0 where nothing is; labels 1..n) of one frame, both (H, W)."""
    origin, ray, (u, v) = *_rays(view), view.centre
    depth = _belt_depth(origin, ray, travel_m, habits)
    labels = np.zeros(depth.shape, np.uint16)
    for number, tuber in enumerate(tubers, start=1):
        centre = np.array([tuber.place_m[0] + travel_m, tuber.place_m[1], tuber.lift_m])
        in_camera = view.belt_from_camera[:3, :3].T @ (centre - origin)
        if in_camera[2] < 0.05:
            continue
        pixel = view.focal * in_camera[:2] / in_camera[2] + (u, v)
        half = view.focal * tuber.radius_m / (in_camera[2] - tuber.radius_m) * 1.25 + 2
        u0, v0 = np.maximum(0, np.floor(pixel - half)).astype(int)
        u1, v1 = np.minimum(view.size, np.ceil(pixel + half)).astype(int)
        if u1 <= u0 or v1 <= v0:
            continue
        part = (slice(v0, v1), slice(u0, u1))
        reached = _meet(tuber, centre, origin, ray[part].reshape(-1, 3)).reshape(v1 - v0, u1 - u0)
        nearer = (reached > 0) & ((reached < depth[part]) | (depth[part] == 0))
        depth[part][nearer] = reached[nearer]
        labels[part][nearer] = number
    return depth, labels


def _meet(tuber: Tuber, centre: Array, origin: Array, rays: Array) -> Array:
    """Ray parameter (= depth) of the first hit, 0 where none; rays (N, 3) in belt axes with unit depth."""
    unit = tuber.turn / tuber.half_m
    start, step = (origin - centre) @ unit, rays @ unit
    length2 = (step**2).sum(1)
    nearest = -(step @ start) / length2
    outer = 1.1 + float(np.maximum(tuber.amplitudes, 0).sum())
    margin = outer**2 - ((start + nearest[:, None] * step) ** 2).sum(1)
    found = np.zeros(len(rays))
    inside = np.flatnonzero(margin > 0)
    step, nearest = step[inside], nearest[inside]
    low = nearest - np.sqrt(margin[inside] / length2[inside])

    def outside(at: Array) -> Array:
        point = start + at[:, None] * step
        size = np.maximum(np.linalg.norm(point, axis=1, keepdims=True), 1e-9)
        grown: Array = _norm(point) / (1 + _bump(point / size, tuber.bumps, tuber.amplitudes)) - 1
        return grown

    hit = outside(nearest) < 0
    inside, step, low, high = inside[hit], step[hit], low[hit], nearest[hit]
    for _ in range(11):
        middle = (low + high) / 2
        out = outside(middle) > 0
        low, high = np.where(out, middle, low), np.where(out, high, middle)
    found[inside] = (low + high) / 2
    return found


def _belt_depth(origin: Array, ray: Array, travel_m: float, habits: Habits) -> Array:
    """Depth of the empty belt: a plane, on wish with rods across it and a floor beside it."""
    depth: Array = np.where(ray[..., 2] < -0.05, -origin[2] / np.minimum(ray[..., 2], -0.05), 0.0)
    x, y = (origin[axis] + depth * ray[..., axis] for axis in (0, 1))
    if habits.rods_mm:
        rise = habits.rods_mm * 1e-3 * np.maximum(0, np.cos((x - travel_m) / 0.04 * 2 * np.pi)) ** 2
        depth = depth * (1 - rise / origin[2])
    if habits.belt_half_m is not None:
        floor = -(origin[2] + habits.floor_m) / np.minimum(ray[..., 2], -0.05)
        depth = np.where(np.abs(y) > habits.belt_half_m, floor, depth)
    return depth


def _write_camera(
    folder: Path, tubers: list[Tuber], view: View, times: Array, travel_at: Callable[[float], float], habits: Habits,
    rng: np.random.Generator,
) -> None:  # fmt: skip
    for name in ("depth", *(["mask"] if habits.masks else []), *(["color"] if habits.colour else [])):
        (folder / name).mkdir(parents=True, exist_ok=True)
    k: dict[str, Any] = {"name": view.name, "width": view.size[0], "height": view.size[1]}
    k |= {"fx": view.focal, "fy": view.focal, "cx": view.centre[0], "cy": view.centre[1], "depth_scale_m": view.unit_m}
    k["belt_distance_m"] = _distance(view) if view.told_distance else None
    k["belt_from_camera"] = view.belt_from_camera.tolist() if view.told_pose else None
    k["fps"] = view.fps
    if habits.extra_keys:
        k |= {"serial": "X-1", "distortion": [0, 0, 0, 0, 0], "exposure": {"us": 4000}}
    (folder / "camera.json").write_text(json.dumps(k))
    gap = ", " if habits.spaces else ","
    lines = [gap.join(("seq", "captured_ns", "travel_m"))]
    for index, t in enumerate(times.tolist()):
        if 0 < index < len(times) - 1 and rng.random() < habits.drop:
            continue
        seq, travel_m = view.first_seq + index, travel_at(t)
        metres = f"{travel_m:.6f}" if habits.travel else ""
        lines.append(gap.join((str(seq), str(view.clock_ns + round(t * 1e9)), metres)))
        depth, labels = render(view, tubers, travel_m, habits)
        depth = _spoilt(depth, habits, rng)
        stored = np.clip(np.round(depth / view.unit_m), 0, 65535).astype(np.uint16)
        cv2.imwrite(str(folder / "depth" / f"{seq:06d}.png"), stored, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        if habits.masks:
            cv2.imwrite(str(folder / "mask" / f"{seq:06d}.png"), labels)
        if habits.colour:
            brown = np.where(labels[..., None] > 0, (60, 120, 170), (40, 45, 40)).astype(np.uint8)
            cv2.imwrite(str(folder / "color" / f"{seq:06d}.{habits.colour}"), brown)
    (folder / "frames.csv").write_bytes((habits.newline.join(lines) + habits.newline).encode())


def _spoilt(depth: Array, habits: Habits, rng: np.random.Generator) -> Array:
    noisy = depth + rng.normal(0, habits.noise_mm * 1e-3, depth.shape) if habits.noise_mm else depth.copy()
    if habits.quantum_mm:
        steps = habits.quantum_mm * 1e-3
        noisy = np.round(noisy / steps) * steps
    if habits.holes:
        coarse = rng.normal(size=(depth.shape[0] // 6 + 2, depth.shape[1] // 6 + 2))
        field_ = cv2.resize(coarse, (depth.shape[1], depth.shape[0]), interpolation=cv2.INTER_CUBIC)
        noisy[field_ > np.quantile(field_, 1 - habits.holes)] = 0
    noisy[depth == 0] = 0
    noisy[:, : habits.blind_columns] = 0
    return np.asarray(noisy)


def _rays(view: View) -> tuple[Array, Array]:
    u, v = np.meshgrid(np.arange(view.size[0]), np.arange(view.size[1]))
    (cx, cy), f = view.centre, view.focal
    in_camera = np.stack([(u - cx) / f, (v - cy) / f, np.ones(u.shape)], axis=-1)
    return view.belt_from_camera[:3, 3], in_camera @ view.belt_from_camera[:3, :3].T


def _project(view: View, tuber: Tuber, travel_m: float) -> Array:
    centre = np.array([tuber.place_m[0] + travel_m, tuber.place_m[1], tuber.lift_m])
    x, y, z = view.belt_from_camera[:3, :3].T @ (centre - view.belt_from_camera[:3, 3])
    return np.array([view.focal * x / z + view.centre[0], view.focal * y / z + view.centre[1]])


def _distance(view: View) -> float:
    return float(view.belt_from_camera[2, 3] / -view.belt_from_camera[2, 2])


def _told(index: int, tuber: Tuber, cameras: list[str]) -> dict[str, Any]:
    length, width = (2000 * value for value in tuber.half_m[:2])
    return {
        "id": f"t{index}", "weight_g": tuber.weight_g, "length_mm": length, "width_mm": width,
        "height_mm": 1000 * tuber.height_m, "place_x_m": tuber.place_m[0], "place_y_m": tuber.place_m[1],
        "cameras": cameras, "bruised": False,
    }  # fmt: skip


def _at(tuber: Tuber, place: tuple[float, float]) -> Tuber:
    t = tuber
    return Tuber(t.half_m, t.turn, t.bumps, t.amplitudes, place, t.lift_m, t.height_m, t.weight_g)


def _footprint(tuber: Tuber) -> Array:
    """(64, 2) outline seen from above, around the centre."""
    sphere = _sphere(3000)
    reach = 1 / _norm(sphere) * (1 + _bump(sphere, tuber.bumps, tuber.amplitudes))
    flat = (sphere * reach[:, None] * tuber.half_m @ tuber.turn.T)[:, :2]
    hull = cv2.convexHull(flat.astype(np.float32))[:, 0].astype(float)
    ring = np.concatenate([hull, hull[:1]])
    along = np.r_[0, np.cumsum(np.linalg.norm(np.diff(ring, axis=0), axis=1))]
    at = np.linspace(0, along[-1], 64, endpoint=False)
    return np.stack([np.interp(at, along, ring[:, 0]), np.interp(at, along, ring[:, 1])], axis=1)


def _clearance(one: Array, other: Array) -> float:
    """Gap between two outlines, metres; negative where they overlap."""
    if np.linalg.norm(one.mean(0) - other.mean(0)) > 0.2:
        return 0.1
    return min(_outside(one, other), _outside(other, one))


def _outside(points: Array, outline: Array) -> float:
    hull = np.ascontiguousarray(outline.astype(np.float32))
    return -max(float(cv2.pointPolygonTest(hull, (float(x), float(y)), True)) for x, y in points)


def _norm(points: Array) -> Array:
    powered: Array = (np.abs(points) ** SHAPE_EXPONENT).sum(1) ** (1 / SHAPE_EXPONENT)
    return powered


def _bump(directions: Array, bumps: Array, amplitudes: Array) -> Array:
    grown: Array = np.exp(5.0 * (directions @ bumps.T - 1)) @ amplitudes
    return grown


def _sphere(n: int) -> Array:
    i = np.arange(n) + 0.5
    polar, around = np.arccos(1 - 2 * i / n), np.pi * (1 + 5**0.5) * i
    return np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=1)
