"""Where the cameras of a line hang over its belt, from a recording of all of them with load on the belt.

Each camera's height and tilt are those of the plane that it sees, how it is turned is told by the way its load moves,
and where it hangs beside another camera by the tubers that both see.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from conveyor.camera_place import CameraPlace
from conveyor.common_places import Offset, Places, common_offset
from conveyor.errors import InputError
from conveyor.formats.cameras import CameraFrames
from conveyor.formats.scale_check import expected_distance_m
from conveyor.formats.turned import quarter_turn
from conveyor.geometry import straight_down_belt_from_camera
from conveyor.messages import Frame, Track
from conveyor.resting import RestingLevel
from segmenter.calibrate import BeltCalibration, calibrate_camera
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.belt_direction import BeltDirection, heading_of
from segmenter.frame.heights import height_map
from segmenter.frame.plane import leaning_pose
from segmenter.perception import Perception, PerceptionSettings
from segmenter.pipeline import Segmenter, Settings

OnFrames = Callable[[str, int, int | None], None]
"""Called with what is read, and how many frames of it; how many there are is not known."""
ALONG_M = 6.0
ACROSS_M = 3.0
"""How far apart cameras of one belt may hang."""
MOST_TRACKS = 1500
"""Of each camera: more make it no more certain, and every one of them is compared with every one of another camera."""
SETTINGS = Settings(perception=PerceptionSettings(method="classical"), views_per_tuber=1)
"""A clod is as good as a tuber."""
OVER_RODS = replace(SETTINGS, resting=RestingLevel("rods"))
"""Where no belt is seen, a web of rods may be: the ground is seen through it, and is no belt."""


@dataclass(frozen=True, slots=True)
class SeenLoad:
    """What one camera saw, over the belt as it sees it.

    Attributes:
        belt: the plane; None where none is seen, as through rods: then the camera is taken to look straight down.
        distance_m: from the camera to the belt along the optical axis, as given, else as seen.
        direction: the way the load moves in that plane.
        pose: (4, 4) of the camera as it was recorded, at (0, 0): height, tilt and turn are known.
        tracks: bodies that crossed its centre row, in belt coordinates of that pose.
        travel: (n, 2) capture time in ns and travel in metres of its frames.
    """

    camera: str
    belt: BeltCalibration | None
    distance_m: float
    direction: BeltDirection
    pose: NDArray[np.float64]
    tracks: tuple[Track, ...]
    travel: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PlacedCamera:
    """One camera and where it hangs; `beside` is the camera by which that is known, '' where it is none.

    Attributes:
        belt_from_camera: (4, 4) of the camera as it was recorded.
        place: the same in words. Where `placed` is False it is not known where it hangs, only how it is turned.
        offset: as the tubers that both saw say it.
    """

    seen: SeenLoad
    belt_from_camera: NDArray[np.float64]
    placed: bool
    beside: str = ""
    offset: Offset | None = None

    @property
    def place(self) -> CameraPlace:
        """Where it hangs and how it is turned."""
        return CameraPlace.of(self.belt_from_camera)


def see_load(camera: CameraFrames, *, seconds: float, on_frame: OnFrames = lambda said, done, total: None) -> SeenLoad:
    """What one camera saw in the first `seconds` of its recording.

    Raises:
        InputError: no belt is seen and its distance is not given, or too little load moves on it to say which way it
            runs.
    """
    name, origin = camera.description.name, camera.description.origin
    belt, distance_m, plane = _plane(camera)
    perception = Perception(SETTINGS.perception, SETTINGS.split)
    direction = heading_of(_whole(frame, plane, perception) for frame in _first(camera, seconds, on_frame))
    if not direction.known:
        raise InputError(
            f"{origin}: under camera '{name}' load moved {direction.travelled_m:.2f} m in {len(direction.moves_m)} "
            "steps, too little to say which way the belt runs; record the belt while it carries tubers"
        )
    pose = CameraPlace(turned_deg=-direction.heading_deg).put(plane)
    turn = quarter_turn(pose)
    core = Segmenter(SETTINGS if belt else OVER_RODS)
    tracks: list[Track] = []
    travel: list[tuple[float, float]] = []
    for frame in _first(camera, seconds, on_frame):
        placed = replace(frame, belt_from_camera=pose, mask=None)
        tracks += [closed.track for closed in core.step(turn.frame(placed) if turn else placed).closed]
        travel.append((frame.captured_ns, core.travel_m))
    tracks += [closed.track for closed in core.finish()]
    recorded = camera.recorded_pose(pose)
    return SeenLoad(name, belt, distance_m, direction, recorded, tuple(tracks), np.array(travel, np.float64))


def _plane(camera: CameraFrames) -> tuple[BeltCalibration | None, float, NDArray[np.float64]]:
    """The belt's plane, its distance, and the (4, 4) pose of a camera at (0, 0) that is not turned."""
    try:
        belt, fit = calibrate_camera(camera)
    except InputError:
        first = next(iter(camera), None)
        given_m = None if first is None else expected_distance_m(first)
        if given_m is None:
            raise
        return None, given_m, straight_down_belt_from_camera(given_m)
    distance_m = belt.given_distance_m or fit.distance_m
    return belt, distance_m, leaning_pose(fit, distance_m)


