"""A line watched over 1 Mbit/s, plain and with TLS: does any number change, does any producer wait, what does it take?

    python -m benchmarks link_watchers [--case NAME ...]          # as root, about a minute a case

Host `edge` runs the whole line, its cameras replaying at a fraction of real time, so that not this machine holds them
up. A replay waits for its segmenters and for no one else, so that its ledger says whether anything changed, and a frame
that passes the router late whether a process waited. Host `office` is behind an emulated link; there are `tuberline
watch` (light), `top`, and a recorder, which asks for far more than the link carries.
"""

from __future__ import annotations

import signal
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from benchmarks.command import audited, scored, tuberline
from benchmarks.link import EmulatedLink, why_no_links
from benchmarks.link_wire import Counts, LinkSettings
from benchmarks.options import parser_of, whole_number
from benchmarks.site_line import SiteLine
from benchmarks.site_net import Network
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SceneSettings
from conveyor.errors import TuberlineError

OFFICE = LinkSettings(bits_per_s=1e6, delay_s=0.020)
CAMERAS = ("left", "right")
SPEED = 0.15
FREEZE_AFTER_FRAMES = 10
CATCH_UP_S = 3.0
"""After the line's end: what is still in the link's queue may arrive."""


@dataclass(frozen=True, slots=True)
class Case:
    """Who watches, how, and for how long they stand still."""

    name: str
    watchers: tuple[str, ...] = ()
    protocol: str = "tcp"
    frozen_s: float = 0.0


EVERYBODY = ("watch", "top", "recorder")
CASES = (
    Case("no one"),
    Case("viewer and top", ("watch", "top")),
    Case("viewer, top, recorder", EVERYBODY),
    Case("the same, frozen 15 s", EVERYBODY, frozen_s=15.0),
    Case("viewer and top, TLS", ("watch", "top"), "tls"),
    Case("viewer, top, recorder, TLS, frozen 15 s", EVERYBODY, "tls", frozen_s=15.0),
)


@dataclass(frozen=True, slots=True)
class Watched:
    """What a run showed."""

    ledger: str
    tubers: int
    frames: dict[str, int]
    """The segmenters' balance sheets, summed: published, processed, gaps, dropped by reason."""
    latest_ms: float
    """By how much the latest frame of a camera passed the router after its time, counted from its earliest frame."""
    oldest_ms: float
    """Age of the oldest frame that was processed."""
    office_kb_per_s: tuple[float, float]
    """Bytes towards the office: mean and the most in one second."""
    queue_dropped: int
    nodes: dict[str, dict[str, float]]


def main(arguments: list[str]) -> None:
    """Run the cases and print the table; exits with 1 where a ledger differs."""
    parser = parser_of("link_watchers", __doc__)
    parser.add_argument("--case", nargs="*", default=[case.name for case in CASES], choices=[c.name for c in CASES])
    parser.add_argument("--tubers", type=whole_number(1), default=24)
    parser.add_argument("--out", type=Path, help="keep recording, ledgers and logs here")
    options = parser.parse_args(arguments)
    if reason := why_no_links():
        raise TuberlineError(f"no slow link can be made here: {reason}")
    with tempfile.TemporaryDirectory(prefix="tuberline-watchers-") as folder:
        work = options.out or Path(folder)
        recording = make_recording(work, tubers=options.tubers)
        calm, differs = "", 0
        print(HEAD, flush=True)
        for n, case in enumerate(case for case in CASES if case.name in options.case or not case.watchers):
            seen = watched(recording, work / f"run-{n}", case)
            calm = calm or seen.ledger
            differs += seen.ledger != calm
            print(row(case, seen, equal=seen.ledger == calm), flush=True)
    if differs:
        sys.exit(1)


def make_recording(folder: Path, *, tubers: int) -> Path:
    """Two cameras over one belt, 848x480, 15 frames/s; made in `folder` where it is not there."""
    out = folder / f"recording-{tubers}"
    if not (out / "truth.json").is_file():
        settings = SceneSettings("two-cameras", seed=11, tubers=tubers, preset=PRESETS["easy"], fps=15.0)
        record_scene(out, settings)
    return out


def watched(recording: Path, out: Path, case: Case) -> Watched:
    """One run of the line with its watchers behind the slow link."""
    certs = out.parent / f"{out.name}-certs"
    settings: dict[str, dict[str, Any]] = {
        # This machine's own pauses must not cost a frame, or runs could not be compared.
        "segmenter": {"views_per_tuber": 3, "max_age_ms": 60_000.0, "ring": 64},
        "regressor": {"processes": 2},
    }
    if case.protocol == "tls":
        settings |= {"link": {"certs": str(certs)}, "access": {"enabled": True}}
    with Network() as network:
        network.add("edge")
        link = network.add_far("office", OFFICE)
        line = SiteLine(
            network, recording, out, cameras=CAMERAS, protocol=case.protocol, settings=settings,
            camera={"speed": SPEED, "compress": "zstd"},
        )  # fmt: skip
        if case.protocol == "tls":
            tuberline("certs", "make", line.config)
        with line:
            _start_all(line, case)
            with LinkMeter(link) as meter:
                for camera in CAMERAS:
                    line.start_node("edge", "camera", "--camera", camera)
                if case.frozen_s:
                    line.wait(lambda: line.seen("frames") >= FREEZE_AFTER_FRAMES, what="frames", timeout_s=60)
                    _freeze(line, case)
                line.wait_finished(timeout_s=300.0)
            time.sleep(CATCH_UP_S if case.watchers else 0.0)
            probe = line.finish_probe()
            counts = link.counts()
    return _evaluate(probe, meter, counts, out, recording)


