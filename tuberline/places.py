"""Where the cameras of a recording hang, and what its tubers lie on, as a line's file says it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from conveyor.camera_place import CameraPlace
from conveyor.config import load_config
from conveyor.config_camera import PLACE, CameraConfig, hang_together, not_apart
from conveyor.errors import InputError
from conveyor.formats.source import CameraDescription

KEYS = ("belt_distance_m", "belt_from_camera", *PLACE)
LIES = frozenset({"surface", "resting_offset_mm", "resting_sd_mm"})
"""Keys of `[belt]` that say what tubers lie on: where one is given, a recording's own word of it counts no more."""


def places_in(file: Path, cameras: Sequence[str]) -> dict[str, dict[str, Any]]:
    """By camera of a recording, what the section of that name in a line's file says of its place; nothing of any where
    the file has `[belt]` alone.

    Raises:
        ConfigError: no line's file.
        InputError: it says nothing of one of the cameras.
    """
    line = load_config(file)
    sections = line.cameras
    if not sections and "belt" in line.model_fields_set:
        return {}
    found = {
        camera: {key: value for key in KEYS if (value := getattr(sections[camera], key)) is not None}
        for camera in cameras
        if camera in sections
    }
    if silent := [camera for camera in cameras if not found.get(camera)]:
        raise InputError(
            f"--places {file} says nothing of camera {', '.join(silent)}: its section [cameras.{silent[0]}] needs "
            f"{' or '.join(KEYS[:2])}, as `tuberline calibrate cameras` prints them"
        )
    return found


def belt_in(file: Path) -> dict[str, Any]:
    """What a line's file says in `[belt]`; empty where it has no such section.

    Raises:
        ConfigError: no line's file.
    """
    return load_config(file).belt.model_dump(exclude_unset=True)


def hung_together(told: Sequence[CameraDescription], sections: Mapping[str, CameraConfig]) -> list[str]:
    """In words, which cameras of a recording hang at one place, by their sections or else by what it says itself."""
    poses = {d.name: d.belt_from_camera for d in told}
    places = {
        name: sections[name].place or (None if pose is None else CameraPlace.of(pose)) for name, pose in poses.items()
    }
    together = not_apart(places)
    return [hang_together(together)] if together else []
