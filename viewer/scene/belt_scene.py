"""The picture of the belt: cameras, depth, tubers that ride with their weights. Messages in, primitives out.

Boxes and clouds hang below `/belt/riding`, whose only content is the belt's travel: each is drawn once at its place and
moves with the belt by itself. A tuber is known only after it was weighed, so its box is drawn from the moment on at
which it came into the picture, in the past: in a recording every potato carries its weight from edge to edge. Until
then, live, it has a provisional box (`viewer.scene.provisional`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conveyor.messages import Frame, TrackEntry, TracksInView, Travel, Tuber, View
from viewer.scene.primitives import (
    BeltAxes,
    Box,
    Cloud,
    Color,
    ColorPicture,
    DepthPicture,
    Entry,
    Gone,
    Layout,
    Lens,
    Moment,
    Number,
    PlotStyle,
    Pose,
    Shift,
)
from viewer.scene.profiles import Profile
from viewer.scene.provisional import Provisional
from viewer.scene.shapes import camera_pose, footprint_m, strided, tuber_box, yaw_rad
from viewer.scene.travel_log import TravelLog

SLOTS = 192
"""Tubers and clouds drawn at once; a later one takes the place of the one `SLOTS` before it."""
RIDE_ON_M = 0.45
"""How far behind the last camera's picture a tuber stays drawn."""
UNKNOWN_REACH_M = 0.3
"""Half the length and width of belt drawn while no camera was seen, as in the light profile."""
BELT_COLOR: Color = (52, 54, 58)
CLOUD_COLOR: Color = (222, 184, 120)
NEAREST_TOP_M = 0.1


