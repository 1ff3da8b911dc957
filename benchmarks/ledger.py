"""What a ledger of 10^4, 10^5 and 10^6 tubers costs to open, to read a page of, to stop, and to verify whole.

`python -m benchmarks ledger [--tubers 10000 100000 1000000] [--out FOLDER]`. Every tuber is told by two cameras (three
views each), written by the aggregator's own writer in batches of `--batch` tubers. Then the ledger is opened again:
nothing is remembered but what the disk holds; 200 more tubers go through core and ledger, and the process is stopped.
"""

from __future__ import annotations

import gc
import json
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from aggregator.core.camera_log import LoggedEntry
from aggregator.core.machine import Aggregation, Applied, Batch, Observation
from aggregator.core.reasons import Role
from aggregator.core.sight import CameraSight
from aggregator.ledger.check import check_file
from aggregator.ledger.reader import read_tubers, reading
from aggregator.ledger.writer import Ledger
from aggregator.report import Reporter
from benchmarks.options import parser_of, whole_number
from conveyor.config import parse_config
from conveyor.counters import CounterSet
from conveyor.messages import Mark, Track, TrackEntry, Tuber, WeighedView

CAMERAS = ("left", "right")
RUN = "benchmark"
SPACING_M = 0.005
"""Two hundred tubers on a metre of belt: what one layer holds."""

SPEED_MPS = 0.3
TRACKS_A_MARK = 60


def main(arguments: Sequence[str]) -> None:
    """Build, measure, print a table and keep it as JSON."""
    parser = parser_of("ledger", __doc__)
    parser.add_argument("--tubers", type=whole_number(1), nargs="+", default=[10_000, 100_000, 1_000_000])
    parser.add_argument("--batch", type=whole_number(1), default=1000)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--no-check", action="store_true", help="leave the full verification out")
    options = parser.parse_args(arguments)
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
    columns = ("tubers", "MB", "build s", "open s", "totals s", "page s", "batch s", "stop s", "close s", "check s")
    print("| " + " | ".join(columns) + " |\n|" + " ---: |" * len(columns))
    for tubers in options.tubers:
        with tempfile.TemporaryDirectory(dir=options.out) as folder:
            found = measure(Path(folder), tubers, batch=options.batch, check=not options.no_check)
        print(
            "| "
            + " | ".join(f"{found[name]:.3g}" if found[name] < 1000 else f"{found[name]:.0f}" for name in columns)
            + " |"
        )
        if options.out is not None:
            (options.out / f"ledger-{tubers}.json").write_text(json.dumps(found, indent=2) + "\n")


