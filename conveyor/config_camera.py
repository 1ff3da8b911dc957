"""The section of one camera: where its frames come from, and where it hangs over the belt.

A router reads it, too, and does without numpy: what needs it is imported where it is used.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from conveyor.config_base import Endpoint, Metres, Section
from conveyor.config_realsense import RealSenseConfig

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from conveyor.camera_place import CameraPlace

Across = Annotated[float, Field(ge=-20, le=20)]
Along = Annotated[float, Field(ge=-100, le=100)]
Turned = Annotated[float, Field(ge=-180, le=180)]
Row = tuple[float, float, float, float]
PLACE = ("across_m", "along_m", "turned_deg")
"""Keys that say where a camera hangs, beside its distance."""
OF_SOURCE = {
    "recording": ("path", "camera", "speed", "starts_at_s", "window", "ignore_masks"),
    "realsense": ("serial", "realsense"),
    "ros2": ("topic", "info_topic", "ros_domain", "ros_router"),
}
"""Keys that say nothing to cameras of another source; `waits = false` is true of a device, too."""


class CameraConfig(Section):
    """One camera: where its frames come from."""

    source: Literal["recording", "realsense", "ros2"] = Field(
        "recording", description="where frames come from: a file, a RealSense device, a ROS 2 topic"
    )
    path: Path | None = Field(None, description="recording to replay (folder, .mcap, 3DPotatoTwin)")
    camera: str | None = Field(None, description="camera of that recording; default: this camera's own name")
    speed: Annotated[float, Field(ge=0)] = Field(1.0, description="times real time; 0 = as fast as the line takes it")
    waits: bool = Field(True, description="wait for the segmenter and lose nothing; false behaves like a live camera")
    starts_at_s: float | None = Field(
        None,
        gt=0,
        le=4e9,
        description="play a recording as a camera that began then (s since 1970): late is gone; with waits = false",
    )
    window: int = Field(1, ge=1, le=64, description="frames in flight while waiting")
    compress: Literal["raw", "zstd"] = Field("raw", description="how frames travel")
    direct: str = Field(
        "auto",
        pattern=r"^(auto|off|unixsock-stream/.+|tcp/(127\.0\.0\.1|\[::1\]|localhost):\d{1,5})$",
        description="the segmenter's socket on the camera's own host, past the router, e.g. "
        "unixsock-stream//dev/shm/tuberline/front.sock; auto: where one `run` starts both; off: by the router",
    )
    serial: str | None = Field(None, description="realsense: serial number of the device")
    realsense: RealSenseConfig = RealSenseConfig()
    topic: str | None = Field(None, description="ros2: depth image topic, e.g. /camera/camera/depth/image_rect_raw")
    info_topic: str | None = Field(None, description="ros2: its CameraInfo topic; default: camera_info beside it")
    ros_domain: int = Field(0, ge=0, le=232, description="ros2: ROS_DOMAIN_ID of the publishing nodes")
    ros_router: Endpoint | None = Field(
        None, description="ros2: endpoint of their rmw_zenohd; default: the line's router"
    )
    belt_distance_m: Metres | None = Field(None, description="overrides what the recording says")
    across_m: Across | None = Field(
        None, description="where it hangs across the belt, positive to the left of who looks along the travel"
    )
    along_m: Along | None = Field(None, description="where it hangs along the belt, positive with the travel")
    turned_deg: Turned | None = Field(
        None,
        description="from the travel to the image's downward direction, counter-clockwise seen from above; "
        "0: the belt runs down the image, 180: up, 90 or -90: across",
    )
    belt_from_camera: tuple[Row, Row, Row, Row] | None = Field(
        None, description="its whole pose instead of these four, as `tuberline calibrate cameras` prints it"
    )
    depth_scale_m: Annotated[float, Field(gt=0, le=0.01)] | None = Field(None, description="overrides the recording")
    ignore_masks: bool = Field(False, description="find tubers though the recording has masks of its own")

    @field_validator("belt_from_camera", mode="before")
    @classmethod
    def _four_by_four(cls, given: object) -> object:
        """One fault of its shape; pydantic tells one of each number that is missing."""
        rows = list(given) if isinstance(given, list | tuple) else None
        if rows is not None and [len(row) if isinstance(row, list | tuple) else 0 for row in rows] != [4] * 4:
            raise ValueError("must be four rows of four numbers, as `tuberline calibrate cameras` prints them")
        return given

    @property
    def held_back(self) -> bool:
        """It waits for the segmenter, as only a recording can; what is not held back is live."""
        return self.waits and self.source == "recording"

    @property
    def of_today(self) -> bool:
        """Its frames say the time of the day: a device's, or a recording's that plays as one (`starts_at_s`)."""
        return self.source != "recording" or self.starts_at_s is not None

    @property
    def pace(self) -> float | None:
        """Seconds of its clock in one of ours; None where the line holds it back or takes it as fast as it can."""
        if self.of_today:
            return 1.0
        return None if self.waits or self.speed == 0 else self.speed

    @model_validator(mode="after")
    def _by_the_clock(self) -> Self:
        if self.starts_at_s is not None and self.source == "recording" and (self.waits or self.speed == 0):
            raise ValueError("starts_at_s plays a recording by the clock: it needs waits = false and a speed above 0")
        return self

    @model_validator(mode="after")
    def _settings_of_that_source(self) -> Self:
        if self.source != "recording" and self.path is not None:
            raise ValueError(f"source '{self.source}' takes no path ({self.path}); remove one of both")
        if self.source != "realsense" and self.realsense != RealSenseConfig():
            raise ValueError(f"a section realsense is for source = 'realsense'; the source is '{self.source}'")
        for source, keys in OF_SOURCE.items():
            given = [key for key in keys if getattr(self, key) != type(self).model_fields[key].default]
            if given and source != self.source:
                raise ValueError(
                    f"{' and '.join(given)} of source = '{source}', but the source is '{self.source}': correct "
                    f"source, or remove {'it' if len(given) == 1 else 'them'}"
                )
        return self

    @model_validator(mode="after")
    def _placed_once(self) -> Self:
        placed = [key for key in PLACE if getattr(self, key) is not None]
        if self.belt_from_camera is not None:
            if said := [*placed, *(("belt_distance_m",) if self.belt_distance_m is not None else ())]:
                raise ValueError(f"belt_from_camera says it all: remove {', '.join(said)}, or belt_from_camera")
            from conveyor.pose import pose_fault

            if fault := pose_fault([list(row) for row in self.belt_from_camera]):
                raise ValueError(fault)
        elif placed and self.source != "recording" and self.belt_distance_m is None:
            raise ValueError(f"{placed[0]} needs belt_distance_m beside it: a live camera does not know its own")
        return self

    @property
    def pose(self) -> NDArray[np.float64] | None:
        """(4, 4) `belt_from_camera` that is given; None where none is."""
        import numpy as np

        return None if self.belt_from_camera is None else np.array(self.belt_from_camera, np.float64)

    @property
    def place(self) -> CameraPlace | None:
        """Where it is said to hang; None where nothing is said."""
        if self.belt_from_camera is None and all(getattr(self, key) is None for key in PLACE):
            return None
        from conveyor.camera_place import CameraPlace

        if self.pose is not None:
            return CameraPlace.of(self.pose)
        return CameraPlace(self.along_m or 0.0, self.across_m or 0.0, self.turned_deg or 0.0)


def one_device_each(cameras: Mapping[str, CameraConfig]) -> None:
    """Refuse two cameras of one device; raises ValueError with their names.

    Those that name none take the first device of their own computer, which may be two.
    """
    by_serial: dict[str, list[str]] = {}
    for name, camera in sorted(cameras.items()):
        if camera.serial is not None:
            by_serial.setdefault(camera.serial, []).append(name)
    for serial, names in by_serial.items():
        if len(names) > 1:
            raise ValueError(
                f"cameras {', '.join(names)} all have serial '{serial}': a device gives its frames to one camera"
            )


def at_one_place(cameras: Mapping[str, CameraConfig]) -> tuple[str, ...]:
    """Live cameras that are said, or by silence taken, to hang where another one hangs; by name."""
    return not_apart({name: camera.place for name, camera in cameras.items() if camera.source != "recording"})


def not_apart(places: Mapping[str, CameraPlace | None]) -> tuple[str, ...]:
    """Cameras whose place is that of another one, None: at the belt's origin. They would see one tuber in two that lie
    side by side. By name.
    """
    from conveyor.camera_place import CameraPlace

    hung = {name: place or CameraPlace() for name, place in places.items()}
    spots = Counter((place.along_m, place.across_m) for place in hung.values())
    return tuple(sorted(name for name, place in hung.items() if spots[place.along_m, place.across_m] > 1))


def hang_together(cameras: Sequence[str]) -> str:
    """That cameras are said to hang at one place."""
    return (
        f"cameras {', '.join(cameras)} are taken to hang at one place of the belt: give across_m or along_m of each, "
        "or its belt_from_camera; `tuberline calibrate cameras RECORDING` measures them"
    )
