"""What of known size a line's cameras see: the rods of its web, the belt's width, or a bar on the frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

GaugeKind = Literal["rods", "belt-width", "bar"]


@dataclass(frozen=True, slots=True)
class Gauge:
    """A body of known size. Lengths in metres.

    Attributes:
        pitch_m, rod_m: centre to centre, and diameter, of the rods of a web.
        width_m: of the belt, edge to edge, both edges in view.
        size_m: of a bar's level top, along and across the belt; place_m: its middle in belt coordinates, under each
            camera that has one.
    """

    kind: GaugeKind
    pitch_m: float = 0.0
    rod_m: float = 0.0
    width_m: float = 0.0
    size_m: tuple[float, float] = (0.0, 0.0)
    place_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def absolute(self) -> bool:
        """It says how far the belt is by itself. The others tell only what changed since the run began: holes eat at
        edges, and a bowed field of view bends what is small.
        """
        return self.kind == "rods"
