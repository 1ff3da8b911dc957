"""Single tubers of the other world, weighed from one frame each: as depth image with mask, and as bare cloud."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.otherworld_camera import Camera, Sensor, View
from benchmarks.otherworld_shapes import FAMILIES, Body, tuber
from benchmarks.otherworld_table import EXACT, FAT, FILLED, FLIGHT, HARSH, SHORT, SPECKS, TENTH, WIDE, d405, hd, vga
from conveyor.geometry import Intrinsics
from tuberline import Weight, weigh, weigh_depth

SEED = 8901
CAMERAS: dict[str, tuple[Camera, Sensor]] = {
    "rounded to 1 mm": (d405(), EXACT),
    "rounded to 0.1 mm, tilted": (d405(height_m=0.4, pitch_deg=4, roll_deg=-3), TENTH),
    "short baseline": (d405(), SHORT),
    "short baseline, 1280x720": (hd(height_m=0.345), SHORT),
    "wide baseline": (vga(), WIDE),
    "wide baseline, harsh": (d405(height_m=0.5), HARSH),
    "grown outlines": (d405(height_m=0.5), FAT),
    "specks on the belt": (vga(height_m=0.5), SPECKS),
    "time of flight": (vga(), FLIGHT),
    "holes filled": (d405(height_m=0.38), FILLED),
}
HEAD = (
    "| single views | tubers | total off | MAE | within 8 % | intervals hold | bare cloud: total off | within 8 % |\n"
    "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |"
)


def views_table(tubers: int) -> str:
    """Markdown: a line for each camera, `tubers` tubers of all families before each."""
    return "\n".join([HEAD, *(_row(name, tubers, number) for number, name in enumerate(CAMERAS))])


def _row(name: str, tubers: int, number: int) -> str:
    rng = np.random.default_rng([SEED, number])
    camera, sensor = CAMERAS[name]
    view = View(camera, sensor, rng)
    images, clouds, true_g, held = [], [], [], []
    for body, depth, label in _seen(view, tubers, rng):
        by_image = _by_image(view, depth, label)
        images.append(by_image.weight_g)
        clouds.append(_by_cloud(view, depth, label).weight_g if camera.straight else np.nan)
        true_g.append(body.weight_g)
        held.append(by_image.low_g <= body.weight_g <= by_image.high_g)
    true = np.array(true_g)
    cells = [name, len(true), *_errors(np.array(images), true), f"{100 * np.mean(held):.0f} %"]
    cloud = _errors(np.array(clouds), true) if camera.straight else ["-", "-", "-"]
    return "| " + " | ".join(map(str, [*cells, cloud[0], cloud[2]])) + " |"


def _errors(told_g: np.ndarray, true_g: np.ndarray) -> list[str]:
    off = 100 * (told_g / true_g - 1)
    return [
        f"{100 * (told_g.sum() / true_g.sum() - 1):+.1f} %",
        f"{np.abs(off).mean():.1f} %",
        f"{100 * (np.abs(off) <= 8).mean():.0f} %",
    ]


def _seen(view: View, tubers: int, rng: np.random.Generator) -> Iterator[tuple[Body, np.ndarray, np.ndarray]]:
    """Each tuber alone on the belt, whole in the image: body, measured depth, mask."""
    camera = view.camera
    families = list(FAMILIES)
    for number in range(tubers):
        body = tuber(rng, families[number % len(families)])
        reach = [camera.height_m / camera.focal_px * side / 2 - 0.09 for side in (camera.height, camera.width)]
        place = np.array([rng.uniform(-max(side, 0.01), max(side, 0.01)) for side in reach] + [0.0])
        depth_m, label = view.exact([(body.vertices_m + place, body.triangles)])
        yield body, view.measured(depth_m, label), label > 0


def _by_image(view: View, depth: np.ndarray, mask: np.ndarray) -> Weight:
    camera = view.camera
    cx, cy = camera.centre_px
    return weigh_depth(
        depth,
        intrinsics=Intrinsics(camera.width, camera.height, camera.focal_px, camera.focal_px, cx, cy),
        depth_scale_m=view.sensor.unit_m,
        belt_from_camera=camera.belt_from_camera,
        mask=mask,
    )


def _by_cloud(view: View, depth: np.ndarray, mask: np.ndarray) -> Weight:
    camera = view.camera
    cx, cy = camera.centre_px
    v, u = np.nonzero(mask & (depth > 0))
    z = depth[v, u] * view.sensor.unit_m
    points = np.stack([(u - cx) * z / camera.focal_px, (v - cy) * z / camera.focal_px, z], 1)
    return weigh(points, belt_distance_m=camera.height_m)
