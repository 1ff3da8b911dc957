"""RVL depth as ROS' compressedDepth sends it (A. Wilson, "Fast Lossless Depth Image Compression", ISS 2017).

Behind the transport's twelve bytes stand width and height (uint32 each), then 32-bit words of eight nibbles, the upper
ones first. A number is nibbles of three bits, low bits first; the fourth bit says that more follow. Pixels are a count
of zeros, a count of others, and for each of those its difference from the one before, in zigzag.
"""

from __future__ import annotations

import struct

import numpy as np
from numba import njit
from numpy.typing import NDArray

from conveyor.formats.png16 import Refusal
from conveyor.wire import MAX_ARRAY_BYTES

_SIZE = struct.Struct("<II")
_MOST_BITS = 30


def decode_rvl(data: bytes) -> NDArray[np.uint16] | Refusal:
    """(H, W) uint16 of width, height and words, or why there is none."""
    if len(data) < _SIZE.size:
        return Refusal("truncated", f"has {len(data)} bytes of RVL, less than its width and height")
    width, height = _SIZE.unpack_from(data)
    if not 0 < width * height <= MAX_ARRAY_BYTES // 2:
        return Refusal("truncated", f"is {width}x{height} pixels of RVL, which no depth image has")
    words = np.frombuffer(data, "<u4", offset=_SIZE.size, count=(len(data) - _SIZE.size) // 4).astype(np.uint32)
    pixels = np.zeros(width * height, np.uint16)
    if not _decode(words, pixels):
        return Refusal("truncated", f"ends or goes astray before its {width}x{height} pixels of RVL are there")
    return pixels.reshape(height, width)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _number(words: NDArray[np.uint32], at: int) -> tuple[int, int]:
    """The number at nibble `at` and where the next one begins; -1 where the words end or no depth is so large."""
    value, shift = 0, 0
    while at < 8 * len(words) and shift <= _MOST_BITS:
        nibble = (int(words[at // 8]) >> (28 - 4 * (at % 8))) & 15
        at += 1
        value |= (nibble & 7) << shift
        shift += 3
        if not nibble & 8:
            return value, at
    return -1, at


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _decode(words: NDArray[np.uint32], pixels: NDArray[np.uint16]) -> bool:
    """Fill `pixels`, all 0 before; whether the words hold exactly as many."""
    done, at, previous = 0, 0, 0
    while done < len(pixels):
        zeros, at = _number(words, at)
        others, at = _number(words, at)
        if zeros < 0 or others < 0 or zeros + others == 0 or done + zeros + others > len(pixels):
            return False
        done += zeros
        for _ in range(others):
            zigzag, at = _number(words, at)
            if zigzag < 0:
                return False
            # Some encoders difference signed 16-bit numbers: what is beyond 32767 comes out the same, modulo 2^16.
            previous = (previous + ((zigzag >> 1) ^ -(zigzag & 1))) & 0xFFFF
            pixels[done] = previous
            done += 1
    return True
