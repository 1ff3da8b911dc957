"""Fixtures shared by all tests: a router process, recorded belts, the optional shared data, seeds."""

from __future__ import annotations

import gc
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from conveyor import taken_port
from conveyor.config import LineConfig, LinkConfig
from conveyor.node import Node
from tests.belts import live_recording, loaded_recording, recording, run_dir
from tests.hang_watch import HangWatch
from tests.routers import Routers

__all__ = ["live_recording", "loaded_recording", "recording", "run_dir"]

# How long an example takes says something of the machine and its load, nothing of the code.
settings.register_profile("tuberline", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("tuberline")

ROOT = Path(__file__).resolve().parents[1]

LONGEST_FIRST = ("chaos", "tuberline", "integration", "viewer", "deploy", "camera_sim")
"""Folders whose tests start processes. They go first: a file that takes a minute must not begin when all else ends."""


def pytest_configure(config: pytest.Config) -> None:
    """A test that hangs beyond its timeout ends its process, and is named."""
    config.pluginmanager.register(HangWatch())


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is collected stays until the end: a third of the time went into looking for what of it is unused."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files in the order in which several workers are done soonest (`make test`)."""
    items.sort(key=lambda item: _rank(item.path))


def _rank(path: Path) -> int:
    folder = path.parent.name
    return LONGEST_FIRST.index(folder) if folder in LONGEST_FIRST else len(LONGEST_FIRST)


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of shared fixtures and real data; tests that need it are skipped loudly where it is absent."""
    path = Path(os.environ.get("TUBERLINE_SHARED", ROOT.parent / "shared"))
    if not (path / "fixtures").is_dir():
        pytest.skip(f"shared data are not at {path}; set TUBERLINE_SHARED to run this test")
    return path


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """A seeded generator; the seed is printed so that a failure can be repeated."""
    seed = int(os.environ.get("TUBERLINE_SEED", "20260106"))
    sys.stdout.write(f"seed {seed} ({request.node.nodeid}; TUBERLINE_SEED repeats it)\n")
    return np.random.default_rng(seed)


@pytest.fixture
def free_port() -> int:
    """A TCP port that was free a moment ago."""
    return taken_port.free_port()


@pytest.fixture(scope="session")
def routers() -> Iterator[Routers]:
    """The process that holds the routers of tests that do not harm theirs."""
    routers = Routers()
    yield routers
    routers.stop()


@pytest.fixture
def link(free_port: int, routers: Routers) -> Iterator[LinkConfig]:
    """The link to a real router of this test's own."""
    endpoint = f"tcp/127.0.0.1:{free_port}"
    with routers.at(endpoint):
        yield LinkConfig(router=endpoint)


def start_router(endpoint: str) -> subprocess.Popen[bytes]:
    """`tuberline router` as its own process, listening when this returns."""
    process = subprocess.Popen([sys.executable, "-m", "tuberline", "router", "--listen", endpoint])
    host, port = endpoint.removeprefix("tcp/").rsplit(":", 1)

    def listening() -> bool:
        with socket.socket() as probe:
            return probe.connect_ex((host, int(port))) == 0

    wait_until(listening, what=f"router at {endpoint}")
    return process


@contextmanager
def sender_and_receiver(link: LinkConfig) -> Iterator[tuple[Node, Node]]:
    """Two nodes of one line."""
    config = LineConfig(link=link)
    with (
        Node("segmenter", "a", config=config, run="r1") as sender,
        Node("aggregator", "b", config=config, run="r1") as receiver,
    ):
        yield sender, receiver


def wait_until(true: Callable[[], object], *, what: str, timeout_s: float = 60.0) -> None:
    """Poll until `true()`; fails with `what` after the deadline."""
    deadline = time.monotonic() + timeout_s
    while not true():
        if time.monotonic() > deadline:
            pytest.fail(f"waited {timeout_s:g} s in vain for: {what}")
        time.sleep(0.02)
