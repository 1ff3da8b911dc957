"""Messages of version 0.1 are understood; one of another schema is refused with both versions."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import pytest

import conveyor.messages as messages
from conveyor.errors import MessageError, Refusal
from conveyor.messages.views import LATER_PARTS
from conveyor.wire import SCHEMA_VERSION, pack, read_array, read_header

OLD = Path(__file__).parent / "v0_1" / "messages"
KINDS = {"TrackEntryMark": "TrackEntry"}
SAMPLES = sorted(file.stem for file in OLD.glob("*.bin"))


def decoded(sample: str) -> messages.Message:
    kind: type[messages.Message] = getattr(messages, KINDS.get(sample, sample))
    return kind.decode((OLD / f"{sample}.bin").read_bytes())


@pytest.mark.parametrize("sample", SAMPLES)
def test_every_message_of_0_1_is_understood(sample: str) -> None:
    """A host of 0.1 in a line of later ones: what its nodes send is taken, with what they did not know at rest."""
    message = decoded(sample)
    assert message.encode()[:4] == (OLD / f"{sample}.bin").read_bytes()[:4]


def test_their_values_are_what_0_1_meant() -> None:
    weight, entry, mark = decoded("Weight"), decoded("TrackEntry"), decoded("TrackEntryMark")
    assert isinstance(weight, messages.Weight)
    assert (weight.view_id, weight.weight_g, weight.low_g, weight.high_g) == ("v/0", 100.0, 90.0, 110.0)
    assert isinstance(entry, messages.TrackEntry)
    assert entry.track is not None
    assert (entry.n, entry.track.views[0].weight_g, entry.track.views_lost) == (2, 100.0, {"shed": 1})
    assert isinstance(mark, messages.TrackEntry)
    assert mark.mark is not None
    assert (mark.mark.looked_at_m, mark.mark.travelled_m) == (0.4, 0.5)
    counters = decoded("Counters")
    assert isinstance(counters, messages.Counters)
    assert counters.version == "0.1.0"
    view = decoded("View")
    assert isinstance(view, messages.View)
    assert (view.resting_offset_m, view.depth.shape) == (0.0, (6, 8))


def test_a_segmenter_of_0_1_gets_answers_that_it_can_read() -> None:
    """It refused weights with sizes, and asked for the same views again and again until its host was upgraded."""
    view, weight = decoded("View"), decoded("Weight")
    assert isinstance(view, messages.View)
    assert isinstance(weight, messages.Weight)
    sizes = messages.Sizes(80.0, 60.0, 50.0, 55.0, 3.0, 3.0, 4.0, 3.0)
    answer = replace(weight, sizes=sizes)
    assert answer.within(LATER_PARTS) == answer
    told = read_header(answer.within(view.takes).encode()).fields
    assert set(told) == set(read_header((OLD / "Weight.bin").read_bytes()).fields)


def test_a_message_of_another_schema_is_refused_with_both_versions() -> None:
    data = bytearray((OLD / "Committed.bin").read_bytes())
    (version,) = struct.unpack_from("B", data, 3)
    assert version == SCHEMA_VERSION, "0.1 spoke the same schema"
    data[3] = SCHEMA_VERSION + 1
    with pytest.raises(
        MessageError, match=rf"version {SCHEMA_VERSION + 1}, this node speaks version {version}"
    ) as found:
        messages.Committed.decode(bytes(data))
    assert found.value.reason is Refusal.VERSION


REPORTS = {"Counters", "Picture", "Totals", "TracksInView", "Tuber"}
"""What people look at; nothing is counted from them."""


def with_more(data: bytes, more: dict[str, object]) -> bytes:
    """A message with fields of a later version."""
    header = read_header(data)
    return pack(header.kind, header.fields | more, {array.name: read_array(data, array) for array in header.arrays})


def test_reports_of_a_later_version_are_read_without_what_is_new() -> None:
    kinds = [getattr(messages, name) for name in messages.__all__]
    tolerant = {kind.__name__ for kind in kinds if getattr(kind, "LATER_FIELDS", "") == "ignore"}
    assert tolerant == REPORTS
    report = decoded("Counters")
    assert messages.Counters.decode(with_more(report.encode(), {"later": {"part": [1]}})) == report
    track = messages.TrackInView("a/1", 0.1, 0.2, 60.0, 40.0, "open")
    view = messages.TracksInView("front", "r1", 5, (track,))
    fields = read_header(view.encode()).fields
    fields["tracks"][0]["later"] = "within a part"
    assert messages.TracksInView.decode(with_more(view.encode(), fields)) == view


@pytest.mark.parametrize("sample", [name for name in SAMPLES if KINDS.get(name, name) not in REPORTS])
def test_what_is_counted_from_is_refused_where_it_says_more(sample: str) -> None:
    with pytest.raises(MessageError, match="later") as found:
        type(decoded(sample)).decode(with_more((OLD / f"{sample}.bin").read_bytes(), {"later": 1}))
    assert found.value.reason is Refusal.FIELD
