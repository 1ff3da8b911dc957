"""Which ground was lifted when: overlap, headlands and narrow last passes, by squares that can be lifted only once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError

SQUARE_M, SQUARES_ACROSS = 0.25, 6
"""A strip is at least so many squares wide: of a single row, 0.75 m, three squares counted its ground 6 % short."""
MOST_SQUARES = 400_000_000
"""25 km2 at 0.25 m: a track that spans more jumps between fields, each of which is to be mapped by itself."""


@dataclass(frozen=True, slots=True, eq=False)
class Harvested:
    """Ground lifted in each of N seconds, in squares.

    Attributes:
        square_m: their side.
        origin_m: (2,) the corner of square (0, 0), metres of the field.
        area_m2: (N,) ground lifted for the first time.
        swept_m2: (N,) ground under the share, lifted before or not.
        second: (M,) which second lifted each square.
        square: (M, 2) int64, its column (east) and row (north).
    """

    square_m: float
    origin_m: NDArray[np.float64]
    area_m2: NDArray[np.float64]
    swept_m2: NDArray[np.float64]
    second: NDArray[np.int64]
    square: NDArray[np.int64]

    @property
    def centres_m(self) -> NDArray[np.float64]:
        """(M, 2) middles of the squares, metres of the field."""
        return self.origin_m + (self.square + 0.5) * self.square_m


def harvest_in_order(
    start_m: NDArray[np.float64], end_m: NDArray[np.float64], *, width_m: float, known: NDArray[np.bool_]
) -> Harvested:
    """Lift the strips from `start_m` to `end_m` ((N, 2) metres), `width_m` wide, one after the other where `known`.

    Raises:
        InputError: the strips lie too far apart for one field.
    """
    square_m = min(SQUARE_M, width_m / SQUARES_ACROSS)
    ends = np.concatenate([start_m[known], end_m[known]]) if known.any() else np.zeros((1, 2))
    low = ends.min(axis=0) - width_m - 1
    columns, rows = np.ceil((ends.max(axis=0) + width_m + 1 - low) / square_m).astype(int)
    if columns * rows > MOST_SQUARES:
        raise InputError(
            f"the track spans {columns * square_m / 1000:.1f} by {rows * square_m / 1000:.1f} km; a map holds up to "
            f"{MOST_SQUARES * square_m**2 / 1e6:.0f} km2: cut it by time or by field"
        )
    lifted = np.zeros((rows, columns), dtype=bool)
    area, swept = np.zeros(len(start_m)), np.zeros(len(start_m))
    seconds: list[NDArray[np.int64]] = []
    squares: list[NDArray[np.int64]] = []
    for i in np.flatnonzero(known):
        inside = _squares((start_m[i] - low) / square_m, (end_m[i] - low) / square_m, width_m / square_m)
        fresh = inside[~lifted[inside[:, 1], inside[:, 0]]]
        lifted[fresh[:, 1], fresh[:, 0]] = True
        swept[i] = float(np.hypot(*(end_m[i] - start_m[i]))) * width_m
        area[i] = swept[i] * len(fresh) / max(len(inside), 1)
        seconds.append(np.full(len(fresh), i))
        squares.append(fresh)
    return Harvested(
        square_m=square_m,
        origin_m=low,
        area_m2=area,
        swept_m2=swept,
        second=np.concatenate(seconds) if seconds else np.zeros(0, dtype=np.int64),
        square=np.concatenate(squares) if squares else np.zeros((0, 2), dtype=np.int64),
    )


def _squares(start: NDArray[np.float64], end: NDArray[np.float64], width: float) -> NDArray[np.int64]:
    """(K, 2) squares (column, row) whose middles lie in the strip, all in units of squares."""
    way = end - start
    length = float(np.hypot(*way))
    if length < 1e-6:
        return np.zeros((0, 2), dtype=np.int64)
    along = way / length
    across = np.array([-along[1], along[0]])
    corners = np.stack([start, start, end, end]) + across * (np.array([1, -1, 1, -1])[:, None] * width / 2)
    low, high = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int)
    column, row = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    squares = np.stack([column.ravel(), row.ravel()], axis=1)
    from_start = squares + 0.5 - start
    ahead, aside = from_start @ along, from_start @ across
    inside: NDArray[np.int64] = squares[(ahead >= 0) & (ahead < length) & (np.abs(aside) <= width / 2)]
    return inside
