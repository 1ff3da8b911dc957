"""The keys of `[belt]` that describe a body of known size in view."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from conveyor.config_base import Metres, Section
from conveyor.gauge import Gauge

Size = Annotated[float, Field(gt=0, le=5000)]
Place = Annotated[float, Field(ge=-5000, le=5000)]
LEAST_BAR_MM = 40.0
"""Over the belt: nearer to it a bar moves as the belt does, and tells nothing."""
DESCRIBES = {"gauge_width_m": "belt-width", "gauge_size_mm": "bar", "gauge_place_mm": "bar"}
"""The gauge that each key describes."""


class GaugeSection(Section):
    """A gauge, if there is one."""

    gauge: Literal["none", "rods", "belt-width", "bar", "travel"] = Field(
        "none",
        description="a body of known size in view: tells a mount that moved from a depth scale that drifted; "
        "travel: the belt's own way, by an encoder that is right within 0.5 %",
    )
    gauge_width_m: Metres | None = Field(None, description="belt-width: edge to edge, both edges in view")
    gauge_size_mm: tuple[Size, Size] | None = Field(
        None, description="bar: of its level top, along and across the belt"
    )
    gauge_place_mm: tuple[Place, Place, Place] | None = Field(
        None, description="bar: middle of its top in belt coordinates (along, across, above the belt)"
    )

    @model_validator(mode="after")
    def _gauge_described(self) -> Self:
        described = [key for key in DESCRIBES if key in self.model_fields_set and getattr(self, key) is not None]
        if described and "gauge" not in self.model_fields_set:
            wanted = " or ".join(f'"{name}"' for name in dict.fromkeys(DESCRIBES[key] for key in described))
            raise ValueError(f'{" and ".join(described)} given without gauge: set gauge = {wanted}, or "none"')
        if self.gauge == "belt-width" and self.gauge_width_m is None:
            raise ValueError('gauge is "belt-width": give gauge_width_m, from edge to edge')
        if self.gauge == "bar" and (self.gauge_size_mm is None or self.gauge_place_mm is None):
            raise ValueError('gauge is "bar": give gauge_size_mm = [along, across] and gauge_place_mm = [x, y, z]')
        if self.gauge == "bar" and self.gauge_place_mm is not None and self.gauge_place_mm[2] < LEAST_BAR_MM:
            raise ValueError(
                f"gauge_place_mm says that the bar's top is {self.gauge_place_mm[2]:g} mm above the belt; it tells "
                f"depth by that, so {LEAST_BAR_MM:g} mm at least are needed"
            )
        return self

    def described_gauge(self, *, pitch_mm: float, rod_mm: float) -> Gauge | None:
        """In metres; None where no body is in view. `pitch_mm`, `rod_mm`: of the web's rods."""
        if self.gauge == "none" or self.gauge == "travel":
            return None
        along_mm, across_mm = self.gauge_size_mm or (0.0, 0.0)
        x_mm, y_mm, z_mm = self.gauge_place_mm or (0.0, 0.0, 0.0)
        return Gauge(
            self.gauge,
            pitch_m=pitch_mm / 1000,
            rod_m=rod_mm / 1000,
            width_m=self.gauge_width_m or 0.0,
            size_m=(along_mm / 1000, across_mm / 1000),
            place_m=(x_mm / 1000, y_mm / 1000, z_mm / 1000),
        )
