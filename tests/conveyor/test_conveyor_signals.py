"""A process that is told to end hears it wherever its main thread is."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap

import pytest

from conveyor.config import LinkConfig

WITHIN_S = 60.0
STOPPED_BY_AN_EVENT = """
    import signal, threading
    from conveyor.signals import stop_when_told

    stop = threading.Event()
    stop_when_told(stop)
    with stop._cond:  # as the main thread has it for a moment whenever it begins or ends to wait
        signal.raise_signal(signal.SIGNAL)
    stop.wait()
"""
NODE = """
    import signal
    from conveyor.config import LineConfig, LinkConfig
    from conveyor.node import Node

    with Node("camera", "front", config=LineConfig(link=LinkConfig(router="ROUTER")), run="r1") as node:
        with node.stop._cond:
            signal.raise_signal(signal.SIGNAL)
        while not node.stop.wait(0.05):
            pass
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_within_a_wait_ends_the_wait(number: signal.Signals) -> None:
    program = textwrap.dedent(STOPPED_BY_AN_EVENT).replace("SIGNAL)", f"{number.name})")
    assert subprocess.run([sys.executable, "-c", program], timeout=WITHIN_S, check=False).returncode == 0


@pytest.mark.graph
def test_a_node_told_within_a_wait_ends_with_0(link: LinkConfig) -> None:
    program = textwrap.dedent(NODE).replace("SIGNAL)", "SIGTERM)").replace("ROUTER", link.router)
    assert subprocess.run([sys.executable, "-c", program], timeout=WITHIN_S, check=False).returncode == 0
