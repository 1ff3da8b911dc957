"""PNG files of depth and of labels, read with suspicion, and how all pictures of a recording are written."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.files import cause, fault_of
from conveyor.wire import MAX_ARRAY_BYTES


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why there is no image: a word to count by, and the rest of a sentence that begins with the file's name."""

    reason: str
    text: str


_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHUNK = struct.Struct(">I4s")
_HEADER_SIZE = struct.Struct(">II")
MISSING = Refusal("missing_file", "does not exist; its frame is a gap")
BROKEN = Refusal("broken_png", "is truncated or no PNG; copy it again")
NOT_16_BIT = Refusal("not_16_bit", "is no 16-bit single-channel PNG; write it as uint16")
NO_LABELS = Refusal("no_labels", "is no PNG of one channel with 16 or 8 bits; write a label for each tuber as uint16")


def read_png16(path: Path) -> NDArray[np.uint16] | Refusal:
    """(H, W) uint16, or why not."""
    return _read(path, (np.uint16,), otherwise=NOT_16_BIT)


def read_labels(path: Path) -> NDArray[np.uint16] | Refusal:
    """(H, W) uint16 labels, of a file with 16 or 8 bits; or why not."""
    return _read(path, (np.uint16, np.uint8), otherwise=NO_LABELS)


def _read(path: Path, types: tuple[type, ...], *, otherwise: Refusal) -> NDArray[np.uint16] | Refusal:
    """(H, W) uint16 of an image of one channel and one of `types`, or why not."""
    try:
        data = np.fromfile(path, np.uint8)
    except OSError:
        return MISSING
    if not is_whole_png(data):
        return BROKEN
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    if image is None:
        return BROKEN
    return np.asarray(image, np.uint16) if image.dtype in types and image.ndim == 2 else otherwise


def is_whole_png(data: NDArray[np.uint8]) -> bool:
    """OpenCV fills the missing rows of a truncated PNG with zeros and says nothing: walk to the end chunk.

    It also makes room for as many pixels as a damaged header asks for, and for as many bytes as a damaged chunk says it
    has, gigabytes of them: no frame has so many pixels, and chunks lie within the file.
    """
    raw = data.tobytes()
    if raw[:8] != _SIGNATURE or raw[12:16] != b"IHDR" or len(raw) < 33:
        return False
    width, height = _HEADER_SIZE.unpack_from(raw, 16)
    if not 0 < width * height <= MAX_ARRAY_BYTES // 2:
        return False
    at = len(_SIGNATURE)
    while at + 12 <= len(raw):
        size, kind = _CHUNK.unpack_from(raw, at)
        at += 12 + size
        if kind == b"IEND":
            return bool(at <= len(raw))
    return False


def write_png(path: Path, image: NDArray[Any], options: Sequence[int]) -> None:
    """Write (h, w) or (h, w, channels) uint8 or uint16 as OpenCV's `options` say.

    OpenCV's own writer says why it could not on standard error, and nowhere else.

    Raises:
        InputError: this user may not write there. OutputError: its disk is full or read-only.
    """
    data = cv2.imencode(".png", image, options)[1]
    try:
        path.write_bytes(data.tobytes())
    except OSError as error:
        raise fault_of(error, f"{path} cannot be written: {cause(error)}") from error
