"""Counts of an encoder and what they say: lines, counters that are full or lost their count, and the zero of a run."""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest

from camera_sim.encoder.counts import Counter, count_of, open_counter
from camera_sim.encoder.shaft import Reading, Shaft
from camera_sim.encoder.zero import WAIT_FOR_REST_NS, Standing, Zero
from conveyor.config import parse_config
from conveyor.config_encoder import EncoderConfig
from conveyor.errors import ConfigError, DeviceError
from conveyor.messages import FrameProgress, Travel

MPP = 0.0005
STEP_NS = 20_000_000
DAY_NS = 1_790_000_000_000_000_000


@pytest.mark.parametrize(
    ("line", "count"),
    [(b"12345", 12345), (b"  -7 \r", -7), (b"count=4294967295\r", 4294967295), (b"A+12", 12), (b"0", 0)],
)
def test_a_line_ends_with_its_count(line: bytes, count: int) -> None:
    assert count_of(line) == count


@pytest.mark.parametrize("line", [b"1.5", b"12 34", b"abc", b"12x", b"9" * 21, b"x" * 79 + b"12", b"\xff\x00"])
def test_a_line_without_a_count_is_refused(line: bytes) -> None:
    with pytest.raises(ValueError, match="no count in the line"):
        count_of(line)


def turned(counts: list[int], *, bits: int = 32, metres_per_pulse: float = MPP) -> tuple[Shaft, list[Reading]]:
    shaft = Shaft(metres_per_pulse, bits=bits)
    return shaft, [shaft.read(count, n * STEP_NS) for n, count in enumerate(counts)]


@pytest.mark.parametrize("bits", [16, 24, 32, 64])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_counter_that_is_full_goes_on(bits: int, sign: int) -> None:
    full = 1 << bits
    shaft, known = turned([(full - 50 + sign * 10 * n) % full for n in range(20)], bits=bits)
    assert set(known) == {Reading.GOOD}
    assert shaft.turned_m == pytest.approx(sign * 190 * MPP)


def test_signed_counts_and_a_shaft_that_counts_down_while_the_belt_runs_on() -> None:
    shaft, known = turned([2**31 - 10 - 10 * n - (2**32 if n < 1 else 0) for n in range(20)], metres_per_pulse=-MPP)
    assert set(known) == {Reading.GOOD}
    assert shaft.turned_m == pytest.approx(190 * MPP)


def test_a_belt_runs_back_and_on() -> None:
    shaft, known = turned([1000, 1010, 1020, 1015, 1005, 1010])
    assert set(known) == {Reading.GOOD}
    assert shaft.turned_m == pytest.approx(10 * MPP)


@pytest.mark.parametrize("after", [0, 3, 4_000_000_000])
def test_a_counter_that_lost_its_count_says_so_and_goes_on_from_there(after: int) -> None:
    shaft, known = turned([70_000, 70_010, 70_020, after, after + 10, after + 20])
    assert [reading.name for reading in known] == ["GOOD", "GOOD", "GOOD", "ODD", "LOST", "GOOD"]
    assert shaft.turned_m == pytest.approx(30 * MPP), "what is not known is not told"
    assert shaft.turned_at(2 * STEP_NS) is None, "nothing of before fits to what comes"
    assert shaft.jump == f"from 70020 to {after + 10} in 0.040 s"


def test_noise_on_a_cable_is_left_out() -> None:
    """One wrong digit would cost half a second without the encoder."""
    shaft, known = turned([70_000, 70_010, 90_020, 70_030, 7, 3_000_000_000, 70_060])
    assert [reading.name for reading in known] == ["GOOD", "GOOD", "ODD", "GOOD", "ODD", "ODD", "GOOD"]
    assert shaft.turned_m == pytest.approx(60 * MPP)


def test_metres_a_pulse_that_no_belt_runs_are_never_believed() -> None:
    shaft, known = turned([1000 * n for n in range(50)])
    assert set(known[1:]) == {Reading.ODD}
    assert shaft.turned_m == 0.0


def reopened(after: int, *, away: bool) -> tuple[Shaft, list[Reading]]:
    """Of 70000; read again 10 s later, and once more."""
    shaft = Shaft(MPP, bits=32)
    shaft.read(70_000, 0)
    if away:
        shaft.reopened()
    return shaft, [shaft.read(after + n, 10 * 10**9 + n * STEP_NS) for n in range(2)]


