"""RVL: lossless depth in a quarter of the bytes at the cost of a memory copy, encoded and decoded.

A. Wilson, "Fast Lossless Depth Image Compression", ISS 2017. Width and height (uint32 each), then 32-bit words of eight
nibbles, the upper ones first. A number is nibbles of three bits, low bits first; the fourth bit says that more follow.
Pixels are a count of zeros, a count of others, and for each of those its difference from the one before, in zigzag.

Two envelopes: plain, as above, and ROS' `compressedDepth` with twelve bytes before it, which Rerun reads too.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from conveyor.formats.png16 import Refusal
from conveyor.kernels import kernel
from conveyor.wire import MAX_ARRAY_BYTES

MEDIA_TYPE = "application/rvl"
"""Of the ROS envelope, to Rerun."""
_SIZE = struct.Struct("<II")
_ROS_HEADER = struct.Struct("<iff")  # kind and two parameters of the inverse depth, unused for integers
_MOST_BITS = 30


def encode_rvl(depth: NDArray[np.uint16]) -> bytes:
    """(H, W) uint16, any units, 0 = no depth, in the plain envelope."""
    pixels = np.ascontiguousarray(depth).reshape(-1)
    # A difference takes at most 6 nibbles of a word's 8, and a pair of run lengths 2 for its at least 2 pixels.
    words = np.empty(pixels.size + 16, np.uint32)
    used = _encode(pixels, words)
    return _SIZE.pack(depth.shape[1], depth.shape[0]) + words[:used].astype("<u4").tobytes()


def decode_rvl(data: bytes) -> NDArray[np.uint16] | Refusal:
    """(H, W) uint16 of the plain envelope, or why there is none."""
    if len(data) < _SIZE.size:
        return Refusal("truncated", f"has {len(data)} bytes of RVL, less than its width and height")
    width, height = _SIZE.unpack_from(data)
    if not 0 < width * height <= MAX_ARRAY_BYTES // 2:
        return Refusal("truncated", f"is {width}x{height} pixels of RVL, which no depth image has")
    words = np.frombuffer(data, "<u4", offset=_SIZE.size, count=(len(data) - _SIZE.size) // 4).astype(np.uint32)
    pixels = np.zeros(width * height, np.uint16)
    if not _decode(words, pixels):
        return Refusal("truncated", f"ends or is damaged before its {width}x{height} pixels of RVL are there")
    return pixels.reshape(height, width)


def encode_ros_rvl(depth: NDArray[np.uint16]) -> bytes:
    """(H, W) uint16 in the envelope of ROS' `compressedDepth`."""
    return _ROS_HEADER.pack(0, 0.0, 0.0) + encode_rvl(depth)


def decode_ros_rvl(data: bytes) -> NDArray[np.uint16] | Refusal:
    """(H, W) uint16 of the envelope of ROS' `compressedDepth`, or why there is none."""
    return decode_rvl(data[_ROS_HEADER.size :])


@kernel(nogil=True)
def _put(value: int, state: NDArray[np.int64], words: NDArray[np.uint32]) -> None:
    """Append `value`; `state` is (3,) int64: word under construction, nibbles in it, words written."""
    while True:
        nibble = value & 7
        value >>= 3
        if value:
            nibble |= 8
        state[0] = (state[0] << 4) | nibble
        state[1] += 1
        if state[1] == 8:
            words[state[2]] = state[0]
            state[2] += 1
            state[0] = 0
            state[1] = 0
        if not value:
            return


@kernel(nogil=True)
def _encode(pixels: NDArray[np.uint16], words: NDArray[np.uint32]) -> int:
    """Fill `words` from the front; how many were needed."""
    state = np.zeros(3, np.int64)
    previous, i, n = np.int64(0), 0, pixels.size
    while i < n:
        start = i
        while i < n and pixels[i] == 0:
            i += 1
        _put(i - start, state, words)
        start = i
        while i < n and pixels[i] != 0:
            i += 1
        _put(i - start, state, words)
        for k in range(start, i):
            current = np.int64(pixels[k])
            delta = current - previous
            _put(int((delta << 1) ^ (delta >> 63)), state, words)
            previous = current
    if state[1]:
        words[state[2]] = state[0] << (4 * (8 - state[1]))  # the last word's rest is zero
        state[2] += 1
    return int(state[2])


@kernel(nogil=True)
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


@kernel(nogil=True)
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
