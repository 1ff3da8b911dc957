"""A run's folder as an aggregator leaves it, from tubers that were never filmed: what is written after the cameras.

The entries go through the real core into a real ledger; only what cameras, segmenters and regressors would have said
of each tuber comes from the caller.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aggregator.core.machine import Aggregation
from aggregator.ledger.writer import Ledger
from aggregator.report import Reporter
from conveyor.config import parse_config
from conveyor.counters import CounterSet
from conveyor.messages import Mark, Track, TrackEntry, WeighedView

CAMERA = "left"
SPEED_M_S = 0.8
BATCH = 1000
_VIEW = WeighedView("", 0, 1.0, 1.0, 1.0, "pointraft", "written@0", ())
_TRACK = Track("", 0, 0.0, 0.0, 0.0, False, 29, 0, 28, 70.0, 55.0, 45.0, 100.0, True, 3, (), {})


def write_run(
    folder: Path,
    *,
    run: str,
    crossed_ns: NDArray[np.int64],
    weight_g: NDArray[np.float64],
    sd_share: float = 0.08,
    stopped: bool = False,
    line: str = "line",
    utc_offset_s: int | None = None,
) -> None:
    """Write ledger.db, summary.json and tubers.csv of a finished run of one camera into `folder`.

    A ledger that is there gets one run more.

    Args:
        crossed_ns: (N,) when each tuber crossed, Unix nanoseconds, ascending.
        weight_g: (N,) as weighed; its 90 % interval is `sd_share` wide as a standard deviation.
        stopped: its line was stopped before the camera ended, as a live one is. line: its name.
        utc_offset_s: of its clock, where the ledger is to state it.
    """
    config = parse_config(
        {"name": line, "cameras": {CAMERA: {"path": "x"}}, "aggregator": {"out": str(folder)}}, where="written run"
    )
    folder.mkdir(parents=True, exist_ok=True)
    half = 1.645 * sd_share
    with Ledger(folder / "ledger.db") as ledger:
        begun_ns = int(crossed_ns[0])
        restored = ledger.open_run(
            run, line=line, cameras=(CAMERA,), version="1", started_ns=begun_ns, utc_offset_s=utc_offset_s
        )
        core = Aggregation(
            run,
            cameras=(CAMERA,),
            merge_gate_mm=2.0,
            camera_stall_s=1e9,
            committed=ledger.committed(run),
            now_s=0.0,
            restored=restored,
        )
        for i, (at_ns, grams) in enumerate(zip(crossed_ns.tolist(), weight_g.tolist(), strict=True)):
            core.receive(_entry(run, i, at_ns, int(crossed_ns[0]), grams, half), now_s=0.0)
            if i % BATCH == BATCH - 1:
                ledger.write(run, core.commit(now_s=0.0))
        final = _final(len(crossed_ns), int(crossed_ns[-1]), int(crossed_ns[0]))
        core.receive(TrackEntry(CAMERA, run, len(crossed_ns) + 1, mark=final), now_s=0.0)
        ledger.write(run, core.commit(now_s=0.0))
        reporter = Reporter(ledger, core, config=config, counters=CounterSet())
        if stopped:
            ledger.stopped(run, core.cameras.sights)
        else:
            ledger.finish(run, reporter.summary_text(0.0), sights=core.cameras.sights)
        reporter.write(folder, 0.0)


def _entry(run: str, i: int, at_ns: int, start_ns: int, grams: float, half: float) -> TrackEntry:
    track_id = f"{run}/{CAMERA}/{i}-1"
    low_g, high_g = grams * (1 - half), grams * (1 + half)
    view = replace(_VIEW, view_id=f"{track_id}/0", seq=3 * i, weight_g=grams, low_g=low_g, high_g=high_g)
    travel_m = _travel_m(at_ns, start_ns) + 1e-6 * i
    track = replace(
        _TRACK,
        track_id=track_id,
        crossed_ns=at_ns,
        travel_m=travel_m,
        y_m=0.06 * (i % 9) - 0.24,
        first_seq=3 * i,
        last_seq=3 * i + 28,
        visible_volume_ml=grams / 1.08,
        views=(view,),
    )
    return TrackEntry(CAMERA, run, i + 1, track=track)


def _travel_m(at_ns: int, start_ns: int) -> float:
    return (at_ns - start_ns) / 1e9 * SPEED_M_S + 1.0


def _final(count: int, last_ns: int, start_ns: int) -> Mark:
    travel_m = _travel_m(last_ns, start_ns) + 1.0
    return Mark(
        captured_ns=last_ns + 1_000_000_000,
        travel_m=travel_m,
        travel_estimated=False,
        complete_ns=last_ns + 1_000_000_000,
        complete_place_x_m=-travel_m,
        final=True,
        looked_at_m=travel_m,
        travelled_m=travel_m,
        frames={"published": count, "received": count, "processed": count, "gaps": 0},
        views={},
        tracks={},
    )
