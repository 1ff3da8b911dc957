"""Sources of frames, all alike to the rest: recordings, live cameras, the simulator."""

from camera_sim.sources.base import CameraDescription, PolledSource, Refused, Source
from camera_sim.sources.detect import Recording, camera_names, describe_recording, open_source

__all__ = [
    "CameraDescription",
    "PolledSource",
    "Recording",
    "Refused",
    "Source",
    "camera_names",
    "describe_recording",
    "open_source",
]
