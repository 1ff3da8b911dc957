"""A site on one machine: throughput with 1, 2 and 4 inference hosts, and with one killed and one frozen.

Three camera hosts, an edge host (router, aggregator), inference hosts with the same small share of a core each, and an
office behind 8 Mbit/s and 40 ms that watches. Every host is a network namespace; needs root and some minutes.
"""

from __future__ import annotations

import argparse
import signal
import statistics
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.command import audited, scored, tuberline
from benchmarks.link_wire import LinkSettings
from benchmarks.options import new_file, parser_of, whole_number
from benchmarks.site_line import CAMERAS, SiteLine
from benchmarks.site_net import Network, Traffic
from benchmarks.site_picture import draw_site, site_hosts
from camera_sim.sim.placement import TOUCHING
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import Layout, SceneSettings
from conveyor.logs import setup_logs

SHARE = 0.10
OFFICE_BITS_PER_S = 8e6
OFFICE_DELAY_S = 0.040
CAMERA_HOSTS = tuple(f"camera-{name}" for name in CAMERAS)
MIDDLE = (0.1, 0.9)
"""Throughput is taken between these shares of all weights: neither the first frames nor the last views count."""


@dataclass(frozen=True, slots=True)
class Case:
    """One run: how many inference hosts, and whether two of them fail."""

    inference: int
    disturbed: bool = False
    compress: str = "raw"

    @property
    def name(self) -> str:
        """How the table calls it."""
        return f"{self.inference}, one killed, one frozen" if self.disturbed else str(self.inference)

    @property
    def hosts(self) -> tuple[str, ...]:
        """The inference hosts."""
        return tuple(f"inference-{n}" for n in range(1, self.inference + 1))


@dataclass(frozen=True, slots=True)
class Result:
    """What a run showed. Latency: from a view's passing the router to its weight's, milliseconds."""

    case: Case
    views_per_s: float
    latency_ms: tuple[float, float]
    traffic: Mapping[str, Traffic]
    shares: Mapping[str, int]
    tubers: int
    missed: int
    doubles: int
    views: Mapping[str, int]
    balanced: bool
    ledger: str
    office_s: float
    requeued: int
    cpu_s: Mapping[str, float]
    """CPU seconds by process, from the cameras' start to the end; a camera's own start is in it."""


def main(arguments: list[str]) -> None:
    """Run the cases and print the table."""
    options = _options(arguments)
    setup_logs()
    cases = [Case(n, compress=options.compress) for n in options.hosts]
    if not options.undisturbed:
        cases.append(Case(max(options.hosts), disturbed=True, compress=options.compress))
    with ExitStack() as stack:
        work = Path(options.work or stack.enter_context(tempfile.TemporaryDirectory(prefix="tuberline-site-")))
        recording = make_recording(work, tubers=options.tubers, seed=options.seed)
        results = []
        for n, case in enumerate(cases):
            sys.stderr.write(f"{case.name} inference host(s) ...\n")
            results.append(run_case(case, recording, work / f"run-{n}"))
    sys.stdout.write(tables(results))
    if options.picture:
        options.picture.write_text(picture(results[len(options.hosts) - 1]), encoding="utf-8")


def picture(result: Result) -> str:
    """The site of a run with its bytes."""
    office = f"{OFFICE_BITS_PER_S / 1e6:.0f} Mbit/s, {1000 * OFFICE_DELAY_S:.0f} ms"
    hosts = site_hosts(result.case.inference, share=SHARE, office=office)
    title = f"{result.views_per_s:.0f} views/s, {result.tubers} tubers; bytes of the whole run"
    return draw_site(hosts, result.traffic, title=title)