def test_a_device_that_was_without_power_for_long_has_lost_its_count() -> None:
    """In 10 s a belt may run 3 m back; a board that was plugged in again counts from 0."""
    _, known = reopened(64_000, away=True)
    assert known == [Reading.ODD, Reading.LOST]
    shaft, known = reopened(64_000, away=False)
    assert known == [Reading.GOOD, Reading.GOOD]
    assert shaft.turned_m == pytest.approx(-3.0, abs=0.001)
    shaft, known = reopened(74_000, away=True)
    assert known == [Reading.GOOD, Reading.GOOD], "it counted on while its cable was out"
    assert shaft.turned_m == pytest.approx(2.0, abs=0.001)


def test_where_it_was_at_a_moment_and_how_fast_it_turns() -> None:
    shaft, _ = turned([10 * n for n in range(100)])
    assert shaft.turned_at(round(50.5 * STEP_NS)) == pytest.approx(505 * MPP)
    assert shaft.turned_at(10**12) == shaft.turned_m
    assert shaft.turned_at(-1) is None
    assert shaft.speed_mps() == pytest.approx(10 * MPP / 0.02)


def progress(camera: str, done: int, run: str = "r") -> FrameProgress:
    return FrameProgress(camera, run, done, 4)


def seen(camera: str, travel_m: float, at_s: float, *, estimated: bool = False, run: str = "r") -> Travel:
    return Travel(camera, run, DAY_NS + round(at_s * 1e9), travel_m, estimated)


def at_clock(now_s: float) -> dict[str, object]:
    """The shaft turns 0.5 m/s, and was first read at 0."""

    def turned_at(day_ns: int) -> float | None:
        since_s = (day_ns - DAY_NS) / 1e9
        return None if since_s < 0 else 0.5 * since_s

    return {"clock_ns": DAY_NS + round(now_s * 1e9), "turned_at": turned_at}


def test_a_run_that_begins_begins_at_zero() -> None:
    zero = Zero("r", ["left", "right"])
    zero.progress(progress("left", -1))
    zero.progress(progress("other", -1))
    zero.progress(progress("right", -1, run="yesterday"))
    assert not zero.decide(0, 3.0), "one has not spoken"
    zero.progress(progress("right", -1))
    assert zero.decide(1, 3.2)
    assert zero.standing is Standing.TELLS
    assert zero.zero_m + 3.2 == 0.0
    assert not zero.decide(2, 3.4), "once"


def test_a_run_that_is_gone_on_with_goes_on_where_the_load_is() -> None:
    """Never behind what one camera saw. What was said of a time before the counter was read says nothing."""
    zero = Zero("r", ["left", "right"])
    for camera in ("left", "right"):
        zero.progress(progress(camera, 812))
    zero.travel(seen("left", 90.0, -1.0), **at_clock(0.2))  # type: ignore[arg-type]
    assert not zero.decide(0, 0.1)
    zero.travel(seen("left", 100.0, 2.0), **at_clock(2.1))  # type: ignore[arg-type]
    assert not zero.decide(1, 1.0)
    zero.travel(seen("right", 100.02, 2.0), **at_clock(2.1))  # type: ignore[arg-type]
    assert zero.decide(2, 1.05)
    assert zero.zero_m == pytest.approx(100.02 - 1.0)
    zero.ask()
    assert zero.standing is Standing.ASKING
    assert not zero.decide(3, 1.1), "each is asked again"


def test_a_camera_that_says_nothing_is_waited_for_a_while() -> None:
    zero = Zero("r", ["left", "right"])
    zero.progress(progress("left", -1))
    assert not zero.decide(0, 0.0)
    assert not zero.decide(WAIT_FOR_REST_NS - 1, 0.0)
    assert zero.decide(WAIT_FOR_REST_NS, 0.0)


def test_a_camera_with_another_clock_is_taken_at_its_word_now() -> None:
    zero = Zero("r", ["left"])
    for n in range(5):
        assert not zero.decide(n, 2.0), "it may be ours, and late"
        zero.travel(seen("left", 7.0 + 0.05 * n, 3600.0 + 0.1 * n), **at_clock(4.0 + 0.1 * n))  # type: ignore[arg-type]
    assert zero.decide(9, 2.2)
    assert zero.zero_m == pytest.approx(7.0 - 2.0)


def test_a_word_that_comes_late_lays_no_belt_back() -> None:
    """On a starved machine a word of 1.1 s ago was taken for one of now, and 25 of 24 tubers counted."""
    zero = Zero("r", ["left"])
    zero.progress(progress("left", 7))
    zero.travel(seen("left", 10.0, 1.0), **at_clock(2.1))  # type: ignore[arg-type]
    assert not zero.decide(0, 1.1)
    zero.travel(seen("left", 10.6, 2.2), **at_clock(2.3))  # type: ignore[arg-type]
    assert zero.decide(1, 1.2)
    assert zero.zero_m == pytest.approx(10.6 - 1.1)
    zero.ask()
    zero.travel(seen("left", 10.1, 1.2), **at_clock(3.0))  # type: ignore[arg-type]
    assert zero.decide(2, 1.5)
    assert zero.zero_m == pytest.approx(10.1 - 0.6), "its clock is known: it is a word of then"


