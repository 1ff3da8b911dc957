"""The correction on simulated views, rendered and weighed by the shipped weights, with the resting level stated wrong.

The same views are weighed as if tubers lay by so many mm higher than they do. Every second tuber is the bucket, the
others are the load that is estimated: few, so a load's own scatter stays in the error. Outlines are the tubers' true
ones; a line takes them from its ledger.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aggregator.calibration.apply import calibrated
from aggregator.calibration.sensitivity import outline_g_per_mm
from aggregator.calibration.tickets import Single, Ticket
from benchmarks.calibration import MODEL
from benchmarks.figures_in_docs import put_table
from benchmarks.options import page_with, parser_of, whole_number
from camera_sim.sim.view_setting import ViewPlan
from camera_sim.sim.views import ViewSimulator
from conveyor.geometry import straight_down_belt_from_camera
from conveyor.statistics import NORMAL_90

OFFSETS_MM = (-2.0, 0.0, 4.0, 8.0)
STRIDE = 5


@dataclass(frozen=True, slots=True)
class Read:
    """One tuber: its truth and what was read of it, grams, with a standard deviation, and grams per mm by outline."""

    truth_g: float
    weighed_g: float
    sd_g: float
    per_mm_g: float


def main(arguments: Sequence[str]) -> None:
    """Simulate, weigh, calibrate and print a Markdown table."""
    parser = parser_of("calibration_rendered", __doc__)
    parser.add_argument("--tubers", type=whole_number(2), default=80, help="half of them the bucket, half the load")
    parser.add_argument("--seed", type=whole_number(0), default=55103)
    parser.add_argument("--preset", default="field")
    parser.add_argument("--weights", type=Path, help="default: the shipped ones")
    parser.add_argument(
        "--docs", type=page_with("calibration_rendered"), help="page between whose marks the table is put"
    )
    given = parser.parse_args(arguments)
    reads = rendered(given.preset, tubers=given.tubers, seed=given.seed, weights=given.weights)
    text = table(reads, preset=given.preset, seed=given.seed)
    print(text)
    if given.docs:
        put_table(given.docs, "calibration_rendered", text)


def rendered(preset: str, *, tubers: int, seed: int, weights: Path | None) -> dict[float, list[Read]]:
    """One view of each tuber, read with each offset; views that are refused are left out of all."""
    from regressor.weigh.prepare import RefusedCloud, prepare_depth
    from regressor.weigh.weigher import Weigher

    weigher = Weigher.load(weights)
    simulator = ViewSimulator(ViewPlan(seed, 1, preset, distance_range_m=(0.30, 0.55)))
    reads: dict[float, list[Read]] = {offset_mm: [] for offset_mm in OFFSETS_MM}
    for number in range(tubers):
        for view in simulator.views(number * STRIDE):
            k, found = view.intrinsics, []
            try:
                for offset_mm in OFFSETS_MM:
                    level_m = view.belt_distance_m + view.resting_m - offset_mm / 1000
                    cloud = prepare_depth(
                        view.depth,
                        depth_scale_m=view.depth_scale_m,
                        fx=k.fx,
                        fy=k.fy,
                        cx=k.cx - view.u0,
                        cy=k.cy - view.v0,
                        belt_from_camera=straight_down_belt_from_camera(level_m),
                    )
                    answer = weigher.weigh(cloud, belt_sd_m=view.belt_sd_m)
                    per_mm_g = outline_g_per_mm(*view.tuber.axes_mm[:2])
                    sd_g = (answer.high_g - answer.low_g) / 2 / NORMAL_90
                    found.append(Read(view.tuber.weight_g, answer.weight_g, sd_g, per_mm_g))
            except RefusedCloud:
                continue
            for offset_mm, read in zip(OFFSETS_MM, found, strict=True):
                reads[offset_mm].append(read)
    return reads


def bucket_of(reads: Sequence[Read], *, singles: bool) -> Ticket:
    """The tubers as one sum, or one by one."""
    rows = tuple(Single(n, r.truth_g, r.weighed_g, r.sd_g, r.per_mm_g) for n, r in enumerate(reads))
    truth_g, weighed_g = sum(r.truth_g for r in reads), sum(r.weighed_g for r in reads)
    own_g = float(np.sqrt(sum(r.sd_g**2 for r in reads)))
    return Ticket(
        "b",
        MODEL,
        truth_g,
        0.002 * truth_g,
        weighed_g,
        own_g,
        1.0,
        kind="tubers" if singles else "bucket",
        tubers=len(reads),
        per_mm_g=sum(r.per_mm_g for r in reads),
        singles=rows if singles else (),
    )


def table(reads: dict[float, list[Read]], *, preset: str, seed: int) -> str:
    """Markdown: the load's error with each offset, before and after."""
    count = len(next(iter(reads.values())))
    lines = [
        f"{count} tubers of `{preset}`, one view each, seed {seed}: half of them the bucket, half the load.",
        "Error of the load in percent, and its stated 90 % interval.",
        "",
        "| tubers lie lower by | as weighed | after the bucket | after single weights | offset by single weights |",
        "| ---: | ---: | ---: | ---: | ---: |",
    ]
    for offset_mm, found in reads.items():
        bucket, load = found[::2], found[1::2]
        cells, offset = [], ""
        for tickets in ((), (bucket_of(bucket, singles=False),), (bucket_of(bucket, singles=True),)):
            variance = sum(r.sd_g**2 for r in load)
            result = calibrated(
                {("pointraft", MODEL): sum(r.weighed_g for r in load)},
                per_mm_g=sum(r.per_mm_g for r in load),
                own_variance_g2=(variance, variance),
                tickets=tickets,
            )
            truth_g = sum(r.truth_g for r in load)
            half = 100 * NORMAL_90 * result.high_sd_g / truth_g
            cells.append(f"{100 * (result.weight_g / truth_g - 1):+.1f} ± {half:.1f}")
            mean, sd = result.corrections[MODEL].offset_mm
            offset = f"{mean:+.1f} ± {NORMAL_90 * sd:.1f} mm"
        lines.append(f"| {offset_mm:+g} mm | {' | '.join(cells)} | {offset} |")
    return "\n".join(lines)