def measure(folder: Path, tubers: int, *, batch: int, check: bool) -> dict[str, float]:
    """Seconds by name, for one size."""
    path = folder / "ledger.db"
    config = parse_config(
        {"name": "t", "cameras": {name: {"path": "x"} for name in CAMERAS}, "aggregator": {"out": str(folder)}},
        where="benchmark",
    )
    found = {"tubers": float(tubers), "build s": build(path, tubers, batch)}
    found["MB"] = path.stat().st_size / 1e6
    gc.collect()
    clock = Clock()
    with Ledger(path) as ledger:
        core = aggregation(ledger)
        reporter = Reporter(ledger, core, config=config, counters=CounterSet())
        found["open s"] = clock.lap()
        assert reporter.totals(0.0).count == tubers, reporter.totals(0.0).count
        clock.lap()
        reporter.totals(0.0)
        found["totals s"] = clock.lap()
        with reading(path) as view:
            assert len(list(read_tubers(view, RUN, since=tubers // 2, limit=1000))) == min(1000, tubers - tubers // 2)
        found["page s"] = clock.lap()
        for entry in entries(tubers, tubers + 200, n0=core.applied()):
            core.receive(entry, now_s=0.0)
        ledger.write(RUN, core.commit(now_s=0.0))
        found["batch s"] = clock.lap()
        reporter.stopped()
        reporter.write(folder, 0.0, in_haste=True)
        found["stop s"] = clock.lap()
    found["close s"] = clock.lap()
    if check:
        assert check_file(path) == []
    found["check s"] = clock.lap() if check else float("nan")
    return found


class Clock:
    """Seconds since it was last asked."""

    def __init__(self) -> None:
        self._since = time.perf_counter()

    def lap(self) -> float:
        """Seconds since the last lap."""
        before, self._since = self._since, time.perf_counter()
        return self._since - before


def aggregation(ledger: Ledger) -> Aggregation:
    """The core, begun or gone on with from the ledger alone."""
    restored = ledger.open_run(RUN, line="t", cameras=CAMERAS, version="1", started_ns=0)
    return Aggregation(
        RUN,
        cameras=CAMERAS,
        merge_gate_mm=2.0,
        camera_stall_s=1e9,
        committed=ledger.committed(RUN),
        now_s=0.0,
        restored=restored,
    )


def build(path: Path, tubers: int, batch: int) -> float:
    """Fill a ledger through its writer with batches as the core makes them; returns the seconds it took."""
    clock, n = Clock(), dict.fromkeys(CAMERAS, 0)
    sights = {camera: CameraSight() for camera in CAMERAS}
    payload = TrackEntry(CAMERAS[0], RUN, 1, track=track_of(CAMERAS[0], 0)).encode()
    with Ledger(path) as ledger:
        aggregation(ledger)
        for first in range(0, tubers, batch):
            last = min(first + batch, tubers)
            ledger.write(RUN, whole_batch(first, last, n, sights, payload))
    return clock.lap()


def whole_batch(first: int, last: int, n: dict[str, int], sights: dict[str, CameraSight], payload: bytes) -> Batch:
    """Tubers `first` to `last`, each seen by both cameras; the tracks' bytes are those of one, the marks their own."""
    entries, tubers, observations = [], [], []
    for at in range(first, last):
        for camera in CAMERAS:
            n[camera] += 1
            track_id = f"{RUN}/{camera}/{at}-1"
            entry = TrackEntry(camera, RUN, n[camera], track=TRACK)
            entries.append(Applied(LoggedEntry(entry, payload), 0.0))
            x_m = -(at + 1) * SPACING_M
            seen = Observation(camera, n[camera], track_id, Role.COUNTED, at + 1, x_m, 0.0, 3 * at, 3 * at + 28)
            observations.append(seen)
        tubers.append(
            replace(
                TUBER,
                tuber_id=at + 1,
                crossed_ns=crossed_ns(at),
                place_x_m=x_m,
                weight_g=100.0 + at % 200,
                tracks=tuple(f"{RUN}/{camera}/{at}-1" for camera in CAMERAS),
            )
        )
        if at % TRACKS_A_MARK == 0 or at == last - 1:
            for camera in CAMERAS:
                n[camera] += 1
                entry = TrackEntry(camera, RUN, n[camera], mark=mark_of(at, beyond=False))
                sights[camera].marked(mark_of(at, beyond=False))
                entries.append(Applied(LoggedEntry(entry, entry.encode()), 0.0))
    return Batch(
        tuple(entries), tuple(tubers), tuple(observations), -last * SPACING_M, settled=dict(n), sights=dict(sights)
    )


def entries(first: int, last: int, *, n0: dict[str, int]) -> Iterator[TrackEntry]:
    """Both cameras' logs, side by side, and a mark beyond the last."""
    n = dict(n0)
    for tuber in range(first, last):
        for camera in CAMERAS:
            n[camera] += 1
            yield TrackEntry(camera, RUN, n[camera], track=track_of(camera, tuber))
    for camera in CAMERAS:
        n[camera] += 1
        yield TrackEntry(camera, RUN, n[camera], mark=mark_of(last - 1, beyond=True))


TUBER = Tuber(
    1, RUN, 0, 0.0, 0.0, 170.0, 155.0, 190.0, 70.0, 55.0, 45.0, 6, "pointraft", "m@0", (), CAMERAS, (),
)  # fmt: skip
VIEW = WeighedView("", 0, 170.0, 150.0, 190.0, "pointraft", "m@0", ())
TRACK = Track("", 0, 0.0, 0.0, 0.0, False, 29, 0, 28, 70.0, 55.0, 45.0, 160.0, True, 3, (), {})


def track_of(camera: str, tuber: int) -> Track:
    """What a camera says of the tuber of that number."""
    track_id = f"{RUN}/{camera}/{tuber}-1"
    travel_m = (tuber + 1) * SPACING_M
    return replace(
        TRACK,
        track_id=track_id,
        crossed_ns=crossed_ns(tuber),
        travel_m=travel_m,
        y_m=0.001 * (tuber % 300),
        first_seq=3 * tuber,
        last_seq=3 * tuber + 28,
        views=tuple(replace(VIEW, view_id=f"{track_id}/{k}", seq=3 * tuber + k) for k in range(3)),
    )


def mark_of(tuber: int, *, beyond: bool) -> Mark:
    """A mark after the tuber of that number; `beyond`: far enough that every tuber so far becomes certain."""
    travel_m = (tuber + 1 + (100 if beyond else 0)) * SPACING_M
    frames = {"published": tuber, "received": tuber, "processed": tuber, "gaps": 0}
    return Mark(
        captured_ns=crossed_ns(tuber + 1),
        travel_m=travel_m,
        travel_estimated=False,
        complete_ns=crossed_ns(tuber),
        complete_place_x_m=-travel_m,
        final=False,
        looked_at_m=travel_m,
        travelled_m=travel_m,
        frames=frames,
        views={},
        tracks={},
    )


def crossed_ns(tuber: int) -> int:
    """When the tuber of that number crossed the centre row."""
    return 1_760_000_000_000_000_000 + round((tuber + 1) * SPACING_M / SPEED_MPS * 1e9)
