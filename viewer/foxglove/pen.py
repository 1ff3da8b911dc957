"""Draws entries as Foxglove's messages on topics. Where they go, to a file or to the app, is the outlet's business."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from conveyor.geometry import Intrinsics
from conveyor.statistics import NORMAL_90
from viewer.foxglove import sdk
from viewer.scene.primitives import (
    Bars,
    Box,
    ColorPicture,
    DepthPicture,
    Entry,
    Gone,
    Lens,
    LogLine,
    Measured,
    Number,
    Page,
    Pose,
    Shift,
)

TRANSFORMS, SCENE, LOG = "/tf", "/tubers", "/log"
RIDING_PATH, CAMERA_PATH = "/belt/riding", "/belt/camera/"
CLOUD_EVERY_NS = 100_000_000
"""A camera's points take most of the bytes: ten a second of them do beside thirty pictures."""
LOAD_AT_M = (0.0, 0.0, 0.16)
"""Where the load's words stand: over the middle of the picture."""


class Outlet(Protocol):
    """Takes messages: one of Foxglove's schemas, or a plain value that is sent as JSON."""

    def wants(self, topic: str, kind: str) -> bool:
        """Somebody takes messages of `topic`, whose schema is `kind`; makes the topic known at its first call."""
        ...

    def put(self, topic: str, message: Any, captured_ns: int) -> None:
        """Send a message of a topic that is wanted."""
        ...


@dataclass(frozen=True, slots=True)
class Said:
    """An entity of the scene as it was drawn last."""

    box: Box | None
    text: str
    values: tuple[tuple[str, float], ...]
    captured_ns: int


class Pen:
    """Keeps what always holds, so that a picture carries its own calibration and a new listener gets the scene.

    Foxglove plays one time: what is drawn back into the past (a counted tuber's box, from the moment at which it came
    into the picture) stands from now on.
    """

    def __init__(self, outlet: Outlet) -> None:
        self._outlet = outlet
        self._lenses: dict[str, Intrinsics] = {}
        self._poses: dict[str, Pose] = {}
        self._scene: dict[str, Said] = {}
        self._shift: tuple[float, int] | None = None
        self._newest_ns = 0
        self._begun = False
        self._cloud_ns: dict[str, int] = {}
        self._figures: dict[str, tuple[str, Any, int]] = {}

    def draw(self, entry: Entry) -> None:
        """Send one entry; kinds that Foxglove has no use for are left out."""
        if entry.moment is not None and not isinstance(entry.primitive, Number):  # a number says its own time
            self._newest_ns = max(self._newest_ns, entry.moment.captured_ns)
            if not self._begun:
                self._begun = True
                self.again()
        draw = _DRAWN.get(type(entry.primitive))
        if draw is not None:
            draw(self, entry, entry.primitive)

    def again(self) -> None:
        """Send the scene as it stands: someone listens who was not there before."""
        for camera in self._poses:
            self._put_pose(camera)
        if self._shift is not None:
            self._put(TRANSFORMS, "FrameTransform", lambda ns: sdk.travel_transform(self._shift_m(), ns))
        if self._scene:
            self._put(SCENE, "SceneUpdate", lambda ns: sdk.scene([self._entity(n) for n in self._scene], [], ns))
        for topic, (kind, value, captured_ns) in self._figures.items():
            self._send_figure(topic, kind, value, captured_ns)

    def forget(self) -> None:
        """Another run begins: nothing of this one stays in the scene."""
        gone = list(self._scene)
        self._scene.clear()
        self._cloud_ns.clear()
        self._figures.clear()
        self._shift, self._newest_ns, self._begun = None, 0, False
        if gone:
            self._put(SCENE, "SceneUpdate", lambda ns: sdk.scene([], gone, ns))

    @property
    def _now(self) -> int:
        return self._newest_ns

    def _shift_m(self) -> float:
        return 0.0 if self._shift is None else self._shift[0]

    def _figure(self, topic: str, kind: str, value: dict[str, Any], captured_ns: int | None = None) -> None:
        """Numbers as JSON; the last of each is kept."""
        said = (kind, value, self._now if captured_ns is None else captured_ns)
        self._figures[topic] = said
        self._send_figure(topic, *said)

    def _send_figure(self, topic: str, kind: str, message: Any, captured_ns: int) -> None:
        if self._outlet.wants(topic, kind):
            self._outlet.put(topic, message, captured_ns)

    def _put(self, topic: str, kind: str, make: Callable[[int], Any]) -> None:
        """Make a message only where somebody takes it."""
        if self._outlet.wants(topic, kind):
            self._outlet.put(topic, make(self._now), self._now)

    def _lens(self, entry: Entry, lens: Lens) -> None:
        self._lenses[entry.path] = lens.intrinsics

    def _pose(self, entry: Entry, pose: Pose) -> None:
        camera = entry.path.removeprefix(CAMERA_PATH)
        self._poses[camera] = pose
        if self._begun:
            self._put_pose(camera)

    def _put_pose(self, camera: str) -> None:
        pose = self._poses[camera].belt_from_camera
        frame = sdk.camera_frame(camera)
        self._put(TRANSFORMS, "FrameTransform", lambda ns: sdk.pose_transform(pose, frame, ns))

    def _depth(self, entry: Entry, picture: DepthPicture) -> None:
        camera = entry.path.removeprefix(CAMERA_PATH).split("/")[0]
        lens, frame = self._lenses[f"{CAMERA_PATH}{camera}/image"], sdk.camera_frame(camera)
        if camera in self._poses:
            self._put_pose(camera)
        topic = f"/{camera}"
        self._put(f"{topic}/depth/calibration", "CameraCalibration", lambda ns: sdk.calibration(lens, frame, ns))
        self._put(f"{topic}/depth/image", "RawImage", lambda ns: sdk.depth_image(picture, frame, ns))
        if self._now - self._cloud_ns.get(camera, -CLOUD_EVERY_NS) >= CLOUD_EVERY_NS:
            self._cloud_ns[camera] = self._now
            self._put(f"{topic}/points", "PointCloud", lambda ns: sdk.depth_cloud(picture, lens, frame, ns))

    def _color(self, entry: Entry, picture: ColorPicture) -> None:
        camera = entry.path.removeprefix(CAMERA_PATH).split("/")[0]
        lens, frame = self._lenses[f"{CAMERA_PATH}{camera}/color"], sdk.camera_frame(camera)
        topic = f"/{camera}/color"
        self._put(f"{topic}/calibration", "CameraCalibration", lambda ns: sdk.calibration(lens, frame, ns))
        self._put(f"{topic}/image", "CompressedImage", lambda ns: sdk.color_image(picture.jpeg, frame, ns))

    def _travel(self, entry: Entry, shift: Shift) -> None:
        self._shift = (shift.x_m, self._now)
        self._put(TRANSFORMS, "FrameTransform", lambda ns: sdk.travel_transform(shift.x_m, ns))

    def _box(self, entry: Entry, box: Box) -> None:
        self._say(entry.path, Said(box, "", box.values, self._now))

    def _gone(self, entry: Entry, _: Gone) -> None:
        if self._scene.pop(entry.path, None) is not None:
            self._put(SCENE, "SceneUpdate", lambda ns: sdk.scene([], [entry.path], ns))

    def _page(self, entry: Entry, page: Page) -> None:
        lines = [line for line in page.markdown.split("\n\n") if line]
        headline = "\n".join(line.removeprefix("# ").replace("**", "") for line in lines[:2])
        self._say(entry.path, Said(None, headline, (), self._now))
        self._figure(entry.path, "text", {"markdown": page.markdown})

    def _say(self, name: str, said: Said) -> None:
        before = self._scene.get(name)
        if before is not None and (before.box, before.text, before.values) == (said.box, said.text, said.values):
            return
        self._scene[name] = said
        if self._begun:
            self._put(SCENE, "SceneUpdate", lambda ns: sdk.scene([self._entity(name)], [], ns))

    def _entity(self, name: str) -> Any:
        said = self._scene[name]
        if said.box is None:
            return sdk.text_entity(said.text, name, LOAD_AT_M, self._now)
        frame = sdk.RIDING if name.startswith(RIDING_PATH) else sdk.BELT
        return sdk.box_entity(said.box, name, frame, self._now, dict(said.values))

    def _number(self, entry: Entry, number: Number) -> None:
        value = {"value": number.value, **dict(number.values)}
        self._figure(entry.path, "number", value, entry.moment.captured_ns if entry.moment else None)

    def _measured(self, entry: Entry, measured: Measured) -> None:
        half = NORMAL_90 * measured.sigma
        value = {"value": measured.value, "low_90": measured.value - half, "high_90": measured.value + half}
        self._figure(entry.path, "measured", {**value, "unit": measured.unit})

    def _bars(self, entry: Entry, bars: Bars) -> None:
        self._figure(entry.path, "bars", {"step": bars.step, "counts": list(bars.counts)})

    def _log(self, entry: Entry, line: LogLine) -> None:
        name = entry.path.removeprefix("/log/")
        self._put(LOG, "Log", lambda ns: sdk.log_line(line.text, name, line.level, ns))


