"""Where the cameras of a belt hang, found by the load that passes under them, and what is counted by it.

    python -m benchmarks camera_places --docs docs/calibrate.md

Simulated belts under two cameras that are turned, leaning and moved by what a person's hands leave; recordings say no
more than the belt distance, which is off by what the preset is off. Every third belt has its second camera the other
way round, every second one no encoder. Seeds of their own that nothing was tuned on.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.figures_in_docs import put_table
from benchmarks.options import page_with, parser_of, whole_number
from benchmarks.perception_line import run_line
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.record import as_text, write_folder
from camera_sim.sim.scenes import SceneSettings, build_world, in_its_world, layout_named
from camera_sim.sim.source import simulated_sources, truth_of
from camera_sim.sim.world import CameraPose, mount
from conveyor.camera_place import CameraPlace
from conveyor.formats.cameras import open_cameras
from conveyor.geometry import belt_distance_m, straight_down_belt_from_camera
from regressor.weigh.weigher import Weigher
from segmenter.calibrate_cameras import PlacedCamera, place_cameras, see_load

FIRST_SEED = 9901
PRESET_NAMES = ("easy", "field", "harsh")
TURNED_DEG, LEANS_DEG, MOVED_M = 8.0, 2.0, 0.03
HEAD = (
    "| preset | seed | encoder | second camera turned by | tubers that both saw | turned: off by | across: off by "
    "| along: off by | true | counted, places not known | counted, places as measured |",
    "| --- | ---: | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
)


@dataclass(frozen=True, slots=True)
class Belt:
    """One recording and the poses of its cameras, (4, 4), by name."""

    recording: Path
    preset: str
    seed: int
    encoder: bool
    true: dict[str, NDArray[np.float64]]


def main(arguments: Sequence[str]) -> None:
    """Simulate, measure, count and print a Markdown table."""
    parser = parser_of("camera_places", __doc__)
    parser.add_argument("--belts", type=whole_number(1), default=12)
    parser.add_argument("--tubers", type=whole_number(1), default=120, help="of each belt")
    parser.add_argument(
        "--seed", type=whole_number(0), default=FIRST_SEED, help="of the first belt; the next ones follow"
    )
    parser.add_argument("--out", type=Path, default=Path("out/camera_places"), help="where recordings are kept")
    parser.add_argument("--docs", type=page_with("camera-places"), help="page between whose marks the table is put")
    given = parser.parse_args(arguments)
    weigher, lines = Weigher.load(None), [*HEAD]
    print("\n".join(HEAD))
    for n in range(given.belts):
        belt = recorded(given.out, n, seed=given.seed + n, tubers=given.tubers)
        lines.append(row(belt, weigher))
        print(lines[-1], flush=True)
    if given.docs:
        put_table(given.docs, "camera-places", "\n".join(lines))


def recorded(root: Path, n: int, *, seed: int, tubers: int) -> Belt:
    """A belt under two cameras hung by hand; what its recording says of them is their distance."""
    preset, encoder = PRESET_NAMES[n % len(PRESET_NAMES)], n % 2 == 0
    out = root / f"{preset}-seed{seed}-{tubers}"
    settings = SceneSettings("two-cameras", seed, tubers, PRESETS[preset], fps=15.0, given_travel=encoder)
    layout = layout_named("two-cameras")
    settings = in_its_world(settings, layout)
    rng = np.random.default_rng([seed, 61])
    world = build_world(settings, layout)
    cameras = [hung(rng, camera, round_=n % 3 == 2 and k == 1) for k, camera in enumerate(world.cameras)]
    world = replace(world, cameras=tuple(cameras))
    true = {camera.name: camera.belt_from_camera for camera in world.cameras}
    if not (out / "truth.json").is_file():
        sources = simulated_sources(world, settings, layout)
        write_folder(out, sources, {"truth.json": as_text(truth_of(world, sources))}, lambda done, total: None)
    return Belt(out, preset, seed, encoder, true)


def hung(rng: np.random.Generator, camera: CameraPose, *, round_: bool) -> CameraPose:
    """The camera as hands leave it, believed to look straight down; `round_`: mounted the other way round."""
    distance_m = belt_distance_m(camera.belt_from_camera)
    where = CameraPlace.of(camera.belt_from_camera)
    along_m, across_m = rng.uniform(-MOVED_M, MOVED_M, 2)
    turned_deg = rng.uniform(-TURNED_DEG, TURNED_DEG) + (180.0 if round_ else 0.0)
    leans = rng.uniform(-LEANS_DEG, LEANS_DEG, 2)
    place = CameraPlace(where.along_m + along_m, where.across_m + across_m, turned_deg)
    believed = straight_down_belt_from_camera(belt_distance_m(camera.believed_belt_from_camera))
    pose = place.put(mount(distance_m, tilt_deg=(float(leans[0]), float(leans[1]))))
    return replace(camera, belt_from_camera=pose, believed_belt_from_camera=believed)


def row(belt: Belt, weigher: Weigher) -> str:
    """One line of the table: errors of the second camera's place as the first one sees it."""
    truth = belt.recording / "truth.json"
    true_count = len(json.loads(truth.read_text(encoding="utf-8"))["tubers"])
    unknown = len(run_line(belt.recording, weigher).tubers)
    first, second = placed = measured(belt)
    turned = CameraPlace.of(belt.true[second.seen.camera]).turned_deg
    start = f"| {belt.preset} | {belt.seed} | {'yes' if belt.encoder else 'no'} | {turned:+.1f}° "
    if second.offset is None:
        return f"{start}| too few | | | | {true_count} | {unknown} | |"
    seen_deg, seen_m = beside(first.belt_from_camera, second.belt_from_camera)
    true_deg, true_m = beside(belt.true[first.seen.camera], belt.true[second.seen.camera])
    with_poses(belt.recording, placed)
    counted = len(run_line(belt.recording, weigher).tubers)
    with_poses(belt.recording, ())
    off_deg = (seen_deg - true_deg + 180.0) % 360.0 - 180.0
    along_mm, across_mm = 1000 * (seen_m - true_m)
    return (
        f"{start}| {len(second.offset.pairs)} | {off_deg:+.2f}° | {across_mm:+.1f} mm | {along_mm:+.1f} mm "
        f"| {true_count} | {unknown} | {counted} |"
    )


def measured(belt: Belt) -> list[PlacedCamera]:
    """As `tuberline calibrate cameras` measures them."""
    cameras = open_cameras(belt.recording, ignore_masks=True)
    return place_cameras([see_load(camera, seconds=60.0) for camera in cameras], first=CameraPlace())


def beside(first: NDArray[np.float64], second: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """How the second camera is turned against the first one, degrees, and (2,) metres along and across to it."""
    a, b = CameraPlace.of(first), CameraPlace.of(second)
    return b.turned_deg - a.turned_deg, np.array([b.along_m - a.along_m, b.across_m - a.across_m])


def with_poses(recording: Path, placed: Sequence[PlacedCamera]) -> None:
    """Write measured poses into the recording, or take them out again."""
    poses = {one.seen.camera: one.belt_from_camera.tolist() for one in placed}
    for path in sorted(recording.glob("*/camera.json")):
        values = json.loads(path.read_text(encoding="utf-8"))
        path.write_text(json.dumps(values | {"belt_from_camera": poses.get(path.parent.name)}), encoding="utf-8")
