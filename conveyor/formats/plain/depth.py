"""Depth as it is stored, in whole numbers of a unit or in decimal metres, to 16-bit depth with its unit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError

MOST_UNIT_M = 0.01
"""Of whole numbers: coarser depth weighs nothing."""
FLOAT_UNIT_M = 0.0001
"""What decimal depth is rounded to: no camera over a belt can tell it apart."""
NEAREST_M, FARTHEST_M = 0.05, 20.0
"""The middle of a frame from any camera lies between; a unit that says otherwise is wrong."""
USUAL = "0.001: millimetres (Azure Kinect, Kinect, OAK, most RealSense); 0.0001: RealSense D405, SR300; 1: metres"


@dataclass(frozen=True, slots=True)
class DepthUnit:
    """`given_m`: metres per stored unit. `stored_m`: metres per unit of what `convert` makes of it.

    `decimal`: the files hold decimal numbers.
    """

    given_m: float
    stored_m: float
    decimal: bool = False

    @classmethod
    def of(cls, given_m: float | None, first: NDArray[Any], *, where: Path, option: str = "--depth-unit") -> DepthUnit:
        """For frames like `first`; `option` is how the command calls the unit.

        Raises:
            InputError: none given, or one that these frames cannot have.
        """
        decimal = first.dtype.kind == "f"
        middle = _middle(first)
        told = f"{where} holds {'decimal' if decimal else 'whole'} numbers around {middle:.4g}"
        units = (0.001, 1.0) if decimal else (0.001, 0.0001)
        if given_m is None:
            raise InputError(
                f"give {option}, how many metres one unit of the files is ({USUAL}). {told}: that is "
                + " and ".join(f"{middle * unit:.4g} m at {unit:g}" for unit in units)
            )
        if not 0 < given_m <= 1:
            raise InputError(f"{option} is {given_m:g}; allowed is above 0 to 1 metre per unit ({USUAL})")
        if not decimal and given_m > MOST_UNIT_M:
            raise InputError(
                f"{option} is {given_m:g}, but {told}: whole numbers count at most {MOST_UNIT_M:g} m each ({USUAL})"
            )
        middle_m = middle * given_m
        if not NEAREST_M <= middle_m <= FARTHEST_M:
            metres = decimal and NEAREST_M <= middle <= FARTHEST_M
            fix = f"they are metres: give {option} 1" if metres else f"give another one ({USUAL})"
            raise InputError(f"{option} is {given_m:g}, but {told}, so what it shows lies {middle_m:.4g} m away; {fix}")
        return cls(given_m, FLOAT_UNIT_M if decimal else given_m, decimal)

    def convert(self, frame: NDArray[Any], *, where: Path) -> NDArray[np.uint16]:
        """(H, W) uint16 in units of `stored_m`, 0 = no depth. Decimal depth that is not finite, negative or beyond
        6.5 m is no depth.

        Raises:
            InputError: whole numbers that 16 bits do not hold, or whole ones where the first frame had decimal ones,
                and the other way round.
        """
        if frame.dtype.kind == "f":
            if not self.decimal:
                raise InputError(f"{where} holds decimal numbers, the frames before it whole ones: import them apart")
            with np.errstate(invalid="ignore", over="ignore"):
                units = np.round(np.nan_to_num(frame.astype(np.float64), nan=0.0) * (self.given_m / FLOAT_UNIT_M))
            return np.where((units > 0) & (units < 65535), units, 0).astype(np.uint16)
        if self.decimal:
            raise InputError(f"{where} holds whole numbers, the frames before it decimal ones: import them apart")
        if frame.dtype != np.uint16 and frame.size and not (frame.min() >= 0 and frame.max() <= 65535):
            raise InputError(f"{where} holds {frame.min()} to {frame.max()}; 16-bit depth is 0 (none) to 65535")
        return np.ascontiguousarray(frame, np.uint16)


def _middle(frame: NDArray[Any]) -> float:
    """Median of the depths in a frame, in its own units; 0 where it has none."""
    seen = frame[np.isfinite(frame) & (frame > 0)]
    return float(np.median(seen)) if seen.size else 0.0
