"""Tubers that lie lower than in earlier loads: how small a change is seen in a load, and how often one that is none?

Simulated tubers (meshes of real cultivars) lie on a belt, at rest or in any pose. From each its outline and its height
are measured as a camera sees them, with the belt followed as a line does, and no pixel is rendered. A line has some
loads of one cultivar, then one more to which something happened: tubers lie lower by so many millimetres, the depth
scale is off by a share, disparity drifted. Sizes differ from load to load. The ledger's own sums and comparison judge.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from aggregator.core.height_change import height_changes
from aggregator.core.height_sums import HeightSums
from benchmarks.figures_in_docs import put_table
from benchmarks.options import above_zero, new_file, page_with, parser_of, whole_number
from camera_sim.sim.cultivars import STOCKS, Stock
from camera_sim.sim.poses import free_rotation, rest_on_belt, resting_rotation
from camera_sim.sim.tubers import draw_tuber
from conveyor.messages import Tuber
from segmenter.frame.constants import DRIFT_M

Floats = NDArray[np.float64]

SEED = 62000
POOL = 600
"""Tubers of each cultivar, at rest and in any pose, that loads are drawn from."""
DISTANCES_M = (0.345, 0.46, 0.55)
STRENGTH_PX_M = 433.0 * 0.018
"""Pixels of disparity at 1 m: focal length times baseline."""
ANY_POSE = (0.05, 0.35)
"""Share of a line's tubers that lie in any pose, and by how much it differs from load to load."""
ANY_POSE_SD = 0.04
SIZE_SD, CHOICE_SD = 0.05, 0.5
"""Of a load: ln of all its sizes against the line's, and how much larger tubers are preferred, in sd of ln weight."""
CELL_MM, WIDTH_SD_MM, HEIGHT_SD_MM = 1.45, 1.0, 1.2
"""What an outline gains by its cells, and what a camera measures wrong of one tuber."""
EARLIER_LOADS = (2, 8)


@dataclass(frozen=True, slots=True)
class Done:
    """What happened to a line: tubers lie lower, the depth scale is off by a share, disparity drifted."""

    name: str
    lower_mm: float = 0.0
    scale: float = 0.0
    drift_px: float = 0.0


CASES = (
    Done("nothing"),
    *(Done(f"{mm:g} mm lower", lower_mm=mm) for mm in (1.0, 2.0, 2.5, 3.0, 4.0, 6.0)),
    *(Done(f"{mm:g} mm higher", lower_mm=-mm) for mm in (3.0, 6.0)),
    *(Done(f"depth scale {100 * s:+g} %", scale=s) for s in (-0.01, 0.01)),
    *(Done(f"drift {px:+g} px", drift_px=px) for px in (-0.4, -0.2, -0.1, 0.1, 0.2, 0.4)),
)


@dataclass(frozen=True, slots=True)
class Row:
    """One line's last load, as it was compared."""

    seed: int
    case: str
    shift_mm: float
    lower_mm: float
    lower_sd_mm: float
    scale_percent: float
    scale_sd_percent: float
    alarm: bool


def posed(stock: Stock, rng: Generator, *, free: bool) -> tuple[float, float, float]:
    """(length, width) of the outline from above and height of one tuber as it lies, millimetres."""
    tuber = draw_tuber(rng, level=3, stock=stock)
    rotation = free_rotation(rng) if free else resting_rotation(tuber.vertices, rng)
    points = rest_on_belt(tuber.vertices, rotation)
    _, sides, _ = cv2.minAreaRect(points[:, :2].astype(np.float32))
    return 1000 * max(sides), 1000 * min(sides), 1000 * float(np.ptp(points[:, 2]))


def draw_pools(seed: int, *, size: int) -> dict[str, tuple[Floats, Floats]]:
    """By cultivar: (n, 3) of tubers at rest, and of tubers in any pose."""
    found = {}
    for at, stock in enumerate(STOCKS):
        rng = np.random.default_rng([seed, at])
        rest, free = (np.array([posed(stock, rng, free=one) for _ in range(size)]) for one in (False, True))
        found[f"{at} {stock.cultivar}"] = rest, free
    return found


def draw_load(pool: tuple[Floats, Floats], rng: Generator, *, any_pose: float, tubers: int, changes: float) -> Floats:
    """(tubers, 3) of a load whose sizes and poses differ from the line's by `changes` times what is usual."""
    chosen = []
    prefers, larger = CHOICE_SD * changes * rng.standard_normal(), np.exp(SIZE_SD * changes * rng.standard_normal())
    share = np.clip(any_pose + ANY_POSE_SD * changes * rng.standard_normal(), 0.0, 1.0)
    free = int(rng.binomial(tubers, share))
    for own, count in zip(pool, (tubers - free, free), strict=True):
        size = np.log(own).sum(axis=1)
        odds = np.exp(prefers * (size - size.mean()) / size.std())
        chosen.append(own[rng.choice(len(own), count, p=odds / odds.sum())])
    load: Floats = np.concatenate(chosen) * larger
    return load


