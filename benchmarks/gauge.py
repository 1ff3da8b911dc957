"""A gauge in view: is a mount that moved told from a depth scale that drifted, and what is left of a load's bias?

Simulated cameras look at belts with a gauge; then the camera is moved by up to 6 mm or its disparity shifted by up to
0.4 px, either way. The segmenter's own estimate names the cause (`causes`), and in some of the worlds whole loads pass
the segmenter and are weighed with the shipped weights: undisturbed, disturbed without a gauge, and with it (`loads`).
Frames are rendered in this process; there is no line of processes around it. Seeds were fixed before anything was run.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.figures_in_docs import put_table
from benchmarks.gauge_worlds import Disturbed, GaugeWorld, gauge_world
from benchmarks.options import new_file, page_with, parser_of, whole_number
from conveyor.gauge import GaugeKind
from conveyor.messages import Frame
from conveyor.resting import RestingLevel
from regressor.weigh.weigher import Weigher, weigh_view
from segmenter.belt_segmenter import Settings
from segmenter.gauge.estimate import REFERENCE_LOOKS, Cause, GaugeReading
from segmenter.gauge.keeper import GaugeKeeper
from segmenter.perception import PerceptionSettings
from segmenter.pipeline import Segmenter
from segmenter.results import ClosedTrack

KINDS: tuple[GaugeKind, ...] = ("rods", "belt-width", "bar")
SEED = 5300
MOST_SHIFT_M, MOST_DRIFT_PX = 0.006, 0.4
LOOKS_AFTER = 40
SMALL_SHIFT_M, SMALL_DRIFT_PX = 0.0015, 0.06
"""Of less, 'none' is as right as its name."""
TUBERS = 16
SAME_M = 0.015
"""A tuber that lies this close to where one lay is the same."""
PRESETS = ("field", "harsh")


@dataclass(frozen=True, slots=True)
class CauseRow:
    """One world: what befell the camera, and what the gauge said."""

    kind: str
    seed: int
    preset: str
    shift_mm: float
    drift_px: float
    said: str
    said_shift_mm: float
    said_drift_px: float
    right: bool


@dataclass(frozen=True, slots=True)
class LoadRow:
    """One load: its bias against the undisturbed camera, percent, without a gauge and with it."""

    kind: str
    seed: int
    shift_mm: float
    drift_px: float
    tubers: int
    without_percent: float
    with_percent: float


def disturbance(seed: int) -> Disturbed:
    """Nine of twenty worlds drift, nine are moved, two are left alone."""
    rng = np.random.default_rng([seed, 172])
    sign = 1.0 if rng.random() < 0.5 else -1.0
    share = float(rng.random())
    return {
        0: Disturbed(drift_px=sign * share * MOST_DRIFT_PX),
        1: Disturbed(shift_m=sign * share * MOST_SHIFT_M),
        2: Disturbed(),
    }[int(np.searchsorted([0.45, 0.9], rng.random(), side="right"))]


def looked(world: GaugeWorld, by: Disturbed) -> GaugeKeeper:
    """The gauge's keeper after the looks of a run's beginning, undisturbed, and some after the disturbance."""
    keeper = GaugeKeeper(world.gauge)
    for disturbed, first, count in ((Disturbed(), 0, REFERENCE_LOOKS), (by, REFERENCE_LOOKS, LOOKS_AFTER)):
        source = world.source(disturbed)
        for n in range(first, first + count):
            keeper.look(source.frame(n, run="gauge"))
    return keeper


def is_right(by: Disturbed, said: Cause) -> bool:
    """The gauge named what befell the camera; of what is small, nothing is right too."""
    if by.shift_m == 0 and by.drift_px == 0:
        return said is Cause.NONE
    small = abs(by.shift_m) < SMALL_SHIFT_M and abs(by.drift_px) < SMALL_DRIFT_PX
    return said is (Cause.MOUNT if by.shift_m else Cause.DRIFT) or (small and said is Cause.NONE)


def causes(kind: GaugeKind, seeds: range) -> Iterator[CauseRow]:
    """A row for each seed."""
    for seed in seeds:
        preset = PRESETS[seed % len(PRESETS)]
        by = disturbance(seed)
        reading = looked(gauge_world(kind, seed, preset=preset, tubers=4), by).reading
        yield _cause_row(kind, seed, preset, by, reading)


def _cause_row(kind: str, seed: int, preset: str, by: Disturbed, reading: GaugeReading | None) -> CauseRow:
    said = "not seen" if reading is None else reading.cause.value
    return CauseRow(
        kind=kind,
        seed=seed,
        preset=preset,
        shift_mm=round(1000 * by.shift_m, 2),
        drift_px=round(by.drift_px, 3),
        said=said,
        said_shift_mm=0.0 if reading is None else round(1000 * reading.shift_m, 2),
        said_drift_px=0.0 if reading is None else round(reading.drift_px, 3),
        right=reading is not None and is_right(by, reading.cause),
    )


def loads(kind: GaugeKind, seeds: range, *, tubers: int = TUBERS) -> Iterator[LoadRow]:
    """A row for each seed: half of them drift, half are moved, by half of the most at least."""
    weigher = Weigher.load()
    for n, seed in enumerate(seeds):
        rng = np.random.default_rng([seed, 173])
        share = float(rng.uniform(0.5, 1.0)) * (1.0 if rng.random() < 0.5 else -1.0)
        by = Disturbed(drift_px=share * MOST_DRIFT_PX) if n % 2 == 0 else Disturbed(shift_m=share * MOST_SHIFT_M)
        world = gauge_world(kind, seed, preset="field", tubers=tubers)
        right, wrong = (all_frames(world, one) for one in (Disturbed(), by))
        keeper = GaugeKeeper(world.gauge)
        for frames, looks in ((right, REFERENCE_LOOKS), (wrong, LOOKS_AFTER)):
            for at in np.linspace(0, len(frames) - 1, looks).round().astype(int):
                keeper.look(frames[at])
        settings = settings_of(world)
        gauged = Segmenter(settings)
        gauged.gauge = keeper
        before, _ = weighed(Segmenter(settings), right, weigher)
        without, _ = weighed(Segmenter(settings), wrong, weigher)
        with_gauge, _ = weighed(gauged, wrong, weigher)
        true_g, without_g, with_g = matched(before, without, with_gauge).sum(axis=0)
        yield LoadRow(
            kind=kind,
            seed=seed,
            shift_mm=round(1000 * by.shift_m, 2),
            drift_px=round(by.drift_px, 3),
            tubers=len(before),
            without_percent=round(float(100 * (without_g / true_g - 1)), 2),
            with_percent=round(float(100 * (with_g / true_g - 1)), 2),
        )


def all_frames(world: GaugeWorld, by: Disturbed) -> list[Frame]:
    """All frames of the world's camera."""
    return [item for item in world.source(by).frames(run="load") if isinstance(item, Frame)]


