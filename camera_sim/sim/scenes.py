"""Scenes by name, from a few settings to a world."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from camera_sim.sim.belt import Belt, draw_belt
from camera_sim.sim.conditions import (
    KNOWN_BELT_SD_M,
    Conditions,
    StatedRest,
    draw_conditions,
    draw_stated,
    draw_tuber_of,
)
from camera_sim.sim.distractors import Mesh, draw_distractor
from camera_sim.sim.drift import draw_drift
from camera_sim.sim.lowering import rest_height_m, settled, typical_sink_m, underside_of
from camera_sim.sim.meshes import Faces, Vertices
from camera_sim.sim.motion import Profile, plan_motion
from camera_sim.sim.optics import D405_848, Optics
from camera_sim.sim.pile import Ground, settle
from camera_sim.sim.placement import CROWDED, LOOSE, SINGULATED, TOUCHING, Lane, Packing
from camera_sim.sim.poses import free_rotation, rest_on_belt
from camera_sim.sim.presets import Preset, initial_rotation
from camera_sim.sim.rods import Rods
from camera_sim.sim.surface import FLAT, Surface
from camera_sim.sim.tubers import Tuber, draw_tuber
from camera_sim.sim.world import Body, CameraPose, Heave, World, mount
from conveyor.errors import InputError

ROUND = ("tuber", "clod", "stone")
"""What may rock, slide and roll; stalks and leaves lie still."""


def belt_tuber(rng: Generator) -> Tuber:
    """A tuber with a mesh as fine as whole belts of them can be rendered with."""
    return draw_tuber(rng, level=3)


@dataclass(frozen=True, slots=True)
class Layout:
    """What a named scene is made of.

    Attributes:
        lanes_m: stretches across the belt that carry tubers, as (low, high) in units of a camera's view across.
        distractors: per tuber.
        one_tuber, one_distractor: draw what is put on the belt.
        cameras: (name, x, y) of each, x in metres along the belt, y in units of a camera's view across.
        tilt_deg: of every camera about its u and v axes.
        dropped: share of frames that are missing, singly and in bursts.
        piled: share of the tubers that lie on others.
        unrest: how much the load rocks, rolls and slides; 1 on a belt that shakes.
        rods: a web of rods that one sees through, instead of a belt with cleats; the load lies on it as it sinks.
    """

    packing: Packing
    lanes_m: tuple[tuple[float, float], ...] = ((-0.36, 0.36),)
    distractors: float = 0.0
    one_tuber: Callable[[Generator], Tuber] = belt_tuber
    one_distractor: Callable[[Generator], tuple[str, Mesh]] = draw_distractor
    cameras: tuple[tuple[str, float, float], ...] = (("front", 0.0, 0.0),)
    profile: Profile = "constant"
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    dropped: float = 0.0
    piled: float = 0.0
    unrest: float = 0.0
    rods: bool = False


SCENES: dict[str, Layout] = {
    "singulated": Layout(SINGULATED),
    "touching": Layout(TOUCHING),
    "crowded": Layout(CROWDED),
    "distractors": Layout(TOUCHING, distractors=0.5),
    "two-cameras": Layout(TOUCHING, lanes_m=((-0.68, 0.68),), cameras=(("left", 0.0, -0.33), ("right", 0.06, 0.33))),
    "two-lane": Layout(SINGULATED, lanes_m=((-0.38, -0.06), (0.06, 0.38))),
    "dropped-frames": Layout(TOUCHING, dropped=0.12),
    "stop-and-go": Layout(TOUCHING, profile="stop-and-go"),
    "changing-speed": Layout(TOUCHING, profile="changing"),
    "tilted": Layout(TOUCHING, tilt_deg=(3.0, -2.0)),
    "piled": Layout(CROWDED, piled=0.3),
    "rolling": Layout(LOOSE, unrest=1.0),
    "rods": Layout(TOUCHING, rods=True),
}


@dataclass(frozen=True, slots=True)
class SceneSettings:
    """What the user chooses.

    Attributes:
        unrest: how much the load moves, where the scene does not move it more; see `drift`.
        jitter: how unsteady the belt's speed is, 1 = 1 %.
        claimed_unit_m: what the recording says its depth unit is; None: the truth.
        resting_offset_mm: how far below the belt plane the whole load lies, beside what the surface's shape gives.
        heave_mm, heave_hz: amplitude and frequency at which belt and load move up and down under the camera.
        conditions: this recording's own world; `in_its_world` draws it for the preset 'harsh'.
        stated: what the recording says of its resting offset; None: nothing.
        drift_by_end_px, shift_by_end_mm: by how much every disparity grows, and the camera moves away from the belt,
            evenly from the first frame to the last; the recording states the belt as it was at first.
    """

    scene: str
    seed: int
    tubers: int
    preset: Preset
    optics: Optics = D405_848
    fps: float = 30.0
    speed_mps: float = 0.31
    belt_distance_m: float = 0.46
    unit_m: float = 0.001
    given_travel: bool = True
    unrest: float = 0.0
    jitter: float = 1.0
    claimed_unit_m: float | None = None
    resting_offset_mm: float = 0.0
    heave_mm: float = 0.0
    heave_hz: float = 4.0
    conditions: Conditions | None = None
    stated: StatedRest | None = None
    drift_by_end_px: float = 0.0
    shift_by_end_mm: float = 0.0

    def surface_of(self, layout: Layout) -> Surface:
        """What the load lies on."""
        if self.conditions is not None:
            return self.conditions.surface
        return Surface("rods", rods=Rods()) if layout.rods else FLAT

    def resting_m(self, layout: Layout) -> float:
        """How far undersides of ordinary tubers lie below the belt plane that the camera sees."""
        if self.conditions is not None:
            return self.conditions.resting_m + self.resting_offset_mm / 1000
        support = self.surface_of(layout).support
        return (typical_sink_m(support) if support is not None else 0.0) + self.resting_offset_mm / 1000


def layout_named(name: str) -> Layout:
    """The layout of the scene `name`, or an error that lists them."""
    if name not in SCENES:
        raise InputError(f"scene '{name}' is unknown; known: {', '.join(SCENES)}")
    return SCENES[name]


def in_its_world(settings: SceneSettings, layout: Layout) -> SceneSettings:
    """The settings with what only this recording has: its world where the preset is 'harsh', its camera where that is
    'matched', what it states.
    """
    rng = np.random.default_rng([settings.seed, 12])
    if settings.preset.name == "harsh" and settings.conditions is None:
        drawn = draw_conditions("harsh", rng)
        settings = replace(settings, conditions=drawn, preset=drawn.preset)
        if settings.heave_mm == 0:
            settings = replace(settings, heave_mm=drawn.heave_m * 1000, heave_hz=drawn.heave_hz)
    if settings.preset.name == "matched":
        settings = replace(settings, preset=draw_conditions("matched", rng).preset)
    if settings.stated is None and settings.conditions is not None:
        stated = draw_stated(settings.conditions, rng)
        settings = replace(
            settings, stated=replace(stated, offset_m=stated.offset_m + settings.resting_offset_mm / 1000)
        )
    elif settings.stated is None and settings.resting_m(layout) != 0:
        settings = replace(settings, stated=StatedRest(settings.resting_m(layout), KNOWN_BELT_SD_M, calibrated=True))
    return settings


def build_world(settings: SceneSettings, layout: Layout) -> World:
    """The world of `settings`: the first tuber enters the view after the start, the last one leaves before the end."""
    rng = np.random.default_rng([settings.seed, 10])
    cameras = _cameras(settings, layout, rng)
    k = settings.optics.intrinsics
    lead_m = 0.5 * settings.belt_distance_m * k.height / k.fy + 0.03
    bodies, rear_m = _bodies(settings, layout, rng, start_m=-lead_m)
    last_x = max(x for _, x, _ in layout.cameras)
    motion = plan_motion(
        rng,
        travel_m=lead_m + last_x - rear_m + 0.02,
        speed_mps=settings.speed_mps,
        profile=layout.profile,
        jitter=settings.jitter,
    )
    belt = _belt(settings, layout, rng)
    heave = Heave(settings.heave_mm / 1000, settings.heave_hz) if settings.heave_mm > 0 else None
    return World(_moving(bodies, settings, layout), belt, motion, cameras, heave)


def _belt(settings: SceneSettings, layout: Layout, rng: Generator) -> Belt:
    soil_m = 0.0012 if settings.preset.name == "easy" else 0.002
    if settings.conditions is not None and settings.conditions.soil_m is not None:
        soil_m = settings.conditions.soil_m
    surface = settings.surface_of(layout)
    if settings.conditions is None and surface.kind == "flat":
        return draw_belt(rng, soil_m=soil_m)
    return surface.belt(rng, soil_m=soil_m)


def _moving(bodies: tuple[Body, ...], settings: SceneSettings, layout: Layout) -> tuple[Body, ...]:
    """The bodies with their motions; drawn apart from all else, so that a scene at rest is the same scene."""
    strength = max(layout.unrest, settings.unrest)
    if strength <= 0:
        return bodies
    rng = np.random.default_rng([settings.seed, 11])
    drifts = [draw_drift(rng, body.vertices, strength=strength) for body in bodies]
    return tuple(
        replace(body, drift=drift) if body.kind in ROUND and body.layer == 1 else body
        for body, drift in zip(bodies, drifts, strict=True)
    )


def _across_m(settings: SceneSettings) -> float:
    k = settings.optics.intrinsics
    return settings.belt_distance_m * k.width / k.fx


def _cameras(settings: SceneSettings, layout: Layout, rng: Generator) -> tuple[CameraPose, ...]:
    across = _across_m(settings)
    poses = []
    for n, (name, x_m, y) in enumerate(layout.cameras):
        error_m = settings.preset.belt_error_session_m * float(np.clip(rng.standard_normal(), -2, 2))
        true = mount(settings.belt_distance_m, x_m=x_m, y_m=y * across, tilt_deg=layout.tilt_deg)
        noise = settings.preset.noise
        if noise.drift_px != 0 or noise.scale != 1:  # the recording states the plane as its camera sees it
            seen_m = noise.seen_m(settings.belt_distance_m, focal_px=settings.optics.intrinsics.fx)
            error_m += seen_m - settings.belt_distance_m
        believed = true.copy()
        believed[:3, 3] -= true[:3, 2] * error_m
        poses.append(CameraPose(name, settings.optics, settings.fps, true, believed, n * 0.37 / settings.fps))
    return tuple(poses)


def _bodies(
    settings: SceneSettings, layout: Layout, rng: Generator, *, start_m: float
) -> tuple[tuple[Body, ...], float]:
    across = _across_m(settings)
    surface = settings.surface_of(layout)
    lanes = [Lane(low * across, high * across, packing=layout.packing, start_m=start_m) for low, high in layout.lanes_m]
    tubers: list[Body] = []
    others: list[Body] = []
    extra = 0.0
    on_top = round(layout.piled * settings.tubers)
    while len(tubers) < settings.tubers - on_top:
        tuber = _one_tuber(settings, layout, rng)
        points = rest_on_belt(tuber.vertices, initial_rotation(tuber.vertices, settings.preset, rng))
        placed = _put(points, tuber.faces, lanes, surface, rng)
        if placed is None:
            raise InputError(
                f"a tuber {tuber.axes_mm[0]:.0f} mm long does not fit on the belt: raise --belt-distance-m"
            )
        tubers.append(Body(len(tubers) + 1, "tuber", placed, tuber.faces, tuber))
        extra += layout.distractors
        while extra >= 1:
            extra -= 1
            kind, (vertices, faces) = layout.one_distractor(rng)
            placed = _put(_lie(kind, vertices, rng), faces, lanes, surface, rng)
            if placed is not None:
                others.append(Body(0, kind, placed, faces, None))
    if on_top:
        tubers += _pile(settings, layout, rng, tubers, count=on_top, rear_m=min(lane.rear_m for lane in lanes))
    numbered = [replace(body, body_id=len(tubers) + n + 1) for n, body in enumerate(others)]
    bodies = [_lowered(body, settings, rng) for body in tubers + numbered]
    return tuple(bodies), min(lane.rear_m for lane in lanes)


def _lowered(body: Body, settings: SceneSettings, rng: Generator) -> Body:
    """The body as far below where its surface holds it as the settings say."""
    below_m, own = settings.resting_offset_mm / 1000, settings.conditions
    if own is not None:
        below_m += own.beyond_m + own.scatter_m * float(rng.standard_normal())
    return replace(body, vertices=body.vertices - np.array([0.0, 0.0, below_m])) if below_m != 0 else body


def _one_tuber(settings: SceneSettings, layout: Layout, rng: Generator) -> Tuber:
    """The next tuber: of the recording's cultivar and under its soil, where it has a world of its own."""
    own = settings.conditions
    if own is None:
        return layout.one_tuber(rng)
    return draw_tuber_of(own, rng, level=3) if layout.one_tuber is belt_tuber else layout.one_tuber(rng)