def make_recording(folder: Path, *, tubers: int, seed: int) -> Path:
    """Three overlapping cameras across one wide belt, 848x480, 15 frames/s; made in `folder` where it is not there."""
    out = folder / f"recording-{seed}-{tubers}"
    if not (out / "truth.json").is_file():
        layout = Layout(
            TOUCHING,
            lanes_m=((-1.0, 1.0),),
            cameras=tuple(
                (name, x, y) for name, x, y in zip(CAMERAS, (0.0, 0.06, 0.0), (-0.66, 0.0, 0.66), strict=True)
            ),
        )
        settings = SceneSettings("three-cameras", seed=seed, tubers=tubers, preset=PRESETS["easy"], fps=15.0)
        record_scene(out, settings, layout=layout)
    return out


def run_case(case: Case, recording: Path, out: Path) -> Result:
    """The site from nothing to its summary, and everything taken down again."""
    with Network() as network:
        for host in ("edge", *CAMERA_HOSTS, *case.hosts):
            network.add(host)
        network.add_far("office", LinkSettings(bits_per_s=OFFICE_BITS_PER_S, delay_s=OFFICE_DELAY_S))
        with SiteLine(network, recording, out, camera={"compress": case.compress}) as line:
            start_all(line, case)
            before = line.traffic(("edge", *CAMERA_HOSTS, *case.hosts, "office"))
            cpu_before = line.cpu_s()
            for host, camera in zip(CAMERA_HOSTS, CAMERAS, strict=True):
                line.start_node(host, "camera", "--camera", camera)
            if case.disturbed:
                disturb(line, case)
            line.wait_finished()
            after = line.traffic(tuple(before))
            cpu_s = {name: used - cpu_before.get(name, 0.0) for name, used in line.cpu_s().items()}
            seen = line.finish_probe()
    traffic = {
        host: Traffic(after[host].sent - before[host].sent, after[host].received - before[host].received)
        for host in before
    }
    return evaluate(case, {**seen, "cpu_s": cpu_s}, traffic, out, recording / "truth.json")


def start_all(line: SiteLine, case: Case) -> None:
    """Everything but the cameras; inference hosts get their share of CPU once they are warm."""
    line.start_probe()
    line.start_node("edge", "aggregator")
    for host, camera in zip(CAMERA_HOSTS, CAMERAS, strict=True):
        line.start_node(host, "segmenter", "--camera", camera)
    line.start("office", "top", "--connect", line.router, "--line", "site", name="top")
    line.start(
        "office",
        "viewer",
        "--config",
        line.config,
        "--profile",
        "light",
        "--rrd",
        line.out / "office.rrd",
        name="viewer",
    )
    for host in case.hosts:
        line.start_node(host, "regressor", "--name", host)
    others = [f"segmenter/{c}" for c in CAMERAS] + ["aggregator/aggregator", "viewer/viewer"]
    line.wait_alive([*others, *(f"regressor/{host}" for host in case.hosts)])
    for host in case.hosts:
        line.limit(f"regressor/{host}", share=SHARE)


def disturb(line: SiteLine, case: Case) -> None:
    """In the midst of it one inference host dies and another one freezes for good."""
    dies, freezes = case.hosts[0], case.hosts[-1]
    line.wait(lambda: line.weights >= 40, what="40 weights", timeout_s=60)
    line.signal(f"regressor/{dies}", signal.SIGKILL)
    line.wait(lambda: line.weights >= 80, what="80 weights", timeout_s=60)
    line.signal(f"regressor/{freezes}", signal.SIGSTOP)


def evaluate(case: Case, seen: Mapping[str, Any], traffic: Mapping[str, Traffic], out: Path, truth: Path) -> Result:
    """Figures of a run, from what the probe saw and from its ledger."""
    passed = seen["passed"]
    low, high = (int(share * (len(passed) - 1)) for share in MIDDLE)
    took_ms = sorted(1e3 * entry["took_s"] for entry in passed)
    score = scored(out, truth)
    audit = audited(out)
    views: dict[str, int] = {}
    for camera in audit["cameras"].values():
        for name, n in camera["views"].items():
            views[name] = views.get(name, 0) + n
    requeued = sum(
        int(value)
        for node in seen["nodes"].values()
        for name, value in node.items()
        if name.startswith("views_requeued_")
    )
    return Result(
        case=case,
        views_per_s=(high - low) / (passed[high]["at_s"] - passed[low]["at_s"]),
        latency_ms=(statistics.median(took_ms), took_ms[int(0.95 * (len(took_ms) - 1))]),
        traffic=traffic,
        shares={host: sum(entry["regressor"] == host for entry in passed) for host in case.hosts},
        tubers=int(score["count"]),
        missed=int(score["missed"]),
        doubles=int(score["double_counted"]),
        views=views,
        balanced=bool(audit["balanced"]),
        ledger=tuberline("ledger", "export", out / "ledger.db", "--canonical"),
        office_s=passed[-1]["at_s"] - passed[0]["at_s"],
        requeued=requeued,
        cpu_s=seen["cpu_s"],
    )


