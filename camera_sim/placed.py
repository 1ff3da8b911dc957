"""A live camera that hangs where the line's config says."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from conveyor.config_camera import CameraConfig
from conveyor.formats import CameraDescription, PolledSource, Refused, Source
from conveyor.formats.turned import quarter_turn
from conveyor.messages import Frame


class PlacedSource:
    """Frames of a live source with the camera's pose, turned where the belt runs along the image's columns."""

    def __init__(self, inner: Source, belt_from_camera: NDArray[np.float64]) -> None:
        self._inner = inner
        self._pose = belt_from_camera
        self._turn = quarter_turn(belt_from_camera)

    @property
    def description(self) -> CameraDescription:
        """The source's, over the belt."""
        described = replace(self._inner.description, belt_from_camera=self._pose)
        return self._turn.description(described) if self._turn else described

    @property
    def reopened(self) -> int | None:
        """How often the device was opened again; None of a source that does not tell."""
        found: int | None = getattr(self._inner, "reopened", None)
        return found

    def attach(self, poll: Callable[[float], bool]) -> None:
        """As of the source."""
        if isinstance(self._inner, PolledSource):
            self._inner.attach(poll)

    def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
        """The source's frames as they come."""
        for item in self._inner.frames(run=run, after=after):
            if isinstance(item, Refused):
                yield item
            else:
                frame = replace(item, belt_from_camera=self._pose)
                yield self._turn.frame(frame) if self._turn else frame


def placed(source: Source, settings: CameraConfig) -> Source:
    """The source, where its section says of the camera's place; as it is where that says no more than the distance."""
    pose = settings.pose
    if pose is None and settings.place is not None and settings.belt_distance_m is not None:
        pose = settings.place.straight_down(settings.belt_distance_m)
    return source if pose is None else PlacedSource(source, pose)
