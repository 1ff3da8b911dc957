"""The resting level: how far under the belt plane that a camera sees the undersides of tubers lie.

On a flat belt it is one number for all, measured or stated. On a web of rods a tuber sinks between two of them, a
small one deeper: that part follows from the rods and the tuber's outline.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Surface = Literal["flat", "rods", "cleats"]

LARGEST_SINK = 0.45
"""Of a body's height: what would sink deeper falls through the web and is not on it."""
FULLNESS = 0.83
"""Tubers are fuller than ellipses, so flatter below: of an ellipse's sink. Fitted to 180 stable poses of simulated
tubers on three webs (tests/regressor/test_regressor_resting.py); 0.1 more is 0.6 mm deeper."""
GEOMETRY_SD_M = 0.0012
"""How far a tuber's outline misleads about its sink between rods, standard deviation over the same poses."""
ROUNDS = 12
ORDINARY_ALONG_M, ORDINARY_TOP_M = 0.068, 0.048
"""Of a tuber of mean size: along the travel, in the mean of its headings, and above the rods' tops."""


@dataclass(frozen=True, slots=True)
class RestingLevel:
    """Where undersides lie. `offset_m` is positive below the belt plane; `sd_m` how well it is known.

    Attributes:
        surface: 'rods' adds the sink between them to `offset_m`, for each tuber its own; on 'flat' and 'cleats' the
            offset is all there is.
        rod_pitch_m, rod_diameter_m: centre to centre, and of one rod. They lie across the travel.
    """

    surface: Surface = "flat"
    offset_m: float = 0.0
    sd_m: float = 0.0
    rod_pitch_m: float = 0.040
    rod_diameter_m: float = 0.011

    def under(self, *, along_m: float, top_m: float) -> tuple[float, float]:
        """(offset, its standard deviation) of one tuber, metres.

        Args:
            along_m: its extent along the travel. top_m: its highest point above the belt plane that the camera sees.
        """
        if self.surface != "rods":
            return self.offset_m, self.sd_m
        top_m = max(top_m + self.offset_m, 0.005)
        sink_m = 0.0
        for _ in range(ROUNDS):  # the deeper it sinks, the taller it is, and the rounder below
            sink_m = FULLNESS * ellipse_sink_m(
                max(along_m, 0.01) / 2,
                (top_m + sink_m) / 2,
                rod_radius_m=self.rod_diameter_m / 2,
                pitch_m=self.rod_pitch_m,
            )
        return self.offset_m + sink_m, math.hypot(self.sd_m, GEOMETRY_SD_M)

    @property
    def ordinary_m(self) -> float:
        """Offset of a tuber of mean size: on a web with its sink, elsewhere the one that is stated."""
        return self.under(along_m=ORDINARY_ALONG_M, top_m=ORDINARY_TOP_M)[0]


def ellipse_sink_m(half_along_m: float, half_height_m: float, *, rod_radius_m: float, pitch_m: float) -> float:
    """How far the underside of an ellipse lies under the tops of the two rods that carry it, metres.

    For a circle of radius R it is R + r - sqrt((R + r)^2 - (P/2)^2). For an ellipse the point that touches a rod is
    found by bisection over the ellipse's parameter t: its curve, moved outwards by r, passes the rod's centre.
    """
    a, c, r = half_along_m, half_height_m, rod_radius_m
    deepest_m = 2 * LARGEST_SINK * c
    if a + r <= pitch_m / 2:
        return deepest_m
    low, high = 0.0, math.pi / 2
    for _ in range(40):
        t = (low + high) / 2
        if a * math.sin(t) + r * c * math.sin(t) / _normal(a, c, t) < pitch_m / 2:
            low = t
        else:
            high = t
    t = (low + high) / 2
    centre_m = c * math.cos(t) + r * a * math.cos(t) / _normal(a, c, t) - r
    return min(c - centre_m, deepest_m)


def _normal(a: float, c: float, t: float) -> float:
    return math.hypot(c * math.sin(t), a * math.cos(t))


POTATOTWIN = RestingLevel(offset_m=0.0055, sd_m=0.0015)
"""Of the recordings of 3DPotatoTwin, measured on its tuber R9-9: 5.4 mm with an sd of 0.95 mm over the optima of 150
starts (regressor/studies/resting.py, seed 0). The sd here says a little more: it is one tuber of one season."""