def tables(results: list[Result]) -> str:
    """The tables for docs/scale.md."""
    one = next((r.views_per_s for r in results if r.case.inference == 1), None)
    rows = [
        (
            r.case.name,
            f"{r.views_per_s:.1f}",
            f"{r.views_per_s / one:.2f}x" if one else "-",
            f"{r.latency_ms[0]:.0f} / {r.latency_ms[1]:.0f}",
            " ".join(str(n) for n in r.shares.values()),
            f"{r.tubers} ({r.missed}, {r.doubles})",
            f"{r.views['sent']} = {r.views['weighed']} + {_lost(r)}",
            str(r.requeued),
            "yes" if r.balanced else "NO",
            "equal" if r.ledger == results[0].ledger else "DIFFERENT",
        )
        for r in results
    ]
    head = (
        *("inference hosts", "views/s", "of one", "view to weight, ms (median / p95)", "views by host"),
        *("tubers (missed, double)", "views sent = weighed + lost", "sent again", "balanced", "canonical ledger"),
    )
    links = [
        (
            *(r.case.name, r.case.compress),
            *(_both(r, hosts) for hosts in (CAMERA_HOSTS, ("edge",), r.case.hosts)),
            _office(r),
            " / ".join(f"{_cpu_s(r, role):.1f}" for role in ("camera", "segmenter", "router")),
        )
        for r in results
    ]
    link_head = (
        *("inference hosts", "frames", "camera hosts together", "edge", "inference hosts together", "office"),
        "CPU s of cameras / segmenters / router",
    )
    return f"{_markdown(head, rows)}\n{_markdown(link_head, links)}"


def _lost(result: Result) -> int:
    return sum(n for name, n in result.views.items() if name.startswith("lost_"))


def _cpu_s(result: Result, role: str) -> float:
    return sum(used for name, used in result.cpu_s.items() if name.partition("/")[0] == role)


def _both(result: Result, hosts: tuple[str, ...]) -> str:
    sent = sum(result.traffic[host].sent for host in hosts)
    received = sum(result.traffic[host].received for host in hosts)
    return f"{sent / 1e6:.2f} out, {received / 1e6:.2f} in MB"


def _office(result: Result) -> str:
    received = result.traffic["office"].received
    return f"{received / 1e3:.0f} kB in ({received / 1e3 / result.office_s:.1f} kB/s)"


def _markdown(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    return "".join(f"| {' | '.join(row)} |\n" for row in (head, ("---",) * len(head), *rows))


def _options(arguments: list[str]) -> argparse.Namespace:
    parser = parser_of("site", __doc__)
    parser.add_argument(
        "--hosts", type=whole_number(1), nargs="+", default=[1, 2, 4], help="inference hosts of each run"
    )
    parser.add_argument("--undisturbed", action="store_true", help="leave out the run in which two of them fail")
    parser.add_argument("--tubers", type=whole_number(1), default=48, help="on the simulated belt")
    parser.add_argument("--seed", type=whole_number(0), default=3, help="of the simulated belt")
    parser.add_argument("--work", type=Path, help="folder for recording, ledgers and logs; default: a temporary one")
    parser.add_argument("--compress", choices=("raw", "zstd"), default="raw", help="how frames travel")
    parser.add_argument("--picture", type=new_file, help="SVG of the site to write")
    return parser.parse_args(arguments)