def weighed(
    segmenter: Segmenter, frames: Sequence[Frame], weigher: Weigher
) -> tuple[NDArray[np.float64], list[ClosedTrack]]:
    """((n, 3) place on the belt, x and y in metres, and weight in grams, of each tuber that counted, in their order;
    the tracks).
    """
    closed: list[ClosedTrack] = []
    for item in frames:
        closed += segmenter.step(item).closed
    closed += segmenter.finish()
    found = []
    for track in closed:
        grams = [weigh_view(weigher, view, regressor="bench").weight_g for view in track.views]
        known = [g for g in grams if g is not None]
        if known:
            found.append((track.track.place_x_m, track.track.y_m, float(np.mean(known))))
    return np.array(found).reshape(-1, 3), closed


def settings_of(world: GaugeWorld, *, scale_by_travel: bool = False) -> Settings:
    """Of a segmenter that counts everything; on rods the line says so, with their pitch and diameter."""
    gauge = world.gauge
    resting = RestingLevel()
    if gauge.kind == "rods":
        resting = RestingLevel(surface="rods", rod_pitch_m=gauge.pitch_m, rod_diameter_m=gauge.rod_m)
    perception = PerceptionSettings(method="classical")
    return Settings(perception=perception, resting=resting, scale_by_travel=scale_by_travel)


