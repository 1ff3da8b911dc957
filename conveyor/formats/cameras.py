"""All cameras of a recording, for commands that work without a line: what `replay` takes, they take."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import ConfigError, InputError
from conveyor.formats.detect import camera_names, open_source
from conveyor.formats.prepared import PreparedSource
from conveyor.formats.source import CameraDescription, Refused
from conveyor.messages import Frame
from conveyor.topics import check_name


class CameraFrames:
    """Readable frames of one camera. What cannot be read is counted, and the first text is kept.

    Attributes:
        unreadable: frames of the last reading that were refused, by reason.
        first_fault: what the first of them said.
    """

    def __init__(self, source: PreparedSource, on_frame: Callable[[], None] = lambda: None) -> None:
        self._source = source
        self._on_frame = on_frame
        self.unreadable: Counter[str] = Counter()
        self.first_fault = ""

    @property
    def description(self) -> CameraDescription:
        """Of the camera, turned where the belt runs along the image's columns."""
        return self._source.description

    def recorded_pose(self, belt_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
        """(4, 4) of the camera as it was recorded: what its camera.json takes, for a pose found in these frames."""
        turn = self._source.turn
        return turn.recorded_pose(belt_from_camera) if turn else belt_from_camera

    def __iter__(self) -> Iterator[Frame]:
        """Frames in their order, from the first.

        Raises:
            InputError: the depth scale contradicts the belt distance, or not one frame can be read.
        """
        self.unreadable.clear()
        readable = 0
        for item in self._source.frames(run="offline"):
            self._on_frame()
            if isinstance(item, Refused):
                self.unreadable[item.reason] += 1
                self.first_fault = self.first_fault or item.text
            else:
                readable += 1
                yield item
        if not readable:
            first = f"; the first: {self.first_fault}" if self.first_fault else ""
            raise InputError(f"{self.description.origin}: no frame can be read{first}")


def line_names(recording: Path) -> list[str]:
    """The cameras of a recording, each of which can be a line's, for its name becomes part of topics, ids and files.

    Raises:
        InputError: no recording, or a camera that no line can call so; says which, and what to rename.
    """
    names = list(camera_names(recording))
    for name in names:
        try:
            check_name(name, what="camera")
        except ConfigError as error:
            raise InputError(
                f"{recording}: {error}; rename the camera's folder, and its entry in line.json where there is one "
                "(of an .mcap file: `tuberline convert` it to a folder first)"
            ) from error
    return names


def check_readable(recording: Path) -> list[str]:
    """Names of a recording's cameras, each read up to its first readable frame. One that has none is among them: its
    frames are counted as lost, and the others' are worth as much as before.

    Raises:
        InputError: no camera has one; with what was said of the first that was refused. Or a depth scale contradicts
            the belt distance, or no line can call a camera so.
    """
    names = line_names(recording)
    found = [_first(open_source(recording, camera=name)) for name in names]
    if not any(isinstance(item, Frame) for item in found):
        fault = next((item.text for item in found if isinstance(item, Refused)), "")
        raise InputError(f"{recording}: no frame can be read" + (f"; the first: {fault}" if fault else ""))
    return names


def _first(source: PreparedSource) -> Frame | Refused | None:
    """The first readable frame, else the first one that was refused."""
    refused = None
    for item in source.frames(run="check"):
        if isinstance(item, Frame):
            return item
        refused = refused or item
    return refused


OnFrame = Callable[[int, int | None], None]
"""Told after each frame of all cameras: how many were read, and how many there are, where that is known."""


def open_cameras(
    recording: Path, *, ignore_masks: bool = False, on_frame: OnFrame = lambda done, total: None
) -> list[CameraFrames]:
    """Every camera of a recording of any kind, in its own order, each opened as `replay` opens it.

    Raises:
        InputError: no recording of a known kind, one that cannot be used, or a camera that no line can call so.
    """
    names = line_names(recording)
    sources = [open_source(recording, camera=name, ignore_masks=ignore_masks) for name in names]
    counts = [source.description.frames for source in sources]
    total = None if None in counts else sum(count or 0 for count in counts)
    done = itertools.count(1)
    return [CameraFrames(source, lambda: on_frame(next(done), total)) for source in sources]
