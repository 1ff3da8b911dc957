"""What a node does about a router that is still to come, a name or port that is taken, and errors that may pass."""

from __future__ import annotations

import fcntl
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from aggregator.ledger.receipt import receipt_path
from conveyor import taken_port
from conveyor.config import CameraConfig, LineConfig, LinkConfig, dump_toml
from conveyor.errors import FAULT, PASSING, PERMANENT
from conveyor.observer import Observer
from tests.conftest import ROOT, start_router, wait_until
from tests.conveyor.test_conveyor_node import start_node
from tuberline import heartbeat
from tuberline.supervisor import ProcessSpec, Supervisor

pytestmark = [pytest.mark.graph, pytest.mark.timeout(120)]
TUBERLINE = [sys.executable, "-m", "tuberline"]


def start(*args: str | Path) -> subprocess.Popen[str]:
    return subprocess.Popen([*TUBERLINE, *map(str, args)], stderr=subprocess.PIPE, text=True, cwd=ROOT)


def test_a_node_waits_for_a_router_that_comes_later(free_port: int) -> None:
    """It gave up after 20 s with the code that means never again."""
    link = LinkConfig(router=f"tcp/127.0.0.1:{free_port}")
    waiting, stopped = start_node(link, "works"), start_node(link, "works")
    assert waiting.stderr is not None
    assert stopped.stderr is not None
    for node in (waiting, stopped):  # the first word about it
        said = node.stderr.readline().decode()
        assert f"no router answers at {link.router} for 5 s: waiting for it" in said
    stopped.send_signal(signal.SIGTERM)
    assert stopped.wait(10) == 0
    assert waiting.poll() is None
    router = start_router(link.router)
    try:
        with Observer(link, line=LineConfig().name) as observer:
            wait_until(lambda: "camera/front" in observer.alive(), what="the node joins", timeout_s=20)
        waiting.send_signal(signal.SIGTERM)
        said = waiting.communicate(timeout=20)[1].decode()
        assert waiting.returncode == 0, said
    finally:
        router.terminate()
        router.wait(30)


def test_a_second_node_of_a_living_name_ends_and_says_who_is_there(link: LinkConfig) -> None:
    first = start_node(link, "works")
    with Observer(link, line=LineConfig().name) as observer:
        wait_until(lambda: "camera/front" in observer.alive(), what="the first")
        began = time.monotonic()
        second = start_node(link, "works")
        _, said = second.communicate(timeout=30)
        assert time.monotonic() - began < 8
        assert second.returncode != 0
        assert f"a camera 'front' of line 'line' lives already: process {first.pid} on host" in said.decode()
        assert first.poll() is None
        assert "camera/front" in observer.alive()
        # Killed without goodbye, its name is free at once.
        first.kill()
        first.wait()
        third = start_node(link, "works")
        wait_until(
            lambda: (c := observer.nodes().get("camera/front")) and c.pid == third.pid, what="the third", timeout_s=20
        )
        third.terminate()
        assert third.wait(20) == 0


def test_of_two_that_started_at_once_one_stays(link: LinkConfig) -> None:
    both = [start_node(link, "works") for _ in range(2)]
    wait_until(lambda: any(node.poll() is not None for node in both), what="one of them to go", timeout_s=30)
    time.sleep(2.5)
    alive = [node for node in both if node.poll() is None]
    assert len(alive) == 1
    alive[0].terminate()
    assert alive[0].wait(20) == 0


def test_a_second_router_and_a_second_run_at_a_taken_port_end_with_2(link: LinkConfig, tmp_path: Path) -> None:
    """Its nodes joined the other line, whose load was announced as final in the middle."""
    living = start_node(link, "works")
    config = LineConfig(name="other", link=link, cameras={"front": CameraConfig(path=tmp_path)})
    path = tmp_path / "line.toml"
    path.write_text(dump_toml(config))
    with Observer(link, line=LineConfig().name) as observer:
        wait_until(lambda: "camera/front" in observer.alive(), what="the first line")
    for command in (("router", "--listen", link.router), ("run", path)):
        second = start(*command)
        _, said = second.communicate(timeout=40)
        assert second.returncode == PERMANENT, said
        assert f"a router on {socket.gethostname()} listens there, with line: camera/front" in said
    with Observer(link, line="other") as observer:
        assert not observer.nodes(), "a node of the second line joined the first one's router"
    living.terminate()
    assert living.wait(20) == 0


