"""The same large messages at full speed, by this line's two ways and by dora-rs: what arrives of each, in which order.

    python -m venv DORA && DORA/bin/pip install dora-rs==1.1.0 dora-rs-cli==1.1.0
    python -m benchmarks peers --dora DORA/bin [--messages 100] [--work-ms 20]

Sender and receiver are processes of their own; the receiver takes `--work-ms` for each message, as a segmenter does for
a frame. `live` is a camera that waits for no one, `replay` one that waits for its segmenter's word, both by the socket
between them. dora-rs runs with the queue that it has by itself, and with one as long as there are messages.
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
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

from benchmarks.frames import CAMERA, WAIT_S, End, _depth, _frame
from benchmarks.options import above_zero, parser_of, whole_number
from camera_sim.flow import SendWindow
from conveyor import topics
from conveyor.config import LinkConfig
from conveyor.delivery import KeptPublisher, KeptSubscriber, LatestPublisher, LatestSubscriber
from conveyor.direct import DirectLink
from conveyor.messages import Frame, FrameProgress

WINDOW = 4
RING = 6
SIZE = (1280, 720)
SETTLE_S = 3.0
DORA_SENDER = """\
import time
import numpy as np, pyarrow as pa
from dora import Node
node = Node()
time.sleep(1.0)
data = pa.array(np.random.default_rng(1).integers(0, 255, {size}).astype(np.uint8))
begun = time.monotonic()
for n in range({messages}):
    node.send_output("frame", data, {{"n": n}})
open("sent.json", "w").write(str(time.monotonic() - begun))
time.sleep({stay_s})
"""
DORA_RECEIVER = """\
import json, time
from dora import Node
seen = []
for event in Node():
    if event["type"] == "INPUT":
        seen.append(event["metadata"]["n"])
        time.sleep({work_s})
        open("seen.json", "w").write(json.dumps(seen))
"""
DORA_FLOW = """\
nodes:
  - id: sender
    path: sender.py
    outputs: [frame]
  - id: receiver
    path: receiver.py
    inputs:
      frame:
        source: sender/frame
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Send the messages each way and print a table."""
    parser = parser_of("peers", __doc__)
    parser.add_argument("--messages", type=whole_number(1), default=100)
    parser.add_argument("--work-ms", type=above_zero, default=20.0)
    parser.add_argument("--dora", type=Path, metavar="FOLDER", help="bin folder of an environment with dora-rs")
    parser.add_argument("--receive", nargs=2, metavar=("WAY", "ENDPOINT"), help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.receive:
        way, endpoint = options.receive
        _receive(way, endpoint, options)
        return 0
    rows = [("Tuberline, live", *_ours("live", options)), ("Tuberline, replay", *_ours("replay", options))]
    if options.dora is not None:
        rows += [
            ("dora-rs 1.1.0, its own queue", *_dora(options, queue=None)),
            (f"dora-rs 1.1.0, queue_size {options.messages}", *_dora(options, queue=options.messages)),
        ]
    size_mb = _depth(SIZE).nbytes / 1e6
    print(
        f"{options.messages} messages of {size_mb:.2f} MB, receiver takes {options.work_ms:g} ms for each; "
        f"Python {platform.python_version()}, eclipse-zenoh {version('eclipse-zenoh')}, {os.cpu_count()} cores, "
        f"load average {os.getloadavg()[0]:.1f} at the end.\n"
    )
    print("| way | arrived | out of order | sent in, s |\n| --- | --- | --- | --- |")
    for name, seen, sent_s in rows:
        back = sum(later < earlier for earlier, later in pairwise(seen))
        print(f"| {name} | {len(set(seen))} of {options.messages} | {back} | {sent_s:.2f} |")
    return 0


def _ours(way: str, options: argparse.Namespace) -> tuple[list[int], float]:
    """(numbers in the order of arrival, seconds until all were sent)."""
    with tempfile.TemporaryDirectory(prefix="tuberline-") as folder:
        endpoint = f"unixsock-stream/{folder}/f.sock"
        command = [sys.executable, "-m", "benchmarks", "peers", "--receive", way, endpoint]
        command += ["--messages", str(options.messages), "--work-ms", str(options.work_ms)]
        receiver = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[1])
        try:
            with DirectLink.open(End(None), endpoint, link=LinkConfig(), listens=False) as link:
                sent_s = _send(End(link.session), way, options.messages)
                out, _ = receiver.communicate(timeout=60 + options.messages * options.work_ms / 1000)
        finally:
            receiver.kill()
            receiver.wait()
    return json.loads(out.splitlines()[-1]), sent_s


def _send(end: End, way: str, messages: int) -> float:
    publisher = LatestPublisher(end, topics.FRAME, camera=CAMERA)
    progress = KeptSubscriber(end, topics.FRAME_PROGRESS, FrameProgress, camera=CAMERA)
    window, depth = SendWindow(WINDOW), _depth(SIZE)
    deadline = time.monotonic() + WAIT_S
    while not publisher.has_listener and time.monotonic() < deadline:
        time.sleep(0.01)

    def wait() -> None:
        """As a camera that waits does: take the receiver's word, send again what seems lost."""
        progress.wait(0.05)
        for word in progress.latest().values():
            window.done(word.done_seq, time.monotonic())
        for frame in window.to_resend(time.monotonic()):
            publisher.put(frame)

    begun = time.monotonic()
    for seq in range(messages):
        while way == "replay" and not window.has_room:
            wait()
        frame = _frame(seq, depth)
        publisher.put(frame)
        window.sent(frame, time.monotonic())
    sent_s = time.monotonic() - begun
    while way == "replay" and window.in_flight:
        wait()
    return sent_s


