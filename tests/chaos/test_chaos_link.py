"""The emulated link is what it is set to: its scheduler by values on a virtual clock, the real one by measurement."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from benchmarks.link import why_no_links
from benchmarks.link_check import measure
from benchmarks.link_wire import MOST_UNDER_WAY_BYTES, LinkSettings, Wire

ATTEMPTS = 4
"""A busy machine makes a link slower than it is, for a moment; a wrong link is wrong each time."""


def arrivals(wire: Wire, *, until_s: float, step_s: float = 0.001) -> list[tuple[float, bytes]]:
    """When each packet arrives, to the step."""
    seen = []
    for n in range(round(until_s / step_s) + 1):
        for packet in wire.due(n * step_s):
            wire.handed_over(packet, taken=True)
            seen.append((n * step_s, packet))
    return seen


def test_a_delayed_packet_arrives_after_the_delay_and_not_before() -> None:
    wire = Wire(LinkSettings(delay_s=0.050), seed=1)
    wire.take(b"a", 0.0)
    wire.take(b"b", 0.020)
    assert wire.next_due_s == 0.050
    assert wire.due(0.049) == []
    assert wire.due(0.050) == [b"a"]
    assert wire.due(1.0) == [b"b"]
    assert wire.next_due_s is None


def test_a_packet_takes_its_bits_times_the_rate_and_the_next_one_waits_for_it() -> None:
    wire = Wire(LinkSettings(bits_per_s=1e6, delay_s=0.010), seed=1)
    for name in b"abc":
        wire.take(bytes([name]) * 1250, 0.0)  # 10 ms of a 1 Mbit/s wire each
    due_s = []
    while (moment := wire.next_due_s) is not None:
        due_s.append(moment)
        wire.due(moment)
    assert due_s == pytest.approx([0.020, 0.030, 0.040])
    wire.take(bytes(1250), 1.0)  # the wire was idle since: no credit was saved up
    assert wire.next_due_s == pytest.approx(1.020)


def test_a_full_queue_drops_its_tail_and_takes_again_once_it_is_drained() -> None:
    wire = Wire(LinkSettings(bits_per_s=8000.0, queue_bytes=3000), seed=1)  # 1000 bytes a second
    for _ in range(5):
        wire.take(bytes(1000), 0.0)
    assert (wire.counts.lost_queue, wire.counts.under_way) == (2, 3)
    wire.take(bytes(1000), 0.9)
    assert wire.counts.lost_queue == 3, "2100 bytes wait still"
    wire.take(bytes(1000), 1.0)
    assert wire.counts.lost_queue == 3
    assert [round(at_s) for at_s, _ in arrivals(wire, until_s=5.0, step_s=0.5)] == [1, 2, 3, 4]


def test_jitter_spreads_the_delay_and_keeps_the_order() -> None:
    wire = Wire(LinkSettings(delay_s=0.050, jitter_s=0.010), seed=7)
    sent_s = [0.1 * n for n in range(500)]
    took_ms = []
    for n, now_s in enumerate(sent_s):
        wire.take(n.to_bytes(2, "big"), now_s)
        assert wire.next_due_s is not None
        took_ms.append(1e3 * (wire.next_due_s - now_s))
        wire.due(now_s + 0.099)
    assert 40.0 <= min(took_ms) < 40.5
    assert 59.5 < max(took_ms) <= 60.0
    crowd = Wire(LinkSettings(delay_s=0.050, jitter_s=0.010), seed=7)
    for n in range(500):
        crowd.take(n.to_bytes(2, "big"), 1e-4 * n)
    assert crowd.due(1.0) == [n.to_bytes(2, "big") for n in range(500)]


def test_loss_is_the_share_it_is_set_to_and_the_same_for_the_same_seed() -> None:
    def kept(seed: int) -> list[bytes]:
        wire = Wire(LinkSettings(loss=0.05), seed=seed)
        for n in range(20_000):
            wire.take(n.to_bytes(2, "big"), 0.0)
        assert wire.counts.lost_loss == 20_000 - wire.counts.under_way
        return wire.due(0.0)

    first = kept(1)
    assert 0.045 < 1 - len(first) / 20_000 < 0.055
    assert kept(1) == first
    assert kept(2) != first


def test_a_cut_lets_what_is_under_way_arrive_and_nothing_else_in() -> None:
    link = LinkSettings(delay_s=0.050)
    wire = Wire(link, seed=1)
    wire.take(b"before", 0.0)
    wire.settings = replace(link, cut=True)
    wire.take(b"during", 0.010)
    wire.settings = link
    wire.take(b"after", 0.020)
    assert wire.due(1.0) == [b"before", b"after"]
    assert wire.counts.lost_cut == 1


def test_every_packet_is_accounted_for_and_memory_is_bounded() -> None:
    wire = Wire(LinkSettings(delay_s=10.0, loss=0.1), seed=3)
    packet = bytes(65536)
    for n in range(2000):
        wire.take(packet, 0.001 * n)
    counts = wire.counts
    assert counts.under_way * len(packet) <= MOST_UNDER_WAY_BYTES
    assert counts.lost_queue > 0
    for n, arrived in enumerate(wire.due(100.0)):
        wire.handed_over(arrived, taken=n % 2 == 0)
    assert counts.under_way == 0
    assert counts.entered == 2000 == counts.forwarded + counts.lost_loss + counts.lost_queue + counts.lost_far_end
    assert counts.forwarded_bytes == counts.forwarded * len(packet)


@pytest.mark.parametrize(
    ("wrong", "why"),
    [({"loss": 1.5}, "share"), ({"delay_s": -1.0}, "at least 0"), ({"jitter_s": 0.1}, "exceeds delay_s")],
)
def test_settings_that_no_link_has_are_refused(wrong: dict[str, float], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        LinkSettings(**wrong)


@pytest.mark.graph
def test_the_real_link_delays_loses_and_throttles_as_it_is_set() -> None:
    if reason := why_no_links():
        pytest.skip(f"the emulated link is not measured: {reason}")
    for _ in range(ATTEMPTS):
        seen = measure(LinkSettings(delay_s=0.050, loss=0.05), echoes=200, tcp_s=0.0)
        if math.isinf(seen.rtt_ms[0]):  # the machine was too busy for a single echo
            continue
        assert seen.rtt_ms[0] >= 100.0, "twice 50 ms"
        assert seen.round_trips_lost > 0.02, "two ways with 5 % each: 9.75 %"
        assert 0.01 < seen.packets_lost < 0.12
        if seen.rtt_ms[0] < 130.0 and seen.round_trips_lost < 0.22:
            break
    else:
        pytest.fail(f"{ATTEMPTS} times slower than it is set to, at last: {seen}")
    for _ in range(ATTEMPTS):
        fast = measure(LinkSettings(bits_per_s=8e6), echoes=5, tcp_s=1.0)
        assert fast.tcp_bits_per_s < 8e6
        if fast.tcp_bits_per_s > 4e6:
            break
    else:
        pytest.fail(f"{ATTEMPTS} times slower than it is set to, at last: {fast}")
