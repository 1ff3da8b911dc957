"""What stereo cameras are like, by simulated world: what the simulator draws, and so what weights are trained for.

The simulator draws its cameras from these ranges, the sidecar of weights names the worlds that they were trained on,
and `tuberline camera profile` and the regressor compare a camera with the ranges of those worlds. They stand here once.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

World = Literal["easy", "field", "harsh"]
Range = tuple[float, float]

BEYOND = 1.15
"""Of the largest local noise trained for, before it is called too much."""

BASELINE_M = 0.018
"""Distance of the imagers of the simulated camera, a D405: what its pixels of disparity stand for."""


@dataclass(frozen=True, slots=True)
class CameraRange:
    """Smallest and largest of each property. Pixels of disparity are those of a baseline of 18 mm.

    Attributes:
        local_px: median residual of the disparity to a quadric of 11 x 11 pixels.
        smooth_px: error over 10 to 20 pixels; bow_px: over the field of view, the same in every frame; both as
            standard deviations.
        soil_m: relief of the belt, rms: no camera can tell it from an error over 10 to 20 pixels.
        islands: false matches per megapixel; island_px: by how much they are off.
        outline_px: median width of the holes at outlines, image pixels.
        bare: share of the surface without depth, beside outlines; missing: of all pixels, outlines included.
        steps_per_px: disparity is a multiple of one of so many parts of a pixel.
    """

    local_px: Range
    smooth_px: Range
    bow_px: Range
    soil_m: Range
    islands: Range
    outline_px: Range
    bare: Range
    missing: Range
    island_px: Range = (5.0, 50.0)
    steps_per_px: int = 32

    def noisier(self, local_px: float | None) -> bool:
        """A camera with that local noise is clearly noisier than these; one that is not known is taken for one of them.

        Soil, cleats and the skins of tubers are in a measured noise too: `BEYOND` leaves room for them.
        """
        return local_px is not None and local_px > BEYOND * self.local_px[1]


CAMERAS: dict[World, CameraRange] = {
    "easy": CameraRange(
        local_px=(0.014, 0.034),
        smooth_px=(0.060, 0.060),
        bow_px=(0.0, 0.0),
        soil_m=(0.0012, 0.0012),
        islands=(0.0, 0.0),
        outline_px=(0.0, 6.0),
        bare=(0.0003, 0.0003),
        missing=(0.0, 0.06),
    ),
    "field": CameraRange(
        local_px=(0.018, 0.038),
        smooth_px=(0.085, 0.085),
        bow_px=(0.0, 0.0),
        soil_m=(0.0020, 0.0020),
        islands=(0.0, 0.0),
        outline_px=(0.0, 7.0),
        bare=(0.001, 0.001),
        missing=(0.0, 0.07),
    ),
    "harsh": CameraRange(
        local_px=(0.015, 0.12),
        smooth_px=(0.05, 0.17),
        bow_px=(0.0, 0.16),
        soil_m=(0.0004, 0.003),
        islands=(1.0, 40.0),
        outline_px=(8.0, 26.0),
        bare=(0.0003, 0.15),
        missing=(0.02, 0.25),
    ),
}
"""`easy` and `field` have one camera each: their local noise and outlines are as measured on their recordings by
`tuberline camera profile`, at 0.345 and 0.460 m and in both depth units (docs/cameras.md); all else is what the
simulator is told. Of `missing` all three are as measured."""

GOOD: tuple[World, ...] = ("easy", "field")
"""Worlds whose cameras are good ones, with clean front glasses: intervals of views tell them from poor ones
(`regressor.weigh.unlike`)."""


def camera_range(worlds: Iterable[str]) -> CameraRange:
    """What the cameras of `worlds` span together; of no known world: of `easy` and `field`.

    Worlds of other names ('mixed' packs say 'easy' and 'field' themselves) add nothing.
    """
    known = [CAMERAS[name] for name in CAMERAS if name in set(worlds)] or [CAMERAS[name] for name in GOOD]

    def span(name: str) -> Range:
        ranges = [getattr(one, name) for one in known]
        return min(low for low, _ in ranges), max(high for _, high in ranges)

    return CameraRange(
        local_px=span("local_px"),
        smooth_px=span("smooth_px"),
        bow_px=span("bow_px"),
        soil_m=span("soil_m"),
        islands=span("islands"),
        outline_px=span("outline_px"),
        bare=span("bare"),
        missing=span("missing"),
        island_px=span("island_px"),
        steps_per_px=known[0].steps_per_px,
    )