def _receive(way: str, endpoint: str, options: argparse.Namespace) -> None:
    """Print the numbers of what arrived, as JSON, when nothing more comes."""
    seen: list[int] = []
    with DirectLink.open(End(None), endpoint, link=LinkConfig(), listens=True) as link:
        end: Any = End(link.session)
        inbox = LatestSubscriber(end, topics.FRAME, Frame, capacity=RING, camera=CAMERA)
        progress = KeptPublisher(end, topics.FRAME_PROGRESS, camera=CAMERA)
        wait_s, done = WAIT_S, -1
        while len(set(seen)) < options.messages and (frame := inbox.get(wait_s)) is not None:
            wait_s = WAIT_S if way == "replay" else SETTLE_S
            if way == "replay" and frame.seq != done + 1:
                continue  # it follows a lost one, or came twice: what is missing is sent again
            done = frame.seq
            seen.append(done)
            time.sleep(options.work_ms / 1000)
            if way == "replay":
                progress.put(FrameProgress(camera=CAMERA, run="r", done_seq=done, window=WINDOW))
        print(json.dumps(seen), flush=True)
        time.sleep(SETTLE_S)  # for its last word


def _dora(options: argparse.Namespace, *, queue: int | None) -> tuple[list[int], float]:
    with tempfile.TemporaryDirectory(prefix="dora-") as name:
        folder = Path(name)
        stay_s = SETTLE_S + 2 * options.messages * options.work_ms / 1000
        (folder / "sender.py").write_text(
            DORA_SENDER.format(size=_depth(SIZE).nbytes, messages=options.messages, stay_s=stay_s)
        )
        (folder / "receiver.py").write_text(DORA_RECEIVER.format(work_s=options.work_ms / 1000))
        (folder / "flow.yml").write_text(DORA_FLOW + (f"        queue_size: {queue}\n" if queue else ""))
        path = f"{options.dora.resolve()}:{os.environ['PATH']}"
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"PATH": path}
        subprocess.run(
            ["dora", "run", "flow.yml"], cwd=folder, env=environment, check=True, capture_output=True, timeout=180
        )
        return json.loads((folder / "seen.json").read_text()), float((folder / "sent.json").read_text())
