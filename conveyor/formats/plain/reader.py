"""A folder of plain depth frames as a source, to be written as a recording."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.formats.plain.depth import DepthUnit
from conveyor.formats.plain.files import frame_files, read_frames
from conveyor.formats.plain.pinhole import read_pinhole
from conveyor.formats.source import CameraDescription, FrameKey
from conveyor.messages import Frame


class PlainFrames:
    """Depth frames of one camera, from files in the order of the numbers in their names.

    Where the last numbers in the names rise without many gaps they number the frames, so that a missing file is a
    gap; else the frames are counted. The first frame is number 0, the others follow at `fps`; none has time 0, which
    to a line is no time.

    Attributes:
        missing: how many numbers there are between the first and the last file that no file has.
    """

    def __init__(
        self,
        folder: Path,
        *,
        intrinsics: Path,
        depth_unit_m: float | None,
        fps: float,
        camera: str = "front",
        pattern: str = "*",
        belt_distance_m: float | None = None,
    ) -> None:
        """Look at all names and the first frame.

        Raises:
            InputError: no frames, or frames, intrinsics or a unit that do not fit each other.
        """
        self._files = frame_files(folder, pattern)
        first, where = self._first()
        pinhole = read_pinhole(intrinsics)
        self._unit = DepthUnit.of(
            depth_unit_m if depth_unit_m is not None else pinhole.depth_scale_m, first, where=where
        )
        numbers = _numbers(self._files)
        self._seqs = numbers or list(range(len(self._files)))
        self.missing = self._seqs[-1] + 1 - len(self._seqs)
        bent = "the intrinsics have lens distortion, which is not undone: record rectified frames"
        self._description = CameraDescription(
            name=camera,
            origin=f"frames of {folder}",
            intrinsics=pinhole.intrinsics(first.shape[1], first.shape[0], where=intrinsics),
            depth_scale_m=self._unit.stored_m,
            belt_distance_m=belt_distance_m,
            belt_from_camera=None,
            fps=fps,
            frames=len(self._files),
            notes=(bent,) if pinhole.distorted else (),
        )

    @property
    def description(self) -> CameraDescription:
        """From the intrinsics file and the first frame."""
        return self._description

    def keys(self) -> list[FrameKey]:
        """One per file; a file of several frames has more."""
        return [FrameKey(seq, self._time_ns(seq)) for seq in self._seqs]

    def frames(self, *, run: str, after: int = -1) -> Iterator[Frame]:
        """All frames.

        Raises:
            InputError: the first that is broken, of another size, or no depth; names its file.
        """
        extra = 0  # frames that stacks added
        for seq, path in zip(self._seqs, self._files, strict=True):
            stack = read_frames(path)
            for at, pixels in enumerate(stack):
                number = seq + extra + at
                if number > after:
                    yield self._frame(pixels, number, run, path)
            extra += len(stack) - 1

    def _first(self) -> tuple[NDArray[Any], Path]:
        """The first frame that shows anything, and its file."""
        for path in self._files:
            for pixels in read_frames(path):
                if (np.nan_to_num(pixels) > 0).any():
                    return pixels, path
        raise InputError(f"none of {len(self._files)} frames in {self._files[0].parent} has any depth")

    def _frame(self, pixels: NDArray[Any], seq: int, run: str, path: Path) -> Frame:
        d = self._description
        k = d.intrinsics
        if pixels.shape != (k.height, k.width):
            raise InputError(
                f"{path} is {pixels.shape[1]}x{pixels.shape[0]}, the frames before it {k.width}x{k.height}: frames of "
                "one camera have one size; import each size apart (--pattern)"
            )
        return Frame(
            camera=d.name,
            run=run,
            seq=seq,
            captured_ns=self._time_ns(seq),
            travel_m=None,
            depth_scale_m=d.depth_scale_m,
            intrinsics=k,
            belt_distance_m=d.belt_distance_m,
            depth=self._unit.convert(pixels, where=path),
        )

    def _time_ns(self, seq: int) -> int:
        return round(1e9 / self._description.fps) + round(seq * 1e9 / self._description.fps)


def _numbers(files: list[Path]) -> list[int] | None:
    """The frames' numbers from their names, the first one 0; None where names hold no such numbers."""
    found = [re.findall(r"\d+", path.stem) for path in files]
    if not all(found):
        return None
    numbers = [int(digits[-1]) for digits in found]
    rising = all(after > before for before, after in pairwise(numbers))
    if not rising or numbers[-1] - numbers[0] >= 2 * len(numbers):
        return None
    return [number - numbers[0] for number in numbers]
