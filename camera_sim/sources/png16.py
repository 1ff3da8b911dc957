"""16-bit PNG files, read with suspicion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why there is no image: a word to count by, and the rest of a sentence that begins with the file's name."""

    reason: str
    text: str


MISSING = Refusal("missing_file", "does not exist; its frame is a gap")
BROKEN = Refusal("broken_png", "is truncated or no PNG; copy it again")
NOT_16_BIT = Refusal("not_16_bit", "is no 16-bit single-channel PNG; write depth as uint16")


def read_png16(path: Path) -> NDArray[np.uint16] | Refusal:
    """(H, W) uint16, or why not."""
    try:
        data = np.fromfile(path, np.uint8)
    except OSError:
        return MISSING
    if not _is_whole(data):
        return BROKEN
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    if image is None:
        return BROKEN
    if image.dtype != np.uint16 or image.ndim != 2:
        return NOT_16_BIT
    return np.asarray(image, np.uint16)


def _is_whole(data: NDArray[np.uint8]) -> bool:
    """OpenCV fills the missing rows of a truncated PNG with zeros and says nothing: look for the end chunk."""
    return len(data) > 20 and data[:8].tobytes() == b"\x89PNG\r\n\x1a\n" and data[-8:-4].tobytes() == b"IEND"
