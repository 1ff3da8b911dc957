"""The source that a line's config names for a camera."""

from __future__ import annotations

from camera_sim.clocked import ClockedSource
from camera_sim.placed import placed
from conveyor.config import LineConfig
from conveyor.formats import Source
from conveyor.formats.configured import recorded_source


def configured_source(config: LineConfig, camera: str) -> Source:
    """The source of `camera`, named as the line names it.

    Raises:
        ConfigError: a recording without its path.
        InputError: the recording or device cannot be used.
    """
    settings = config.camera(camera)
    if settings.source == "realsense":
        from camera_sim.live.realsense import RealSenseSource

        return placed(RealSenseSource.connect(camera, settings), settings)
    if settings.source == "ros2":
        from camera_sim.live.ros2 import Ros2Source

        return placed(Ros2Source.connect(camera, settings, config.link), settings)
    recorded = recorded_source(config, camera)
    if settings.starts_at_s is None:
        return recorded
    return ClockedSource(recorded, starts_at_s=settings.starts_at_s, speed=settings.speed)
