"""A process that is told to end hears it wherever its main thread is."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap

import pytest

from conveyor.config import LinkConfig

WITHIN_S = 60.0
BY_AN_EVENT = """
    import signal, sys, threading
    from conveyor.signals import stop_when_told

    stop = threading.Event()
    stop_when_told(stop)
    with stop._cond:  # as the main thread has it for a moment whenever it begins or ends to wait
        signal.raise_signal(int(sys.argv[1]))
    stop.wait()
"""
NODE = """
    import signal, sys
    from conveyor.config import LineConfig, LinkConfig
    from conveyor.node import Node

    with Node("camera", "front", config=LineConfig(link=LinkConfig(router=sys.argv[2])), run="r1") as node:
        with node.stop._cond:
            signal.raise_signal(int(sys.argv[1]))
        node.stop.wait()
"""


def end_of(program: str, number: signal.Signals, *more: str) -> int:
    """The exit code of a process of its own, which gives itself that signal."""
    command = [sys.executable, "-c", textwrap.dedent(program), str(int(number)), *more]
    return subprocess.run(command, timeout=WITHIN_S, check=False).returncode


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_within_a_wait_ends_the_wait(number: signal.Signals) -> None:
    assert end_of(BY_AN_EVENT, number) == 0


@pytest.mark.graph
def test_a_node_told_within_a_wait_ends_with_0(link: LinkConfig) -> None:
    assert end_of(NODE, signal.SIGTERM, link.router) == 0
