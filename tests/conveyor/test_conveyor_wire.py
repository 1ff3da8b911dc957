"""The wire format refuses what it does not know and never allocates what a header merely claims."""

from __future__ import annotations

import contextlib
import struct
import tracemalloc
from dataclasses import replace

import msgpack
import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from conveyor import wire
from conveyor.errors import MessageError, Refusal, TuberlineError, UnsendableError
from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from conveyor.messages import Frame, Mark, Track, TrackEntry, View, WeighedView, Weight
from conveyor.messages.base import check_part

INTRINSICS = Intrinsics(width=64, height=48, fx=60.0, fy=61.0, cx=31.5, cy=24.5)


def make_frame(**changes: object) -> Frame:
    values = {
        "camera": "front",
        "run": "r1",
        "seq": 7,
        "captured_ns": 123,
        "travel_m": 0.25,
        "depth_scale_m": 0.001,
        "intrinsics": INTRINSICS,
        "belt_distance_m": 0.46,
        "depth": np.arange(48 * 64, dtype=np.uint16).reshape(48, 64),
        "belt_from_camera": straight_down_belt_from_camera(0.46),
        **changes,
    }
    return Frame(**values)  # type: ignore[arg-type]


def make_view(**changes: object) -> View:
    values = {
        "view_id": "r1/front/3-1/5",
        "track_id": "r1/front/3-1",
        "camera": "front",
        "run": "r1",
        "seq": 5,
        "captured_ns": 123,
        "rank": 0,
        "depth_scale_m": 0.001,
        "intrinsics": INTRINSICS,
        "u0": 2,
        "v0": 3,
        "depth": np.ones((4, 5), np.uint16),
        "belt_from_camera": straight_down_belt_from_camera(0.46),
        **changes,
    }
    return View(**values)  # type: ignore[arg-type]


def make_track() -> Track:
    view = WeighedView("t/5", 5, 171.5, 150.0, 190.0, "pointraft", "m@1", ("few_points",))
    return Track(
        track_id="r1/front/3-1",
        crossed_ns=10**9,
        crossed_x_m=0.001,
        y_m=-0.12,
        travel_m=1.5,
        travel_estimated=False,
        frames=28,
        first_seq=3,
        last_seq=30,
        length_mm=80.0,
        width_mm=60.0,
        height_mm=50.0,
        visible_volume_ml=190.0,
        whole=True,
        views_sent=2,
        views=(view,),
        views_lost={"deadline": 1},
    )


@pytest.mark.parametrize("codec", ["raw", "zstd"])
def test_a_frame_comes_back_as_it_was(codec: str) -> None:
    frame = make_frame(mask=np.eye(48, 64, dtype=np.uint16))
    back = Frame.decode(frame.encode(codec=codec))
    np.testing.assert_array_equal(back.depth, frame.depth)
    np.testing.assert_array_equal(back.mask, frame.mask)
    np.testing.assert_array_equal(back.belt_from_camera, frame.belt_from_camera)
    assert back.color_jpeg is None
    assert (back.camera, back.seq, back.travel_m, back.intrinsics) == ("front", 7, 0.25, INTRINSICS)


def test_a_log_entry_comes_back_as_it_was() -> None:
    entry = TrackEntry("front", "r1", 9, track=make_track())
    assert TrackEntry.decode(entry.encode()) == entry


def test_other_version_is_refused_with_both_versions() -> None:
    data = bytearray(make_frame().encode())
    data[3] = 9
    with pytest.raises(MessageError, match=r"schema version 9.*version 1"):
        Frame.decode(bytes(data))


def test_other_kind_is_refused_with_both_kinds() -> None:
    with pytest.raises(MessageError, match=r"'Weight'.*'Frame'"):
        Weight.decode(make_frame().encode())


