"""A load's error and interval before and after a bucket, single weights and tickets, over simulated lines.

Each draw is a line of unknown resting offset (-2 to +8 mm), factor (density, cultivar, camera scale within 1 %, what
the weigher misjudges) and mix of sizes (`benchmarks.calibration_worlds`). One load is estimated after each stage.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
from numpy.random import Generator

from aggregator.calibration.apply import calibrated
from aggregator.calibration.tickets import Single, Ticket
from benchmarks import calibration_worlds as worlds
from benchmarks.calibration_worlds import Passed, World, draw_load, draw_passed, draw_world
from benchmarks.figures_in_docs import put_table
from benchmarks.options import new_file, page_with, parser_of, whole_number
from conveyor.statistics import NORMAL_90

SEED = 73019
"""Of the table in docs/calibrate.md; fixed in the commit before it was first run."""

DRAWS = 200
BETWEEN_SDS = (0.003, 0.015)
"""What loads of one line differ by beside sizes: with the bars, and five times as much."""
STAGES = ("nothing", "1 bucket of 50", "50 single weights", "1 ticket", "3 tickets", "bucket and 3 tickets")
BARS = {"1 bucket of 50": 2.5, "3 tickets": 1.0}
MODEL = "m"


def main(arguments: Sequence[str]) -> None:
    """Draw, calibrate and print a Markdown table."""
    parser = parser_of("calibration", __doc__)
    parser.add_argument("--draws", type=whole_number(1), default=DRAWS)
    parser.add_argument("--seed", type=whole_number(0), default=SEED)
    parser.add_argument("--docs", type=page_with("calibration"), help="page between whose marks the table is put")
    parser.add_argument("--json", type=new_file, help="file for every draw")
    given = parser.parse_args(arguments)
    errors, widths = {}, {}
    for between_sd in BETWEEN_SDS:
        found = np.array([one(n, given.seed, between_sd) for n in range(given.draws)])
        errors[between_sd], widths[between_sd] = found[:, :, 0], found[:, :, 1]
    text = table(errors, widths, seed=given.seed)
    print(text)
    if given.docs:
        put_table(given.docs, "calibration", text)
    if given.json:
        told = {str(sd): {"errors": errors[sd].tolist(), "half_widths": widths[sd].tolist()} for sd in BETWEEN_SDS}
        given.json.write_text(json.dumps({"stages": STAGES, "draws": told}) + "\n", encoding="utf-8")


def one(draw: int, seed: int, between_sd: float) -> list[tuple[float, float]]:
    """(ln estimate over truth, stated 90 % half-width as a share) of one line's load after each stage."""
    rng = np.random.default_rng([seed, draw])
    world = draw_world(rng, between_sd=between_sd)
    bucket = bucket_ticket(draw_passed(world, worlds.BUCKET_TUBERS, rng), rng)
    singles = singles_ticket(draw_passed(world, worlds.BUCKET_TUBERS, rng), rng)
    loads = [load_ticket(world, n, rng) for n in range(3)]
    test = draw_load(world, rng)
    stages: tuple[list[Ticket], ...] = ([], [bucket], [singles], loads[:1], loads, [bucket, *loads])
    return [judged(test, stage) for stage in stages]


def judged(load: Passed, tickets: Sequence[Ticket]) -> tuple[float, float]:
    """(ln estimate over truth, half-width as a share) of a load."""
    seen, sd_g = load.weighed_g[load.seen], load.sd_g[load.seen]
    own = float((sd_g**2).sum())
    found = calibrated(
        {("pointraft", MODEL): float(seen.sum())},
        per_mm_g=float(load.per_mm_g[load.seen].sum()),
        own_variance_g2=(own, own),
        tickets=tickets,
    )
    half_g = NORMAL_90 * float(np.hypot(found.high_sd_g / load.coverage, unseen_sd_g(load)))
    estimate_g = found.weight_g / load.coverage
    return float(np.log(estimate_g / load.truth_g.sum())), half_g / estimate_g