def matched(*runs: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, runs) weights of the tubers that all runs have; places and weights as `weighed` gives them."""
    rows = []
    for tuber in runs[0]:
        apart = [np.hypot(*(run[:, :2] - tuber[:2]).T) for run in runs]
        if all(len(far) and far.min() < SAME_M for far in apart):
            rows.append([run[far.argmin(), 2] for run, far in zip(runs, apart, strict=True)])
    return np.array(rows).reshape(-1, len(runs))


def table(cause_rows: list[CauseRow], load_rows: list[LoadRow]) -> str:
    """For the page."""
    lines = [
        "| gauge | worlds | cause right | shift, rms error mm | drift, rms error px "
        "| loads | error of a load %, no gauge: rms, worst | with gauge: mean, rms, worst |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for kind in (*KINDS, "all"):
        rows = [row for row in cause_rows if kind in (row.kind, "all")]
        of_loads = [row for row in load_rows if kind in (row.kind, "all")]
        if not rows:
            continue
        right = sum(row.right for row in rows)
        shift = _rms([row.said_shift_mm - row.shift_mm for row in rows])
        drift = _rms([row.said_drift_px - row.drift_px for row in rows])
        without = [row.without_percent for row in of_loads]
        corrected = [row.with_percent for row in of_loads]
        lines.append(
            f"| {kind} | {len(rows)} | {right} | {shift:.2f} | {drift:.3f} | {len(of_loads)} "
            f"| {_spread(without)} | {f'{np.mean(corrected):+.2f}, ' if corrected else ''}{_spread(corrected)} |"
        )
    return "\n".join(lines)


def _spread(percents: list[float]) -> str:
    return f"{_rms(percents):.2f}, {max(percents, key=abs):+.2f}" if percents else "-"


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _save(path: Path | None, cause_rows: list[CauseRow], load_rows: list[LoadRow]) -> None:
    if path is not None:
        report = {"causes": [asdict(row) for row in cause_rows], "loads": [asdict(row) for row in load_rows]}
        path.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


def main(arguments: list[str]) -> None:
    """Command line."""
    parser = parser_of("gauge", __doc__)
    parser.add_argument("--worlds", type=whole_number(1), default=24, help="of each gauge, for the causes")
    parser.add_argument("--loads", type=whole_number(0), default=4, help="of each gauge")
    parser.add_argument("--tubers", type=whole_number(1), default=TUBERS, help="of each load")
    parser.add_argument("--seed", type=whole_number(0), default=SEED)
    parser.add_argument("--only", choices=KINDS, help="one gauge")
    parser.add_argument("--out", type=new_file, help="rows as JSON")
    parser.add_argument("--rows", type=Path, nargs="+", help="make the table of rows that were saved; run nothing")
    parser.add_argument("--page", type=page_with("gauge"), help="put the table into this page")
    options = parser.parse_args(arguments)
    kinds = (options.only,) if options.only else KINDS
    cause_rows: list[CauseRow] = []
    load_rows: list[LoadRow] = []
    for path in options.rows or ():
        saved = json.loads(path.read_text(encoding="utf-8"))
        cause_rows += [CauseRow(**row) for row in saved["causes"]]
        load_rows += [LoadRow(**row) for row in saved["loads"]]
    for kind in () if options.rows else kinds:
        for row in causes(kind, range(options.seed, options.seed + options.worlds)):
            cause_rows.append(row)
            print("right" if row.right else "WRONG", row, flush=True)
        _save(options.out, cause_rows, load_rows)
        for load in loads(kind, range(options.seed + 500, options.seed + 500 + options.loads), tubers=options.tubers):
            load_rows.append(load)
            print(load, flush=True)
        _save(options.out, cause_rows, load_rows)
    text = table(cause_rows, load_rows)
    print(text)
    if options.page:
        put_table(options.page, "gauge", text)
