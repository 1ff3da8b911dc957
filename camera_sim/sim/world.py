"""A belt with everything on it, as any camera over it sees it at any time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from camera_sim.sim.belt import Belt, belt_depth
from camera_sim.sim.drift import Drift
from camera_sim.sim.meshes import Faces, Vertices, rotation_about
from camera_sim.sim.motion import BeltMotion
from camera_sim.sim.optics import BASELINE_M, Optics
from camera_sim.sim.raster import Canvas, Window, canvas_over, draw, whole_image
from camera_sim.sim.tubers import Tuber
from conveyor.geometry import Intrinsics, inverse_rigid, straight_down_belt_from_camera, transform_points

REACH_M = 0.22
"""A body whose centre is further than this from the view cannot reach into it."""


@dataclass(frozen=True, slots=True)
class Body:
    """Something that rides on the belt.

    Attributes:
        body_id: 1, 2, 3, ...; tubers come first.
        kind: 'tuber' or a kind of distractor; `tuber` is given for the former.
        vertices: (V, 3) metres, at its place: x - travel, y, z in belt coordinates.
        drift: how it moves against the belt; `vertices` are those of its crossing x = 0. None: it lies still.
        layer: 1 on the belt, 2 on others.
    """

    body_id: int
    kind: str
    vertices: Vertices
    faces: Faces
    tuber: Tuber | None
    drift: Drift | None = None
    layer: int = 1

    @property
    def place(self) -> NDArray[np.float64]:
        """(3,) middle of its box: x - travel, y, z in belt coordinates, metres."""
        return np.asarray((self.vertices.min(axis=0) + self.vertices.max(axis=0)) / 2)

    def place_at(self, travel_m: float) -> NDArray[np.float64]:
        """(3,) its place when the belt has moved `travel_m`."""
        place = self.place
        if self.drift is not None:
            place[:2] += self.drift.offset_m(place[0] + travel_m)
        return place

    def vertices_at(self, travel_m: float) -> Vertices:
        """(V, 3) its vertices at its place when the belt has moved `travel_m`."""
        if self.drift is None:
            return self.vertices
        return self.drift.moved(self.vertices, float(self.place[0]) + travel_m)


@dataclass(frozen=True, slots=True)
class CameraPose:
    """A camera over the belt.

    Attributes:
        belt_from_camera: (4, 4) the truth; `believed_belt_from_camera` what its calibration says.
        phase_s: its first frame comes this long after the belt's start.
    """

    name: str
    optics: Optics
    fps: float
    belt_from_camera: NDArray[np.float64]
    believed_belt_from_camera: NDArray[np.float64]
    phase_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Heave:
    """Belt and load that move up and down together under the cameras."""

    amplitude_m: float
    frequency_hz: float

    def height_m(self, time_s: float) -> float:
        """How far they are above their mean at `time_s`."""
        return self.amplitude_m * float(np.sin(2 * np.pi * self.frequency_hz * time_s))


@dataclass(frozen=True, slots=True)
class Edges:
    """A belt `width_m` wide, its middle at y = 0, with the floor `floor_m` below it on both sides."""

    width_m: float
    floor_m: float = 0.2

    def beside(self, depth_m: NDArray[np.float32], intrinsics: Intrinsics, m: NDArray[np.float64]) -> None:
        """Put the floor into (H, W) `depth_m` where there is no belt; `m` is belt_from_camera."""
        x = (np.arange(intrinsics.width) - intrinsics.cx)[None, :] / intrinsics.fx
        y = (np.arange(intrinsics.height) - intrinsics.cy)[:, None] / intrinsics.fy
        down = -(m[2, 0] * x + m[2, 1] * y + m[2, 2])
        across = (m[1, 0] * x + m[1, 1] * y + m[1, 2]) * m[2, 3] / down + m[1, 3]
        floor = (m[2, 3] + self.floor_m) / down
        beside = np.abs(across) > self.width_m / 2
        depth_m[beside] = floor[beside]


@dataclass(frozen=True, slots=True)
class World:
    """All that is needed to render any frame; `heave` None: the belt runs level.

    Attributes:
        fixed: what is mounted on the frame and does not ride, vertices in belt coordinates.
        edges: the belt's two edges; None: it reaches beyond the view.
    """

    bodies: tuple[Body, ...]
    belt: Belt
    motion: BeltMotion
    cameras: tuple[CameraPose, ...]
    heave: Heave | None = None
    fixed: tuple[Body, ...] = ()
    edges: Edges | None = None


def mount(
    distance_m: float, *, x_m: float = 0.0, y_m: float = 0.0, tilt_deg: tuple[float, float] = (0.0, 0.0)
) -> NDArray[np.float64]:
    """(4, 4) belt_from_camera whose optical axis meets the belt at (x, y) after `distance_m`, tilted about u and v."""
    about_u = rotation_about(np.array([1.0, 0.0, 0.0]), np.radians(tilt_deg[0]))
    about_v = rotation_about(np.array([0.0, 1.0, 0.0]), np.radians(tilt_deg[1]))
    belt_from_camera = straight_down_belt_from_camera(distance_m)
    belt_from_camera[:3, :3] = belt_from_camera[:3, :3] @ about_u @ about_v
    belt_from_camera[:3, 3] = np.array([x_m, y_m, 0.0]) - belt_from_camera[:3, 2] * distance_m
    return belt_from_camera


def render(
    world: World,
    camera: CameraPose,
    travel_m: float,
    *,
    time_s: float = 0.0,
    window: Window | None = None,
    aside_m: float = 0.0,
) -> Canvas:
    """What `camera` truly sees when the belt has moved `travel_m`; ids are the bodies'.

    Args:
        time_s: of the heave. window: the part that is drawn, which may reach beyond the image; None: the image.
        aside_m: how far to the right of the camera what looks is, a second imager say.
    """
    k = camera.optics.intrinsics
    if window is not None:
        k = Intrinsics(window.width, window.height, k.fx, k.fy, k.cx - window.u0, k.cy - window.v0)
    belt_from_camera = to_the_right(heaved(world, camera, time_s), aside_m)
    camera_from_belt = inverse_rigid(belt_from_camera)
    depth = belt_depth(
        world.belt,
        intrinsics=k,
        belt_from_camera=belt_from_camera,
        travel_m=travel_m,
        u0=0,
        v0=0,
        height=k.height,
        width=k.width,
    )
    if world.edges is not None:
        world.edges.beside(depth, k, belt_from_camera)
    canvas = canvas_over(depth, whole_image(k))
    view_x, view_half = camera.belt_from_camera[0, 3], 1.2 * camera.belt_from_camera[2, 3] * k.height / (2 * k.fy)
    for body in world.bodies:
        if abs(body.place[0] + travel_m - view_x) < view_half + REACH_M:
            points = transform_points(camera_from_belt, body.vertices_at(travel_m) + np.array([travel_m, 0.0, 0.0]))
            draw(canvas, points, body.faces, intrinsics=k, instance=body.body_id)
    for body in world.fixed:
        draw(canvas, transform_points(camera_from_belt, body.vertices), body.faces, intrinsics=k, instance=body.body_id)
    return canvas if window is None else replace(canvas, window=window)


def to_the_right(belt_from_camera: NDArray[np.float64], aside_m: float) -> NDArray[np.float64]:
    """(4, 4) of an imager so far to the right of the camera."""
    moved = belt_from_camera.copy()
    moved[:3, 3] += moved[:3, 0] * aside_m
    return moved


def heaved(world: World, camera: CameraPose, time_s: float) -> NDArray[np.float64]:
    """(4, 4) belt_from_camera at `time_s`: belt and load rise and fall."""
    belt_from_camera = camera.belt_from_camera
    if world.heave is not None:
        belt_from_camera = belt_from_camera.copy()
        belt_from_camera[2, 3] -= world.heave.height_m(time_s)
    return belt_from_camera


def own_frames(world: World, camera: CameraPose, travel_m: float, *, time_s: float = 0.0) -> NDArray[np.float64]:
    """(n + 1, 4, 4) for belt (0) and bodies the frame that moves with each, from the camera's."""
    belt_from_camera = heaved(world, camera, time_s)
    riding = belt_from_camera.copy()
    riding[0, 3] -= travel_m
    numbers = [body.body_id for body in (*world.bodies, *world.fixed)]
    frames = np.tile(riding, (max(numbers, default=0) + 1, 1, 1))
    for body in world.bodies:
        if body.drift is not None:
            frames[body.body_id] = rigid_between(body.vertices_at(travel_m), body.vertices) @ riding
    for body in world.fixed:
        frames[body.body_id] = belt_from_camera
    return frames