def test_a_run_that_went_by_the_load_goes_on_by_the_load() -> None:
    zero = Zero("r", ["left", "right"])
    zero.progress(progress("right", -1))
    zero.travel(seen("left", 3.0, 1.0, estimated=True), **at_clock(1.1))  # type: ignore[arg-type]
    assert zero.standing is Standing.LATE
    assert not zero.decide(10**12, 0.0)
    zero.ask()
    assert zero.standing is Standing.LATE


@contextmanager
def device(lines: Iterator[bytes], *, every_s: float = 0.005) -> Iterator[int]:
    """A TCP server that sends these lines to whoever comes; its port."""
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with closing(server), closing(server.accept()[0]) as peer:
            for line in lines:
                peer.sendall(line)
                time.sleep(every_s)

    threading.Thread(target=serve, daemon=True).start()
    yield server.getsockname()[1]


def settings(source: str, **more: float) -> EncoderConfig:
    return EncoderConfig.model_validate({"source": source, "metres_per_pulse": MPP, **more})


def read_all(counter: Counter, found: list[int]) -> None:
    """Until it raises."""
    while True:
        if (count := counter.read()) is not None:
            found.append(count)


def test_counts_come_over_tcp_and_only_the_newest_of_many_counts() -> None:
    with device(iter([b"1\n2\n3\r\n", b"4\n", b"rubbish\n"]), every_s=0.3) as port:
        counter = open_counter(settings(f"tcp://127.0.0.1:{port}"), wait=lambda s: False)
        found: list[int] = []
        with pytest.raises(ValueError, match="rubbish"):
            read_all(counter, found)
        with pytest.raises(DeviceError, match=r"encoder at 127\.0\.0\.1:[0-9]+ closed the connection"):
            read_all(counter, found)
        counter.close()
    assert found == [3, 4]


def test_a_counter_of_the_kernel_is_read(tmp_path: Path) -> None:
    (tmp_path / "count").write_text("4711\n")
    waits: list[float] = []
    for path in (tmp_path, tmp_path / "count"):
        counter = open_counter(settings(f"counter:{path}"), wait=lambda s: bool(waits.append(s)))
        assert counter.read() == 4711
    assert waits == [0.02, 0.02]
    (tmp_path / "count").unlink()
    with pytest.raises(DeviceError, match="count cannot be read: No such file"):
        counter.read()
    with pytest.raises(DeviceError, match="cannot be read"):
        open_counter(settings(f"counter:{tmp_path}"), wait=lambda s: False)


def test_a_simulated_belt_runs_at_its_speed() -> None:
    counter = open_counter(settings("simulated:?speed_mps=0.4"), wait=lambda s: bool(time.sleep(s)))
    began_s = time.monotonic()
    time.sleep(0.1)
    count = counter.read()
    assert count is not None
    assert 0 < count * MPP <= 0.4 * (time.monotonic() - began_s) + 0.01


@pytest.mark.parametrize(
    "source",
    [
        *("/dev/ttyACM0", "serial:", "serial:/dev/x?baud=fast", "serial:/dev/x?bauds=9600", "tcp://host", "usb:1"),
        *("tcp://host:99999", "simulated:?speed_mps=x", "simulated:?speed_mps=nan", "simulated:?speed_mps=40"),
    ],
)
def test_another_source_is_refused_with_those_that_are_known(source: str) -> None:
    """Before the line is started, not by a node that ends again and again."""
    raw = {"encoder": {"source": source, "metres_per_pulse": MPP}}
    with pytest.raises(ConfigError, match=r"is no encoder; allowed are serial:/dev/ttyACM0\?baud=115200, tcp://host"):
        parse_config(raw, where="test")


@pytest.mark.parametrize(
    "wrong", [*({"metres_per_pulse": metres} for metres in (0.0, 0.2, math.inf)), {"bits": 4}, {"name": "a b"}]
)
def test_settings_that_cannot_be_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        EncoderConfig.model_validate({"source": "simulated:", "metres_per_pulse": MPP, **wrong})


@pytest.mark.parametrize("seed", range(3))
def test_what_is_told_is_the_belt_whatever_the_counter_does(seed: int) -> None:
    """Random walks of a belt over a full 16-bit counter."""
    rng = np.random.default_rng(seed)
    pulses = np.cumsum(rng.integers(-20, 60, 5000))
    shaft, known = turned([int(p) % 65536 for p in pulses], bits=16)
    assert set(known) == {Reading.GOOD}
    assert shaft.turned_m == pytest.approx((pulses[-1] - pulses[0]) * MPP)
