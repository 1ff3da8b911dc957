"""What the load is made of, cell by cell: belt, tuber or other (clod, stone, haulm), by a small network on heights.

The network (`segmenter.training`) is run by OpenCV from an ONNX file; torch is not needed here. It sees the height map at
2 mm per cell, whatever the camera, and answers on a grid of 4 mm. The method 'learned' finds instances with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from segmenter.classify.classifier import read_network
from segmenter.frame.heights import HeightMap

SHIPPED = Path(__file__).parent / "weights" / "tuberline-cells.onnx"
GRID_MM = 2.0
STEP = 2
"""Input cells per output cell."""
MULTIPLE = 32
"""Input rows and columns are padded to a multiple of this."""
FULL_MM = 60.0
FINE_MM = 1.5
FINE_SIGMA = 3.0
BELT, TUBER, OTHER = 0, 1, 2
CHANNELS = 5
"""Of the answer: logits of the three classes, then rows and columns to the tuber's centre, in units of `REACH`."""
REACH = 10.0
COARSEST_MM = 2.1
"""Cells larger than this show no skin: the network has not learned to see with them and is not asked."""


@dataclass(frozen=True, slots=True)
class Grid:
    """A height map as the network takes it.

    Attributes:
        image: (3, H, W) float32: height / 60 mm, height over its surroundings / 1.5 mm, 1 where the camera measured.
        rows, columns: how many of H and W are not padding.
    """

    image: NDArray[np.float32]
    rows: int
    columns: int


@dataclass(frozen=True, slots=True)
class ClassMap:
    """The network's answer for one frame.

    Attributes:
        answer: (5, h, w) float32 on the grid of 4 mm, see `CHANNELS`; padding included.
        scale: (rows, columns) of output cells per cell of the height map.
    """

    answer: NDArray[np.float32]
    scale: tuple[float, float]


class ClassNet:
    """The network, read once. Not for several threads.

    Raises:
        InputError: the file is missing, or no network that OpenCV reads.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path or SHIPPED
        self._net = read_network(self.path)

    def __call__(self, heights: HeightMap) -> ClassMap:
        """Classes of one height map."""
        grid = grid_of(heights)
        self._net.setInput(grid.image[None])
        answer = np.asarray(self._net.forward(), np.float32)
        if answer.ndim != 4 or answer.shape[1] != CHANNELS:
            raise InputError(f"{self.path} answers {answer.shape}; (1, {CHANNELS}, rows, columns) is needed")
        rows, columns = heights.height_mm.shape
        return ClassMap(answer[0], (grid.rows / rows / STEP, grid.columns / columns / STEP))


def can_see(heights: HeightMap) -> bool:
    """The height map is fine enough for the network."""
    return heights.cell_mm <= COARSEST_MM


def grid_of(heights: HeightMap) -> Grid:
    """The network's input for a height map."""
    rows, columns = (max(1, round(n * heights.cell_mm / GRID_MM)) for n in heights.height_mm.shape)
    shrinks = heights.cell_mm <= GRID_MM
    how = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    height_mm = np.asarray(cv2.resize(heights.height_mm, (columns, rows), interpolation=how), np.float32)
    seen = cv2.resize(heights.seen.astype(np.float32), (columns, rows), interpolation=how)
    return Grid(as_channels(height_mm, np.asarray(seen, np.float32)), rows, columns)


def as_channels(height_mm: NDArray[np.float32], seen: NDArray[np.float32]) -> NDArray[np.float32]:
    """(3, H, W) float32 input of heights (h, w) in mm and the share measured (h, w), padded with belt never seen."""
    rows, columns = height_mm.shape
    image = np.zeros((3, -(-rows // MULTIPLE) * MULTIPLE, -(-columns // MULTIPLE) * MULTIPLE), np.float32)
    fine = height_mm - cv2.GaussianBlur(height_mm, (0, 0), FINE_SIGMA)
    image[0, :rows, :columns] = height_mm / np.float32(FULL_MM)
    image[1, :rows, :columns] = np.clip(fine / np.float32(FINE_MM), -4, 4)
    image[2, :rows, :columns] = seen
    return image
