"""A simulated camera as a source of frames, and the recording of a whole simulated line with its truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camera_sim.sim.distractors import DENSITY_G_ML
from camera_sim.sim.faults import plan_faults
from camera_sim.sim.meshes import volume
from camera_sim.sim.paint import paint_jpeg
from camera_sim.sim.raster import Canvas
from camera_sim.sim.scenes import Layout, SceneSettings, tuber_of
from camera_sim.sim.seen import measured
from camera_sim.sim.stereo import Field, NoiseBank, StereoNoise
from camera_sim.sim.stereo_faults import bowed_field
from camera_sim.sim.world import Body, CameraPose, World, crossing_travel_m
from conveyor.errors import InputError
from conveyor.formats.source import CameraDescription, Refused
from conveyor.geometry import belt_distance_m, straight_down_belt_from_camera
from conveyor.messages import Frame

EPOCH_NS = 1_760_000_000_000_000_000
"""Capture time of every simulated belt's start: recordings of one seed are equal, whenever they are made."""


FOREIGN_KEYS = ("kind", "weight_g", "volume_ml", "place_x_m", "place_y_m")
"""What truth.json says of each body that is no tuber, under 'foreign'."""


class SimulatedSource:
    """One camera over a simulated world. Frame n is the same whatever was rendered before it.

    Raises:
        InputError: the belt is done before the camera has taken a frame.
    """

    def __init__(
        self,
        world: World,
        camera: CameraPose,
        settings: SceneSettings,
        *,
        layout: Layout,
        index: int = 0,
        masks: bool = False,
        color: bool = False,
        faults: tuple[str, ...] = (),
    ) -> None:
        self._world = world
        self._camera = camera
        self._settings = settings
        self._masks = masks
        self._color = color
        self._key = (settings.seed, 20 + index)
        count = int((world.motion.duration_s - camera.phase_s) * camera.fps)
        if count < 1:
            raise InputError(
                f"the belt is done after {world.motion.duration_s:.2f} s, before camera '{camera.name}' with "
                f"{camera.fps:g} frames/s has taken one: give more tubers, a slower belt or more frames/s"
            )
        self._faults = plan_faults(
            np.random.default_rng([*self._key, 0]), frames=count, fps=camera.fps, names=faults, dropped=layout.dropped
        )
        self._count = count
        self._bank: NoiseBank | None = None
        self._bow: Field | None = None

    @property
    def description(self) -> CameraDescription:
        """As the system believes the camera to be: its belt distance has the preset's error."""
        believed = self._camera.believed_belt_from_camera
        distance_m = round(belt_distance_m(believed), 6)
        plain = np.allclose(believed, straight_down_belt_from_camera(distance_m), atol=1e-6)
        stated = self._settings.stated
        return CameraDescription(
            name=self._camera.name,
            origin=f"simulated scene '{self._settings.scene}', seed {self._settings.seed}",
            intrinsics=self._camera.optics.intrinsics,
            depth_scale_m=self._settings.claimed_unit_m or self._settings.unit_m,
            belt_distance_m=distance_m,
            belt_from_camera=None if plain else believed,
            fps=self._camera.fps,
            frames=self._count - len(self._faults.missing),
            resting_offset_mm=None if stated is None else round(1000 * stated.offset_m, 3),
            resting_sd_mm=None if stated is None else round(1000 * stated.sd_m, 3),
        )

    def time_s(self, seq: int) -> float:
        """Capture time of frame `seq` after the belt's start, seconds."""
        return self._camera.phase_s + seq / self._camera.fps

    def travel_range_m(self) -> tuple[float, float]:
        """Belt travel at the first and at the last frame."""
        numbers = [seq for seq in range(self._count) if seq not in self._faults.missing]
        first, last = (self._world.motion.travel_at(self.time_s(seq)) for seq in (numbers[0], numbers[-1]))
        return first, last

    def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
        """All frames but the dropped ones, in order."""
        for seq in range(after + 1, self._count):
            if seq not in self._faults.missing:
                yield self.frame(seq, run=run)

    def frame(self, seq: int, *, run: str) -> Frame:
        """Frame `seq`."""
        settings, k = self._settings, self._camera.optics.intrinsics
        if self._bank is None:
            self._bank = NoiseBank(np.random.default_rng([*self._key, 1]), height=k.height, width=k.width)
        picture, time_s = self._faults.picture_of(seq), self.time_s(self._faults.time_of(seq))
        travel = self._world.motion.travel_at(time_s)
        seen_s = self.time_s(picture)
        camera, noise = self._disturbed(seq)
        rng = np.random.default_rng([*self._key, 2, picture])
        canvas, depth = measured(
            self._world,
            camera,
            replace(settings.preset, noise=noise),
            travel_m=self._world.motion.travel_at(seen_s),
            time_s=seen_s,
            unit_m=settings.unit_m,
            bank=self._bank,
            rng=rng,
            bow=self._bowed(),
        )
        d = self.description
        if self._faults.dirt:
            depth[self._dirty(depth.shape)] = 0
        return Frame(
            camera=d.name,
            run=run,
            seq=seq,
            captured_ns=EPOCH_NS + round(time_s * 1e9) + self._faults.clock_shift_ns(seq),
            travel_m=round(travel, 5) if settings.given_travel else None,
            depth_scale_m=d.depth_scale_m,
            intrinsics=k,
            belt_distance_m=d.belt_distance_m,
            depth=depth,
            belt_from_camera=d.belt_from_camera,
            mask=self._tuber_labels(canvas) if self._masks else None,
            color_jpeg=paint_jpeg(canvas, self._world, rng) if self._color else None,
        )

    def _disturbed(self, seq: int) -> tuple[CameraPose, StereoNoise]:
        """The camera as it hangs by frame `seq`, and what its error is by then."""
        settings, share = self._settings, min(seq / max(self._count - 1, 1), 1.0)
        camera, noise = self._camera, settings.preset.noise
        if settings.drift_by_end_px:
            noise = replace(noise, drift_px=noise.drift_px + share * settings.drift_by_end_px)
        if settings.shift_by_end_mm:
            moved = camera.belt_from_camera.copy()
            moved[:3, 3] -= moved[:3, 2] * share * settings.shift_by_end_mm / 1000
            camera = replace(camera, belt_from_camera=moved)
        return camera, noise

    def _bowed(self) -> Field | None:
        """(H, W) the camera's bowed field, the same in every frame."""
        if self._bow is None and self._settings.preset.noise.bow_px > 0:
            k = self._camera.optics.intrinsics
            self._bow = bowed_field(np.random.default_rng([*self._key, 3]), height=k.height, width=k.width)
        return self._bow

    def _dirty(self, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """(h, w) where dirt on the lens leaves no depth: round spots, the same in every frame."""
        rows, columns = np.ogrid[: shape[0], : shape[1]]
        dirty = np.zeros(shape, np.bool_)
        for u, v, radius in self._faults.dirt:
            far = ((columns - u * shape[1]) ** 2 + (rows - v * shape[0]) ** 2) / shape[1] ** 2
            dirty |= far < radius**2
        return dirty

    def _tuber_labels(self, canvas: Canvas) -> NDArray[np.uint16]:
        """(h, w) ids of the tubers seen; distractors and belt are 0."""
        tubers = sum(body.kind == "tuber" for body in self._world.bodies)
        return np.where(canvas.ids <= tubers, canvas.ids, 0).astype(np.uint16)


def simulated_sources(
    world: World,
    settings: SceneSettings,
    layout: Layout,
    *,
    masks: bool = False,
    color: bool = False,
    faults: tuple[str, ...] = (),
) -> list[SimulatedSource]:
    """A source for each camera of the world."""
    return [
        SimulatedSource(world, camera, settings, layout=layout, index=n, masks=masks, color=color, faults=faults)
        for n, camera in enumerate(world.cameras)
    ]


def truth_of(world: World, sources: list[SimulatedSource]) -> dict[str, Any]:
    """truth.json: the tubers whose centre crosses the centre row of a camera that sees it, while it records."""
    tubers, others = [], []
    for body in world.bodies:
        seen = [
            camera.name for camera, source in zip(world.cameras, sources, strict=True) if _crosses(camera, source, body)
        ]
        if seen and body.kind == "tuber":
            tubers.append(_truth_row(body, seen, crossing_place(world, body, seen[0])))
        elif seen:
            others.append(_distractor_row(body, seen, crossing_place(world, body, seen[0])))
    distractors = [body.kind for body in world.bodies if body.kind != "tuber"]
    return {
        "tubers": tubers,
        "distractors": len(distractors),
        "distractor_kinds": {kind: distractors.count(kind) for kind in sorted(set(distractors))},
        "distractor_places": others,
        "foreign": [{key: row[key] for key in FOREIGN_KEYS} for row in others],
        "travel_m": world.motion.travel_at(world.motion.duration_s),
    }


def _crosses(camera: CameraPose, source: SimulatedSource, body: Body) -> bool:
    at = crossing_travel_m(body, camera)
    if at is None:
        return False
    first, last = source.travel_range_m()
    return first <= at <= last


def _distractor_row(body: Body, cameras: list[str], place: NDArray[np.float64]) -> dict[str, Any]:
    reach_m = float(np.ptp(body.vertices[:, :2], axis=0).max()) / 2
    volume_ml = abs(volume(body.vertices, body.faces)) * 1e6
    return {
        "kind": body.kind,
        "volume_ml": round(volume_ml, 2),
        "weight_g": round(volume_ml * DENSITY_G_ML[body.kind], 2),
        "place_x_m": round(float(place[0]), 5),
        "place_y_m": round(float(place[1]), 5),
        "reach_mm": round(reach_m * 1000, 2),
        "top_mm": round(float(body.vertices[:, 2].max()) * 1000, 2),
        "cameras": cameras,
    }


def crossing_place(world: World, body: Body, camera: str) -> NDArray[np.float64]:
    """(3,) the place of a body when it crosses the centre row of the camera."""
    pose = next(pose for pose in world.cameras if pose.name == camera)
    travel_m = crossing_travel_m(body, pose)
    return body.place if travel_m is None else body.place_at(travel_m)


def _truth_row(body: Body, cameras: list[str], place: NDArray[np.float64]) -> dict[str, Any]:
    tuber = tuber_of(body)
    length, width, height = tuber.axes_mm
    return {
        "id": body.body_id,
        "weight_g": round(tuber.weight_g, 2),
        "volume_ml": round(tuber.volume_ml, 2),
        "length_mm": round(length, 2),
        "width_mm": round(width, 2),
        "height_mm": round(height, 2),
        "square_mesh_mm": round(tuber.square_mesh_mm, 2),
        "place_x_m": round(float(place[0]), 5),
        "place_y_m": round(float(place[1]), 5),
        "top_mm": round(float(body.vertices[:, 2].max()) * 1000, 2),
        "cultivar": tuber.stock.cultivar,
        "season": tuber.stock.season,
        "cameras": cameras,
        **({"layer": body.layer} if body.layer > 1 else {}),
    }