def test_an_error_that_may_pass_is_tried_again_until_it_has_passed(link: LinkConfig, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    config = LineConfig.model_validate({"link": link, "cameras": {"front": {}}, "aggregator": {"out": out}})
    path = tmp_path / "line.toml"
    path.write_text(dump_toml(config))
    receipt = receipt_path(out / "ledger.db")
    receipt.touch()
    spec = ProcessSpec("aggregator", ("aggregator", "--config", str(path), "--run", "r1"))
    with receipt.open("r+b") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        alone = start(*spec.args)
        said = alone.communicate(timeout=40)[1]
        assert alone.returncode == PASSING, said
        with Supervisor([spec], log_dir=tmp_path / "logs") as supervisor:
            wait_until(lambda: supervisor.restarts["aggregator"] >= 2, what="two more tries")
            assert not supervisor.failures
            assert supervisor.crashes == {"aggregator": 0}
            assert "is being written by another process" in supervisor.log_tail("aggregator")
            fcntl.flock(held, fcntl.LOCK_UN)
            with Observer(link, line="line") as observer:
                wait_until(lambda: "aggregator/aggregator" in observer.alive(), what="the aggregator")


def test_what_gave_up_says_why_and_is_started_again_when_its_config_changes(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """'camera-left gave up with exit code 2' was all. A camera that was then started by hand sent its frames to no one:
    the segmenter of a `run` hears the camera of that `run`.
    """
    path = tmp_path / "line.toml"

    def look_in(folder: str) -> None:
        path.write_text(dump_toml(LineConfig.model_validate({"cameras": {"left": {"path": tmp_path / folder}}})))

    look_in("nowhere")
    spec = ProcessSpec("camera-left", ("camera", "--config", str(path), "--camera", "left", "--run", "r1"))
    with Supervisor([spec], log_dir=tmp_path / "logs") as supervisor:
        for restarts, folder in enumerate(("nowhere", "elsewhere")):
            look_in(folder)
            said = f"camera-left gave up with exit code {PERMANENT}: {tmp_path / folder} does not exist"
            wait_until(lambda said=said: said in caplog.text, what=said)  # type: ignore[misc]
            assert supervisor.failures == {"camera-left": PERMANENT}
            assert supervisor.restarts["camera-left"] >= restarts
    assert f"; it is started again when {path} changes" in caplog.text


def test_a_node_that_somebody_else_ends_is_started_again(
    tmp_path: Path, free_port: int, caplog: pytest.LogCaptureFixture
) -> None:
    """By its own process id, as a guard of the memory does: it left well, so a replay waited for it forever."""
    endpoint = f"tcp/127.0.0.1:{free_port}"
    path = tmp_path / "line.toml"
    path.write_text(dump_toml(LineConfig(link=LinkConfig(router=endpoint))))
    specs = [
        ProcessSpec("router", ("router", "--listen", endpoint)),
        ProcessSpec("recorder", ("recorder", "--config", str(path), "--out", str(tmp_path / "belt.mcap"))),
    ]
    told = "recorder was told to end, though not by this line: it is started again"
    with Supervisor(specs, log_dir=tmp_path) as supervisor:
        wait_until(lambda: "started run=" in supervisor.log_tail("recorder"), what="the recorder")
        first = supervisor.pid("recorder")
        assert first is not None
        os.kill(first, signal.SIGTERM)
        wait_until(lambda: supervisor.pid("recorder") not in (None, first), what="another one")
        assert supervisor.restarts == {"router": 0, "recorder": 1}
        assert supervisor.crashes == {"router": 0, "recorder": 0}
        assert not supervisor.finished("recorder")
        assert caplog.text.count(told) == 1
        wait_until(lambda: supervisor.log_tail("recorder").count("started run=") == 2, what="its start")
        second = supervisor.pid("recorder")
        assert second is not None
        os.kill(second, signal.SIGTERM)
        wait_until(lambda: supervisor.pid("recorder") is None, what="its end")
    assert caplog.text.count(told) == 1  # the whole line is told a moment later


def test_a_process_that_stands_still_is_killed_and_started_again(
    tmp_path: Path, free_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frozen once it works, and frozen while it starts."""
    monkeypatch.setattr(heartbeat, "STILL_AFTER_S", 4.0)
    spec = ProcessSpec("router", ("router", "--listen", f"tcp/127.0.0.1:{free_port}"))
    with Supervisor([spec], log_dir=tmp_path) as supervisor:
        wait_until(lambda: "listening" in supervisor.log_tail("router"), what="the router")
        for n in (1, 2):
            pid = supervisor.pid("router")
            assert pid is not None
            subprocess.run(["kill", "-STOP", str(pid)], check=True)
            wait_until(
                lambda n=n: supervisor.restarts["router"] == n and supervisor.pid("router"),  # type: ignore[misc]
                what=f"restart {n}",
                timeout_s=20,
            )
        wait_until(lambda: "listening" in supervisor.log_tail("router", 1), what="the router again", timeout_s=20)
        time.sleep(6.0)
        assert supervisor.restarts == {"router": 2}, "one that moves is left alone"


def test_the_supervisor_watches_without_being_asked(tmp_path: Path, free_port: int) -> None:
    """It looked only after an observer had connected: a router that died while the line started stayed dead."""
    spec = ProcessSpec("router", ("router", "--listen", f"tcp/127.0.0.1:{free_port}"))
    with Supervisor([spec], log_dir=tmp_path) as supervisor:
        first = supervisor.pid("router")
        assert first is not None
        subprocess.run(["kill", "-9", str(first)], check=True)
        wait_until(lambda: supervisor.pid("router") not in (None, first), what="a new router", timeout_s=20)
        wait_until(lambda: "listening" in supervisor.log_tail("router"), what="it listens", timeout_s=20)


def test_codes_are_those_of_the_units() -> None:
    unit = (ROOT / "deploy/systemd/tuberline-.service.d/10-common.conf").read_text()
    assert f"\nRestartPreventExitStatus={PERMANENT}\n" in unit
    assert "\nRestart=always\n" in unit, "a node that a guard of the memory had ended stayed away: it ends with 0"
    assert "\nStartLimitIntervalSec=0\n" in unit
    assert f"\nWatchdogSec={heartbeat.STILL_AFTER_S:g}\n" in unit
    assert f"\nTimeoutStartSec={heartbeat.START_WITHIN_S:g}\n" in unit


def test_a_process_that_starts_slowly_gets_more_time_each_time() -> None:
    """All of a line were killed after 5 minutes of starting on a busy machine, and would have been again and again."""
    for patience in (1.0, 2.0):
        beat = heartbeat.Heartbeat(0.0, patience=patience)
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as process:
            for at_s in (200.0, 299.0, 301.0):
                process.sendto(b"STATUS=here", "\0" + beat.environment["NOTIFY_SOCKET"][1:])
                assert bool(beat.standstill(at_s)) == (at_s > 300 * patience), (patience, at_s)
        beat.close()
    assert len({PERMANENT, PASSING, FAULT}) == 3


def test_a_free_port_is_none_that_the_system_gives_to_connections() -> None:
    """A router that came a moment later found its port taken by another program's connection, once in many runs."""
    ports = [taken_port.free_port() for _ in range(20)]
    assert max(ports) < 32_768
    assert len(set(ports)) > 15


def test_a_port_that_listens_and_is_no_router_of_this_link_is_told(free_port: int) -> None:
    """Certificates of another authority, or tcp/ for tls/: a regressor said that no router answers, which was there."""
    link = LinkConfig(router=f"tcp/127.0.0.1:{free_port}")
    with socket.create_server(("127.0.0.1", free_port)):
        node = start_node(link, "works")
        assert node.stderr is not None
        said = node.stderr.readline().decode()
        node.terminate()
        assert node.wait(20) == 0
    told = f"no router answers at {link.router} for 5 s: waiting for it; something listens there: a router that hangs"
    assert told in said
