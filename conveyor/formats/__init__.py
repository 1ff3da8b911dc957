"""Sources of frames, all alike to the rest: recordings, live cameras, the simulator."""

from conveyor.formats.detect import Recording, camera_names, describe_recording, open_source
from conveyor.formats.source import CameraDescription, PolledSource, Refused, Source

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
