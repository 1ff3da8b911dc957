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

from benchmarks.figures_in_docs import put_table
from benchmarks.gauge import MOST_DRIFT_PX, PRESETS, all_frames, matched, settings_of, weighed
from benchmarks.gauge_worlds import Disturbed, gauge_world
from benchmarks.options import new_file, page_with, parser_of, whole_number
from conveyor.camera_flags import SCALED_BY_TRAVEL
from conveyor.gauge import GaugeKind
from conveyor.messages import Frame
from regressor.weigh.weigher import Weigher
from segmenter.pipeline import Segmenter

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
        plain, by_travel = settings_of(world), settings_of(world, scale_by_travel=True)
        right, wrong = (all_frames(world, by) for by in (Disturbed(), Disturbed(drift_px=drift_px)))
        true, _ = weighed(Segmenter(plain), right, weigher)
        without, _ = weighed(Segmenter(plain), wrong, weigher)
        gauged, closed = weighed(Segmenter(by_travel), wrong, weigher)
        encoder_off, _ = weighed(Segmenter(by_travel), [_told(frame, off) for frame in wrong], weigher)
        needless, _ = weighed(Segmenter(by_travel), right, weigher)
        grams = matched(true, without, gauged, encoder_off, needless)
        of_all, of_later = (100 * (g.sum(axis=0) / g[:, 0].sum() - 1) for g in (grams, grams[AFTER:]))
        yield TravelRow(
            seed=seed,
            preset=preset,
            drift_px=round(drift_px, 3),
            tubers=len(grams),
            scaled=sum(SCALED_BY_TRAVEL in one.track.flags for one in closed),
            without=round(float(of_all[1]), 2),
            gauged=round(float(of_all[2]), 2),
            later=round(float(of_later[2]), 2),
            off=round(float(of_all[3]), 2),
            needless=round(float(of_all[4]), 2),
        )


def _told(frame: Frame, off: float) -> Frame:
    return frame if frame.travel_m is None else replace(frame, travel_m=frame.travel_m * off)


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
