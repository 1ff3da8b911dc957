"""On PYTHONPATH of a camera process: stands in for the RealSense SDK, with one device that misbehaves on command.

It shows a plane at 0.46 m, 30 times a second in real time. Files in the folder REALSENSE_STAND_IN command it: `gone`
(off the bus), `stalled` (no frames until it is reset), `unit` (depth unit in metres after the next start), `fixed`
(the unit cannot be set), `refuses` (does not start), `stubborn` (keeps its exposure), `blinks` (leaves the bus for a
moment, and the SDK starts it again by itself). It has a D405's options: no
projector. A reset takes it off the bus for a second. `asked` tells what was done.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np

FOLDER = Path(os.environ["REALSENSE_STAND_IN"])
SERIAL, DISTANCE_M, FPS = "123622270001", 0.46, 30
camera_info = SimpleNamespace(serial_number=0, usb_type_descriptor=1, physical_port=2, name=3)
stream = SimpleNamespace(depth=0, color=1)
format = SimpleNamespace(z16=0, bgr8=1)
option = SimpleNamespace(
    depth_units=0, visual_preset=1, enable_auto_exposure=2, exposure=3, gain=4, emitter_enabled=5, laser_power=6
)
RANGES = {1: (0.0, 5.0, 1.0), 2: (0.0, 1.0, 1.0), 3: (1.0, 165000.0, 1.0), 4: (16.0, 248.0, 1.0)}
"""Lowest, highest and step of the options that this device has."""
OFFERED = [(848, 480, 15), (848, 480, 30), (848, 480, 60), (1280, 720, 15), (1280, 720, 30)]
_options = {1: 1.0, 2: 1.0, 3: 33000.0, 4: 16.0}
_away_until = 0.0
_unit_m = 0.0001


def _is(what: str) -> bool:
    return (FOLDER / what).exists()


def _asked(what: str) -> None:
    with (FOLDER / "asked").open("a") as file:
        file.write(what + "\n")


def _there() -> bool:
    return not _is("gone") and time.monotonic() >= _away_until


def _take_unit() -> None:
    """The unit that a device has when it starts."""
    global _unit_m
    if _is("unit"):
        _unit_m = float((FOLDER / "unit").read_text())
        (FOLDER / "unit").unlink()


def _need_device() -> None:
    if not _there():
        raise RuntimeError("Device disconnected")


class device:
    def get_info(self, what: int) -> str:
        _need_device()
        return (SERIAL, "3.2", "2-1.4", "Intel RealSense D405")[what]

    def supports(self, what: int) -> bool:
        return True

    def hardware_reset(self) -> None:
        global _away_until
        _need_device()
        _asked("reset")
        _away_until = time.monotonic() + 1.0
        (FOLDER / "stalled").unlink(missing_ok=True)

    def first_depth_sensor(self) -> sensor:
        return sensor()

    def query_sensors(self) -> list[sensor]:
        return [sensor()]


class sensor:
    def get_depth_scale(self) -> float:
        _need_device()
        return _unit_m

    def get_stream_profiles(self) -> list[offer]:
        return [offer(kind, *size) for size in OFFERED for kind in (stream.depth, stream.color)]

    def supports(self, what: int) -> bool:
        return what in RANGES

    def get_option_range(self, what: int) -> SimpleNamespace:
        return SimpleNamespace(**dict(zip(("min", "max", "step"), RANGES[what], strict=True)))

    def get_option(self, what: int) -> float:
        return _options[what]

    def set_option(self, what: int, value: float) -> None:
        global _unit_m
        if what in RANGES:
            _asked(f"option {what} {value:g}")
            if what == option.visual_preset:  # a preset sets the others
                _options.update({2: 1.0, 3: 33000.0, 4: 16.0})
            if not (_is("stubborn") and what == option.exposure):
                _options[what] = value
            return
        _asked(f"unit {value:g}")
        if _is("fixed"):
            raise RuntimeError("set_option is not supported")
        _unit_m = value


class offer:
    def __init__(self, kind: int, width: int, height: int, fps: int) -> None:
        self._kind, self._size = kind, (width, height, fps)

    def stream_type(self) -> int:
        return self._kind

    def format(self) -> int:
        return self._kind  # depth comes as Z16, colour as BGR

    def as_video_stream_profile(self) -> offer:
        return self

    def width(self) -> int:
        return self._size[0]

    def height(self) -> int:
        return self._size[1]

    def fps(self) -> int:
        return self._size[2]


class same:
    """A filter or an alignment that changes nothing."""

    def __init__(self, *_: object) -> None: ...

    def process(self, frame: object) -> object:
        _asked("aligned" if isinstance(self, align) else "filtered")
        return frame


class align(same): ...


spatial_filter = temporal_filter = hole_filling_filter = disparity_transform = same


class context:
    def query_devices(self) -> list[device]:
        return [device()] if _there() else []


class config:
    def enable_device(self, serial: str) -> None:
        assert serial == SERIAL

    def enable_stream(self, what: int, width: int, height: int, how: int, fps: int) -> None:
        assert (width, height, fps) in OFFERED


class profile:
    def get_device(self) -> device:
        return device()

    def get_stream(self, what: int) -> profile:
        return self

    def as_video_stream_profile(self) -> profile:
        return self

    def get_intrinsics(self) -> SimpleNamespace:
        return SimpleNamespace(width=64, height=48, fx=42.0, fy=42.0, ppx=32.0, ppy=24.0)


class frame:
    def __init__(self, number: int, time_ms: float) -> None:
        self._number, self._time_ms = number, time_ms

    def get_depth_frame(self) -> frame:
        return self

    def get_color_frame(self) -> color_frame:
        return color_frame()

    def get_frame_number(self) -> int:
        return self._number

    def get_timestamp(self) -> float:
        return self._time_ms

    def get_data(self) -> np.ndarray:
        return np.full((48, 64), round(DISTANCE_M / _unit_m), np.uint16)


class color_frame:
    def get_data(self) -> np.ndarray:
        return np.full((48, 64, 3), (10, 60, 200), np.uint8)


class pipeline:
    def __init__(self) -> None:
        self._started = 0.0
        self._number = 0
        self._lost = False  # a pipeline does not survive its device's leaving the bus

    def start(self, wanted: config) -> profile:
        _need_device()
        _asked("start")
        if _is("refuses"):
            raise RuntimeError("Couldn't resolve requests")
        _take_unit()
        self._started = time.monotonic()
        return profile()

    def wait_for_frames(self, timeout_ms: int) -> frame:
        deadline = time.monotonic() + timeout_ms / 1000
        due = self._started + (self._number + 1) / FPS
        while time.monotonic() < deadline:
            if _is("blinks"):
                (FOLDER / "blinks").unlink()
                _take_unit()
                self._started = due = time.monotonic()
            self._lost |= not _there()
            if not self._lost and not _is("stalled") and time.monotonic() >= due:
                self._number = int((time.monotonic() - self._started) * FPS)
                return frame(self._number, (time.monotonic() - self._started) * 1000)  # its clock starts again too
            time.sleep(0.004)
        raise RuntimeError(f"Frame didn't arrive within {timeout_ms}")

    def stop(self) -> None:
        if not self._started:
            raise RuntimeError("stop() cannot be called before start()")
