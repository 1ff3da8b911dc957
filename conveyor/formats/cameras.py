"""All cameras of a recording, for commands that work without a line: what `replay` takes, they take."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import ConfigError, InputError
from conveyor.formats.detect import camera_names, open_source, recording_kind
from conveyor.formats.prepared import PreparedSource
from conveyor.formats.source import CameraDescription, FrameKey, Refused
from conveyor.messages import Frame
from conveyor.topics import check_name

SHORTEST_STEP_NS = 100_000
"""Between two frames; a tenth of what the fastest camera takes. Times in microseconds, or coarser, lie closer."""

MOST_APART_NS = 24 * 3_600_000_000_000
"""Between the first frames of two cameras of one recording; a clock from 1970 and one from its start are 56 years
apart."""


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
            raise none_readable(self.description.origin, self.first_fault)


def none_readable(origin: str, first_fault: str) -> InputError:
    """The error to raise for a recording of which no frame can be read; what the first of them said, where any did."""
    return InputError(f"{origin}: no frame can be read" + (f"; the first: {first_fault}" if first_fault else ""))


def told_unreadable(unreadable: Mapping[str, int], first_fault: str) -> str:
    """Frames that were refused, by reason, and what the first of them said; empty where there are none."""
    if not unreadable:
        return ""
    reasons = ", ".join(f"{n} {reason.replace('_', ' ')}" for reason, n in sorted(unreadable.items()))
    return f"frames that cannot be used: {reasons}; the first: {first_fault}"


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
            of_folder = recording_kind(recording) == "folder"
            fix = "rename the camera's folder, and its entry in line.json where there is one"
            again = "record or export it again with another name"
            raise InputError(f"{recording}: {error}; {fix if of_folder else again}") from error
    return names


def check_readable(recording: Path, *, ignore_masks: bool = False) -> list[str]:
    """Names of a recording's cameras, each read up to its first readable frame. One that has none is among them: its
    frames are counted as lost, and the others' are worth as much as before.

    Raises:
        InputError: no camera has one; with what was said of the first that was refused. Or a depth scale contradicts
            the belt distance, no line can call a camera so, or its clock cannot tell travel, which is not given.
    """
    names = line_names(recording)
    sources = [open_source(recording, camera=name, ignore_masks=ignore_masks) for name in names]
    found = [_beginning(source) for source in sources]
    by_clock = {
        name: frames for name, (frames, _) in zip(names, found, strict=True) if frames and frames[0].travel_m is None
    }
    for name, source in zip(names, sources, strict=True):
        if name in by_clock:
            _check_clock(source, by_clock[name])
    _check_one_clock(recording, {name: frames[0].captured_ns for name, frames in by_clock.items()})
    if not any(frames for frames, _ in found):
        fault = next((refused.text for _, refused in found if refused), "")
        raise none_readable(str(recording), fault)
    return names


def _check_clock(source: PreparedSource, first: Iterable[Frame]) -> None:
    """Where the load has to tell travel, it does so by the clock. `first`: the source's first frames.

    Raises:
        InputError: frames follow one another sooner than any camera takes them.
    """
    if not 0 < _step_ns(first) < SHORTEST_STEP_NS:
        return
    step_ns = _step_ns(source.keys())
    if 0 < step_ns < SHORTEST_STEP_NS:
        raise InputError(
            f"{source.description.origin}: frames are captured {step_ns:g} ns apart, and their travel is not given, so "
            "the load must tell it by the clock: give captured_ns in nanoseconds (milliseconds times 1,000,000), or "
            "travel_m"
        )


def _check_one_clock(recording: Path, first_ns: Mapping[str, int]) -> None:
    """Cameras whose travel the load tells lie side by side by the clock.

    Args:
        first_ns: when the first frame of each was captured.

    Raises:
        InputError: two of them can have no clock in common.
    """
    early, late = (pick(first_ns, key=lambda name: first_ns[name], default="") for pick in (min, max))
    if early and first_ns[late] - first_ns[early] > MOST_APART_NS:
        raise InputError(
            f"{recording}: cameras '{early}' and '{late}' begin {(first_ns[late] - first_ns[early]) / 3.6e12:.0f} h "
            "apart, and their travel is not given, so only a clock in common lays their tubers side by side: give "
            "captured_ns of one clock, or travel_m"
        )


def _step_ns(frames: Iterable[Frame | FrameKey]) -> float:
    """The median time from one to the next; 0 where there is one."""
    steps = np.diff([frame.captured_ns for frame in frames])
    return float(np.median(steps)) if len(steps) else 0.0


def _beginning(source: PreparedSource) -> tuple[list[Frame], Refused | None]:
    """The first readable frame, the second, too, where that one has no travel; and the first that was refused."""
    frames: list[Frame] = []
    refused = None
    for item in source.frames(run="check"):
        if isinstance(item, Refused):
            refused = refused or item
            continue
        frames.append(item)
        if item.travel_m is not None or len(frames) == 2:
            break
    return frames, refused


OnFrame = Callable[[int, int | None], None]
"""Told after each frame of all cameras: how many were read, and how many there are, where that is known."""


def open_cameras(
    recording: Path,
    *,
    ignore_masks: bool = False,
    follow: bool = False,
    on_frame: OnFrame = lambda done, total: None,
) -> list[CameraFrames]:
    """Every camera of a recording of any kind, in its own order, each opened as `replay` opens it.

    Args:
        follow: its load is followed from frame to frame, so its clock must tell travel where that is not given.

    Raises:
        InputError: no recording of a known kind, one that cannot be used, or a camera that no line can call so; to
            `follow` also what `check_readable` refuses.
    """
    names = check_readable(recording, ignore_masks=ignore_masks) if follow else line_names(recording)
    sources = [open_source(recording, camera=name, ignore_masks=ignore_masks) for name in names]
    counts = [source.description.frames for source in sources]
    total = None if None in counts else sum(count or 0 for count in counts)
    done = itertools.count(1)
    return [CameraFrames(source, lambda: on_frame(next(done), total)) for source in sources]
