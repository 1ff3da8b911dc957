"""Frames of many cameras through one router, each camera's host behind a link of its own: what arrives, and when.

    python -m benchmarks site_frames                                    # 3 hosts behind 100 Mbit/s, 30 frames/s, zstd
    python -m benchmarks site_frames --hosts 10 --mbit 0 --size 424x240 --codec raw    # ten cameras with small frames

As root. Every host is a network namespace on a switch; the router and who listens to all frames run on one more. Frames
are simulated ones (preset `field`, seed 1), cut to `--size`, sent by the camera's own publisher at an even pace.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.frames import End
from benchmarks.line_watch import percentile
from benchmarks.options import above_zero, parser_of, pixels, whole_number
from benchmarks.proc import cpu_s
from benchmarks.site_codecs import first_frames
from benchmarks.site_net import Network
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SceneSettings
from conveyor import topics
from conveyor.config import LinkConfig
from conveyor.delivery import LatestPublisher, LatestSubscriber
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame
from conveyor.session import open_client, open_router

EDGE = "edge"
PORT = 7447
WAIT_S = 120.0
SETTLE_S = 2.0
SIMULATED = (848, 480)


def main(arguments: Sequence[str] | None = None) -> int:
    """Lay out the hosts, send, and print the table."""
    parser = parser_of("site_frames", __doc__)
    parser.add_argument("--hosts", type=whole_number(1), default=3)
    parser.add_argument("--mbit", type=float, default=100.0, help="of each host's link, each way; 0: no limit")
    parser.add_argument("--per-s", type=above_zero, default=30.0)
    parser.add_argument("--seconds", type=above_zero, default=10.0)
    parser.add_argument("--size", type=pixels, default=SIMULATED, help="cut to so many pixels, 848x480 at most")
    parser.add_argument("--codec", choices=("raw", "zstd"), default="zstd")
    parser.add_argument("--part", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.part:
        {"route": _route, "receive": _receive, "send": _send}[options.part[0]](options.part[1:], options)
        return 0
    if options.size[0] > SIMULATED[0] or options.size[1] > SIMULATED[1]:
        parser.error("argument --size: what is simulated has 848x480 pixels; give no more")
    with tempfile.TemporaryDirectory(prefix="tuberline-frames-") as folder:
        record_scene(Path(folder) / "belt", SceneSettings("touching", 1, 6, PRESETS["field"], unit_m=0.001))
        _measure(Path(folder) / "belt", options)
    return 0


def _measure(belt: Path, options: argparse.Namespace) -> None:
    cameras = [f"camera-{n}" for n in range(1, options.hosts + 1)]
    with Network() as net, ExitStack() as stack:
        for host in (EDGE, *cameras):
            net.add(host)
            if host != EDGE and options.mbit:
                net.limit(host, options.mbit)
        address = f"tcp/{net.address(EDGE)}:{PORT}"

        def start(host: str, *part: str) -> subprocess.Popen[str]:
            command = [sys.executable, "-m", "benchmarks", "site_frames", "--per-s", str(options.per_s)]
            command += [
                "--seconds",
                str(options.seconds),
                "--size",
                f"{options.size[0]}x{options.size[1]}",
                "--codec",
                options.codec,
            ]
            child = subprocess.Popen(
                net.command(host, [*command, "--part", *part]),
                stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[1],
            )  # fmt: skip
            stack.callback(child.wait)
            stack.callback(child.kill)
            return child

        router = start(EDGE, "route", address)
        assert router.stdout is not None
        router.stdout.readline()  # it listens
        started_s = cpu_s(router.pid)
        receiver = start(EDGE, "receive", address, str(len(cameras)))
        begins_s = time.monotonic() + 3.0 + len(cameras)
        senders = {name: start(name, "send", address, name, str(belt), str(begins_s)) for name in cameras}
        sent = {name: json.loads(sender.communicate()[0].splitlines()[-1]) for name, sender in senders.items()}
        mbits = {name: 8 * net.traffic(name).sent / 1e6 / options.seconds for name in cameras}
        came = json.loads(receiver.communicate(timeout=WAIT_S)[0].splitlines()[-1])
        _tell(sent, came, mbits, 1e3 * (cpu_s(router.pid) - started_s), options)


def _tell(
    sent: dict[str, Any], came: dict[str, Any], mbits: dict[str, float], router_ms: float, options: argparse.Namespace
) -> None:
    frames = sum(len(ms) for ms in came["ms"].values())
    limit = f"{options.mbit:g} Mbit/s" if options.mbit else "no limit"
    width, height = options.size
    print(
        f"{options.hosts} hosts, {limit} each, {options.per_s:g} frames/s of {width}x{height}, {options.codec}, "
        f"{options.seconds:g} s; {os.cpu_count()} cores {platform.machine()}, Python {platform.python_version()}, "
        f"eclipse-zenoh {version('eclipse-zenoh')}, load average {os.getloadavg()[0]:.1f} at the end.\n"
    )
    print("| camera | arrived of sent | p50 ms | p99 ms | Mbit/s out | CPU ms a frame, packing too |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name, said in sent.items():
        ms = came["ms"].get(name, [])
        times = f"{percentile(ms, 0.5):.1f} | {percentile(ms, 0.99):.1f}" if ms else "- | -"
        print(f"| {name} | {len(ms)} of {said['sent']} | {times} | {mbits[name]:.1f} | {said['cpu_ms']:.1f} |")
    each = max(1, frames)
    print(f"\nRouter {router_ms / each:.2f} ms of CPU a frame; receiver {came['cpu_ms'] / each:.2f}.")


def _cut(frame: Frame, size: tuple[int, int]) -> Frame:
    width, height = size
    k = frame.intrinsics
    intrinsics = Intrinsics(width, height, k.fx, k.fy, min(k.cx, width / 2), min(k.cy, height / 2))
    depth = np.ascontiguousarray(frame.depth[:height, :width])
    return replace(frame, intrinsics=intrinsics, depth=depth, mask=None, color_jpeg=None)


def _send(part: list[str], options: argparse.Namespace) -> None:
    """Frames at an even pace from `begins_s` of the monotonic clock on, which all namespaces share."""
    address, name, belt, begins_s = part[0], part[1], Path(part[2]), float(part[3])
    frames = [replace(_cut(frame, options.size), camera=name) for frame in first_frames(belt)]
    with open_client(LinkConfig(router=address), name=name) as session:
        publisher = LatestPublisher(End(session), topics.FRAME, camera=name)
        deadline_s = time.monotonic() + WAIT_S
        while not publisher.has_listener and time.monotonic() < deadline_s:
            time.sleep(0.05)
        begins_s, before_s = max(begins_s, time.monotonic()), time.process_time()
        count = max(1, round(options.seconds * options.per_s))
        for seq in range(count):
            time.sleep(max(0.0, begins_s + seq / options.per_s - time.monotonic()))
            frame = replace(frames[seq % len(frames)], seq=seq, captured_ns=time.monotonic_ns())
            publisher.put(frame, codec=options.codec)
        used_s = time.process_time() - before_s
        time.sleep(SETTLE_S)
    print(json.dumps({"sent": count, "cpu_ms": 1e3 * used_s / count}), flush=True)


def _receive(part: list[str], options: argparse.Namespace) -> None:
    """Milliseconds of all frames, by camera, until none comes any more."""
    address, cameras = part[0], int(part[1])
    ms: dict[str, list[float]] = {}
    with open_client(LinkConfig(router=address), name="listener") as session:
        inbox = LatestSubscriber(End(session), topics.FRAME, Frame, capacity=6 * cameras, camera="*")
        wait_s, before_s = WAIT_S, time.process_time()
        while (frame := inbox.get(wait_s)) is not None:
            wait_s = SETTLE_S
            ms.setdefault(frame.camera, []).append((time.monotonic_ns() - frame.captured_ns) / 1e6)
    print(json.dumps({"ms": ms, "cpu_ms": 1e3 * (time.process_time() - before_s)}), flush=True)


def _route(part: list[str], options: argparse.Namespace) -> None:
    with open_router(LinkConfig(router=part[0])):
        print("listens", flush=True)
        time.sleep(3600)
