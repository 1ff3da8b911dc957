"""A RealSense is set as the line's file says: what the device does not offer is refused, what it took is read back."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

from conveyor.config_realsense import RealSenseConfig
from conveyor.errors import InputError

PRESETS = {"default": 1, "hand": 2, "high-accuracy": 3, "high-density": 4, "medium-density": 5}
"""rs400_visual_preset of the SDK."""


def check_stream(rs: Any, device: Any, wanted: RealSenseConfig, *, camera: str) -> None:
    """Whether the device has depth, and colour where it is wanted, of this size and rate.

    Raises:
        InputError: it has not; the text lists what it offers.
    """
    kinds = [("depth", rs.stream.depth, rs.format.z16)]
    kinds += [("colour", rs.stream.color, rs.format.bgr8)] if wanted.color else []
    for words, stream, form in kinds:
        offered: dict[tuple[int, int], set[int]] = defaultdict(set)
        for sensor in device.query_sensors():
            for profile in sensor.get_stream_profiles():
                if profile.stream_type() == stream and profile.format() == form:
                    video = profile.as_video_stream_profile()
                    offered[video.width(), video.height()].add(int(profile.fps()))
        if wanted.fps not in offered.get((wanted.width, wanted.height), set()):
            listed = "; ".join(
                f"{width}x{height} at {', '.join(map(str, sorted(rates)))}"
                for (width, height), rates in sorted(offered.items())
            )
            raise InputError(
                f"camera '{camera}': the device has no {words} of {wanted.width}x{wanted.height} at {wanted.fps} "
                f"frames/s; it offers {listed or 'none'}. Set width, height and fps of its realsense section to one"
            )


def apply(rs: Any, sensor: Any, wanted: RealSenseConfig, *, camera: str) -> str:
    """Set what is given, a preset first, for it changes the others; what the device then says, in words.

    Raises:
        InputError: the device has no such option, not that value, or keeps another one.
    """
    for key, option, value in _asked(rs, wanted):
        if not sensor.supports(option):
            raise InputError(
                f"camera '{camera}': this device has no {key} to set; remove it from its realsense section"
            )
        limits = sensor.get_option_range(option)
        if not limits.min <= value <= limits.max:
            raise InputError(
                f"camera '{camera}': {key} is {value:g}; this device takes {limits.min:g} to {limits.max:g} in steps "
                f"of {limits.step:g}"
            )
        sensor.set_option(option, value)
        kept = float(sensor.get_option(option))
        if abs(kept - value) > max(limits.step, 1e-6 * abs(value)):
            raise InputError(f"camera '{camera}': {key} was set to {value:g} and the device keeps {kept:g}; remove it")
    return _told(rs, sensor, wanted)


def _asked(rs: Any, wanted: RealSenseConfig) -> list[tuple[str, Any, float]]:
    option = rs.option
    asked: list[tuple[str, Any, float | None]] = [
        ("preset", option.visual_preset, PRESETS[wanted.preset] if wanted.preset else None),
        ("exposure_us", option.enable_auto_exposure, 0.0 if wanted.exposure_us is not None else None),
        ("exposure_us", option.exposure, wanted.exposure_us),
        ("gain", option.gain, wanted.gain),
        ("laser", option.emitter_enabled, None if wanted.laser is None else float(wanted.laser)),
        ("laser_mw", option.laser_power, wanted.laser_mw),
    ]
    return [(key, which, float(value)) for key, which, value in asked if value is not None]


def _told(rs: Any, sensor: Any, wanted: RealSenseConfig) -> str:
    """Size, rate and what the device says of its options, as far as it has them."""
    option = rs.option

    def read(which: Any) -> float | None:
        return float(sensor.get_option(which)) if sensor.supports(which) else None

    told = [f"{wanted.width}x{wanted.height} at {wanted.fps}/s"]
    names = {number: name for name, number in PRESETS.items()}
    preset, auto, exposure, gain = (
        read(which) for which in (option.visual_preset, option.enable_auto_exposure, option.exposure, option.gain)
    )
    emitter, power = read(option.emitter_enabled), read(option.laser_power)
    if preset is not None:
        told.append(f"preset {names.get(round(preset), 'custom')}")
    if auto:
        told.append("exposure automatic")
    elif exposure is not None:
        told.append(f"exposure {exposure:g} us")
    if gain is not None and not auto:
        told.append(f"gain {gain:g}")
    if emitter is not None:
        told.append(f"laser {'on' if emitter else 'off'}" + (f" {power:g} mW" if emitter and power is not None else ""))
    told += [f"filter {name}" for name in wanted.filters]
    return ", ".join(told) + (", colour" if wanted.color else "")


def depth_filters(rs: Any, wanted: RealSenseConfig) -> list[Any]:
    """The SDK's filters in the order in which they are run; spatial and temporal ones work on disparity."""
    smoothing = [
        {"spatial": rs.spatial_filter, "temporal": rs.temporal_filter}[name]()
        for name in wanted.filters
        if name != "hole-filling"
    ]
    around = [rs.disparity_transform(True), *smoothing, rs.disparity_transform(False)] if smoothing else []
    return [*around, *([rs.hole_filling_filter()] if "hole-filling" in wanted.filters else [])]
