"""One segmenter's dispatch at 1,000 views a second to eight fast workers, of which some leave and join meanwhile.

    python -m benchmarks dispatch [--per-s 1000] [--seconds 20] [--workers 8]

Router and workers are processes of their own; a worker answers at once what it was sent, with the line's own inbox and
publisher, and weighs nothing. The sender is the segmenter's dispatcher with its publishers, subscriber and presence, in
turns of 10 ms. A quarter of the time in, a worker is killed; at half time another one leaves in order; at three
quarters two join. Views are 13 kB, as a line's are.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.line_watch import percentile
from benchmarks.options import above_zero, parser_of, whole_number
from benchmarks.proc import cpu_s
from conveyor import topics
from conveyor.config import LineConfig, parse_config
from conveyor.delivery import LatestPublisher, LatestSubscriber, Presence, ReliablePublisher, ReliableSubscriber
from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from conveyor.messages import View, Weight
from conveyor.node import Node
from conveyor.session import open_router
from conveyor.taken_port import free_port
from segmenter.dispatch.dispatcher import Dispatcher, DispatchSettings

CAMERA, RUN = "front", "bench"
LATE = "late"
"""Workers of this name start with the others and announce themselves when they are told to."""
TURN_S, WAIT_S, LEAST_LEASE_MS = 0.01, 60.0, 500
VIEW = View(
    view_id="0/0", track_id="0", camera=CAMERA, run=RUN, seq=0, captured_ns=0, rank=0, depth_scale_m=0.001,
    intrinsics=Intrinsics(848, 480, 433.0, 433.0, 424.0, 240.0), u0=100, v0=100,
    depth=np.random.default_rng(1).integers(400, 460, (80, 80)).astype(np.uint16),
    belt_from_camera=straight_down_belt_from_camera(0.46),
)  # fmt: skip


@dataclass(slots=True)
class Told:
    """What was seen: seconds from sent to answered, answers by worker, when each change was seen by the dispatcher."""

    took_s: list[float] = field(default_factory=list)
    by_worker: dict[str, int] = field(default_factory=dict)
    changes: list[str] = field(default_factory=list)
    cpu_ms: float = 0.0
    router_cpu_ms: float = 0.0
    seconds: float = 0.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = parser_of("dispatch", __doc__)
    parser.add_argument("--per-s", type=above_zero, default=1000.0)
    parser.add_argument("--seconds", type=above_zero, default=20.0)
    parser.add_argument("--workers", type=whole_number(2), default=8)
    parser.add_argument("--serve", nargs=2, metavar=("WHAT", "ROUTER"), help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.serve:
        _serve(*options.serve)
        return 0
    config = _config(f"tcp/127.0.0.1:{free_port()}")
    with contextlib.ExitStack() as stack:
        router = stack.enter_context(_child("router", config))
        workers = {name: stack.enter_context(_child(name, config)) for name in _names(options.workers)}
        late = [stack.enter_context(_child(f"{LATE}-{n}", config)) for n in (1, 2)]
        dispatcher, told = _send(config, options, workers, lambda: _go_all(late), router.pid)
    _print(dispatcher, told, options)
    return 0


def _names(workers: int) -> list[str]:
    return [f"worker-{n}" for n in range(1, workers + 1)]


def _config(router: str) -> LineConfig:
    return parse_config(
        {"name": "bench", "cameras": {CAMERA: {"path": "x"}}, "link": {"router": router, "lease_ms": LEAST_LEASE_MS}},
        where="benchmark",
    )


def _send(
    config: LineConfig, options: argparse.Namespace, workers: dict[str, Any], join: Any, router: int
) -> tuple[Dispatcher, Told]:
    """Offer views at the asked rate, send what is assigned, take answers; all views are answered or lost at the end."""
    dispatcher = Dispatcher(DispatchSettings(shed_over=None, deadline_s=5.0))
    told, sent_s, works = Told(), dict[str, float](), dict[str, LatestPublisher]()
    names = list(workers)
    events = [
        (0.25, f"{names[0]} is killed", lambda: workers[names[0]].kill()),
        (0.50, f"{names[1]} leaves", lambda: workers[names[1]].send_signal(signal.SIGTERM)),
        (0.75, "two join", join),
    ]
    with Node("segmenter", CAMERA, config=config, run=RUN) as node:
        presence = Presence(node, "regressor")
        answers = ReliableSubscriber(node, topics.WEIGHT, Weight, camera=CAMERA)
        deadline = time.monotonic() + WAIT_S
        while len(presence.names()) < options.workers and time.monotonic() < deadline and not node.stop.is_set():
            node.progress()
            time.sleep(0.05)
        begun, cpu, router_cpu = time.monotonic(), time.process_time(), cpu_s(router)
        offered, seen = 0, presence.names()
        while dispatcher.outstanding or time.monotonic() - begun < options.seconds:
            if node.stop.is_set():  # a signal came: the node has taken it
                sys.exit(128 + signal.SIGTERM)
            now_s = time.monotonic()
            node.progress()
            while events and now_s - begun >= events[0][0] * options.seconds:
                _, what, do = events.pop(0)
                told.changes.append(f"{now_s - begun:.2f} s: {what}")
                do()
            due = int(min(now_s - begun, options.seconds) * options.per_s)
            for n in range(offered, due):
                dispatcher.offer(replace(VIEW, view_id=f"{n}/0", track_id=str(n), seq=n), now_s=now_s)
            offered = due
            while len(answers) and (weight := answers.get(0.0)) is not None:
                if dispatcher.answer(weight.view_id, regressor=weight.regressor, usable=True):
                    told.took_s.append(now_s - sent_s[weight.view_id])
                    told.by_worker[weight.regressor] = told.by_worker.get(weight.regressor, 0) + 1
            if (alive := presence.names()) != seen:
                gone, came = ", ".join(sorted(seen - alive)), ", ".join(sorted(alive - seen))
                told.changes.append(f"{now_s - begun:.2f} s: seen to have {'left ' + gone if gone else 'come ' + came}")
                seen = alive
            dispatcher.present(alive)
            dispatcher.expire(now_s)
            for name, view in dispatcher.assign(now_s):
                sent_s.setdefault(view.view_id, now_s)
                if name not in works:
                    works[name] = LatestPublisher(node, topics.VIEW, regressor=name)
                works[name].put(view)
            if now_s - begun > options.seconds + WAIT_S:
                break
            time.sleep(max(0.0, TURN_S - (time.monotonic() - now_s)))
        told.seconds = time.monotonic() - begun
        told.cpu_ms = 1e3 * (time.process_time() - cpu) / max(offered, 1)
        told.router_cpu_ms = 1e3 * (cpu_s(router) - router_cpu) / max(offered, 1)
    return dispatcher, told


def _print(dispatcher: Dispatcher, told: Told, options: argparse.Namespace) -> None:
    sheet = dispatcher.balance()
    print(
        f"{options.per_s:g} views a second of {len(VIEW.encode()) / 1e3:.1f} kB for {options.seconds:g} s to "
        f"{options.workers} workers; {os.cpu_count()} cores, load average {os.getloadavg()[0]:.1f} at the end.\n"
    )
    print("| views | answered a second | sent to answered ms, p50 and p99 | CPU ms a view: segmenter, router |")
    print("| --- | --- | --- | --- |")
    print(
        f"| {sheet['sent']} = {sheet['weighed']} weighed + {sum(dispatcher.lost.values())} lost | "
        f"{len(told.took_s) / told.seconds:.0f} | {1e3 * percentile(told.took_s, 0.5):.1f}, "
        f"{1e3 * percentile(told.took_s, 0.99):.1f} | {told.cpu_ms:.2f}, {told.router_cpu_ms:.2f} |\n"
    )
    print("Sent again: " + (", ".join(f"{why} {n}" for why, n in dispatcher.requeued.items()) or "none") + ".")
    print("By worker: " + ", ".join(f"{name} {n}" for name, n in sorted(told.by_worker.items())) + ".")
    print("\n".join(f"* {change}" for change in told.changes))


def _serve(what: str, router: str) -> None:
    config = _config(router)
    if what == "router":
        with open_router(config.link):
            print("listens", flush=True)
            signal.sigwait([signal.SIGTERM])
        return
    with Node("regressor", what, config=config, run=RUN, announce=False) as node:
        inbox = LatestSubscriber(node, topics.VIEW, View, capacity=1024, regressor=what)
        answers = ReliablePublisher(node, topics.WEIGHT, camera=CAMERA)
        if what.startswith(LATE):
            sys.stdin.readline()
        node.announce()
        while not node.stop.is_set():
            node.progress()
            if (view := inbox.get(0.2)) is not None:
                answers.put(_answer(view, what))


def _answer(view: View, regressor: str) -> Weight:
    return Weight(
        view.view_id, view.track_id, view.camera, view.run, view.seq, "weighed", 100.0, 90.0, 110.0, "volume", "none",
        (), regressor,
    )  # fmt: skip


def _go_all(children: Sequence[subprocess.Popen[str]]) -> None:
    for child in children:
        assert child.stdin is not None
        child.stdin.write("go\n")
        child.stdin.flush()


@contextlib.contextmanager
def _child(what: str, config: LineConfig) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "benchmarks", "dispatch", "--serve", what, config.link.router]
    child = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[1]
    )
    try:
        if what == "router":
            assert child.stdout is not None
            child.stdout.readline()  # it listens
        yield child
    finally:
        child.kill()
        child.communicate()
