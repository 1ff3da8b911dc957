"""Sizes and classes of simulated belts against their meshes, on cultivars that were in no choice.

    python -m benchmarks sizes --out runs/sizes --docs docs/sizes.md --picture docs/images/sizes.png
    python -m benchmarks sizes --out runs/sizes --fit regressor/weights/tuberline-sizes.json

The segmenter's core and a regressor's weighing run over belts of 75 tubers; each is kept as OUT/<belt>.json. `--fit`
makes the rules from the belts of the simulator's own cultivars.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aggregator.calibration.tickets import Ticket
from aggregator.core.class_totals import class_totals, classes_together
from aggregator.core.load_sums import LoadSums
from aggregator.core.merge import Group, PlacedTrack
from aggregator.core.totals import LoadTotals
from aggregator.core.tubers import make_tuber
from benchmarks.figures_in_docs import put_table
from benchmarks.options import new_file, page_with, parser_of, whole_number
from benchmarks.sizes_belts import WORLDS, Passed, fewer, kept, plans
from conveyor.contract import Contract, SizeClass
from conveyor.messages import ClassTotal, Tuber
from conveyor.messages.sizes import MEASURES
from regressor.weigh.sizes import SizeRules, fit_sizes

TRUE_KEYS = dict(zip(MEASURES, ("length_mm", "width_mm", "height_mm", "square_mesh_mm"), strict=True))
CONTRACT = Contract(
    name="benchmark",
    classes=(
        SizeClass(name="below 35", to_mm=35),
        SizeClass(name="35 to 45", from_mm=35, to_mm=45),
        SizeClass(name="45 to 55", from_mm=45, to_mm=55),
        SizeClass(name="55 and more", from_mm=55),
    ),
)
"""Edges fixed before any belt was judged."""
SCALE_ERROR = 0.005
"""Of a ticket, standard deviation."""


def main(arguments: Sequence[str]) -> None:
    """Make what is not kept yet; fit, or print the tables."""
    parser = parser_of("sizes", __doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/sizes"))
    parser.add_argument("--belts", choices=("judge", "check"), default="judge")
    parser.add_argument("--fit", type=new_file, help="write rules fitted on the training belts to this file instead")
    parser.add_argument("--only", type=whole_number(0), nargs="+", help="numbers of belts, from 0")
    parser.add_argument("--tubers", type=whole_number(1), help="of each belt; default: as planned")
    parser.add_argument(
        "--docs", type=page_with("sizes", "classes"), help="page between whose marks the tables are put"
    )
    parser.add_argument("--picture", type=new_file, help="draw true against estimated mesh size")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    if given.fit:
        training = fewer(plans("train"), only=given.only, tubers=given.tubers)
        by_cultivar: dict[str, list[Passed]] = {}
        for plan in training:
            by_cultivar.setdefault(plan.stock.cultivar, []).extend(kept(given.out, plan))
        write_rules(given.fit, fitted(by_cultivar, farthest_m=max(plan.distance_m for plan in training)))
        return
    groups: dict[str, list[list[Passed]]] = {}
    for plan in fewer(plans(given.belts), only=given.only, tubers=given.tubers):
        name = f"{plan.stock.cultivar}, {plan.preset}{WORLDS[plan.world]}" if given.belts == "judge" else plan.preset
        groups.setdefault(name, []).append(kept(given.out, plan))
    of_all = {name: [row for belt in belts for row in belt] for name, belts in groups.items()}
    sizes, classes = size_table(of_all), class_table(groups)
    print(sizes + "\n" + classes)
    if given.docs:
        put_table(given.docs, "sizes", sizes.rstrip())
        put_table(given.docs, "classes", classes.rstrip())
    if given.picture:
        draw({name: rows for name, rows in of_all.items() if "clean" not in name}, given.picture)


def fitted(by_cultivar: dict[str, list[Passed]], *, farthest_m: float) -> SizeRules:
    """The rules from tubers whose truth is known; each cultivar has the same say, however many belts it had."""
    views = [
        (features, [row.truth[key] for key in TRUE_KEYS.values()], terms, 1 / sum(len(row.terms) for row in rows))
        for rows in by_cultivar.values()
        for row in rows
        for features, terms in zip(row.features, row.terms, strict=True)
    ]
    columns = (np.array(column, np.float64) for column in zip(*views, strict=True))
    return fit_sizes(*columns, farthest_m=farthest_m)


def write_rules(path: Path, rules: SizeRules) -> None:
    """As they are shipped: seven digits."""
    told = json.loads(json.dumps(rules.to_json()), parse_float=lambda text: float(f"{float(text):.7g}"))
    path.write_text(json.dumps(told) + "\n", encoding="utf-8")


def as_tuber(row: Passed, number: int) -> Tuber:
    """The tuber that an aggregator makes of its track."""
    place = PlacedTrack("front", 1, row.track, row.track.place_x_m, row.track.y_m)
    return make_tuber(Group([place]), run="sizes", tuber_id=number)


def size_table(groups: dict[str, list[Passed]]) -> str:
    """Markdown: median absolute error, bias, and share held by the 90 % interval, of each size."""
    lines = [
        "| belts | tubers | size | median error mm | bias mm | outline's median error mm | 90 % interval held |",
        "| --- | ---: | --- | ---: | ---: | ---: | ---: |",
    ]
    for name, rows in groups.items():
        tubers = [as_tuber(row, n + 1) for n, row in enumerate(rows)]
        for measure, key in TRUE_KEYS.items():
            truth = np.array([row.truth[key] for row in rows])
            said = np.array([t.sizes.of(measure) if t.sizes else (np.nan, np.nan) for t in tubers])
            off = said[:, 0] - truth
            fine = ~np.isnan(off)
            bounds = np.array([t.sizes.interval_mm(measure) for t in tubers if t.sizes])
            held = (bounds[:, 0] <= truth[fine]) & (truth[fine] <= bounds[:, 1])
            outline = np.abs(outline_mm(tubers, measure) - truth)
            lines.append(
                f"| {name} | {fine.sum()} | {measure} | {np.median(np.abs(off[fine])):.1f} | {off[fine].mean():+.1f} "
                f"| {np.median(outline):.1f} | {100 * held.mean():.0f} % |"
            )
    return "\n".join(lines) + "\n"


def outline_mm(tubers: Sequence[Tuber], measure: str) -> NDArray[np.float64]:
    """What the visible outline and height alone would say, to compare with."""
    axes = np.array([sorted((t.length_mm, t.width_mm, t.height_mm), reverse=True) for t in tubers])
    if measure == "mesh":
        return np.asarray(np.hypot(axes[:, 1], axes[:, 2]) / np.sqrt(2))
    return np.asarray(axes[:, MEASURES.index(measure)])


def class_table(groups: dict[str, list[list[Passed]]]) -> str:
    """Markdown: the share of weight of each class, estimated with its interval and true, percent: without a ticket all
    belts of a group are one load, with tickets each is one that was on the scale.
    """
    names = [each.name for each in CONTRACT.classes]
    lines = [
        f"| belts | tubers | {' | '.join(names)} | largest difference |",
        "| --- | ---: |" + " ---: |" * (len(names) + 1),
    ]
    for name, belts in groups.items():
        rows = [row for belt in belts for row in belt]
        whole = LoadTotals(summed(rows))
        lines.append(class_row(name, rows, class_totals(whole, CONTRACT)))
        lines.append(class_row(f"{name}, with tickets", rows, classes_together(list(map(weighed, belts)), CONTRACT)))
    return "\n".join(lines) + "\n"


def summed(rows: Sequence[Passed]) -> LoadSums:
    """The sums of a load of these tubers."""
    sums = LoadSums(50.0)
    for n, row in enumerate(rows):
        sums.add(as_tuber(row, n + 1))
    return sums


def weighed(rows: Sequence[Passed]) -> LoadTotals:
    """A load of these tubers and its net ticket."""
    sums, true_g = summed(rows), sum(row.truth["weight_g"] for row in rows)
    (_, model), _ = max(sums.weighed.items(), key=lambda item: item[1][1])
    own_g = float(np.sqrt((sums.low_variance_g2 + sums.high_variance_g2) / 2))
    ticket = Ticket(
        "sizes", model, true_g, SCALE_ERROR * true_g, sums.as_weighed_g, own_g, 1.0,
        tubers=len(rows), per_mm_g=sums.per_mm_g,
    )  # fmt: skip
    return LoadTotals(sums, [ticket])


def class_row(name: str, rows: Sequence[Passed], found: Sequence[ClassTotal]) -> str:
    """One row of `class_table`."""
    grams = np.array([row.truth["weight_g"] for row in rows])
    mesh = np.array([row.truth["square_mesh_mm"] for row in rows])
    cells, worst = [], 0.0
    for each, told in zip(CONTRACT.classes, found, strict=True):
        true = 100 * float(grams[(mesh >= each.low_mm) & (mesh < each.high_mm)].sum() / grams.sum())
        inside = told.percent_low - 0.05 <= true <= told.percent_high + 0.05
        cells.append(
            f"{told.percent:.1f} ({told.percent_low:.0f} to {told.percent_high:.0f}), true {true:.1f}"
            + ("" if inside else ", missed")
        )
        worst = max(worst, abs(told.percent - true))
    return f"| {name} | {len(rows)} | {' | '.join(cells)} | {worst:.1f} |"


def draw(groups: dict[str, list[Passed]], path: Path) -> None:
    """True against estimated mesh size, one panel for each group of belts."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, len(groups), figsize=(3.2 * len(groups), 3.4), sharex=True, sharey=True)
    for axis, (name, rows) in zip(np.atleast_1d(axes), groups.items(), strict=True):
        said = [as_tuber(row, n + 1).sizes for n, row in enumerate(rows)]
        pairs = [(row.truth["square_mesh_mm"], s.mesh_mm) for row, s in zip(rows, said, strict=True) if s]
        true, found = np.array(pairs).T
        axis.plot([15, 85], [15, 85], color="0.6", linewidth=1)
        axis.scatter(true, found, s=6, alpha=0.6)
        axis.set(title=name, xlabel="true mesh size, mm", xlim=(15, 85), ylim=(15, 85), aspect="equal")
    np.atleast_1d(axes)[0].set_ylabel("estimated, mm")
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, bbox_inches="tight")