def _start_all(line: SiteLine, case: Case) -> None:
    line.start_probe("benchmarks.link_probe", str(line.config))
    line.start_node("edge", "aggregator")
    for name in ("r1", "r2"):
        line.start_node("edge", "regressor", "--name", name)
    for camera in CAMERAS:
        line.start_node("edge", "segmenter", "--camera", camera)
    recorded = line.out / "office.mcap"
    commands: dict[str, tuple[str | Path, ...]] = {
        "watch": ("watch", line.router, "--config", line.config, "--web"),
        "top": ("top", "--config", line.config),
        "recorder": ("recorder", "--config", line.config, "--run", "bench", "--out", recorded),
    }
    for name in case.watchers:
        line.start("office", *commands[name], name=name)
    ready = [f"segmenter/{camera}" for camera in CAMERAS] + ["regressor/r1", "regressor/r2", "aggregator/aggregator"]
    ready += ["recorder/recorder"] if "recorder" in case.watchers else []
    line.wait_alive(ready, timeout_s=240.0)
    if "watch" in case.watchers:
        line.wait(lambda: line.is_alive("viewer/watch-"), what="the viewer", timeout_s=120.0)


def _freeze(line: SiteLine, case: Case) -> None:
    """All watchers stand still for a while; the line does not."""
    for number in (signal.SIGSTOP, signal.SIGCONT):
        for name in case.watchers:
            line.signal(name, number)
        if number == signal.SIGSTOP:
            time.sleep(case.frozen_s)


class LinkMeter:
    """Bytes towards the office, second by second, while the `with` block lasts."""

    def __init__(self, link: EmulatedLink) -> None:
        self._link = link
        self._stop = threading.Event()
        self._seen: list[tuple[float, int]] = []
        self._thread = threading.Thread(target=self._measure, name="link-meter", daemon=True)

    def __enter__(self) -> LinkMeter:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def kb_per_s(self) -> tuple[float, float]:
        """Mean, and the most between two readings."""
        rates = [(b[1] - a[1]) / 1e3 / (b[0] - a[0]) for a, b in pairwise(self._seen) if b[0] - a[0] > 0.5]
        (begun_s, before), (ended_s, after) = self._seen[0], self._seen[-1]
        return (after - before) / 1e3 / max(ended_s - begun_s, 1.0), max(rates, default=0.0)

    def _measure(self) -> None:
        while True:
            self._seen.append((time.monotonic(), self._link.counts()[1].forwarded_bytes))
            if self._stop.wait(1.0):
                return


def _evaluate(
    probe: dict[str, Any],
    meter: LinkMeter,
    counts: tuple[Counts, Counts],
    out: Path,
    recording: Path,
) -> Watched:
    audit = audited(out)
    frames: dict[str, int] = {}
    for sheet in audit["cameras"].values():
        for name, n in sheet["frames"].items():
            frames[name] = frames.get(name, 0) + n
    step_s = 1 / (15.0 * SPEED)
    late_s = [
        max(at_s - n * step_s for n, at_s in enumerate(passed_s))
        - min(at_s - n * step_s for n, at_s in enumerate(passed_s))
        for passed_s in probe["passed_s"].values()
    ]
    nodes = probe["nodes"]
    return Watched(
        ledger=tuberline("ledger", "export", out / "ledger.db", "--canonical"),
        tubers=int(scored(out, recording / "truth.json")["count"]),
        frames=frames,
        latest_ms=1e3 * max(late_s),
        oldest_ms=max(node.get("frame_age_max_ms", 0.0) for node in nodes.values()),
        office_kb_per_s=meter.kb_per_s(),
        queue_dropped=counts[1].lost_queue,
        nodes=nodes,
    )


HEAD = (
    "| watchers in the office | frames processed of published | latest frame ms | oldest processed ms | kB/s to the "
    "office (most in 1 s) | packets the link's queue dropped | recorder got | ledger |\n" + "| --- " * 8 + "|"
)


def row(case: Case, seen: Watched, *, equal: bool) -> str:
    """The case's line of the table."""
    recorder = seen.nodes.get("recorder/recorder", {})
    cells = (
        case.name,
        f"{seen.frames['processed']} of {seen.frames['published']}",
        f"{seen.latest_ms:.0f}",
        f"{seen.oldest_ms:.0f}",
        f"{seen.office_kb_per_s[0]:.1f} ({seen.office_kb_per_s[1]:.1f})",
        str(seen.queue_dropped),
        f"{recorder.get('frames_written', 0):.0f} frames" if recorder else "-",
        "equal" if equal else "DIFFERS",
    )
    return f"| {' | '.join(cells)} |"
