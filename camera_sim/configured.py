"""The source that a line's config names for a camera."""

from __future__ import annotations

from camera_sim.clocked import ClockedSource
from camera_sim.placed import placed
from conveyor.config import LineConfig
from conveyor.errors import ConfigError
from conveyor.formats import Source, camera_names, open_source


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
    if settings.path is None:
        raise ConfigError(f"cameras.{camera}: a recording needs its path, e.g. path = 'recordings/monday.mcap'")
    wanted = settings.camera
    if wanted is None and camera in camera_names(settings.path):
        wanted = camera
    recorded = open_source(
        settings.path,
        camera=wanted,
        name=camera,
        belt_distance_m=settings.belt_distance_m,
        place=settings.place,
        belt_from_camera=settings.pose,
        depth_scale_m=settings.depth_scale_m,
        ignore_masks=settings.ignore_masks,
    )
    if settings.starts_at_s is None:
        return recorded
    return ClockedSource(recorded, starts_at_s=settings.starts_at_s, speed=settings.speed)
