"""What tubers lie on: a flat belt, a web of rods, a belt with cleats, or one that sags."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from camera_sim.sim.belt import TILE_MM, Belt, cleat_heights_m, draw_belt
from camera_sim.sim.lowering import STEP_M, Support
from camera_sim.sim.rods import Rods

SurfaceKind = Literal["flat", "rods", "cleats", "sagging"]
SAG_SPAN_M = TILE_MM / 1000
"""A sagging belt is highest this far apart across, and lowest at y = 0."""
MEAN_OF_COS = float(np.sinc(0.5 / SAG_SPAN_M))
"""Of the sag's wave over the middle half metre, whose mean height is the belt plane."""


@dataclass(frozen=True, slots=True)
class Surface:
    """One belt's shape. Its plane z = 0 is the rods' tops, the belt between cleats, or a sagging belt's middle.

    Attributes:
        cleat_m, cleat_pitch_mm: height and distance of cleats; the distance divides 1024 mm.
        sag_m: how far a sagging belt's middle lies below its highest parts.
    """

    kind: SurfaceKind = "flat"
    rods: Rods | None = None
    cleat_m: float = 0.0
    cleat_pitch_mm: int = 64
    sag_m: float = 0.0

    def belt(self, rng: Generator, *, soil_m: float) -> Belt:
        """This surface with soil of the given rms."""
        if self.rods is not None:
            return replace(draw_belt(rng, soil_m=soil_m, cleat_m=0.0), rods=self.rods)
        belt = draw_belt(rng, soil_m=soil_m, cleat_m=self.cleat_m, pitch_mm=self.cleat_pitch_mm)
        if self.sag_m == 0:
            return belt
        across = self.height_m(np.arange(TILE_MM) / 1000)
        return replace(belt, relief_m=(belt.relief_m + across[None, :]).astype(np.float32))

    @property
    def support(self) -> Support | None:
        """What a body is lowered onto, along the travel; None where it is level."""
        if self.rods is not None:
            return Support(self.rods.pitch_m, self.rods.heights_m(STEP_M / 2))
        if self.cleat_m > 0:
            x_mm = np.arange(0, self.cleat_pitch_mm, 0.25)
            return Support(self.cleat_pitch_mm / 1000, cleat_heights_m(self.cleat_m, self.cleat_pitch_mm, x_mm))
        return None

    def height_m(self, y_m: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Height of the sagging belt at `y_m` across, metres; its mean over the middle half metre is 0."""
        wave = np.cos(2 * np.pi * np.asarray(y_m) / SAG_SPAN_M)
        return np.asarray(-self.sag_m / 2 * (wave - MEAN_OF_COS))


FLAT = Surface()
