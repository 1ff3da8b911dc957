"""A source as a line uses it: named by the line, with the config's overrides, its depth scale checked."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from conveyor.camera_place import CameraPlace
from conveyor.errors import InputError
from conveyor.formats.scale_check import ScaleCheck
from conveyor.formats.source import CameraDescription, FrameKey, RecordedSource, Refused
from conveyor.formats.turned import QuarterTurn, quarter_turn
from conveyor.geometry import belt_distance_m as distance_along_axis_m
from conveyor.messages import Frame

MOST_MISFITS = 10
"""Frames at a recording's start that contradict its belt distance, before one that fits: a camera that settles, a hand
before it. Where there are more, or no other, the depth unit or the distance is wrong."""


class PreparedSource:
    """Wraps a source. Overrides are applied before the check, so a wrong scale is repaired by giving the right one."""

    def __init__(
        self,
        inner: RecordedSource,
        *,
        where: str,
        name: str | None = None,
        belt_distance_m: float | None = None,
        place: CameraPlace | None = None,
        belt_from_camera: NDArray[np.float64] | None = None,
        depth_scale_m: float | None = None,
        ignore_masks: bool = False,
    ) -> None:
        self._inner = inner
        self._where = where
        self._ignore_masks = ignore_masks
        d = inner.description
        matrix = d.belt_from_camera
        if belt_distance_m is not None and matrix is not None:
            matrix = _at_distance(matrix, belt_distance_m)
        if belt_from_camera is not None:
            matrix = belt_from_camera
        elif place is not None:
            matrix = _at_place(place, matrix, belt_distance_m or d.belt_distance_m, where=where)
        self._description = replace(
            d,
            name=name or d.name,
            belt_distance_m=d.belt_distance_m if belt_distance_m is None else belt_distance_m,
            depth_scale_m=d.depth_scale_m if depth_scale_m is None else depth_scale_m,
            belt_from_camera=matrix,
        )
        overrides = (belt_distance_m, place, belt_from_camera, depth_scale_m)
        self._as_is = name in (None, d.name) and all(given is None for given in overrides)

    @property
    def description(self) -> CameraDescription:
        """With name and overrides applied, and turned where the belt runs along the image's columns."""
        return self.turn.description(self._description) if self.turn else self._description

    @property
    def turn(self) -> QuarterTurn | None:
        """What is done to the frames of a belt that runs along the image's columns."""
        return quarter_turn(self._description.belt_from_camera)

    def keys(self) -> list[FrameKey]:
        """Of all frames in their order."""
        return self._inner.keys()

    def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
        """The source's frames, with name and overrides, turned where the belt runs along the image's columns.

        Raises:
            InputError: the depth scale contradicts the belt distance in all of the first frames.
        """
        d, turn, scale = self._description, self.turn, ScaleCheck(self._where)
        for frame in self._inner.frames(run=run, after=after):
            if isinstance(frame, Refused):
                yield frame
                continue
            if not self._as_is:
                frame = replace(
                    frame,
                    camera=d.name,
                    depth_scale_m=d.depth_scale_m,
                    belt_distance_m=d.belt_distance_m,
                    belt_from_camera=d.belt_from_camera,
                )
            if self._ignore_masks and frame.mask is not None:
                frame = replace(frame, mask=None)
            if (refused := scale.refusal(frame)) is not None:
                if scale.against and scale.misfits >= MOST_MISFITS:
                    raise InputError(scale.against.text)
                yield refused
                continue
            yield turn.frame(frame) if turn else frame
        if scale.against:
            raise InputError(scale.against.text)


def _at_place(
    place: CameraPlace, belt_from_camera: NDArray[np.float64] | None, distance_m: float | None, *, where: str
) -> NDArray[np.float64]:
    """(4, 4) the recorded height and tilt, at another place."""
    if belt_from_camera is not None:
        return place.put(belt_from_camera)
    if distance_m is None:
        raise InputError(f"{where}: a camera's place needs its belt_distance_m, which the recording does not say")
    return place.straight_down(distance_m)


def _at_distance(belt_from_camera: NDArray[np.float64], distance_m: float) -> NDArray[np.float64]:
    """(4, 4) the same direction and the same point on the belt, seen from another distance."""
    moved = belt_from_camera.copy()
    moved[:3, 3] += belt_from_camera[:3, 2] * (distance_along_axis_m(belt_from_camera) - distance_m)
    return moved
