"""A command that is stopped or killed leaves no process of a line behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from tests.belts import simulate
from tests.conftest import ROOT, wait_until
from tuberline.cli.leaving import Told, told_to_end

SUPERVISES = """
import sys, time
from pathlib import Path
from tuberline.supervisor import ProcessSpec, Supervisor
with Supervisor([ProcessSpec("router", ("router", "--listen", sys.argv[1]))], log_dir=Path(sys.argv[2])) as supervisor:
    print(supervisor.pid("router"), flush=True)
    time.sleep(60)
"""


def descendants(pid: int) -> list[int]:
    """Process ids of all that a process has started, and of what these have."""
    found = []
    for children in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):
            found += [int(child) for child in children.read_text(encoding="ascii").split()]
    return found + [further for child in found for further in descendants(child)]


def gone(pid: int) -> bool:
    """No such process, or one that only waits to be reaped."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()[0] == "Z"
    except FileNotFoundError:
        return True


@pytest.mark.timeout(60)
def test_a_node_ends_when_its_supervisor_was_killed(tmp_path: Path, free_port: int) -> None:
    command = [sys.executable, "-c", SUPERVISES, f"tcp/127.0.0.1:{free_port}", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT, text=True) as supervisor:
        assert supervisor.stdout is not None
        pid = int(supervisor.stdout.readline())
        log = tmp_path / "router.log"
        wait_until(lambda: "listening" in log.read_text(), what="the router listens", timeout_s=60)
        assert not gone(pid)
        supervisor.kill()
    try:
        wait_until(lambda: gone(pid), what="the router is gone")
    finally:
        if not gone(pid):
            os.kill(pid, signal.SIGKILL)
    assert "that started this one is gone" in log.read_text()


@pytest.mark.graph
@pytest.mark.timeout(120)
def test_a_replay_that_is_told_to_stop_takes_its_nodes_along(tmp_path: Path) -> None:
    recording, out = tmp_path / "recording", tmp_path / "out"
    tuberline = [sys.executable, "-m", "tuberline"]
    simulate(recording, tubers="20")
    logs = out / "logs"
    begin = [*tuberline, "replay", recording, "--out", out, "--speed", "real"]
    with subprocess.Popen(begin, cwd=ROOT, stderr=subprocess.PIPE, text=True) as replay:
        wait_until(lambda: [*logs.glob("camera-*.log")], what="the cameras are started", timeout_s=60)
        pids = descendants(replay.pid)
        assert len(pids) >= 5, "the nodes, and what forks them"
        replay.send_signal(signal.SIGTERM)
        assert replay.wait(30) == 128 + signal.SIGTERM
        assert replay.stderr is not None
        assert f"`tuberline replay {recording} --out {out} --resume` goes on" in replay.stderr.read()
    # One that was being started when the signal came is known to no one; it ends by itself, within a second.
    wait_until(lambda: all(gone(pid) for pid in pids), what="the nodes are gone")


DROPPED = """
import os, signal, sys, time, weakref
from tuberline.cli.leaving import leave_when_told
leave_when_told()
class Thing: pass
thing = Thing()
watched = weakref.ref(thing, lambda _: signal.raise_signal(signal.{name}))
del thing
print("went on", flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 128 + signal.SIGTERM), ("SIGINT", -signal.SIGINT)])
def test_a_signal_that_python_drops_is_given_again(name: str, code: int) -> None:
    """A replay that was told to stop while a module's lock was tidied up counted on to its end."""
    done = subprocess.run(
        [sys.executable, "-c", DROPPED.format(name=name)], cwd=ROOT, capture_output=True, text=True, timeout=30
    )
    assert (done.returncode, done.stdout) == (code, "went on\n")
    assert "Exception ignored" not in done.stderr


def test_what_follows_of_an_end_is_not_told() -> None:
    """pydantic took the signal for a text that does not match: 'not sent: View.track_id' was said, then a traceback of
    numba's compiler, when a line was stopped while it warmed up."""
    script = (
        "import signal\nfrom tuberline.cli.leaving import leave_when_told, swallowed\nleave_when_told()\n"
        "class A:\n def __del__(self): 1 / 0\n"
        "try: signal.raise_signal(signal.SIGTERM)\n"
        "except SystemExit as told:\n A()\n late = ValueError('a full disk, while it left')\n late.__context__ = told\n"
        "print(swallowed(ValueError('no match')), swallowed(late))"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stdout, done.stderr) == (0, "143 None\n", "")


def test_what_is_dropped_otherwise_is_told() -> None:
    script = "from tuberline.cli.leaving import leave_when_told as f; f()\nclass A:\n def __del__(self): 1 / 0\nA()"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=30)
    assert (done.returncode, "ZeroDivisionError" in done.stderr) == (0, True)


@pytest.mark.parametrize(("told", "code"), [(KeyboardInterrupt(), 130), (Told(143), 143)])
def test_a_signal_that_python_wraps_ends_the_command_all_the_same(told: BaseException, code: int) -> None:
    """While it makes a class Python 3.11 turns what is raised into a RuntimeError: Ctrl-C ended with a traceback."""

    class Named:
        def __set_name__(self, _owner: type, _name: str) -> None:
            raise told

    with pytest.raises((RuntimeError, KeyboardInterrupt, Told)) as raised:
        type("Made", (), {"attribute": Named()})
    assert told_to_end(raised.value) == code
    assert told_to_end(RuntimeError("a fault")) is None
