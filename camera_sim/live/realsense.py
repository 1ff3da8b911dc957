"""A live RealSense camera. Depth scale and intrinsics come from the device, never from a default.

Devices stall, drop off the bus and come back with another depth unit. The source resets and opens them again, for as
long as it takes, and goes on in the unit and with the numbers that the run began with.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from camera_sim.live.realsense_options import apply, check_stream, depth_filters
from conveyor.config_camera import CameraConfig
from conveyor.errors import DeviceError, InputError
from conveyor.extras import needed
from conveyor.formats.source import CameraDescription, Refused
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame

JPEG_QUALITY = 90
WAIT_MS = 200
STALLED_AFTER_S = 3.0
BACK_WITHIN_S = 8.0
"""A device that was reset is on the bus again by then."""
BACKOFF_FIRST_S, BACKOFF_LIMIT_S = 1.0, 30.0
LOOK_EVERY_S = 0.2
SAME_UNIT = 1e-3


class RealSenseSource:
    """Depth frames of a connected D405 (or its relatives), as the device numbers and times them.

    Attributes:
        reopened: how often the device had to be opened again.
    """

    _description: CameraDescription

    def __init__(self, name: str, settings: CameraConfig, library: Any) -> None:
        self.reopened = 0
        self._name = name
        self._settings = settings
        self._rs = library
        self._serial = settings.serial
        self._pipeline: Any = None
        self._align_color: Any = None
        self._filters: list[Any] = []
        self._to_unit = 1.0
        self._poll: Callable[[float], bool] = lambda still_s: True
        self._log = logging.getLogger(f"camera/{name}")

    @classmethod
    def connect(cls, name: str, settings: CameraConfig) -> RealSenseSource:
        """Start the device.

        Raises:
            InputError: pyrealsense2 is not installed, or the config's depth scale is not the device's.
            DeviceError: the device is not there, or it refuses the stream.
        """
        source = cls(name, settings, _library())
        source._description = source._open()
        return source

    @property
    def description(self) -> CameraDescription:
        """As the device says; a depth scale in the config is only compared with it."""
        return self._description

    def attach(self, poll: Callable[[float], bool]) -> None:
        """While nothing comes, `poll` is told several times a second for how long (seconds); False ends the frames."""
        self._poll = poll

    def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
        """Frames as they come, until no one asks for more. The device's first frame is number `after` + 1, and what
        could not be seen while it was away is a gap in the numbers. One that came back with other intrinsics is told,
        and tried again until it has those of the run.
        """
        newest, last_s = after, time.monotonic()
        offset, before = None, -1
        try:
            while self._poll(time.monotonic() - last_s):
                taken = self._take()
                if taken is None:
                    if time.monotonic() - last_s >= STALLED_AFTER_S:
                        if not self._recover(last_s):
                            return
                        offset, before = None, -1
                    continue
                depth, color = taken
                number = int(depth.get_frame_number())
                if number < before:  # it left the bus for a moment, and the SDK started it again without a word
                    if not self._recover(last_s, reset=False):
                        return
                    offset, before = None, -1
                    continue
                before = number
                if offset is None:  # the first one, or the first after a gap whose length only the time tells
                    missed = (
                        0
                        if newest == after
                        else max(0, round((time.monotonic() - last_s) * self._settings.realsense.fps) - 1)
                    )
                    offset = newest + 1 + missed - number
                last_s = time.monotonic()
                if number + offset > newest:
                    newest = number + offset
                    yield self._frame(depth, color, newest, run)
        finally:
            self._close()

    def _take(self) -> tuple[Any, Any] | None:
        """The next depth frame, filtered, and its colour, aligned to it, or None; None when none came within a moment,
        or the device is gone.
        """
        try:
            frames = self._pipeline.wait_for_frames(WAIT_MS)
            if self._align_color is not None:
                frames = self._align_color.process(frames)
            depth = frames.get_depth_frame()
            for one in self._filters if depth else ():
                depth = one.process(depth)
            color = frames.get_color_frame() if depth and self._align_color is not None else None
        except RuntimeError:
            return None
        return (depth, color or None) if depth else None

    def _recover(self, since_s: float, *, reset: bool = True) -> bool:
        """Reset and open the device again, until it works; False: stop. One that came back by itself has lost its
        options and its depth unit: it is opened again, and is reset only where that fails.
        """
        backoff_s = BACKOFF_FIRST_S
        while True:
            self._close()
            if reset:
                self._log.warning("no frame for %.0f s: resetting the camera", time.monotonic() - since_s)
                self._reset()
            else:
                self._log.warning("the camera's frame numbers began again: opening it again")
            reset = True
            if not self._wait(lambda: self._device() is not None, BACK_WITHIN_S, since_s):
                return False
            try:
                self._align(self._open())
            except InputError as error:
                self._log.error("%s; tried again in %.0f s", error, backoff_s)
                if not self._wait(lambda: False, backoff_s, since_s):
                    return False
                backoff_s = min(2 * backoff_s, BACKOFF_LIMIT_S)
                continue
            self.reopened += 1
            self._log.warning("the camera is open again after %.1f s", time.monotonic() - since_s)
            return True

    def _wait(self, until: Callable[[], bool], seconds: float, since_s: float) -> bool:
        """Wait until something is so, at most for `seconds`; False: stop."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not until():
            if not self._poll(time.monotonic() - since_s):
                return False
            time.sleep(LOOK_EVERY_S)
        return True

    def _reset(self) -> None:
        device = self._device()
        if device is not None:
            with contextlib.suppress(RuntimeError):  # it went meanwhile
                device.hardware_reset()
            time.sleep(LOOK_EVERY_S)  # it is on the bus for a moment still

    def _close(self) -> None:
        pipeline, self._pipeline = self._pipeline, None
        if pipeline is not None:
            with contextlib.suppress(RuntimeError):  # not started, or gone
                pipeline.stop()

    def _align(self, found: CameraDescription) -> None:
        """Go on in the depth unit that the run began with.

        Raises:
            DeviceError: the intrinsics are others.
        """
        began = self._description
        if found.intrinsics != began.intrinsics:
            raise DeviceError(
                f"camera '{self._name}' came back with {found.intrinsics}, the run began with {began.intrinsics}: "
                "plug in the camera that was there, or start a new run"
            )
        self._to_unit = found.depth_scale_m / began.depth_scale_m
        if abs(self._to_unit - 1) > SAME_UNIT:
            self._log.warning(
                "the camera came back with a depth unit of %g m and keeps it: its depths are converted to %g m",
                found.depth_scale_m, began.depth_scale_m,
            )  # fmt: skip

    def _device(self) -> Any:
        """The camera on the bus: the one of the run, or whichever comes first."""
        rs = self._rs
        try:
            for device in rs.context().query_devices():
                if self._serial in (None, device.get_info(rs.camera_info.serial_number)):
                    return device
        except RuntimeError:  # one goes while it is asked
            return None
        return None

    def _open(self) -> CameraDescription:
        rs, device = self._rs, self._device()
        if device is None:
            raise DeviceError(
                f"camera '{self._name}': RealSense {self._serial or 'device'} is not connected; connected: "
                f"{self._connected() or 'none'}. Check the cable and the udev rules, or set 'serial' to one of them"
            )
        try:
            serial = device.get_info(rs.camera_info.serial_number)
            where = self._where(device)
            config = rs.config()
            config.enable_device(serial)
            wanted = self._settings.realsense
            check_stream(rs, device, wanted, camera=self._name)
            told = apply(rs, device.first_depth_sensor(), wanted, camera=self._name)
            config.enable_stream(rs.stream.depth, wanted.width, wanted.height, rs.format.z16, wanted.fps)
            if wanted.color:
                config.enable_stream(rs.stream.color, wanted.width, wanted.height, rs.format.bgr8, wanted.fps)
            self._align_color = rs.align(rs.stream.depth) if wanted.color else None
            self._filters = depth_filters(rs, wanted)
            self._pipeline = rs.pipeline()
            profile = self._pipeline.start(config)
            scale_m = self._depth_scale_m(profile.get_device().first_depth_sensor())
            k = profile.get_stream(rs.stream.depth).as_video_stream_profile().get_intrinsics()
        except RuntimeError as error:
            self._close()
            raise DeviceError(f"camera '{self._name}': the RealSense refuses: {error}") from error
        self._serial = serial
        self._log.info("RealSense %s: %s", serial, told)
        return CameraDescription(
            name=self._name,
            origin=f"RealSense {serial}{where}: {told}",
            intrinsics=Intrinsics(k.width, k.height, k.fx, k.fy, k.ppx, k.ppy),
            depth_scale_m=scale_m,
            belt_distance_m=self._settings.belt_distance_m,
            belt_from_camera=None,
            fps=float(wanted.fps),
            frames=None,
            live=True,
            serial=serial,
        )

    def _depth_scale_m(self, sensor: Any) -> float:
        """The device's unit; after a restart set back to the one the run began with, where it can be set.

        Raises:
            InputError: the config says another one.
        """
        scale_m = float(sensor.get_depth_scale())
        if hasattr(self, "_description") and abs(scale_m / self._description.depth_scale_m - 1) > SAME_UNIT:
            self._log.warning("the camera came back with a depth unit of %g m: setting it back", scale_m)
            with contextlib.suppress(RuntimeError):  # not every device can
                sensor.set_option(self._rs.option.depth_units, self._description.depth_scale_m)
            scale_m = float(sensor.get_depth_scale())
        wanted = self._settings.depth_scale_m
        if wanted is not None and not self.reopened and abs(wanted - scale_m) > SAME_UNIT * scale_m:
            raise InputError(
                f"camera '{self._name}': the device's depth scale is {scale_m:g} m, the config says {wanted:g}; "
                "remove depth_scale_m, a live camera knows its own"
            )
        return scale_m

    def _connected(self) -> str:
        rs = self._rs
        try:
            return ", ".join(
                f"{device.get_info(rs.camera_info.serial_number)}{self._where(device)}"
                for device in rs.context().query_devices()
            )
        except RuntimeError as error:
            return f"unknown ({error})"

    def _where(self, device: Any) -> str:
        """USB type and port, as far as the device says them."""
        rs = self._rs
        told = []
        for name, words in (("usb_type_descriptor", "USB"), ("physical_port", "port")):
            field = getattr(rs.camera_info, name, None)
            if field is not None and device.supports(field):
                told.append(f"{words} {device.get_info(field)}")
        return f" ({', '.join(told)})" if told else ""

    def _frame(self, depth: Any, color: Any, seq: int, run: str) -> Frame:
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
            depth=self._in_unit(np.array(depth.get_data(), np.uint16)),
            color_jpeg=None if color is None else _jpeg(np.asarray(color.get_data(), np.uint8)),
        )

    def _in_unit(self, depth: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """(h, w) uint16 depth in the run's unit; what does not fit is unseen."""
        if abs(self._to_unit - 1) <= SAME_UNIT:
            return depth
        converted = np.rint(depth * self._to_unit)
        return np.where(converted <= np.iinfo(np.uint16).max, converted, 0).astype(np.uint16)


def _jpeg(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(n,) the JPEG file of an (h, w, 3) picture."""
    return np.asarray(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1], np.uint8).ravel()


def connected_devices() -> list[tuple[str, str]]:
    """(name, serial number) of every RealSense on this machine.

    Raises:
        InputError: the SDK's package is not installed.
        DeviceError: the SDK cannot look for them.
    """
    rs = _library()
    try:
        return [
            (str(device.get_info(rs.camera_info.name)), str(device.get_info(rs.camera_info.serial_number)))
            for device in rs.context().query_devices()
        ]
    except RuntimeError as error:
        raise DeviceError(f"the RealSense SDK cannot look for cameras: {error}") from error


def _library() -> Any:
    return needed("pyrealsense2", extra="realsense", what="a live RealSense camera")
