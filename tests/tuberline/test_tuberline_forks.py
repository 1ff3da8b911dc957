"""Nodes are forked from one process: they end, fail and are watched as processes that start by themselves."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from conveyor.errors import FAULT, PERMANENT
from tests.conftest import wait_until
from tests.conveyor.test_conveyor_orphan import descendants, gone
from tuberline.forks import MODULES, Forked, ForkServer
from tuberline.supervisor import ProcessSpec, Supervisor

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def forks() -> Iterator[ForkServer]:
    """Without anything loaded ahead."""
    server = ForkServer.if_usable(())
    if server is None:
        pytest.skip("this kernel has no handles for processes")
    with server:
        yield server


def start_router(forks: ForkServer, port: int, log: Path, **environment: str) -> Forked:
    """A router that listens, with its log in a file of its own."""
    log.unlink(missing_ok=True)
    router = forks.start(("router", "--listen", f"tcp/127.0.0.1:{port}"), environment=environment, log=log)
    wait_until(lambda: "listening" in log.read_text(encoding="utf-8"), what="the router listens", timeout_s=60)
    return router


def server_of(pid: int) -> int:
    """The process that forked a node."""
    return int(Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()[1])


def test_a_node_tells_its_exit_code_and_its_reason(forks: ForkServer, tmp_path: Path) -> None:
    log = tmp_path / "node.log"
    log.write_text("of an earlier start\n", encoding="utf-8")
    node = forks.start(("camera", "--config", "none.toml", "--camera", "left"), environment={}, log=log)
    assert node.wait(60) == node.poll() == PERMANENT
    node.kill()  # of no one
    earlier, said = log.read_text(encoding="utf-8").splitlines()
    assert earlier == "of an earlier start"
    assert said.startswith("tuberline: ")
    assert "none.toml" in said


def test_a_node_has_its_own_name_environment_and_signals(forks: ForkServer, free_port: int, tmp_path: Path) -> None:
    log = tmp_path / "router.log"
    router = start_router(forks, free_port, log)
    assert Path(f"/proc/{router.pid}/cmdline").read_bytes().startswith(b"tuberline router --listen tcp/127.0.0.1:")
    assert router.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        router.wait(0.0)
    router.send_signal(signal.SIGTERM)
    assert router.wait(10) == 0
    router = start_router(forks, free_port, log, TUBERLINE_LOG="json")
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # the tests themselves are to outlive their terminal
        for pid in (server_of(router.pid), router.pid):
            os.kill(pid, signal.SIGHUP)
        assert router.wait(10) == 0, "a closed terminal killed all nodes of a line, and no summary was written"
        router = start_router(forks, free_port, log, TUBERLINE_LOG="json")
    assert json.loads(log.read_text(encoding="utf-8").splitlines()[-1])["node"] == "router"
    router.kill()
    assert router.wait(10) == -signal.SIGKILL


def test_a_node_that_was_just_forked_hears_that_it_is_to_end(forks: ForkServer, free_port: int) -> None:
    """Of 25 such signals 15 were lost: the line that was stopped as it started waited, and killed the node."""
    nodes = []
    for _ in range(8):
        nodes.append(forks.start(("router", "--listen", f"tcp/127.0.0.1:{free_port}"), environment={}, log=None))
        nodes[-1].send_signal(signal.SIGTERM)
    codes = [node.wait(15) for node in nodes]
    assert set(codes) <= {-signal.SIGTERM, 128 + signal.SIGTERM, 0}, codes


def test_what_cannot_be_started_is_an_error_of_the_system(forks: ForkServer, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        forks.start(("router",), environment={}, log=tmp_path / "no" / "router.log")
    assert forks.start(("router", "--help"), environment={}, log=tmp_path / "router.log").wait(60) == 0


def test_a_node_that_could_not_be_watched_does_not_run(
    forks: ForkServer, free_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where this process has no handle left the node is told as one that cannot be started."""
    asked: list[int] = []

    def none_left(pid: int) -> int:
        asked.append(pid)
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(os, "pidfd_open", none_left)
    with pytest.raises(OSError, match="Too many open files"):
        forks.start(("router", "--listen", f"tcp/127.0.0.1:{free_port}"), environment={}, log=None)
    assert gone(asked[0])


def test_the_process_that_forks_has_no_thread(forks: ForkServer, tmp_path: Path) -> None:
    """One would be missing in each node, with whatever it holds."""
    for role in MODULES:
        node = forks.start((role, "--help"), environment={}, log=tmp_path / "log")
        server = server_of(node.pid)
        assert node.wait(60) == 0
    assert len(list(Path(f"/proc/{server}/task").iterdir())) == 1


def test_a_question_that_a_signal_cut_short_is_the_last(forks: ForkServer, free_port: int, tmp_path: Path) -> None:
    """Its answer, the process id of a node, was taken for an exit code when a replay was stopped while it started."""
    router = start_router(forks, free_port, tmp_path / "router.log")

    def stop(*_: object) -> None:
        raise SystemExit(3)

    before = signal.signal(signal.SIGALRM, stop)
    os.kill(server_of(router.pid), signal.SIGSTOP)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with pytest.raises(SystemExit):
            forks.start(("router", "--help"), environment={}, log=None)
    finally:
        os.kill(server_of(router.pid), signal.SIGCONT)
        signal.signal(signal.SIGALRM, before)
    router.send_signal(signal.SIGTERM)
    assert router.wait(15) == FAULT
    with pytest.raises(ConnectionError):
        forks.start(("router", "--help"), environment={}, log=None)


def test_nodes_end_with_the_process_that_forked_them(forks: ForkServer, free_port: int, tmp_path: Path) -> None:
    router = start_router(forks, free_port, tmp_path / "router.log")
    os.kill(server_of(router.pid), signal.SIGKILL)
    assert router.wait(15) == FAULT, "its code is not known"
    assert "that started this one is gone" in (tmp_path / "router.log").read_text(encoding="utf-8")
    with pytest.raises(ConnectionError, match="does not answer"):
        forks.start(("router",), environment={}, log=None)


def test_a_line_outlives_the_process_that_forks(free_port: int, tmp_path: Path) -> None:
    spec = ProcessSpec("router", ("router", "--listen", f"tcp/127.0.0.1:{free_port}"))
    log = tmp_path / "router.log"
    with Supervisor([spec], log_dir=tmp_path) as supervisor:
        first = supervisor.pid("router")
        assert first is not None
        wait_until(lambda: "listening" in log.read_text(encoding="utf-8"), what="the router listens", timeout_s=60)
        os.kill(server_of(first), signal.SIGKILL)
        wait_until(
            lambda: log.read_text(encoding="utf-8").count("listening") == 2, what="the router is back", timeout_s=60
        )
        second = supervisor.pid("router")
        assert second not in (None, first)
        assert supervisor.restarts == supervisor.crashes == {"router": 1}
    left = [pid for pid in descendants(os.getpid()) if not gone(pid)]
    assert second not in left


def test_without_handles_of_processes_each_node_starts_by_itself(
    free_port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on an old kernel, and on systems other than Linux."""
    monkeypatch.delattr(os, "pidfd_open")
    assert ForkServer.if_usable(()) is None
    spec = ProcessSpec("router", ("router", "--listen", f"tcp/127.0.0.1:{free_port}"))
    with Supervisor([spec], log_dir=tmp_path) as supervisor:
        pid = supervisor.pid("router")
        assert pid is not None
        assert server_of(pid) == os.getpid()
        log = tmp_path / "router.log"
        wait_until(lambda: "listening" in log.read_text(encoding="utf-8"), what="the router listens", timeout_s=60)
    assert gone(pid)