class BeltScene:
    """State of the picture; every method returns what has to be drawn now."""

    def __init__(self, profile: Profile) -> None:
        self._profile = profile
        self._travel = TravelLog()
        self._shown_tick: dict[str, int] = {}
        self._calibration: dict[str, tuple[object, ...]] = {}
        self._drawn: dict[str, tuple[str, int, int]] = {}
        self._footprints: dict[str, tuple[float, float, float, float]] = {}
        self._riding: dict[str, float] = {}
        self._yaw: dict[str, float] = {}
        self._boxes = 0
        self._provisional = Provisional(self._new_path)
        self._clouds = 0
        self._with_field = False
        self.newest: Moment | None = None
        self.counted_until: Moment | None = None
        """When the last counted tuber crossed; the start while there is none. What the totals are the totals of."""

    def opening(self) -> list[Entry]:
        """What holds from the start."""
        surface = [] if self._profile.pictures else [self._surface()]
        return [
            *surface,
            Entry("/belt", BeltAxes(), None),
            Entry("/tuber/weight_g", PlotStyle("each tuber, g", (240, 190, 90), points=True), None),
            Entry("layout", self._layout(), None),
        ]

    def with_field(self) -> list[Entry]:
        """From now on the window has the field's map beside the belt."""
        self._with_field = True
        return [Entry("layout", self._layout(), None)]

    def on_frame(self, frame: Frame) -> list[Entry]:
        """Draw a frame if it is its turn; [] when the profile shows fewer pictures than come."""
        moment = Moment(frame.captured_ns, frame.seq)
        entries: list[Entry] = []
        if frame.travel_m is not None:
            entries += self._on_travel(moment, frame.travel_m, source="frames", estimated=False)
        self._advance(moment)
        if not self._due(frame.camera, frame.captured_ns):
            return entries
        travel_m = self._travel.at(frame.captured_ns)
        if travel_m is not None:  # boxes must lie on this very picture, not where the belt was at the last one
            entries.append(Entry("/belt/riding", Shift(travel_m), moment))
        pose = camera_pose(frame)
        entries += self._calibrate(frame, pose)
        stride = self._profile.stride
        image = f"/belt/camera/{frame.camera}/image"
        far_m = frame.belt_distance_m or (None if pose is None else float(-pose[2, 3] / pose[2, 2]))
        picture = DepthPicture(
            frame.depth[::stride, ::stride],
            frame.depth_scale_m,
            None if far_m is None else (far_m, max(far_m - NEAREST_TOP_M, 0.0)),
        )
        entries.append(Entry(f"{image}/depth", picture, moment, heavy=True))
        if frame.color_jpeg is not None:
            jpeg = ColorPicture(frame.color_jpeg.tobytes())
            entries.append(Entry(f"/belt/camera/{frame.camera}/color/picture", jpeg, moment, heavy=True))
        return entries

    def on_travel(self, travel: Travel) -> list[Entry]:
        """Move the belt."""
        moment = Moment(travel.captured_ns)
        self._advance(moment)
        return self._on_travel(moment, travel.travel_m, source=travel.source, estimated=travel.estimated)

    def on_known_travel(self, moment: Moment, travel_m: float) -> list[Entry]:
        """Move the belt as a ledger says that it moved."""
        return self._on_travel(moment, travel_m, source="ledger", estimated=True)

    @property
    def enters_at_m(self) -> float:
        """Belt x at which a tuber comes into the first picture, metres."""
        return self._reach()[0]

    def on_track(self, entry: TrackEntry) -> list[Entry]:
        """Move the belt by the marks of a camera's log: what remains where neither frames nor an encoder are heard."""
        if entry.mark is None:
            return []
        moment = Moment(entry.mark.captured_ns)
        self._advance(moment)
        source = f"track/{entry.camera}"
        return self._on_travel(moment, entry.mark.travel_m, source=source, estimated=True)

    def on_view(self, view: View) -> list[Entry]:
        """The cloud of one tuber, riding from the moment it was seen; [] for views the profile leaves out."""
        moment = Moment(view.captured_ns, view.seq)
        self._advance(moment)
        if self._profile.best_views_only and view.rank > 0:
            return []
        points = view.points_in_belt_m()
        if len(points) == 0:
            return []
        self._remember_yaw(view.track_id, points)
        points = points[:: -(-len(points) // self._profile.cloud_points)]
        travel_m = self._travel.at(view.captured_ns)
        if travel_m is None:  # the belt's travel is unknown: the cloud can be shown where it was seen, but not ride
            path = f"/belt/camera_view/{view.camera}"
            return [Entry(path, Cloud(points.astype(np.float32), CLOUD_COLOR), moment, heavy=True)]
        points[:, 0] -= travel_m
        path = f"/belt/riding/cloud/{self._clouds % SLOTS:02d}"
        self._clouds += 1
        self._riding[path] = float(points[:, 0].mean())
        return [Entry(path, Cloud(points.astype(np.float32), CLOUD_COLOR), moment, heavy=True)]

    def on_in_view(self, message: TracksInView) -> list[Entry]:
        """Boxes of what is in view and not counted yet."""
        return self._provisional.seen(message)

    def on_tuber(self, tuber: Tuber) -> list[Entry]:
        """The box of a counted tuber, from the moment it came into the picture, and its dot in the plot."""
        crossed = self._travel.nearest(tuber.crossed_ns)
        self._advance(crossed)
        if self.counted_until is None or crossed.captured_ns >= self.counted_until.captured_ns:
            self.counted_until = crossed
        path, drawn, gone = self._provisional.counted(tuber.tracks)
        path = path or self._new_path()
        appears = self._travel.when(self._reach()[0] - tuber.place_x_m)
        start = appears if appears is not None and appears.captured_ns <= crossed.captured_ns else crossed
        yaw = next((self._yaw[track] for track in tuber.tracks if track in self._yaw), None)
        details = (
            ("tuber_id", float(tuber.tuber_id)),
            ("low_g", tuber.low_g),
            ("high_g", tuber.high_g),
            ("place_x_m", tuber.place_x_m),
            ("place_y_m", tuber.place_y_m),
        )
        box = tuber_box(tuber, yaw)
        entries = [
            *gone,
            Entry(path, box, start),
            *(Entry(path, box, moment) for moment in drawn if moment.captured_ns != start.captured_ns),
            Entry("/tuber/weight_g", Number(tuber.weight_g, details), crossed),
        ]
        left = self._travel.when(self._reach()[1] + RIDE_ON_M - tuber.place_x_m)
        if left is None:
            self._riding[path] = tuber.place_x_m
        elif left.captured_ns > start.captured_ns:  # counted only after it had ridden out of the picture
            entries.append(Entry(path, Gone(), left))
        return entries

    def _on_travel(self, moment: Moment, travel_m: float, *, source: str, estimated: bool) -> list[Entry]:
        if not self._travel.add(moment, travel_m, source=source, estimated=estimated):
            return []
        if not self._due("/belt/riding", moment.captured_ns):
            return []
        gone = [path for path, place in self._riding.items() if place + travel_m > self._reach()[1] + RIDE_ON_M]
        for path in gone:
            del self._riding[path]
        return [
            Entry("/belt/riding", Shift(travel_m), moment),
            *(Entry(path, Gone(), moment) for path in gone),
        ]

    def _new_path(self) -> str:
        path = f"/belt/riding/tuber/{self._boxes % SLOTS:02d}"
        self._boxes += 1
        return path

    def _due(self, what: str, captured_ns: int) -> bool:
        """Whether `what` was not drawn yet in this tick of capture time.

        All cameras share the ticks, so that their pictures are of nearly the same moment: boxes fit only one travel.
        """
        tick = captured_ns * self._profile.rate_hz // 1_000_000_000
        if self._shown_tick.get(what) == tick:
            return False
        self._shown_tick[what] = tick
        return True

    def _advance(self, moment: Moment) -> None:
        if self.newest is None or moment.captured_ns >= self.newest.captured_ns:
            self.newest = moment
        if self.counted_until is None:
            self.counted_until = moment

    def _calibrate(self, frame: Frame, pose: NDArray[np.float64] | None) -> list[Entry]:
        """Lens and pose of the frame's camera when they are new, and the belt below it."""
        key = (frame.intrinsics, None if pose is None else pose.tobytes(), frame.color_jpeg is not None)
        if self._calibration.get(frame.camera) == key:
            return []
        self._calibration[frame.camera] = key
        camera = f"/belt/camera/{frame.camera}"
        distance_m = frame.belt_distance_m
        drawn = strided(frame.intrinsics, self._profile.stride)
        self._drawn[frame.camera] = (frame.camera, drawn.width, drawn.height)
        entries = [Entry(f"{camera}/image", Lens(drawn, distance_m), None)]
        if frame.color_jpeg is not None:
            entries.append(Entry(f"{camera}/color", Lens(frame.intrinsics, distance_m), None))
        if pose is not None:
            self._footprints[frame.camera] = footprint_m(frame.intrinsics, pose)
            entries += [Entry(camera, Pose(pose), None), self._surface()]
        return [*entries, Entry("layout", self._layout(), None)]

    def _surface(self) -> Entry:
        """The belt itself, below everything any camera sees and some way on."""
        x0, x1, y0, y1 = self._extent()
        thickness_m = 0.006
        center = ((x0 + x1) / 2, (y0 + y1) / 2, -thickness_m)  # a little below z = 0, or it hides the belt's own depth
        half = ((x1 - x0) / 2, (y1 - y0) / 2, thickness_m / 2)
        return Entry("/belt/surface", Box(center, half, BELT_COLOR, solid=True), None)

    def _extent(self) -> tuple[float, float, float, float]:
        """(x0, x1, y0, y1) of the belt that is drawn, metres."""
        x0, x1 = self._reach()
        sides = [p[2:] for p in self._footprints.values()] or [(-UNKNOWN_REACH_M, UNKNOWN_REACH_M)]
        return x0, x1 + RIDE_ON_M, min(y[0] for y in sides), max(y[1] for y in sides)

    def _reach(self) -> tuple[float, float]:
        """Belt x at which a tuber enters the first picture and leaves the last one, metres."""
        if not self._footprints:
            return -UNKNOWN_REACH_M, UNKNOWN_REACH_M
        prints = self._footprints.values()
        return min(p[0] for p in prints), max(p[1] for p in prints)

    def _layout(self) -> Layout:
        x0, x1, y0, y1 = self._extent()
        return Layout(tuple(sorted(self._drawn.values())), self._profile.pictures, (x0, x1), (y0, y1), self._with_field)

    def _remember_yaw(self, track_id: str, points: NDArray[np.float64]) -> None:
        """Heading of the cloud's longest horizontal axis; kept for the box that follows."""
        self._yaw[track_id] = yaw_rad(points)
        while len(self._yaw) > 4 * SLOTS:
            del self._yaw[next(iter(self._yaw))]
