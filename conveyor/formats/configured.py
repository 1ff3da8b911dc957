"""The recording that a line's config names for a camera."""

from __future__ import annotations

from conveyor.config import LineConfig
from conveyor.errors import ConfigError
from conveyor.formats.detect import camera_names, open_source
from conveyor.formats.source import RecordedSource


def recorded_source(config: LineConfig, camera: str) -> RecordedSource:
    """The recording of `camera`, named as the line names it and hung where the line says.

    Raises:
        ConfigError: no path.
        InputError: the recording cannot be used.
    """
    settings = config.camera(camera)
    if settings.path is None:
        raise ConfigError(f"cameras.{camera}: a recording needs its path, e.g. path = 'recordings/monday.mcap'")
    wanted = settings.camera
    if wanted is None and camera in camera_names(settings.path):
        wanted = camera
    return open_source(
        settings.path,
        camera=wanted,
        name=camera,
        belt_distance_m=settings.belt_distance_m,
        place=settings.place,
        belt_from_camera=settings.pose,
        depth_scale_m=settings.depth_scale_m,
        ignore_masks=settings.ignore_masks,
    )
