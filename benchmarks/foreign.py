"""Share of foreign matter by count and weight on simulated belts whose clods, stones and haulm are known.

    python -m benchmarks foreign --out runs/foreign --docs docs/sizes.md

The segmenter's core runs over belts with none to many others among the tubers; each is kept as OUT/<belt>.json. Of the
others those count that are of a tuber's size: so large that a smallest tuber could be as large.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from aggregator.core.foreign import ForeignBody
from aggregator.core.foreign_totals import foreign_total
from aggregator.core.load_sums import LoadSums
from aggregator.core.totals import LoadTotals
from benchmarks.figures_in_docs import put_table
from benchmarks.foreign_belts import PLANS, kept
from benchmarks.options import page_with, parser_of, whole_number
from benchmarks.sizes_belts import fewer
from conveyor.config_yield import ForeignConfig
from conveyor.messages import Tuber

LEAST_TOP_MM, LEAST_VOLUME_ML = 18.0, 12.0
"""Of a body of a tuber's size: as `CountSettings` has them for tubers."""
SIMULATED = ForeignConfig(stone_share=0.29)
"""Densities of the simulator, and its share of stones among clods and stones."""
VOLUME_G_PER_ML = 0.94


def main(arguments: Sequence[str]) -> None:
    """Make what is not kept yet, and print the table."""
    parser = parser_of("foreign", __doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/foreign"))
    parser.add_argument("--belts", choices=sorted(PLANS), default="judge")
    parser.add_argument("--only", type=whole_number(0), nargs="+", help="numbers of belts, from 0")
    parser.add_argument("--tubers", type=whole_number(1), help="of each belt; default: as planned")
    parser.add_argument("--docs", type=page_with("foreign"), help="page between whose marks the table is put")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    groups: dict[str, list[dict[str, Any]]] = {}
    for plan in fewer(PLANS[given.belts], only=given.only, tubers=given.tubers):
        crowded = ", crowded" if plan.scene == "crowded" else ""
        groups.setdefault(f"{plan.preset}, {plan.others:g} others a tuber{crowded}", []).append(kept(given.out, plan))
    text = table(groups)
    print(text)
    if given.belts == "fit" and (filled := filling(belt for belts in groups.values() for belt in belts)) is not None:
        print(f"Of refused clods and stones {filled:.2f} of the visible volume is body (`CLOD_FILLED`).")
    if given.docs:
        put_table(given.docs, "foreign", text.rstrip())


def large(row: dict[str, Any]) -> bool:
    """A true body of a tuber's size."""
    return row["top_mm"] >= LEAST_TOP_MM and row["volume_ml"] >= LEAST_VOLUME_ML and row["kind"] in ("clod", "stone")


def table(groups: dict[str, list[dict[str, Any]]]) -> str:
    """Markdown: share by count and by weight, estimated and true. Each belt is a load of its own, as it has a camera of
    its own; of single ones there stand how far the worst is off, and how many intervals hold.
    """
    lines = [
        "| belts | tubers | others | % by count | true | off | worst belt | held "
        "| % by weight | true | off | worst belt | held |",
        "| --- | ---: | ---: |" + " ---: |" * 10,
    ]
    for name, belts in groups.items():
        told = [each for belt in belts if (each := judged(belt)) is not None]
        if not told:
            continue
        cells = "".join(f" {_cells([each[k] for each in told])} |" for k in range(2))
        others = sum(each[0].true for each in told)
        lines.append(f"| {name} | {sum(len(belt['tubers']) for belt in belts)} | {others:.0f} |{cells}")
    return "\n".join(lines) + "\n"


@dataclass(frozen=True, slots=True)
class Judged:
    """A belt by its sums and by the truth, by count or by grams: others told among all there is, others truly among all
    there truly is; and whether the interval holds."""

    told: float
    told_all: float
    true: float
    true_all: float
    held: bool

    @property
    def off(self) -> float:
        """Points."""
        return 100 * (self.told / self.told_all - self.true / self.true_all)


def judged(belt: dict[str, Any]) -> tuple[Judged, Judged] | None:
    """A belt as a load, by count and by weight; None where nothing was seen on it."""
    sums = LoadSums(50.0)
    add(sums, belt)
    found = foreign_total(LoadTotals(sums), SIMULATED)
    if found is None:
        return None
    others = [row for row in belt["foreign"] if large(row)]
    count, tubers = len(others), len(belt["tubers"])
    grams, tubers_g = (sum(row["weight_g"] for row in rows) for rows in (others, belt["tubers"]))
    share, share_g = 100 * count / (count + tubers), 100 * grams / (grams + tubers_g)
    all_g = 100 * found.weight_g / found.weight_percent if found.weight_percent else sums.as_weighed_g
    return (
        Judged(
            found.count, sums.count + sums.foreign.count, count, count + tubers,
            found.percent_low <= share <= found.percent_high,
        ),
        Judged(
            found.weight_g, all_g, grams, grams + tubers_g,
            found.weight_percent_low <= share_g <= found.weight_percent_high,
        ),
    )  # fmt: skip


def _cells(belts: Sequence[Judged]) -> str:
    told = 100 * sum(each.told for each in belts) / sum(each.told_all for each in belts)
    true = 100 * sum(each.true for each in belts) / sum(each.true_all for each in belts)
    worst, held = max((each.off for each in belts), key=abs), sum(each.held for each in belts)
    return f"{told:.1f} | {true:.1f} | {told - true:+.1f} | {worst:+.1f} | {held} of {len(belts)}"


def add(sums: LoadSums, belt: dict[str, Any]) -> None:
    """The tracks of a belt as an aggregator counts them; tubers weigh by their visible volume."""
    for n, track in enumerate(belt["tracks"]):
        place = track["crossed_x_m"] - track["travel_m"], track["y_m"]
        size = (track["length_mm"], track["width_mm"], track["height_mm"])
        common = ("front",), (track["track_id"],)
        if track["kind"] == "tuber":
            grams = VOLUME_G_PER_ML * track["visible_volume_ml"]
            sums.add(
                Tuber(
                    n + 1, "foreign", track["crossed_ns"], *place, grams, 0.8 * grams, 1.2 * grams, *size,
                    0, "volume", "", (), *common, log_odds=track["log_odds"],
                )
            )  # fmt: skip
        else:
            sums.add(
                ForeignBody(
                    n + 1, "foreign", track["crossed_ns"], *place, track["kind"], *size,
                    track["visible_volume_ml"], *common, track["log_odds"],
                )
            )  # fmt: skip


def filling(belts: Iterable[dict[str, Any]]) -> float | None:
    """Median of true volume over visible volume, of clods and stones that were refused; None where none was."""
    ratios = [
        track["true_volume_ml"] / track["visible_volume_ml"]
        for belt in belts
        for track in belt["tracks"]
        if track["kind"] == "lump" and track["truly"] in ("clod", "stone")
    ]
    return float(np.median(ratios)) if ratios else None
