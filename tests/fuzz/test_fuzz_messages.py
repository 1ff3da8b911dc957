"""Every message on the wire, damaged: a message comes out or a `MessageError`, never anything else."""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conveyor import messages as m
from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from tests.fuzz.damage import ANY_JSON, bounded_memory, damaged, outcome, quick

INTRINSICS = Intrinsics(width=16, height=12, fx=15.0, fy=15.5, cx=7.5, cy=5.5)
DEPTH = np.arange(192, dtype=np.uint16).reshape(12, 16)
POSE = straight_down_belt_from_camera(0.46)
VIEW = m.WeighedView("r/c/3-1/5", 5, 171.5, 150.0, 190.0, "pointraft", "m@1", ("few_points",))
TRACK = m.Track(
    track_id="r/c/3-1", crossed_ns=10**9, crossed_x_m=0.001, y_m=-0.12, travel_m=1.5, travel_estimated=False,
    frames=28, first_seq=3, last_seq=30, length_mm=80.0, width_mm=60.0, height_mm=50.0, visible_volume_ml=190.0,
    whole=True, views_sent=2, views=(VIEW,), views_lost={"deadline": 1},
)  # fmt: skip
MARK = m.Mark(
    captured_ns=10**9, travel_m=1.5, travel_estimated=True, complete_ns=9 * 10**8, complete_place_x_m=-1.2,
    final=False, looked_at_m=1.4, travelled_m=1.5, frames={"published": 3}, views={"sent": 2}, tracks={"opened": 1},
)  # fmt: skip
TUBER = m.Tuber(
    tuber_id=1, run="r", crossed_ns=1, place_x_m=-0.5, place_y_m=0.1, weight_g=170.0, low_g=150.0, high_g=190.0,
    length_mm=80.0, width_mm=60.0, height_mm=50.0, views=3, method="pointraft", model="m@1", flags=(),
    cameras=("c",), tracks=("r/c/3-1",),
)  # fmt: skip
TOTALS = m.Totals(
    run="r", count=1, weight_g=170.0, low_g=150.0, high_g=190.0, coverage=0.9, estimated_weight_g=188.0,
    estimated_low_g=150.0, estimated_high_g=220.0, tubers_per_s=1.0, histogram_step_g=50.0, histogram=(0, 0, 0, 1),
    cameras={"c": "running"}, final=False, exchanged=(m.CameraExchanged("c", "lens a", "lens b", 1),),
)  # fmt: skip
EXAMPLES: list[m.Message] = [
    m.Frame("c", "r", 7, 123, 0.25, 0.001, INTRINSICS, 0.46, DEPTH, POSE, DEPTH, np.arange(9, dtype=np.uint8)),
    m.View("r/c/3-1/5", "r/c/3-1", "c", "r", 5, 123, 0, 0.001, INTRINSICS, 2, 3, DEPTH[:4, :5], POSE),
    m.Weight("r/c/3-1/5", "r/c/3-1", "c", "r", 5, "weighed", 1.0, 0.5, 2.0, "pointraft", "m@1", ("extent",), "r1"),
    m.TrackEntry("c", "r", 9, track=TRACK),
    m.TrackEntry("c", "r", 10, mark=MARK),
    m.Committed("c", "r", 10),
    m.FrameProgress("c", "r", 10, 1),
    m.FrameSlot(1, 0, 2, 100),
    m.Travel("c", "r", 10, 1.5, True),
    m.TracksInView(
        "c",
        "r",
        10,
        (
            m.TrackInView("r/c/3-1", -1.2, 0.1, 61.0, 44.0, "open"),
            m.TrackInView("r/c/1-2", -0.9, 0.0, 70.0, 51.0, "counted", 150.0, 130.0, 170.0),
        ),
    ),
    m.CameraInfo("c", "r", "streaming", "x", 30.0, True, INTRINSICS, 0.001, 0, 9, 10, {"damaged": 1}, serial="77"),
    m.Counters("segmenter", "c", "r", 1, "host", "0", 1.0, {"a": 1}, {"b": 1.0}),
    TUBER,
    TOTALS,
    m.Picture("c", "r", 7, 123, 6, 4, np.arange(9, dtype=np.uint8), (m.Outline((0, 0, 5, 3), "counted", 170.0),)),
    m.Position("gnss", "r", 3, 10**18, 10**18, 52.7, 5.75, 4, 0.7, 14),
    m.LoadOrder("r1", "start", "gate", 0.5, fields={"name": "A", "variety": "Agria"}, note="wet", place_x_m=-1.5),
    m.LoadAnswer("r1", True, text="load 1 (A) has begun", load=1, name="A", event=1, place_x_m=-1.5, later=False),
]
NAMES = [f"{type(example).__name__}-{i}" for i, example in enumerate(EXAMPLES)]


def changed(good: bytes, change: Any) -> bytes:
    """`good` with its header changed by `change(header)`."""
    size = int.from_bytes(good[4:8], "little")
    header = msgpack.unpackb(good[8 : 8 + size])
    change(header)
    fresh: bytes = msgpack.packb(header)
    return good[:4] + len(fresh).to_bytes(4, "little") + fresh + good[8 + size :]


def test_every_kind_of_message_is_here() -> None:
    parts = {m.Message, m.Outline, m.LoadNow, m.Track, m.Mark, m.Sizes, m.ClassTotal, m.ForeignTotal, m.WeighedView}
    parts |= {m.TrackInView, m.HeightChange, m.CamerasApart, m.CameraExchanged}
    kinds = {getattr(m, name) for name in m.__all__} - parts
    assert kinds == {type(example) for example in EXAMPLES}


@pytest.mark.parametrize("example", EXAMPLES, ids=NAMES)
def test_damaged_bytes(example: m.Message) -> None:
    seen: set[str] = set()

    @quick(150)
    @given(damaged(example.encode(), head=300))
    def decode(data: bytes) -> None:
        seen.add(outcome(lambda: type(example).decode(data)))

    with bounded_memory():
        decode()
    assert seen <= {"value", "MessageError"}
    assert "MessageError" in seen


@pytest.mark.parametrize("example", EXAMPLES, ids=NAMES)
def test_a_header_that_says_something_else(example: m.Message) -> None:
    """Fields of other types, arrays of other shapes, names that are not known."""
    good = example.encode()
    fields = [name for name in type(example).__dataclass_fields__ if name not in example.ARRAYS]
    seen: set[str] = set()

    @quick(120)
    @given(st.sampled_from([*fields, "unknown"]), ANY_JSON, st.sampled_from(["field", "array", "arrays"]))
    def decode(name: str, value: object, where: str) -> None:
        def change(header: dict[str, Any]) -> None:
            if where == "field" or not header["arrays"]:
                header["fields"][name] = value
            elif where == "array":
                header["arrays"][0][["shape", "dtype", "size", "codec", "name"][len(name) % 5]] = value
            else:
                header["arrays"] = value

        try:
            data = changed(good, change)
        except (OverflowError, ValueError):
            return  # MessagePack itself cannot say it
        seen.add(outcome(lambda: type(example).decode(data)))

    with bounded_memory():
        decode()
    assert seen <= {"value", "MessageError"}
    assert "MessageError" in seen
