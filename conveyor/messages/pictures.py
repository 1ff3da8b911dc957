"""A camera's picture for people: small, a few a second, and only while somebody looks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from conveyor.messages.base import ArraySpec, Message
from conveyor.ranges import Items, Name, Nanoseconds, Range, Seq, ViewGrams, Word

MAX_PICTURE_BYTES = 48 * 1024
MAX_PICTURE_SIDE = 2048
MOST_CORNERS = 48
MOST_OUTLINES = 256
Side = Annotated[int, Range(1, MAX_PICTURE_SIDE, "px")]
Corner = Annotated[int, Range(-MAX_PICTURE_SIDE, 2 * MAX_PICTURE_SIDE, "px")]


@dataclass(frozen=True, slots=True)
class Outline:
    """What lies on the belt, as the segmenter sees it.

    Attributes:
        corners: u, v, u, v, ... of its outline, pixels of the picture.
        state: 'seen' (not decided yet), 'counted', 'lump' (refused: a clod or a stone), 'haulm' (refused as that), or
            'left_out': neither counted nor foreign, a part of something or seen too little.
        weight_g: median of what its views weigh by now; None before the first answer. What is not counted yet has a
            provisional one.
    """

    corners: Annotated[tuple[Corner, ...], Items(2 * MOST_CORNERS)]
    state: Literal["seen", "counted", "lump", "haulm", "left_out"]
    weight_g: ViewGrams | None = None


@dataclass(frozen=True, slots=True)
class Picture(Message):
    """What a camera sees, for people.

    Attributes:
        camera, run, seq, captured_ns: of the frame.
        width, height: of the picture, pixels.
        jpeg: (n,) uint8, a JPEG file: the camera's colours where it sends them, else its depth, shaded.
        drop: why the frame was not used; empty where it was. Then nothing is outlined.
    """

    camera: Name
    run: Name
    seq: Seq
    captured_ns: Nanoseconds
    width: Side
    height: Side
    jpeg: NDArray[np.uint8]
    outlines: Annotated[tuple[Outline, ...], Items(MOST_OUTLINES)] = ()
    drop: Word = ""

    LATER_FIELDS = "ignore"
    ARRAYS: ClassVar[dict[str, ArraySpec]] = {"jpeg": ArraySpec("u1", ((1, MAX_PICTURE_BYTES),))}
