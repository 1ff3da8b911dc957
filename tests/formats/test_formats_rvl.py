"""RVL: what is encoded comes back by our decoder and by the paper's listing; damage is refused, never guessed at."""

from __future__ import annotations

import struct

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from conveyor.formats.png16 import Refusal
from conveyor.formats.rvl import decode_ros_rvl, decode_rvl, encode_ros_rvl, encode_rvl

TRANSPORT_BYTES = 12
IMAGES = arrays(
    np.uint16,
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    elements=st.sampled_from([0, 0, 0, 1, 2, 3449, 3450, 3460, 32767, 32768, 65535]),
)


def _listing(blob: bytes) -> NDArray[np.uint16]:
    """(h, w) uint16 of a plain blob, decoded as the paper's listing does it."""
    width, height = struct.unpack_from("<II", blob)
    words = np.frombuffer(blob, "<u4", offset=8)
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
@given(IMAGES)
def test_every_depth_image_comes_back(depth: NDArray[np.uint16]) -> None:
    for found in (decode_rvl(encode_rvl(depth)), decode_ros_rvl(encode_ros_rvl(depth))):
        assert not isinstance(found, Refusal)
        assert np.array_equal(found, depth)
    assert np.array_equal(_listing(encode_rvl(depth)), depth)
    assert encode_ros_rvl(depth)[TRANSPORT_BYTES:] == encode_rvl(depth)


@settings(max_examples=100, deadline=None)
@given(IMAGES, st.data())
def test_damaged_bytes_are_refused_or_have_the_size_that_they_claim(
    depth: NDArray[np.uint16], data: st.DataObject
) -> None:
    blob = bytearray(encode_rvl(depth))
    at = data.draw(st.integers(8, len(blob) - 1))
    blob[at] ^= data.draw(st.integers(1, 255))
    found = decode_rvl(bytes(blob))
    assert isinstance(found, Refusal) or found.shape == depth.shape


def test_a_difference_of_signed_numbers_means_the_same() -> None:
    # 40000 is -25536 to an encoder that counts with signed 16 bits: zigzag 51071, in six nibbles of three bits.
    nibbles = [0, 1] + [(51071 >> 3 * n & 7) | (8 if n < 5 else 0) for n in range(6)]
    word = sum(nibble << 28 - 4 * n for n, nibble in enumerate(nibbles))
    found = decode_rvl(struct.pack("<III", 1, 1, word))
    assert not isinstance(found, Refusal)
    assert found.tolist() == [[40000]]


def test_what_is_cut_off_or_too_large_is_refused_with_its_size() -> None:
    blob = encode_rvl(np.arange(1, 65, dtype=np.uint16).reshape(8, 8))
    for cut in (4, 8, len(blob) - 4):
        found = decode_rvl(blob[:cut])
        assert isinstance(found, Refusal)
        assert found.reason == "truncated"
    huge = decode_rvl(struct.pack("<II", 2**31, 2**31) + blob[8:])
    assert isinstance(huge, Refusal)
    assert "2147483648x2147483648" in huge.text


def test_a_strided_belt_shrinks_to_less_than_half() -> None:
    rng = np.random.default_rng(3)
    depth = (4600 + rng.normal(0, 3, (240, 424))).astype(np.uint16)[::2, ::2]
    blob = encode_rvl(depth)
    assert np.array_equal(decode_rvl(blob), depth)
    assert len(blob) < 0.5 * depth.nbytes