def place_cameras(seen: Sequence[SeenLoad], *, first: CameraPlace) -> list[PlacedCamera]:
    """Every camera's place, the first one's being given; each of the others by the camera that shares most with it.

    Those that share no tubers with any of them are not placed.
    """
    reference = seen[0]
    places = {load.camera: _places(load, reference) for load in seen}
    found = {reference.camera: PlacedCamera(reference, _moved(reference.pose, first.along_m, first.across_m), True)}
    while rest := [load for load in seen if load.camera not in found]:
        offers = [
            (len(offset.pairs), load, known, offset)
            for load in rest
            for known in found.values()
            if (offset := _offset(places[known.seen.camera], places[load.camera])) is not None
        ]
        if not offers:
            break
        _, load, known, offset = max(offers, key=lambda offer: offer[0])
        origin = known.place
        pose = _moved(load.pose, origin.along_m - offset.along_m, origin.across_m - offset.across_m)
        found[load.camera] = PlacedCamera(load, pose, True, known.seen.camera, offset)
    return [found.get(load.camera) or PlacedCamera(load, load.pose, False) for load in seen]


def _offset(known: Places, other: Places) -> Offset | None:
    return common_offset(known, other, along_m=ALONG_M, across_m=ACROSS_M)


def _moved(pose: NDArray[np.float64], along_m: float, across_m: float) -> NDArray[np.float64]:
    moved = pose.copy()
    moved[0, 3], moved[1, 3] = along_m, across_m
    return moved


def _first(camera: CameraFrames, seconds: float, on_frame: OnFrames) -> Iterator[Frame]:
    began_ns: int | None = None
    for done, frame in enumerate(camera, start=1):
        began_ns = frame.captured_ns if began_ns is None else began_ns
        if (frame.captured_ns - began_ns) / 1e9 > seconds:
            return
        on_frame(f"camera {camera.description.name}", done, None)
        yield frame


def _whole(
    frame: Frame, pose: NDArray[np.float64], perception: Perception
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n, 2) centres and (n,) areas of what no border cuts."""
    belt = BeltGeometry(frame.intrinsics, pose)
    pixel_mm = SETTINGS.split.pixel_mm
    heights = height_map(frame.depth, depth_scale_m=frame.depth_scale_m, belt=belt, pixel_mm=pixel_mm)
    found = perception.find(heights, belt)
    whole = ~found.cut.any(axis=1)
    return np.asarray(found.centre_m[whole]), np.asarray(found.area_m2[whole])


def _places(load: SeenLoad, reference: SeenLoad) -> Places:
    """Of the whole bodies, along the belt by the reference's travel: each camera's own begins when it began."""
    ns, travel_m = reference.travel.T
    kept = [t for t in load.tracks if t.whole and t.visible_volume_ml > 0 and ns[0] <= t.crossed_ns <= ns[-1]]
    kept = kept[:MOST_TRACKS]
    at_m = np.interp([float(t.crossed_ns) for t in kept], ns, travel_m)
    xy_m = np.array([(t.crossed_x_m, t.y_m) for t in kept]).reshape(-1, 2)
    xy_m[:, 0] -= at_m
    return Places(xy_m, np.array([t.height_mm for t in kept]), np.array([t.visible_volume_ml for t in kept]))
