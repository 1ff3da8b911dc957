"""Depth pixels out of ROS and Foxglove images: 16-bit, float metres, and `compressedDepth`.

16-bit depth is in millimetres and float depth in metres (REP 118). Float depth is rounded to 0.1 mm, which a stereo
camera cannot tell apart at any belt distance. `compressedDepth` is the format of compressed_depth_image_transport:
twelve bytes (int32 kind, two float32 of the inverse-depth quantisation), then a PNG file or RVL. Without them, a 16-bit
PNG file is what the plain image transport and Foxglove send.
"""

from __future__ import annotations

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.formats.png16 import Refusal, is_whole_png
from conveyor.formats.rosbag.messages import RosCalibration, RosCompressed, RosImage
from conveyor.formats.rvl import decode_ros_rvl
from conveyor.geometry import Intrinsics

SHORT_ENCODINGS = ("16UC1", "mono16", "Z16")
FLOAT_ENCODING = "32FC1"
KNOWN = ", ".join((*SHORT_ENCODINGS, f"{FLOAT_ENCODING} (metres)", "compressedDepth png or rvl"))
SHORT_UNIT_M, FLOAT_UNIT_M = 0.001, 0.0001
_HEADER = struct.Struct("<iff")


def depth_encoding(message: RosImage | RosCompressed) -> str:
    """The pixels' encoding: 'rgb8', '16UC1', '32FC1', ..."""
    return message.encoding if isinstance(message, RosImage) else message.format.split(";")[0].strip()


def unit_m(message: RosImage | RosCompressed) -> float:
    """Metres per unit of what `depth_pixels` makes of this message, by REP 118."""
    return FLOAT_UNIT_M if depth_encoding(message) == FLOAT_ENCODING else SHORT_UNIT_M


def unsupported(message: RosImage | RosCompressed) -> str | None:
    """Why no depth can be read from such messages, or None."""
    encoding = depth_encoding(message)
    if isinstance(message, RosCompressed):
        transport = message.format.partition(";")[2]
        plain_png = encoding == "png" or ("png" in transport and encoding in SHORT_ENCODINGS)
        if "compressedDepth" not in transport and not plain_png:
            return f"has format '{message.format}', which is no depth; depth is read from {KNOWN}"
        if encoding == "png":
            return None
    if encoding not in (*SHORT_ENCODINGS, FLOAT_ENCODING):
        return f"has encoding '{encoding}'; depth is read from {KNOWN}"
    return None


def depth_pixels(message: RosImage | RosCompressed) -> NDArray[np.uint16] | Refusal:
    """(H, W) uint16 in units of `unit_m`, 0 = no depth, or why there is none."""
    fault = unsupported(message)
    if fault:
        return Refusal("encoding", fault)
    return _raw(message) if isinstance(message, RosImage) else _compressed(message)


def intrinsics_of(calibration: RosCalibration, *, rectified: bool, where: str) -> Intrinsics:
    """Intrinsics of a calibration: of a rectified image those of its projection matrix P, where there is one.

    Raises:
        InputError: an uncalibrated camera (all zero).
    """
    k, p = calibration.k, calibration.p
    if rectified and len(p) == 12 and p[0] > 0 and p[5] > 0:
        fx, fy, cx, cy = p[0], p[5], p[2], p[6]
    elif len(k) == 9:
        fx, fy, cx, cy = k[0], k[4], k[2], k[5]
    else:
        raise InputError(f"{where} has a K of {len(k)} numbers, 9 are needed")
    if not (fx > 0 and fy > 0 and np.isfinite([fx, fy, cx, cy]).all()):
        raise InputError(f"{where} is not calibrated (fx {fx:g}, fy {fy:g}): calibrate the camera, or fix the driver")
    return Intrinsics(calibration.width, calibration.height, fx, fy, cx, cy)


def _raw(image: RosImage) -> NDArray[np.uint16] | Refusal:
    pixel_bytes = 4 if image.encoding == FLOAT_ENCODING else 2
    row_bytes = pixel_bytes * image.width
    if image.width <= 0 or image.height <= 0:
        return Refusal("truncated", f"is {image.width}x{image.height} pixels")
    if image.step < row_bytes or len(image.data) < image.height * image.step:
        needed = f"{image.height} rows of {max(image.step, row_bytes)}"
        return Refusal("truncated", f"has {len(image.data)} bytes in rows of {image.step}, {needed} are needed")
    rows = np.frombuffer(image.data, np.uint8)[: image.height * image.step].reshape(image.height, image.step)
    order = ">" if image.big_endian else "<"
    pixels = np.ascontiguousarray(rows[:, :row_bytes]).view(f"{order}{'f4' if pixel_bytes == 4 else 'u2'}")
    return _from_metres(pixels.astype(np.float32)) if pixel_bytes == 4 else pixels.astype(np.uint16)


def _compressed(message: RosCompressed) -> NDArray[np.uint16] | Refusal:
    plain_png = "compressedDepth" not in message.format
    if len(message.data) <= _HEADER.size:
        return Refusal("truncated", f"has {len(message.data)} bytes, less than its header")
    _, quant_a, quant_b = _HEADER.unpack_from(message.data)
    if "rvl" in message.format.partition(";")[2]:
        image = decode_ros_rvl(message.data)
    else:
        image = _png(np.frombuffer(message.data, np.uint8)[0 if plain_png else _HEADER.size :])
    if isinstance(image, Refusal) or depth_encoding(message) != FLOAT_ENCODING:
        return image
    with np.errstate(divide="ignore", invalid="ignore"):
        metres = np.float32(quant_a) / (image.astype(np.float32) - np.float32(quant_b))
    return _from_metres(np.where(image > 0, metres, np.nan).astype(np.float32))


def _png(data: NDArray[np.uint8]) -> NDArray[np.uint16] | Refusal:
    if not is_whole_png(data):
        return Refusal("broken_png", "is truncated or no PNG behind its 12 bytes of header")
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint16 or image.ndim != 2:
        return Refusal("not_16_bit", "holds no 16-bit single-channel PNG")
    return np.asarray(image, np.uint16)


def _from_metres(depth_m: NDArray[np.float32]) -> NDArray[np.uint16]:
    """NaN, infinity, what is negative and what is beyond 6.5 m is no depth."""
    units = np.round(np.nan_to_num(depth_m, nan=0.0, posinf=0.0, neginf=0.0) / np.float32(FLOAT_UNIT_M))
    return np.where((units > 0) & (units < 65535), units, 0).astype(np.uint16)
