"""The aggregator's work at a thousand tubers a second: processor time and memory per 10,000 tubers, up to 100,000.

    python -m benchmarks aggregate [--tubers 100000] [--per-s 1000]

Two cameras see every tuber, three views each. Their entries are decoded as they come from the wire, applied, committed
and written to a real ledger every 0.05 s of the belt, by the aggregator's own core and writer; totals are asked for
twice a second. All of it in one thread as in the process, without the sockets. At more than 1 ms of processor time a
tuber a core would not carry 1,000 a second.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from aggregator.ledger.writer import Ledger
from aggregator.report import Reporter
from benchmarks.ledger import CAMERAS, RUN, SPACING_M, aggregation, mark_of, track_of
from benchmarks.options import above_zero, parser_of, whole_number
from conveyor.config import parse_config
from conveyor.counters import CounterSet
from conveyor.heap import resident_mib
from conveyor.messages import TrackEntry

COMMIT_S, TOTALS_S = 0.05, 0.5
BLOCKS = 10
CERTAIN = int(0.125 / SPACING_M)
"""Tubers by which marks stay behind the newest track."""


@dataclass(frozen=True, slots=True)
class Block:
    """What the last tenth of the tubers took, each; memory and ledger then."""

    tubers: int
    cpu_ms: float
    wall_ms: float
    memory_mib: float
    ledger_mb: float


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print a table."""
    parser = parser_of("aggregate", __doc__)
    parser.add_argument("--tubers", type=whole_number(1), default=100_000)
    parser.add_argument("--per-s", type=above_zero, default=1000.0)
    parser.add_argument("--out", type=Path, help="the ledger is written here, on the disk to be measured")
    options = parser.parse_args(arguments)
    print(
        "| tubers | CPU ms a tuber | wall ms a tuber | memory MiB | ledger MB |\n| ---: | ---: | ---: | ---: | ---: |"
    )
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=options.out) as folder:
        for block in blocks(Path(folder), options.tubers, per_s=options.per_s):
            print(
                f"| {block.tubers} | {block.cpu_ms:.3f} | {block.wall_ms:.3f} | {block.memory_mib:.0f} | "
                f"{block.ledger_mb:.0f} |",
                flush=True,
            )
    print(f"\nload average {os.getloadavg()[0]:.1f} at the end; {os.cpu_count()} cores.")
    return 0


def blocks(folder: Path, tubers: int, *, per_s: float) -> list[Block]:
    """Run them all; one block per tenth, or per commit where that is more."""
    per_commit = max(1, round(per_s * COMMIT_S))
    config = parse_config(
        {"name": "t", "cameras": {name: {"path": "x"} for name in CAMERAS}, "aggregator": {"out": str(folder)}},
        where="benchmark",
    )
    found: list[Block] = []
    n = dict.fromkeys(CAMERAS, 0)
    with Ledger(folder / "ledger.db") as ledger:
        core = aggregation(ledger)
        reporter = Reporter(ledger, core, config=config, counters=CounterSet())
        every = max(1, round(TOTALS_S / COMMIT_S))
        told, cpu_s, wall_s = 0, 0.0, 0.0
        for turn, first in enumerate(range(0, tubers, per_commit)):
            last = min(first + per_commit, tubers)
            coming, now_s = _coming(first, last, n, end=last == tubers), first / per_s
            cpu_before, wall_before = time.process_time(), time.perf_counter()
            for payload in coming:
                core.receive(TrackEntry.decode(payload), now_s=now_s)
            ledger.write(RUN, core.commit(now_s=now_s))
            if turn % every == 0:
                reporter.totals(now_s)
            cpu_s, wall_s = cpu_s + time.process_time() - cpu_before, wall_s + time.perf_counter() - wall_before
            if last * BLOCKS // tubers > first * BLOCKS // tubers:
                disk = sum(file.stat().st_size for file in folder.iterdir()) / 1e6
                each_ms = 1e3 / (last - told)
                found.append(Block(last, each_ms * cpu_s, each_ms * wall_s, resident_mib() or 0.0, disk))
                told, cpu_s, wall_s = last, 0.0, 0.0
        counted = reporter.totals(tubers / per_s).count
    if counted != tubers:
        raise AssertionError(f"{counted} of {tubers} tubers are in the ledger")
    return found


def _coming(first: int, last: int, n: dict[str, int], *, end: bool) -> list[bytes]:
    """What both cameras send meanwhile: a track each per tuber, and one mark, a little behind."""
    sent: list[bytes] = []
    for tuber in range(first, last):
        for camera in CAMERAS:
            n[camera] += 1
            sent.append(TrackEntry(camera, RUN, n[camera], track=track_of(camera, tuber)).encode())
    for camera in CAMERAS:
        n[camera] += 1
        mark = mark_of(last - 1 if end else max(0, last - 1 - CERTAIN), beyond=end)
        sent.append(TrackEntry(camera, RUN, n[camera], mark=mark).encode())
    return sent