def test_truncation_anywhere_is_an_error_of_ours() -> None:
    data = make_frame().encode()
    for size in [*range(0, 300, 7), len(data) // 2, len(data) - 1]:
        with pytest.raises(MessageError):
            Frame.decode(data[:size])


def message_of(header: object, body: bytes = b"") -> bytes:
    """A message with any header."""
    packed: bytes = msgpack.packb(header)
    return struct.pack("<3sBI", b"TBL", 1, len(packed)) + packed + body


def refused(data: bytes, *, most_bytes: int = 1 << 20) -> MessageError:
    """The error that reading `data` ends with; it must not take more than `most_bytes`."""
    tracemalloc.start()
    try:
        with pytest.raises(MessageError) as caught:
            wire.unpack(data)
        assert tracemalloc.get_traced_memory()[1] < most_bytes
    finally:
        tracemalloc.stop()
    return caught.value


@pytest.mark.parametrize("codec", ["raw", "zstd"])
@pytest.mark.parametrize(
    "shape",
    [
        [1 << 20, 1 << 20],
        [0, 1 << 62],  # numpy multiplies the sides that are not 0, in 64 bits: this one ended the process
        [0, 1 << 26, 1 << 26, 1 << 26],
        [1 << 62, 0],
        [(1 << 26) + 1],
        [1 << 13, 1 << 13],
        [-1, 4],
        [1, 1, 1, 1, 1],
        [True],
        [2.0],
        ["2"],
        [None],
        "ab",
        None,
    ],
    ids=str,
)
def test_a_shape_that_claims_too_much_allocates_nothing(shape: object, codec: str) -> None:
    """Each side has its bound, and their product, in whole numbers of Python's."""
    claim = {"name": "depth", "dtype": "u2", "shape": shape, "codec": codec, "size": 4}
    error = refused(message_of({"kind": "Frame", "fields": {}, "arrays": [claim]}, b"\0\0\0\0"))
    assert error.reason in (Refusal.SIZE, Refusal.ARRAY)


@pytest.mark.parametrize(
    ("header", "reason"),
    [
        ({"kind": "F", "fields": {"n": (1 << 63) - 1}, "arrays": []}, None),
        ({"kind": "F", "fields": {"n": 1 << 63}, "arrays": []}, Refusal.RANGE),
        ({"kind": "F", "fields": {"n": [[(1 << 64) - 1]]}, "arrays": []}, Refusal.RANGE),
        ({"kind": "F", "fields": {"n": float("inf")}, "arrays": []}, Refusal.RANGE),
        ({"kind": "F", "fields": {"n": {"a": float("nan")}}, "arrays": []}, Refusal.RANGE),
        ({"kind": "F", "fields": {"n": [[[[[0]]]]]}, "arrays": []}, None),
        ({"kind": "F", "fields": {"n": [[[[[[[0]]]]]]]}, "arrays": []}, Refusal.SIZE),
        ({"kind": "F", "fields": {"n": b"bytes"}, "arrays": []}, Refusal.HEADER),
        ({"kind": "F", "fields": {"n": b""}, "arrays": []}, Refusal.FIELD),
        ({"kind": "F", "fields": {"n": msgpack.ExtType(5, b"x")}, "arrays": []}, Refusal.FIELD),
        ({"kind": "F", "fields": {"n": msgpack.Timestamp(5)}, "arrays": []}, Refusal.FIELD),
        ({"kind": "F", "fields": {"n": "x" * wire.MAX_TEXT_BYTES}, "arrays": []}, None),
        ({"kind": "F", "fields": {"n": "x" * (wire.MAX_TEXT_BYTES + 1)}, "arrays": []}, Refusal.HEADER),
        ({"kind": "F", "fields": {"n": [0] * (wire.MAX_ITEMS - 4)}, "arrays": []}, None),
        ({"kind": "F", "fields": {"n": [0] * wire.MAX_ITEMS}, "arrays": []}, Refusal.SIZE),
        ({"kind": "F", "fields": {"n": [[0] * 300] * 120}, "arrays": []}, Refusal.SIZE),
        ({"kind": "F", "fields": {1: 2}, "arrays": []}, Refusal.HEADER),
        ({"kind": "F", "fields": {}, "arrays": [], "more": 1}, Refusal.HEADER),
        ({"kind": "F", "fields": {}}, Refusal.HEADER),
        ({"kind": 1, "fields": {}, "arrays": []}, Refusal.HEADER),
        ([], Refusal.HEADER),
        ({"kind": "F", "fields": {}, "arrays": [None]}, Refusal.ARRAY),
        ({"kind": "F", "fields": {}, "arrays": [[]] * 9}, Refusal.SIZE),
    ],
)
def test_what_no_field_may_hold_is_refused_with_a_reason(header: object, reason: Refusal | None) -> None:
    data = message_of(header)
    if reason is None:
        assert wire.unpack(data)[0] == "F"
    else:
        assert refused(data, most_bytes=4 << 20).reason is reason


def test_the_largest_header_takes_80_times_its_length_at_most() -> None:
    """Empty maps are what takes the most memory for one byte of a header."""
    rows = wire.MAX_HEADER_BYTES // 256 - 16
    maps = b"\xdc" + struct.pack(">H", rows) + (b"\xdc\x00\xfd" + b"\x80" * 253) * rows
    header = b"\x83\xa4kind\xa1F\xa6arrays\x90\xa6fields\x81\xa1n" + maps
    assert len(header) < wire.MAX_HEADER_BYTES
    data = struct.pack("<3sBI", b"TBL", 1, len(header)) + header
    assert refused(data, most_bytes=80 * wire.MAX_HEADER_BYTES).reason is Refusal.SIZE


def test_arrays_are_bounded_together_before_one_is_decompressed() -> None:
    chunk = zstandard.ZstdCompressor(level=1).compress(bytes(wire.MAX_ARRAY_BYTES // 2))
    claims = [
        {"name": str(n), "dtype": "u1", "shape": [wire.MAX_ARRAY_BYTES // 2], "codec": "zstd", "size": len(chunk)}
        for n in range(3)
    ]
    data = message_of({"kind": "F", "fields": {}, "arrays": claims}, 3 * chunk)
    assert refused(data).reason is Refusal.SIZE
    assert refused(message_of({"kind": "F", "fields": {}, "arrays": claims[:1] * 2}, 2 * chunk)).reason is Refusal.ARRAY


@pytest.mark.parametrize("extra", [b"\0", zstandard.ZstdCompressor().compress(b"more")], ids=["a byte", "a frame"])
def test_bytes_behind_a_compressed_array_are_refused(extra: bytes) -> None:
    chunk = zstandard.ZstdCompressor(level=1).compress(bytes(8)) + extra
    claim = {"name": "a", "dtype": "u1", "shape": [8], "codec": "zstd", "size": len(chunk)}
    assert refused(message_of({"kind": "F", "fields": {}, "arrays": [claim]}, chunk)).reason is Refusal.ARRAY


def test_an_array_of_another_class_is_refused_before_it_is_decompressed() -> None:
    """A view's depth as floats, of a size that only a frame's colour picture may have."""
    chunk = zstandard.ZstdCompressor(level=1).compress(bytes(32 << 20))
    claim = {"name": "depth", "dtype": "u1", "shape": [32 << 20], "codec": "zstd", "size": len(chunk)}
    data = message_of({"kind": "View", "fields": {}, "arrays": [claim]}, chunk)
    tracemalloc.start()
    with pytest.raises(MessageError, match=r"View\.depth must be u2 with 2 dimensions"):
        View.decode(data)
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()


def test_a_depth_image_of_another_size_than_its_intrinsics_is_refused() -> None:
    with pytest.raises(MessageError, match=r"\(10, 10\).*\(48, 64\)"):
        make_frame(depth=np.zeros((10, 10), np.uint16))


WEIGHT = Weight("v", "t", "front", "r1", 1, "weighed", 1.5, 1.0, 2.0, "pointraft", "m", (), "r1")


@pytest.mark.parametrize("weight_g", [float("nan"), float("inf"), -0.1, 1e308, 1e5 + 1, "1.5", True])
def test_a_weight_that_is_none_is_refused_on_arrival_and_not_sent(weight_g: object) -> None:
    with pytest.raises(UnsendableError, match=r"not sent: Weight\.weight_g"):
        replace(WEIGHT, weight_g=weight_g).encode()  # type: ignore[arg-type]
    _, fields, _ = wire.unpack(WEIGHT.encode())
    with pytest.raises(MessageError, match=r"weight_g|not a finite one") as caught:
        Weight.decode(wire.pack("Weight", {**fields, "weight_g": weight_g}, {}))
    assert caught.value.reason in (Refusal.RANGE, Refusal.FIELD)


def test_a_part_of_a_message_is_checked_where_it_is_made() -> None:
    check_part(make_track())
    with pytest.raises(UnsendableError, match=r"Track\.length_mm: must be at most 2000 mm"):
        check_part(replace(make_track(), length_mm=2000.5))
    with pytest.raises(UnsendableError, match=r"Track\.views\.0\.weight_g"):
        check_part(replace(make_track(), views=(replace(make_track().views[0], weight_g=float("nan")),)))


def test_a_fault_of_our_own_does_not_end_a_process_for_good() -> None:
    """Exit code 2 means that starting again is of no use; a fault of the program's is none of these."""
    with pytest.raises(UnsendableError) as caught:
        replace(WEIGHT, seq=-1).encode()
    assert caught.value.exit_code not in (0, 2)


def test_a_pose_that_is_none_is_refused() -> None:
    pose = straight_down_belt_from_camera(0.46)
    for bad in (np.full((4, 4), np.nan), pose * 1e6, pose[:3]):
        with pytest.raises(MessageError, match="belt_from_camera"):
            make_frame(belt_from_camera=bad).encode()
    with pytest.raises(TuberlineError, match="look down"):
        make_view(belt_from_camera=np.eye(4))


def test_a_crop_lies_within_its_image() -> None:
    make_view(u0=61, v0=46, depth=np.ones((2, 3), np.uint16))
    for u0, v0 in ((62, 46), (61, 47)):
        with pytest.raises(MessageError, match=r"more than the image of 48 rows and 64 columns holds"):
            make_view(u0=u0, v0=v0, depth=np.ones((2, 3), np.uint16))


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=400), st.integers(0, 3))
def test_any_bytes_are_a_value_or_an_error_of_ours(noise: bytes, prefix: int) -> None:
    data = (b"TBL\x01" if prefix else b"") + noise
    for kind in (Frame, View, Weight, TrackEntry):
        with pytest.raises(MessageError):
            kind.decode(data)


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_a_flipped_byte_is_a_value_or_an_error_of_ours(data: st.DataObject) -> None:
    message = bytearray(TrackEntry("front", "r1", 9, track=make_track()).encode())
    where = data.draw(st.integers(0, len(message) - 1))
    message[where] ^= data.draw(st.integers(1, 255))
    with contextlib.suppress(MessageError):
        TrackEntry.decode(bytes(message))


@settings(max_examples=50, deadline=None)
@given(
    hnp.arrays(np.uint16, st.tuples(st.integers(0, 9), st.integers(0, 9))),
    st.sampled_from(["raw", "zstd"]),
)
def test_any_crop_survives_the_wire(depth: np.ndarray, codec: str) -> None:
    view = View("v", "t", "front", "r1", 1, 2, 0, 0.001, INTRINSICS, 3, 4, depth, straight_down_belt_from_camera(0.4))
    back = View.decode(view.encode(codec=codec))
    np.testing.assert_array_equal(back.depth, depth)
    assert back.belt_distance_m == pytest.approx(0.4)


def test_mark_and_track_are_both_optional_but_typed() -> None:
    mark = Mark(1, 0.5, False, 1, -0.4, True, 0.5, 0.5, {"received": 3}, {"sent": 0}, {"opened": 0})
    assert TrackEntry.decode(TrackEntry("a", "r", 1, mark=mark).encode()).mark == mark
