"""A recording through the code of the whole line in one process: what the nodes run, without sockets between them.

`CameraRun` with its dispatcher and log, `Weigher`, `Aggregation`: the same objects with the same embedded defaults as
`tuberline replay`, which gives the same ledger (`python -m benchmarks perception --graph` compares the two).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from aggregator.calibration.correction import prior_told
from aggregator.core.committed import CommittedTuber
from aggregator.core.coverage import Moment, coverage
from aggregator.core.load_sums import LoadSums
from aggregator.core.machine import Aggregation
from aggregator.core.totals import LoadTotals
from aggregator.ledger.stated import told_belt
from aggregator.scoring.score import Score, score_tubers
from aggregator.scoring.truth import read_truth
from conveyor.config import LineConfig, parse_config
from conveyor.errors import TuberlineError
from conveyor.formats import camera_names, open_source
from conveyor.messages import Frame, Totals, Tuber
from regressor.weigh.weigher import Weigher, weigh_view
from segmenter.camera_run import CameraRun
from segmenter.first_look import look_first
from segmenter.setup import run_settings
from segmenter.warmup import warm_up
from tuberline.replayer import stated_belt

RUN = "perception"
WORKER = "inline"


@dataclass(frozen=True, slots=True)
class LineResult:
    """What a recording led to.

    Attributes:
        discarded: tracks that were not counted, by reason, all cameras together.
        belt_off_mm: by camera, the belt as the last check saw it less the belt as given; missing where none was seen.
        outline_lost_px: by camera, what is missing of outlines, pixels; below 0 they have grown; missing where too few
            tubers told.
        totals: of the load, as the ledger's summary has them before any ticket.
    """

    tubers: tuple[Tuber, ...]
    coverage: float | None
    estimated: bool
    discarded: dict[str, int]
    belt_off_mm: dict[str, float]
    outline_lost_px: dict[str, float]
    totals: Totals

    def score(self, truth: Path) -> Score:
        """Against truth.json, as `tuberline score` does it."""
        return score_tubers(
            self.tubers, read_truth(truth), match_mm=25.0, travel_estimated=self.estimated, coverage=self.coverage
        )


class _NothingCommitted:
    """One batch at the end: no track can come late."""

    def near(self, low_x_m: float, high_x_m: float) -> Sequence[CommittedTuber]:
        return ()

    def entry_checksum(self, camera: str, n: int) -> int | None:
        return None

    def knows_track(self, track_id: str) -> bool:
        return False


def run_line(recording: Path, weigher: Weigher, *, belt_follow_mm: float | None = None) -> LineResult:
    """Count and weigh everything in `recording`; its masks are not used.

    Args:
        belt_follow_mm: as in the config; None is the default there.

    Raises:
        TuberlineError: a recording that cannot be used.
    """
    names = camera_names(recording)
    cameras = {name: {"path": str(recording), "ignore_masks": True} for name in names}
    segmenter = {"look_first": True} | ({} if belt_follow_mm is None else {"belt_follow_mm": belt_follow_mm})
    belt = stated_belt(open_source(recording, camera=name).description for name in names)
    config = parse_config({"cameras": cameras, "segmenter": segmenter, "belt": belt}, where="of the benchmark")
    warm_up(config.segmenter.pixel_mm)
    line = Aggregation(
        RUN,
        cameras=names,
        merge_gate_mm=config.aggregator.merge_gate_mm,
        camera_stall_s=config.aggregator.camera_stall_s,
        committed=_NothingCommitted(),
        now_s=0.0,
    )
    discarded: Counter[str] = Counter()
    belt_off_mm: dict[str, float] = {}
    outline_lost_px: dict[str, float] = {}
    estimated = False
    for name in names:
        camera = _run_camera(recording, name, config, weigher, line)
        mark = camera.log.last_mark
        estimated |= mark is not None and mark.travel_estimated
        discarded.update({str(reason): n for reason, n in camera.core.discarded.items()})
        if (drift_m := camera.core.belt_check.drift_m) is not None:
            belt_off_mm[name] = 1000 * drift_m
        if (reading := camera.core.outlines) is not None:
            outline_lost_px[name] = reading.lost_px
    batch = line.commit(now_s=0.0)
    if not line.finished:
        raise TuberlineError(f"{recording}: {line.pending} tracks are still pending after the last frame")
    seen_by = Counter(frozenset(tuber.cameras) for tuber in batch.tubers)
    seen = coverage(line.cameras.sights, seen_by=seen_by, moment=Moment(over=True))
    sums = LoadSums(config.aggregator.histogram_step_g)
    for tuber in batch.tubers:
        sums.add(tuber)
    totals = LoadTotals(sums, prior=prior_told(told_belt(config))).message(
        RUN, coverage=seen.share, cameras={}, final=True, belt_m=seen.belt_m
    )
    reasons = dict(sorted(discarded.items()))
    return LineResult(batch.tubers, seen.share, estimated, reasons, belt_off_mm, outline_lost_px, totals)


def _run_camera(recording: Path, name: str, config: LineConfig, weigher: Weigher, line: Aggregation) -> CameraRun:
    look = look_first(config, name)
    camera = CameraRun(name, RUN, run_settings(config, name), None, known=look.known if look else None)
    for frame in open_source(recording, camera=name, ignore_masks=True).frames(run=RUN):
        if isinstance(frame, Frame):
            camera.frame(frame, 0.0)
            _serve(camera, weigher, line)
    camera.end(0.0)
    _serve(camera, weigher, line)
    return camera


def _serve(camera: CameraRun, weigher: Weigher, line: Aggregation) -> None:
    """Weigh what is to be weighed, then hand on what the log holds."""
    while views := camera.tick(0.0, {WORKER}):
        for _, view in views:
            camera.weight(weigh_view(weigher, view, regressor=WORKER))
    camera.tick(0.0, {WORKER})
    for entry in camera.log.due(0.0):
        line.receive(entry, now_s=0.0)
        camera.log.commit(entry.n)