_DRAWN: dict[type[Any], Callable[[Pen, Entry, Any], None]] = {
    Lens: Pen._lens,
    Pose: Pen._pose,
    DepthPicture: Pen._depth,
    ColorPicture: Pen._color,
    Shift: Pen._travel,
    Box: Pen._box,
    Gone: Pen._gone,
    Page: Pen._page,
    Number: Pen._number,
    Measured: Pen._measured,
    Bars: Pen._bars,
    LogLine: Pen._log,
}

_NUMBER = {"type": "number"}
JSON_SCHEMAS: dict[str, dict[str, Any]] = {
    "text": {"type": "object", "properties": {"markdown": {"type": "string"}}},
    "number": {
        "type": "object",
        "properties": {
            "value": _NUMBER,
            **dict.fromkeys(("tuber_id", "low_g", "high_g", "place_x_m", "place_y_m"), _NUMBER),
        },
    },
    "measured": {
        "type": "object",
        "properties": {"value": _NUMBER, "low_90": _NUMBER, "high_90": _NUMBER, "unit": {"type": "string"}},
    },
    "bars": {"type": "object", "properties": {"step": _NUMBER, "counts": {"type": "array", "items": _NUMBER}}},
}
"""What is no schema of Foxglove's: plain numbers, which its Plot panel draws from JSON."""


def encoded(kind: str, message: Any) -> bytes:
    """A message as its bytes."""
    return json.dumps(message).encode() if kind in JSON_SCHEMAS else bytes(message.encode())


def schema_of(kind: str) -> tuple[str, str, str, bytes]:
    """(message encoding, schema name, schema encoding, schema) of a kind."""
    if kind in JSON_SCHEMAS:
        return "json", f"tuberline.{kind}", "jsonschema", json.dumps(JSON_SCHEMAS[kind]).encode()
    schema = getattr(sdk.schemas, kind).get_schema()
    return "protobuf", schema.name, schema.encoding, schema.data
