"""One frame from a camera to its segmenter on the same host: by the router, and straight.

    python -m benchmarks frames [--frames 300] [--per-s 30] [--size 1280x720]

Sender and receiver are processes of their own with the line's own publisher, inbox and messages; a frame's time is from
before it is encoded to after it is decoded. CPU is that of sender, receiver and router per frame. `zmq ipc` sends the
same messages by pyzmq, where that is installed, with nothing of ours around it.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import os
import platform
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.line_watch import percentile
from benchmarks.options import above_zero, parser_of, pixels, whole_number
from benchmarks.proc import cpu_s
from conveyor import topics
from conveyor.config import LinkConfig
from conveyor.counters import CounterSet
from conveyor.delivery import LatestPublisher, LatestSubscriber
from conveyor.direct import DirectLink
from conveyor.frame_ring import IN_MEMORY, RingInlet, RingOutlet, ring_path
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame
from conveyor.session import open_client, open_router

WAYS = ("by the router", "direct, shared memory", "direct, unix socket", "direct, tcp", "zmq ipc")
WAIT_S = 20.0
CAMERA = "front"


@dataclass(slots=True)
class End:
    """One end of a way: what the delivery classes need."""

    session: Any
    line: str = "bench"
    counters: CounterSet = field(default_factory=CounterSet)
    log: logging.Logger = field(default_factory=lambda: logging.getLogger("bench"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure all ways in turn and print a table."""
    parser = parser_of("frames", __doc__)
    parser.add_argument("--frames", type=whole_number(1), default=300)
    parser.add_argument("--per-s", type=above_zero, default=30.0)
    parser.add_argument("--size", type=pixels, default=(1280, 720), help="of an image, e.g. 848x480; default: 1280x720")
    parser.add_argument("--receive", nargs=2, metavar=("WAY", "ENDPOINT"), help=argparse.SUPPRESS)
    parser.add_argument("--route", metavar="ENDPOINT", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.route:
        _route(options.route)
    elif options.receive:
        _receive(*options.receive, frames=options.frames)
    else:
        ways = [way for way in WAYS if way != "zmq ipc" or find_spec("zmq")]
        print(markdown({way: measured(way, options) for way in ways}, options))
    return 0


def measured(way: str, options: argparse.Namespace) -> dict[str, float]:
    """Milliseconds per frame, CPU milliseconds per frame by process, and how many arrived."""
    folder = tempfile.mkdtemp(prefix="tuberline-", dir=IN_MEMORY if "memory" in way else None)
    endpoint = (
        f"unixsock-stream/{folder}/f.sock"
        if "unix" in way or "memory" in way
        else f"ipc://{folder}/f.ipc"
        if "zmq" in way
        else _tcp()
    )
    try:
        with contextlib.ExitStack() as stack:
            router = stack.enter_context(_child("--route", endpoint)) if way == WAYS[0] else None
            if router is not None:
                assert router.stdout is not None
                router.stdout.readline()  # it listens
            receiver = stack.enter_context(_child("--receive", way, endpoint, "--frames", str(options.frames)))
            send = stack.enter_context(_sender(way, endpoint))
            depth = _depth(options.size)
            before = [cpu_s(os.getpid()), cpu_s(receiver.pid), cpu_s(router.pid) if router else 0.0]
            begun = time.monotonic()
            for seq in range(options.frames):
                time.sleep(max(0.0, begun + seq / options.per_s - time.monotonic()))
                send(_frame(seq, depth))
            time.sleep(0.1)
            after = [cpu_s(os.getpid()), cpu_s(receiver.pid), cpu_s(router.pid) if router else 0.0]
            out, _ = receiver.communicate(timeout=2 * WAIT_S)
        took_ms = json.loads(out.splitlines()[-1])
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    used = [1e3 * (b - a) / options.frames for a, b in zip(before, after, strict=True)]
    return {
        "arrived": len(took_ms),
        "p50_ms": percentile(took_ms, 0.5),
        "p99_ms": percentile(took_ms, 0.99),
        **dict(zip(("sender_cpu_ms", "receiver_cpu_ms", "router_cpu_ms"), used, strict=True)),
    }


def markdown(results: dict[str, dict[str, float]], options: argparse.Namespace) -> str:
    """The table."""
    size_mb = _frame(0, _depth(options.size)).depth.nbytes / 1e6
    versions = f"Python {platform.python_version()}, eclipse-zenoh {version('eclipse-zenoh')}"
    lines = [
        f"{options.frames} frames of {size_mb:.2f} MB at {options.per_s:g} a second; {os.cpu_count()} cores "
        f"{platform.machine()}, {versions}, load average {os.getloadavg()[0]:.1f} at the end.",
        "",
        "| way | p50 ms | p99 ms | CPU ms: sender, receiver, router | arrived |",
        "| --- | --- | --- | --- | --- |",
        *(
            f"| {way} | {r['p50_ms']:.2f} | {r['p99_ms']:.2f} | {r['sender_cpu_ms']:.1f}, {r['receiver_cpu_ms']:.1f}, "
            f"{r['router_cpu_ms']:.1f} | {r['arrived']:.0f} |"
            for way, r in results.items()
        ),
    ]
    return "\n".join(lines) + "\n"


def _depth(size: tuple[int, int]) -> np.ndarray:
    width, height = size
    return np.random.default_rng(1).integers(380, 470, (height, width)).astype(np.uint16)


def _frame(seq: int, depth: np.ndarray) -> Frame:
    height, width = depth.shape
    intrinsics = Intrinsics(width, height, 650.0, 650.0, width / 2, height / 2)
    return Frame(CAMERA, "r", seq, time.monotonic_ns(), 0.0, 0.001, intrinsics, 0.46, depth)


@contextlib.contextmanager
def _sender(way: str, endpoint: str) -> Iterator[Any]:
    """A function that sends a frame; somebody listens when this is entered."""
    if "zmq" in way:
        import zmq

        with zmq.Context() as context, context.socket(zmq.PUSH) as pipe:
            pipe.connect(endpoint)
            yield lambda frame: pipe.send(frame.encode(), copy=False)
        return
    link = LinkConfig(router=_router_of(endpoint))
    with _session(way, endpoint, link, listens=False) as session:
        publisher = LatestPublisher(End(session), topics.FRAME, camera=CAMERA)
        deadline = time.monotonic() + WAIT_S
        while not publisher.has_listener:
            if time.monotonic() > deadline:
                raise TimeoutError(f"no one listens {way}")
            time.sleep(0.01)
        path = ring_path(endpoint) if "memory" in way else None
        if path is None:
            yield publisher.put
            return
        ring = RingOutlet(End(session), path, camera=CAMERA)
        while not ring.has_reader and time.monotonic() < deadline:
            time.sleep(0.01)
        yield lambda frame: ring.put(frame.encode())
        ring.close()


def _receive(way: str, endpoint: str, *, frames: int) -> None:
    """Print the milliseconds of all frames that arrived, as JSON."""
    took_ms: list[float] = []
    if "zmq" in way:
        import zmq

        with zmq.Context() as context, context.socket(zmq.PULL) as pipe:
            pipe.bind(endpoint)
            while len(took_ms) < frames and pipe.poll(WAIT_S * 1000):
                took_ms.append(_age_ms(Frame.decode(pipe.recv())))
    else:
        with _session(way, endpoint, LinkConfig(router=_router_of(endpoint)), listens=True) as session:
            inbox = LatestSubscriber(End(session), topics.FRAME, Frame, capacity=3, camera=CAMERA)
            path = ring_path(endpoint) if "memory" in way else None
            _inlet = RingInlet(End(session), path, inbox, camera=CAMERA) if path else None
            deadline = time.monotonic() + WAIT_S
            while len(took_ms) < frames and time.monotonic() < deadline:
                if (frame := inbox.get(0.5)) is not None:
                    took_ms.append(_age_ms(frame))
                    deadline = time.monotonic() + WAIT_S / 4
    print(json.dumps(took_ms), flush=True)


def _age_ms(frame: Frame) -> float:
    return (time.monotonic_ns() - frame.captured_ns) / 1e6


@contextlib.contextmanager
def _session(way: str, endpoint: str, link: LinkConfig, *, listens: bool) -> Iterator[Any]:
    if way == WAYS[0]:
        with open_client(link, name="bench") as session:
            yield session
    else:
        with DirectLink.open(End(None), endpoint, link=link, listens=listens) as direct:
            yield direct.session


def _router_of(endpoint: str) -> str:
    return endpoint if endpoint.startswith("tcp/") else "tcp/127.0.0.1:7447"


def _route(endpoint: str) -> None:
    with open_router(LinkConfig(router=endpoint)):
        print("listens", flush=True)
        time.sleep(3600)


def _tcp() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@contextlib.contextmanager
def _child(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "benchmarks", "frames", *arguments]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[1])
    try:
        yield child
    finally:
        child.kill()
        child.communicate()