def _pile(
    settings: SceneSettings, layout: Layout, rng: Generator, lying: list[Body], *, count: int, rear_m: float
) -> list[Body]:
    """Tubers dropped onto those that lie already, one after the other, each somewhere on its own part of the belt."""
    across = _across_m(settings)
    y_m = min(low for low, _ in layout.lanes_m) * across, max(high for _, high in layout.lanes_m) * across
    front_m = max(float(body.vertices[:, 0].max()) for body in lying)
    ground = Ground(x_m=(rear_m - 0.3, front_m + 0.3), y_m=(y_m[0] - 0.3, y_m[1] + 0.3))
    for body in lying:
        ground.add(body.vertices, body.faces)
    part_m, piled = (front_m - rear_m) / count, []
    for n in range(count):
        tuber = _one_tuber(settings, layout, rng)
        points = rest_on_belt(tuber.vertices, initial_rotation(tuber.vertices, settings.preset, rng))
        x_m = front_m - (n + 1) * part_m, front_m - n * part_m
        half = float(points[:, 1].max())
        placed = points + settle(points, ground, rng, x_m=x_m, y_m=(y_m[0] + half, y_m[1] - half))
        ground.add(placed, tuber.faces)
        layer = 2 if placed[:, 2].min() > 0.002 else 1
        piled.append(Body(len(lying) + n + 1, "tuber", placed, tuber.faces, tuber, layer=layer))
    return piled