def rigid_between(start: Vertices, end: Vertices) -> NDArray[np.float64]:
    """(4, 4) the rigid motion that brings (V, 3) `start` to `end`, by least squares."""
    a, b = start.mean(axis=0), end.mean(axis=0)
    u, _, vt = np.linalg.svd((end - b).T @ (start - a))
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = turn, b - turn @ a
    return moved


def crossing_travel_m(body: Body, camera: CameraPose) -> float | None:
    """Belt travel at which the body's centre lies on the camera's centre row, or None where it passes unseen.

    The centre row v = cy is the plane y = 0 of the camera. Unseen: beside the image, or in the strip at its left that
    the right imager does not see.
    """
    camera_from_belt = inverse_rigid(camera.belt_from_camera)
    row = camera_from_belt[1]
    place, x = body.place, 0.0
    for _ in range(1 if body.drift is None else 6):  # one that moves is met where it is when it crosses
        x = -(row[1] * place[1] + row[2] * place[2] + row[3]) / row[0]
        place = body.place_at(float(x - place[0]))
    centre = transform_points(camera_from_belt, np.array([[x, place[1], place[2]]]))[0]
    k = camera.optics.intrinsics
    u = k.fx * centre[0] / centre[2] + k.cx
    if not k.fx * BASELINE_M / centre[2] <= u < k.width:
        return None
    return float(x - place[0])
