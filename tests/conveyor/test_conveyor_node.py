"""Life of a node: it stops on a signal, reports its counters, and says when it stalls."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from conveyor.config import LineConfig, LinkConfig
from conveyor.messages import Counters
from conveyor.observer import Observer
from tests.conftest import wait_until
from tuberline.supervisor import ProcessSpec, Supervisor

pytestmark = pytest.mark.graph

NODE = """
    import os, sys, time
    from conveyor.config import LineConfig, LinkConfig
    from conveyor.node import Node

    def work():
        with Node("camera", "front", config=LineConfig(link=LinkConfig(router=sys.argv[1])), run="r1") as node:
            node.counters.add("frames_published", 7)
            if sys.argv[2] == "hang":
                node.stop.wait()
                time.sleep(60)
            while not node.stop.wait(0.05):
                if sys.argv[2] == "works":
                    node.progress()

    try:
        work()
    except SystemExit as left:  # stopped while it waited for a router
        sys.stderr.flush()
        os._exit(left.code)  # as `tuberline` does: on a busy machine the end of an interpreter takes too long
"""


def start_node(link: LinkConfig, how: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-c", textwrap.dedent(NODE), link.router, how], stderr=subprocess.PIPE)


def test_counters_arrive_and_sigterm_ends_it_with_0(link: LinkConfig) -> None:
    process = start_node(link, "works")
    with Observer(link, line=LineConfig().name) as observer:

        def counters() -> Counters | None:
            return observer.nodes().get("camera/front")

        wait_until(lambda: counters() and "camera/front" in observer.alive(), what="counters and token")
        seen = counters()
        assert seen is not None
        assert (seen.values["frames_published"], seen.pid, seen.status) == (7, process.pid, "ok")
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
        wait_until(lambda: "camera/front" not in observer.alive(), what="the token to go")


def test_a_node_that_hangs_on_stop_leaves_all_the_same(link: LinkConfig) -> None:
    process = start_node(link, "hang")
    with Observer(link, line=LineConfig().name) as observer:
        wait_until(lambda: "camera/front" in observer.alive(), what="the token")
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 70
    assert b"did not stop within 2 s of signal 2" in said


def test_no_progress_is_reported_as_a_stall(link: LinkConfig) -> None:
    process = start_node(link, "stalls")
    with Observer(link, line=LineConfig().name) as observer:
        wait_until(
            lambda: (c := observer.nodes().get("camera/front")) and c.status == "stalled" and c.values["stalls"] == 1,
            what="the stall",
        )
    process.terminate()
    assert process.wait(30) == 0


def test_supervisor_leaves_bad_input_alone(tmp_path: Path) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text("nmae = 'x'")
    specs = [
        ProcessSpec("bad", ("config", "check", str(bad))),
        ProcessSpec("brief", ("topics", "--json")),
    ]
    with Supervisor(specs, log_dir=tmp_path / "logs") as supervisor:
        wait_until(lambda: supervisor.failures and supervisor.finished("brief"), what="both ends")
        assert supervisor.failures == {"bad": 2}
        assert "did you mean 'name'" in supervisor.log_tail("bad")
        assert supervisor.restarts == {"bad": 0, "brief": 0}


def test_supervisor_counts_a_restart_after_sigkill(tmp_path: Path, free_port: int) -> None:
    spec = ProcessSpec("router", ("router", "--listen", f"tcp/127.0.0.1:{free_port}"))
    with Supervisor([spec], log_dir=tmp_path) as supervisor:
        wait_until(lambda: "listening" in supervisor.log_tail("router"), what="the router")
        first = supervisor.pid("router")
        assert first is not None
        subprocess.run(["kill", "-9", str(first)], check=True)
        wait_until(lambda: supervisor.pid("router") not in (None, first), what="a new router")
        assert supervisor.restarts == {"router": 1}