def _put(points: Vertices, faces: Faces, lanes: list[Lane], surface: Surface, rng: Generator) -> Vertices | None:
    """The body moved to its place in the lane that is filled least, sunk as deep as it lies there."""
    lane, support = max(lanes, key=lambda lane: lane.rear_m), surface.support
    if support is None:
        moved = lane.add(points, rng)
        z_m = 0.0
    else:
        underside = underside_of(points, faces)
        moved = lane.add(points, rng, settle=lambda x_m: settled(underside, support, x_m, backwards=True)[0])
        z_m = rest_height_m(underside, support, moved[0]) if moved is not None else 0.0
    if moved is None:
        return None
    if surface.sag_m > 0:
        z_m += float(surface.height_m(moved[1]))
    return np.asarray(points + np.array([moved[0], moved[1], z_m]))


def _lie(kind: str, vertices: Vertices, rng: Generator) -> Vertices:
    """Clods and stones lie anyhow, stalks and leaves flat."""
    if kind in ("clod", "stone"):
        return rest_on_belt(vertices, free_rotation(rng))
    angle = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    return rest_on_belt(vertices, turn)


def tuber_of(body: Body) -> Tuber:
    """The tuber that `body` is."""
    if body.tuber is None:
        raise ValueError(f"body {body.body_id} is a {body.kind}")
    return body.tuber
