"""RVL against a decoder written from the paper's listing."""

from __future__ import annotations

import struct

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from conveyor.formats.rvl_encoder import encode_rvl


def decode_rvl(blob: bytes) -> NDArray[np.uint16]:
    """(h, w) uint16 of a blob in ROS' layout."""
    width, height = struct.unpack_from("<II", blob, 12)
    words = np.frombuffer(blob, "<u4", offset=20)
    nibbles = iter([int(word) >> shift & 15 for word in words for shift in range(28, -1, -4)])

    def number() -> int:
        value, shift = 0, 0
        while True:
            nibble = next(nibbles)
            value |= (nibble & 7) << shift
            shift += 3
            if not nibble & 8:
                return value

    pixels: list[int] = []
    previous = 0
    while len(pixels) < width * height:
        pixels += [0] * number()
        for _ in range(number()):
            zigzag = number()
            previous += (zigzag >> 1) ^ -(zigzag & 1)
            pixels.append(previous)
    return np.array(pixels, np.uint16).reshape(height, width)


@settings(max_examples=60, deadline=None)
@given(
    arrays(
        np.uint16,
        st.tuples(st.integers(1, 9), st.integers(1, 9)),
        elements=st.sampled_from([0, 0, 0, 1, 2, 3449, 3450, 3460, 65535]),
    )
)
def test_every_depth_image_comes_back(depth: NDArray[np.uint16]) -> None:
    assert np.array_equal(decode_rvl(encode_rvl(depth)), depth)


def test_a_strided_belt_shrinks_to_less_than_half() -> None:
    rng = np.random.default_rng(3)
    depth = (4600 + rng.normal(0, 3, (240, 424))).astype(np.uint16)[::2, ::2]
    blob = encode_rvl(depth)
    assert np.array_equal(decode_rvl(blob), depth)
    assert len(blob) < 0.5 * depth.nbytes
