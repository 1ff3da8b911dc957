"""A process that waits for a processor is slow and not stuck: its standstill is one in its own time."""

from __future__ import annotations

import os
import signal
import socket
from pathlib import Path

import pytest

from conveyor.taken_port import free_port as another_port
from tests.conftest import wait_until
from tuberline import heartbeat, own_time
from tuberline.own_time import OwnTime
from tuberline.supervisor import ProcessSpec, Supervisor

WAITED_S = 10_000


def tell(proc: Path, pid: int, waited_s: float) -> None:
    """As the kernel tells it: nanoseconds run, nanoseconds waited, times."""
    (proc / str(pid)).mkdir(exist_ok=True)
    (proc / str(pid) / "schedstat").write_text(f"5000000 {round(waited_s * 1e9)} 7\n")


def test_the_clock_of_a_process_stands_while_it_waits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(own_time, "PROC", tmp_path)
    own = OwnTime(42)
    assert own.look() == 0.0, "the kernel does not tell: its time is that of all"
    assert own.at(100.0) == 100.0
    tell(tmp_path, 42, 30.5)
    assert own.look() == 30.5
    assert own.at(100.0) == 69.5
    tell(tmp_path, 42, 31.0)
    assert own.look() == 0.5
    (tmp_path / "42" / "schedstat").write_text("")
    assert own.look() == 0.0, "it is gone"
    assert own.at(100.0) == 69.0


def test_the_kernel_tells_how_long_a_process_waited() -> None:
    """Of this one: it shares the machine with others, or not."""
    if not (own_time.PROC / "self" / "schedstat").is_file():
        pytest.skip("this kernel does not tell who waits for a processor")
    own = OwnTime(os.getpid())
    run_ns, waited_ns, _ = map(int, (own_time.PROC / "self" / "schedstat").read_text().split())
    assert run_ns > 0
    assert own.look() >= waited_ns / 1e9


def test_slow_to_start_is_not_too_long_to_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At load 15 a regressor said nothing for 20 s while it loaded its libraries, and was killed over and over."""
    monkeypatch.setattr(own_time, "PROC", tmp_path)
    own, beat = OwnTime(42), heartbeat.Heartbeat(0.0)
    tell(tmp_path, 42, 385.0)
    own.look()
    assert beat.standstill(own.at(400.0)) == ""
    assert beat.standstill(own.at(410.0)) == "has stood still for 25 s"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as process:
        process.sendto(b"STATUS=here", "\0" + beat.environment["NOTIFY_SOCKET"][1:])
    assert beat.standstill(own.at(410.0)) == ""
    assert beat.standstill(own.at(690.0)) != ""
    beat.close()


def test_of_two_that_say_nothing_the_one_that_waits_is_left_alone(
    tmp_path: Path, free_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both are stopped, so that they are silent for certain; of one the kernel says that it waits for a processor."""
    monkeypatch.setattr(heartbeat, "STILL_AFTER_S", 2.0)
    monkeypatch.setattr(own_time, "PROC", tmp_path)
    specs = [
        ProcessSpec(name, ("router", "--listen", f"tcp/127.0.0.1:{port}"))
        for name, port in (("waits", free_port), ("stuck", another_port()))
    ]
    with Supervisor(specs[:1], log_dir=tmp_path) as waits, Supervisor(specs[1:], log_dir=tmp_path) as stuck:
        slow = waits.pid("waits")
        assert slow is not None
        tell(tmp_path, slow, WAITED_S)
        os.kill(slow, signal.SIGSTOP)
        wait_until(lambda: waits.own_time_s < stuck.own_time_s - WAITED_S / 2, what="a look at the one that waits")
        other = stuck.pid("stuck")
        assert other is not None
        os.kill(other, signal.SIGSTOP)
        wait_until(lambda: stuck.restarts["stuck"], what="the restart of the other one")
        assert waits.restarts == {"waits": 0}
