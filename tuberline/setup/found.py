"""Cameras that a line could have: RealSense devices, recordings near here, depth topics of a ROS 2 system."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from conveyor.config import LinkConfig
from conveyor.errors import InputError, TuberlineError
from conveyor.formats import describe_recording
from conveyor.formats.detect import Recording
from tuberline.replayer import stated_belt

NAMES = ("front", "rear", "left", "right")
"""Of cameras that have none of their own, in this order."""
LOOK_DEPTH, MOST_LOOKED_AT = 2, 300


@dataclass(frozen=True, slots=True)
class Found:
    """One source of frames with one or more cameras.

    Attributes:
        words: one line for people.
        cameras: of each camera its own name, or None, and the settings of its section.
        distance_known: the recording says how far its belt is.
        belt: settings of section `belt`, as the recording states them.
    """

    words: str
    cameras: tuple[tuple[str | None, dict[str, Any]], ...]
    distance_known: bool = False
    belt: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = field(default=())


def found_recordings(folder: Path) -> Iterator[Found]:
    """Recordings in `folder` and in the two levels of folders below it, hidden ones left out."""
    for path in _candidates(folder):
        try:
            yield found_recording(path)
        except TuberlineError:
            continue


def found_recording(path: Path) -> Found:
    """The recording at `path`.

    Raises:
        InputError: it is none.
    """
    recording: Recording = describe_recording(path)
    if not recording.cameras:
        raise InputError(f"{path} holds no frames of any camera")
    many = len(recording.cameras) > 1
    cameras = tuple(
        (
            camera.name,
            {"source": "recording", "path": path, **({"camera": camera.name} if many else {}), "speed": 1.0},
        )
        for camera in recording.cameras
    )
    frames = sum(camera.frames or 0 for camera in recording.cameras)
    names = ", ".join(camera.name for camera in recording.cameras)
    known = all(c.belt_distance_m is not None or c.belt_from_camera is not None for c in recording.cameras)
    words = f"recording {path}: {frames} frame{'s' * (frames != 1)} of {'cameras' if many else 'camera'} {names}"
    belt = stated_belt(recording.cameras)
    return Found(words, cameras, distance_known=known, belt=belt)


def _candidates(folder: Path) -> Iterator[Path]:
    """What may be a recording, by its name alone; nothing inside of one."""
    waiting, looked = [(folder, 0)], 0
    while waiting and looked < MOST_LOOKED_AT:
        here, depth = waiting.pop(0)
        if depth and any((here / name).is_file() for name in ("metadata.yaml", "line.json", "camera.json")):
            yield here
            continue
        try:
            entries = sorted(os.scandir(here), key=lambda entry: entry.name)
        except OSError:
            continue
        looked += len(entries)
        below = [Path(entry.path) for entry in entries if entry.is_dir() and not entry.name.startswith(".")]
        if depth and any((one / "camera.json").is_file() or one.name == "1_rgbd" for one in below):
            yield here
            continue
        yield from (Path(entry.path) for entry in entries if entry.name.endswith((".mcap", ".bag", ".db3")))
        if depth < LOOK_DEPTH:
            waiting += [(one, depth + 1) for one in below]


def found_realsense() -> tuple[list[Found], str]:
    """Devices on this machine, and why none could be looked for (empty where it could)."""
    from camera_sim.live.realsense import connected_devices

    try:
        devices = connected_devices()
    except TuberlineError as error:
        return [], str(error)
    return [
        Found(f"{name}, serial number {serial}", ((None, {"source": "realsense", "serial": serial}),))
        for name, serial in devices
    ], ""


def found_ros2(router: str, domain: int) -> list[Found]:
    """Depth topics that a ROS 2 system publishes through its rmw_zenoh router.

    Raises:
        LinkError: no router answers there.
    """
    from camera_sim.live.ros2 import published_depth

    link = LinkConfig(router=router, connect_timeout_s=5.0)
    settings = {"source": "ros2", "ros_router": router, "ros_domain": domain}
    return [
        Found(f"ROS 2 topic {topic}", ((_camera_of(topic), {**settings, "topic": topic}),))
        for topic in published_depth(link, domain)
    ]


def _camera_of(topic: str) -> str | None:
    """'/front/depth/image_rect_raw' is front's."""
    before = [part for part in topic.split("/depth")[0].split("/") if part]
    return before[-1] if before else None


def named(found: Iterable[Found]) -> dict[str, dict[str, Any]]:
    """A section per camera: by its own name where a line may use it, else front, rear, ..."""
    sections: dict[str, dict[str, Any]] = {}
    for one in found:
        for name, settings in one.cameras:
            plain = "".join(letter if letter.isalnum() or letter in "._-" else "-" for letter in name or "").strip(
                "._-"
            )
            free = [free for free in (*NAMES, *(f"camera{n}" for n in range(5, 99))) if free not in sections]
            chosen = plain[:64] if plain and plain not in sections else free[0]
            own = {"camera": name} if settings["source"] == "recording" and chosen != name else {}
            sections[chosen] = {**settings, **own}
    return sections


def common_belt(found: Iterable[Found]) -> Mapping[str, float]:
    """The resting level that all sources state which state one; none where they differ."""
    stated = [one.belt for one in found if one.belt]
    return stated[0] if stated and all(belt == stated[0] for belt in stated) else {}
