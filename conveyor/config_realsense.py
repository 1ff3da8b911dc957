"""The settings of a RealSense camera, as a line's file gives them."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from conveyor.config_base import Section

Preset = Literal["default", "hand", "high-accuracy", "high-density", "medium-density"]
Filter = Literal["spatial", "temporal", "hole-filling"]


class RealSenseConfig(Section):
    """What a RealSense camera is set to before it starts. Each setting is checked against what the device offers, read
    back from it, and told with the camera's source; what is not given stays as the device has it.
    """

    width: int = Field(848, ge=160, le=1920, description="of the depth image, pixels")
    height: int = Field(480, ge=90, le=1200, description="of the depth image, pixels")
    fps: int = Field(30, ge=1, le=300, description="frames per second")
    exposure_us: int | None = Field(
        None, ge=1, le=1_000_000, description="fixed exposure, microseconds; not given: automatic"
    )
    gain: int | None = Field(None, ge=0, le=1000, description="fixed gain; with exposure_us")
    preset: Preset | None = Field(None, description="the device's own set of depth settings, by name")
    laser: bool | None = Field(None, description="the projector, on or off (the D405 has none)")
    laser_mw: float | None = Field(None, ge=0, le=1000, description="power of the projector, milliwatts")
    filters: tuple[Filter, ...] = Field(
        (), description="the SDK's own; temporal smears a moving belt, hole-filling invents depth"
    )
    color: bool = Field(
        False, description="colour aligned to the depth, for viewers and recordings; weighing needs none"
    )
