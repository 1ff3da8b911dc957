"""The wire format refuses what it does not know and never allocates what a header merely claims."""

from __future__ import annotations

import contextlib
import struct
import tracemalloc

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from conveyor import wire
from conveyor.errors import MessageError
from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from conveyor.messages import Frame, Mark, Track, TrackEntry, View, WeighedView, Weight

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


def test_a_header_that_claims_gigabytes_allocates_nothing() -> None:
    claim = {"name": "depth", "dtype": "u2", "shape": [1 << 20, 1 << 20], "codec": "zstd", "size": 4}
    header = msgpack.packb({"kind": "Frame", "fields": {}, "arrays": [claim]})
    data = struct.pack("<3sBI", b"TBL", 1, len(header)) + header + b"\0\0\0\0"
    tracemalloc.start()
    with pytest.raises(MessageError, match="exceeds the limit"):
        wire.unpack(data)
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()


def test_a_depth_image_of_another_size_than_its_intrinsics_is_refused() -> None:
    with pytest.raises(MessageError, match=r"\(10, 10\).*\(48, 64\)"):
        make_frame(depth=np.zeros((10, 10), np.uint16))


def test_numbers_that_are_none_are_refused_on_arrival() -> None:
    weight = Weight("v", "t", "front", "r1", 1, "weighed", float("nan"), 1.0, 2.0, "pointraft", "m", (), "r1")
    with pytest.raises(MessageError, match="weight_g"):
        Weight.decode(weight.encode())


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