def seen(bodies_mm: Floats, done: Done, *, belt_m: float, rng: Generator) -> Floats:
    """(n, 3) length, width and height of tubers as the ledger has them, millimetres, under a camera `belt_m` above."""

    def depth(true_m: Floats | float) -> Floats:
        z = np.asarray(true_m)
        return np.asarray(z / (1 + z * done.drift_px / STRENGTH_PX_M) * (1 + done.scale))

    top_m = belt_m - (bodies_mm[:, 2] - done.lower_mm) / 1000
    middle_m = (belt_m + top_m) / 2
    off_m = float(depth(belt_m)) - belt_m
    plane_m = belt_m + off_m if abs(off_m) <= DRIFT_M else belt_m  # farther off it is not followed, and an alarm
    sides = bodies_mm[:, :2] * (depth(middle_m) / middle_m)[:, None]
    sides += CELL_MM + WIDTH_SD_MM * rng.standard_normal(sides.shape)
    height = 1000 * (plane_m - depth(top_m)) + HEIGHT_SD_MM * rng.standard_normal(len(bodies_mm))
    return np.column_stack([sides, height])


def sums_of(measured_mm: Floats) -> HeightSums:
    """As the ledger sums them up."""
    sums = HeightSums()
    for n, (length, width, height) in enumerate(np.maximum(measured_mm, 0.0).tolist()):
        tuber = Tuber(
            n, "r", 0, 0.0, 0.0, 100.0, 90.0, 110.0, length, width, height, 3, "pointraft", "m", (), ("a",), ("t",)
        )  # fmt: skip
        sums.add(tuber)
    return sums


def lines(pools: dict[str, tuple[Floats, Floats]], seeds: range, *, tubers: int, changes: float) -> Iterator[Row]:
    """One line a seed, its last load once for each case."""
    draw = partial(draw_load, tubers=tubers, changes=changes)
    for seed in seeds:
        rng = np.random.default_rng([seed, 17])
        pool = pools[str(rng.choice(sorted(pools)))]
        belt_m, any_pose = float(rng.choice(DISTANCES_M)), float(rng.uniform(*ANY_POSE))

        earlier = [
            sums_of(seen(draw(pool, rng, any_pose=any_pose), Done(""), belt_m=belt_m, rng=rng))
            for _ in range(int(rng.integers(*EARLIER_LOADS)))
        ]
        last = draw(pool, rng, any_pose=any_pose)
        for case in CASES:
            (found,) = height_changes(sums_of(seen(last, case, belt_m=belt_m, rng=rng)), earlier)
            yield Row(
                seed,
                case.name,
                case.lower_mm,
                found.lower_mm,
                found.lower_sd_mm,
                found.scale_percent,
                found.scale_sd_percent,
                found.alarm,
            )


def table(rows: Sequence[Row], *, tubers: int) -> str:
    """For the page."""
    lines_ = [
        f"| what happened to a load of {tubers} tubers | loads | alarms "
        "| lower by, mm: mean, 5 to 95 % | height over width, %: mean, 5 to 95 % |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    for case in dict.fromkeys(row.case for row in rows):
        own = [row for row in rows if row.case == case]
        lines_.append(
            f"| {case} | {len(own)} | {100 * np.mean([row.alarm for row in own]):.0f} % "
            f"| {_spread([row.lower_mm for row in own])} | {_spread([row.scale_percent for row in own])} |"
        )
    return "\n".join(lines_)


def _spread(values: Sequence[float]) -> str:
    low, high = np.quantile(values, [0.05, 0.95])
    return f"{np.mean(values):+.1f}, {low:+.1f} to {high:+.1f}"


def main(arguments: Sequence[str]) -> None:
    """Command line."""
    parser = parser_of("heights", __doc__)
    parser.add_argument("--lines", type=whole_number(1), default=200)
    parser.add_argument("--tubers", type=whole_number(1), default=300, help="of each load")
    parser.add_argument("--pool", type=whole_number(1), default=POOL, help="tubers drawn of each cultivar")
    parser.add_argument("--changes", type=above_zero, default=1.0, help="of sizes and poses, times what is usual")
    parser.add_argument("--seed", type=whole_number(0), default=SEED)
    parser.add_argument("--out", type=new_file, help="rows as JSON")
    parser.add_argument("--page", type=page_with("heights"), help="put the table into this page")
    given = parser.parse_args(arguments)
    pools = draw_pools(given.seed, size=given.pool)
    rows = list(lines(pools, range(given.seed, given.seed + given.lines), tubers=given.tubers, changes=given.changes))
    text = table(rows, tubers=given.tubers)
    print(text)
    if given.out:
        given.out.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n", encoding="utf-8")
    if given.page:
        put_table(given.page, "heights", text)
