"""A live RealSense camera. Depth scale and intrinsics come from the device, never from a default."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from conveyor.config import CameraConfig
from conveyor.errors import InputError
from conveyor.formats.source import CameraDescription, Refused
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame

WIDTH, HEIGHT, FPS = 848, 480, 30
FRAME_TIMEOUT_MS = 2000


class RealSenseSource:
    """Depth frames of a connected D405 (or its relatives), as the device numbers and times them."""

    _description: CameraDescription

    def __init__(self, name: str, settings: CameraConfig, library: Any) -> None:
        self._name = name
        self._settings = settings
        self._rs = library
        self._pipeline: Any = library.pipeline()

    @classmethod
    def connect(cls, name: str, settings: CameraConfig) -> RealSenseSource:
        """Start the device.

        Raises:
            InputError: pyrealsense2 is not installed, the device is not there, or it refuses the stream.
        """
        source = cls(name, settings, _library())
        source._description = source._start()
        return source

    @property
    def description(self) -> CameraDescription:
        """As the device says; a depth scale in the config is only compared with it."""
        return self._description

    def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
        """Frames as they come, until nobody asks for more. The device's first frame is number `after` + 1."""
        first: int | None = None
        newest = after
        try:
            while True:
                depth = self._next_depth()
                first = int(depth.get_frame_number()) if first is None else first
                seq = after + 1 + int(depth.get_frame_number()) - first
                if seq > newest:
                    newest = seq
                    yield self._frame(depth, seq, run)
        finally:
            self._pipeline.stop()

    def _start(self) -> CameraDescription:
        rs, serial = self._rs, self._settings.serial
        found = [device.get_info(rs.camera_info.serial_number) for device in rs.context().query_devices()]
        if not found or (serial is not None and serial not in found):
            raise InputError(
                f"camera '{self._name}': RealSense {serial or 'device'} is not connected; connected: "
                f"{', '.join(found) or 'none'}. Check the cable and the udev rules, or set 'serial' to one of them"
            )
        config = rs.config()
        config.enable_device(serial or found[0])
        config.enable_stream(rs.stream.depth, WIDTH, HEIGHT, rs.format.z16, FPS)
        try:
            profile = self._pipeline.start(config)
        except RuntimeError as error:
            raise InputError(f"camera '{self._name}': the RealSense {serial or found[0]} refuses: {error}") from error
        scale_m = float(profile.get_device().first_depth_sensor().get_depth_scale())
        wanted = self._settings.depth_scale_m
        if wanted is not None and abs(wanted - scale_m) > 1e-3 * scale_m:
            raise InputError(
                f"camera '{self._name}': the device's depth scale is {scale_m:g} m, the config says {wanted:g}; "
                "remove depth_scale_m, a live camera knows its own"
            )
        k = profile.get_stream(rs.stream.depth).as_video_stream_profile().get_intrinsics()
        return CameraDescription(
            name=self._name,
            origin=f"RealSense {serial or found[0]}",
            intrinsics=Intrinsics(k.width, k.height, k.fx, k.fy, k.ppx, k.ppy),
            depth_scale_m=scale_m,
            belt_distance_m=self._settings.belt_distance_m,
            belt_from_camera=None,
            fps=float(FPS),
            frames=None,
            live=True,
        )

    def _next_depth(self) -> Any:
        try:
            depth = self._pipeline.wait_for_frames(FRAME_TIMEOUT_MS).get_depth_frame()
        except RuntimeError as error:
            raise InputError(
                f"camera '{self._name}': no frame from the RealSense within {FRAME_TIMEOUT_MS} ms ({error})"
            ) from error
        return depth

    def _frame(self, depth: Any, seq: int, run: str) -> Frame:
        d = self._description
        return Frame(
            camera=d.name,
            run=run,
            seq=seq,
            captured_ns=round(depth.get_timestamp() * 1e6),
            travel_m=None,
            depth_scale_m=d.depth_scale_m,
            intrinsics=d.intrinsics,
            belt_distance_m=d.belt_distance_m,
            depth=np.array(depth.get_data(), np.uint16),
        )


def _library() -> Any:
    try:
        return importlib.import_module("pyrealsense2")
    except ImportError as error:
        raise InputError(
            f"a live RealSense camera needs the package pyrealsense2 ({error}): pip install 'tuberline[realsense]'"
        ) from error