def unseen_sd_g(load: Passed) -> float:
    """By chance of how many tubers lay on the belt that was not looked at; the belt itself is loaded evenly here."""
    odds = (1 - load.coverage) / load.coverage
    seen = load.weighed_g[load.seen]
    return float(np.sqrt(len(seen) * odds * (1 + odds) * np.mean(seen**2)))


def load_ticket(world: World, n: int, rng: Generator) -> Ticket:
    """A load of the world that met a weighbridge."""
    load = draw_load(world, rng)
    seen = load.seen
    truth_g = float(load.truth_g.sum())
    own_g = float(np.sqrt((load.sd_g[seen] ** 2).sum()))
    return Ticket(
        f"load {n}",
        MODEL,
        truth_g * float(np.exp(rng.normal(0.0, worlds.LOAD_SCALE_SD))),
        worlds.LOAD_SCALE_SD * truth_g,
        float(load.weighed_g[seen].sum()) / load.coverage,
        float(np.hypot(own_g / load.coverage, unseen_sd_g(load))),
        load.coverage,
        tubers=int(seen.sum()),
        per_mm_g=float(load.per_mm_g[seen].sum()) / load.coverage,
    )


def bucket_ticket(passed: Passed, rng: Generator) -> Ticket:
    """The tubers as one sum on a hanging scale."""
    truth_g = float(passed.truth_g.sum())
    return Ticket(
        "bucket",
        MODEL,
        truth_g * float(np.exp(rng.normal(0.0, worlds.BUCKET_SCALE_SD))),
        worlds.BUCKET_SCALE_SD * truth_g,
        float(passed.weighed_g.sum()),
        float(np.sqrt((passed.sd_g**2).sum())),
        1.0,
        kind="bucket",
        tubers=len(passed.truth_g),
        per_mm_g=float(passed.per_mm_g.sum()),
    )


def singles_ticket(passed: Passed, rng: Generator) -> Ticket:
    """The tubers one by one on a kitchen scale of 1 g."""
    scale_g = np.maximum(passed.truth_g + rng.normal(0.0, 1.0, len(passed.truth_g)), 5.0)
    columns = (scale_g, passed.weighed_g, passed.sd_g, passed.per_mm_g)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    singles = tuple(Single(n, *row) for n, row in enumerate(rows))
    sum_g = float(scale_g.sum())
    per_mm_g = float(passed.per_mm_g.sum())
    own_g = float(np.sqrt((passed.sd_g**2).sum()))
    weighed_g = float(passed.weighed_g.sum())
    return Ticket(
        "singles", MODEL, sum_g, 7.0, weighed_g, own_g, 1.0, "tubers", "", len(singles), per_mm_g, singles=singles
    )


def table(errors: dict[float, np.ndarray], widths: dict[float, np.ndarray], *, seed: int) -> str:
    """Markdown: one row per stage, for each scatter between loads."""
    draws = len(next(iter(errors.values())))
    lines = [
        f"{draws} lines, seed {seed}; a load of {worlds.LOAD_TUBERS} tubers, seen to 97 to 100 %. The error's 90th",
        "percentile and the stated interval in percent of the load.",
        "",
        "| loads differ by | calibrated with | mean error | error, 90th percentile | stated +- (median) | held |",
        "| --- | --- | ---: | ---: | ---: | ---: |",
    ]
    for between_sd, found in errors.items():
        for n, stage in enumerate(STAGES):
            error = 100 * (np.exp(found[:, n]) - 1)
            half = 100 * widths[between_sd][:, n]
            held = 100 * float((np.abs(error) <= half).mean())
            p90, bar = float(np.quantile(np.abs(error), 0.9)), BARS.get(stage)
            told = f" (bar {bar:g})" if bar and between_sd == BETWEEN_SDS[0] else ""
            cells = (f"{100 * between_sd:.1f} %", stage, f"{error.mean():+.2f}", f"{p90:.2f}{told}")
            lines.append(f"| {' | '.join(cells)} | {np.median(half):.2f} | {held:.1f} % |")
    return "\n".join(lines)
