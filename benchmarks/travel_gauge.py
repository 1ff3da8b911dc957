"""The belt's travel as a gauge: what is left of a load's bias where depth has drifted, or the encoder is off.

The disparity of simulated cameras is shifted by 0.2 to 0.4 px, either way. The same tubers pass them undisturbed,
shifted with no gauge, and shifted with `gauge = "travel"` and an encoder that is right, or off by 0.5 %. Frames are
rendered in this process; there is no line of processes around it. Seeds were fixed before anything was run.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.figures_in_docs import put_table
from benchmarks.gauge import MOST_DRIFT_PX, PRESETS, all_frames, matched, resting_of
from benchmarks.gauge_worlds import Disturbed, gauge_world
from benchmarks.options import new_file, page_with, parser_of, whole_number
from conveyor.camera_flags import SCALED_BY_TRAVEL
from conveyor.gauge import GaugeKind
from conveyor.messages import Frame
from conveyor.resting import RestingLevel
from regressor.weigh.weigher import Weigher, weigh_view
from segmenter.belt_segmenter import Settings
from segmenter.perception import PerceptionSettings
from segmenter.pipeline import Segmenter
from segmenter.results import ClosedTrack

SEED = 8300
TUBERS = 48
ENCODER_OFF = 0.005
AFTER = 20
"""Tubers after which a camera is well known."""


@dataclass(frozen=True, slots=True)
class TravelRow:
    """One load: its bias against the undisturbed camera, percent.

    Attributes:
        without: with no gauge. gauged: with the gauge, of all tubers; later: of those after the first `AFTER`.
        off: as `gauged`, where the encoder says 0.5 % too much or too little.
        needless: with the gauge under the undisturbed camera, of all tubers.
        scaled: tubers that were scaled.
    """

    seed: int
    preset: str
    drift_px: float
    tubers: int
    scaled: int
    without: float
    gauged: float
    later: float
    off: float
    needless: float


def rows(seeds: range, *, tubers: int, kind: GaugeKind) -> Iterator[TravelRow]:
    """A row for each seed; `kind`: of the body in view, at which no one looks."""
    weigher = Weigher.load()
    for seed in seeds:
        rng = np.random.default_rng([seed, 174])
        drift_px = float(rng.uniform(0.5, 1.0)) * (1.0 if rng.random() < 0.5 else -1.0) * MOST_DRIFT_PX
        off = 1 + ENCODER_OFF * (1.0 if rng.random() < 0.5 else -1.0)
        preset = PRESETS[seed % len(PRESETS)]
        world = gauge_world(kind, seed, preset=preset, tubers=tubers)
        rest = resting_of(world)
        right, wrong = (all_frames(world, by) for by in (Disturbed(), Disturbed(drift_px=drift_px)))
        true, _ = _weighed(right, weigher, rest, by_travel=False)
        without, _ = _weighed(wrong, weigher, rest, by_travel=False)
        gauged, scaled = _weighed(wrong, weigher, rest, by_travel=True)
        encoder_off, _ = _weighed([_told(frame, off) for frame in wrong], weigher, rest, by_travel=True)
        needless, _ = _weighed(right, weigher, rest, by_travel=True)
        grams = matched(true, without, gauged, encoder_off, needless)
        of_all, of_later = (100 * (g.sum(axis=0) / g[:, 0].sum() - 1) for g in (grams, grams[AFTER:]))
        yield TravelRow(
            seed=seed,
            preset=preset,
            drift_px=round(drift_px, 3),
            tubers=len(grams),
            scaled=scaled,
            without=round(float(of_all[1]), 2),
            gauged=round(float(of_all[2]), 2),
            later=round(float(of_later[2]), 2),
            off=round(float(of_all[3]), 2),
            needless=round(float(of_all[4]), 2),
        )


def _told(frame: Frame, off: float) -> Frame:
    return frame if frame.travel_m is None else replace(frame, travel_m=frame.travel_m * off)


def _weighed(
    frames: Sequence[Frame], weigher: Weigher, rest: RestingLevel, *, by_travel: bool
) -> tuple[NDArray[np.float64], int]:
    """((n, 3) place on the belt, x and y in metres, and grams of each tuber that counted, in their order; how many were
    scaled).
    """
    settings = Settings(perception=PerceptionSettings(method="classical"), resting=rest, scale_by_travel=by_travel)
    segmenter = Segmenter(settings)
    closed: list[ClosedTrack] = []
    for frame in frames:
        closed += segmenter.step(frame).closed
    closed += segmenter.finish()
    found = []
    for track in closed:
        grams = [weigh_view(weigher, view, regressor="bench").weight_g for view in track.views]
        known = [g for g in grams if g is not None]
        if known:
            found.append((track.track.place_x_m, track.track.y_m, float(np.mean(known))))
    scaled = sum(SCALED_BY_TRAVEL in one.track.flags for one in closed)
    return np.array(found).reshape(-1, 3), scaled


def table(found: Sequence[TravelRow]) -> str:
    """For the page."""
    lines = [
        "| camera | loads | no gauge: rms, worst | travel: rms, worst | its tubers after the 20th "
        "| encoder 0.5 % off | depth was right |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for preset in (*PRESETS, "all"):
        some = [row for row in found if preset in (row.preset, "all")]
        if some:
            columns = [_spread([getattr(row, of) for row in some]) for of in COLUMNS]
            lines.append(f"| {preset} | {len(some)} | {' | '.join(columns)} |")
    return "\n".join(lines)


COLUMNS = ("without", "gauged", "later", "off", "needless")


def _spread(percents: list[float]) -> str:
    return f"{np.sqrt(np.mean(np.square(percents))):.2f}, {max(percents, key=abs):+.2f}"


def main(arguments: list[str]) -> None:
    """Command line."""
    parser = parser_of("travel_gauge", __doc__)
    parser.add_argument("--loads", type=whole_number(1), default=12)
    parser.add_argument("--tubers", type=whole_number(1), default=TUBERS, help="of each load")
    parser.add_argument("--seed", type=whole_number(0), default=SEED)
    parser.add_argument("--rods", action="store_true", help="webs of rods instead of flat belts")
    parser.add_argument("--out", type=new_file, help="rows as JSON")
    parser.add_argument("--page", type=page_with("travel_gauge"), help="put the table into this page")
    options = parser.parse_args(arguments)
    found = []
    kind: GaugeKind = "rods" if options.rods else "belt-width"
    for row in rows(range(options.seed, options.seed + options.loads), tubers=options.tubers, kind=kind):
        found.append(row)
        print(row, flush=True)
        if options.out is not None:
            options.out.write_text(json.dumps([asdict(one) for one in found], indent=1) + "\n", encoding="utf-8")
    text = table(found)
    print(text)
    if options.page:
        put_table(options.page, "travel_gauge", text)
