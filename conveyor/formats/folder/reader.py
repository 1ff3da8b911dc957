"""Reading a camera of a plain folder recording."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.formats.folder.layout import (
    FrameRow,
    describe,
    read_camera_file,
    read_frame_rows,
    travel_going_on,
)
from conveyor.formats.png16 import Refusal, read_labels, read_png16
from conveyor.formats.source import CameraDescription, FrameKey, Refused
from conveyor.formats.within import plain_name
from conveyor.messages import Frame

WITHOUT_MASKS = "; or ignore the masks (`replay --ignore-masks`, or ignore_masks in a line's file)"


class FolderSource:
    """Frames of one camera folder. Only depth is needed; masks and colour come along where they are.

    Args:
        masks: False leaves the folder's masks unread.
    """

    def __init__(self, folder: Path, *, masks: bool = True) -> None:
        self._folder = folder
        self._masks = masks
        travel = travel_going_on(read_frame_rows(folder / "frames.csv"))
        self._rows = travel.rows
        described = describe(
            read_camera_file(folder / "camera.json"), origin=f"folder {folder}", frames=len(self._rows)
        )
        notes = []
        name = folder.resolve().name
        if plain_name(described.name, where=folder / "camera.json") != name:
            notes.append(f"camera.json names it '{described.name}': it is called '{name}', as its folder is")
        for what, where in (("sets travel_m back", travel.set_back), ("lets travel_m jump", travel.jumped)):
            if where:
                more = f" and {len(where) - 5} more" if len(where) > 5 else ""
                notes.append(
                    f"frames.csv {what} at seq {', '.join(map(str, where[:5]))}{more}: it is taken to go on there at "
                    "the belt's usual speed"
                )
        notes += self._masks_left_out() if masks else []
        self._description = replace(described, name=name, notes=tuple(notes))
        if not (folder / "depth").is_dir():
            raise InputError(f"{folder} has no folder 'depth' with the frames' 16-bit PNG files")

    @property
    def description(self) -> CameraDescription:
        """From camera.json, with the name of its folder: two that were copied may say the same name."""
        return self._description

    def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
        """Frames in order; a file that is missing or broken is refused by name and the rest goes on."""
        first = bisect_right(self._rows, after, key=lambda row: row.seq)
        for n in range(first, len(self._rows)):
            yield self._frame(self._rows[n], run)

    def keys(self) -> list[FrameKey]:
        """From frames.csv."""
        return [FrameKey(row.seq, row.captured_ns) for row in self._rows]

    def _masks_left_out(self) -> list[str]:
        """A note where there are masks, and frames without one of their name: tubers are found on depth there."""
        folder = self._folder / "mask"
        files = sorted(path.name for path in folder.glob("[!.]*"))
        there = set(files)
        without = [name for row in self._rows if (name := f"{row.seq:06d}.png") not in there]
        if not files or not without:
            return []
        if len(without) < len(self._rows):
            told = f"mask/ lacks the masks of {len(without)} of {len(self._rows)} frames ({without[0]} is the first)"
            return [f"{told}: tubers of these are found on depth, as without masks"]
        told = f"mask/ holds none that is called as its frame's depth ({without[0]})"
        return [f"{told}, but {files[0]!a}: tubers are found on depth, as without masks"]

    def _frame(self, row: FrameRow, run: str) -> Frame | Refused:
        path = self._folder / "depth" / f"{row.seq:06d}.png"
        depth = read_png16(path)
        if isinstance(depth, Refusal):
            return Refused(row.seq, depth.reason, f"frame {row.seq}: {path} {depth.text}")
        k = self._description.intrinsics
        if depth.shape != (k.height, k.width):
            return Refused(
                row.seq,
                "wrong_size",
                f"frame {row.seq}: {path} is {depth.shape[1]}x{depth.shape[0]}, camera.json says {k.width}x{k.height}",
            )
        mask_path = self._folder / "mask" / f"{row.seq:06d}.png"
        mask = read_labels(mask_path) if self._masks and mask_path.is_file() else None
        if isinstance(mask, Refusal):
            return Refused(row.seq, "bad_mask", f"frame {row.seq}: {mask_path} {mask.text}{WITHOUT_MASKS}")
        if mask is not None and mask.shape != depth.shape:
            size = f"{mask.shape[1]}x{mask.shape[0]}, its depth {depth.shape[1]}x{depth.shape[0]}"
            return Refused(row.seq, "bad_mask", f"frame {row.seq}: {mask_path} is {size}{WITHOUT_MASKS}")
        d = self._description
        return Frame(
            camera=d.name,
            run=run,
            seq=row.seq,
            captured_ns=row.captured_ns,
            travel_m=row.travel_m,
            depth_scale_m=d.depth_scale_m,
            intrinsics=k,
            belt_distance_m=d.belt_distance_m,
            depth=depth,
            belt_from_camera=d.belt_from_camera,
            mask=mask,
            color_jpeg=self._color(row.seq),
        )

    def _color(self, seq: int) -> NDArray[np.uint8] | None:
        """The frame's colour as a JPEG file; a PNG is encoded again; broken colour is left out, as it is optional."""
        jpeg = self._folder / "color" / f"{seq:06d}.jpg"
        if jpeg.is_file():
            return np.fromfile(jpeg, np.uint8)
        png = self._folder / "color" / f"{seq:06d}.png"
        image = cv2.imread(str(png), cv2.IMREAD_COLOR) if png.is_file() else None
        if image is None:
            return None
        return np.asarray(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1], np.uint8).ravel()
