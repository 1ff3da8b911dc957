"""A day's facts as the blocks of a report, in the order in which they are read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, date, datetime
from typing import Any

from aggregator.ledger.totals_by import Total
from conveyor import __version__
from conveyor.contract import Contract
from conveyor.messages import ClassTotal
from conveyor.rounding import rounded_to_sum
from tuberline.export.report.gather import DayFacts, LoadFacts
from tuberline.export.report.page import Align, Bars, Block, Figures, Grid, Picture, Report, Sentences
from tuberline.export.report.wrong import what_went_wrong

COLOURS = ("#c9b458", "#8fae4b", "#4f8f4f", "#2f6b5e", "#24485c", "#5b4a78", "#8a4a6b", "#a35b45")
"""Of classes from small to large; told apart in grey too."""
NONE = "–"


def report_of(facts: DayFacts, *, map_png: bytes | None, map_note: str, more_wrong: Sequence[str] = ()) -> Report:
    """The report.

    Args:
        map_png: the field's map, where positions are known. more_wrong: what is to be told beside what ledgers know.
    """
    blocks: list[Block] = [_figures(facts), _loads(facts), *_groups(facts), *_sizes(facts)]
    if map_png is not None:
        blocks.append(Picture("Yield of the field", map_png, map_note))
    wrong = [*what_went_wrong(facts), *more_wrong]
    blocks.append(Sentences("What went wrong", tuple(wrong or ["Nothing that the ledger knows of."]), warn=bool(wrong)))
    blocks += [_made_of(facts), Sentences("How to read it", _how(facts))]
    lines = ", ".join(dict.fromkeys(run.line for run in facts.runs))
    made = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    return Report(
        title=f"Harvest of {_days(facts.days)}",
        subtitle=f"{'Line' if ',' not in lines else 'Lines'} {lines}",
        blocks=tuple(blocks),
        foot=f"tuberline {__version__}, made {made}",
    )


def _days(days: Sequence[str]) -> str:
    first, last = (date.fromisoformat(day) for day in (days[0], days[-1]))
    told = f"{last.day} {last:%B %Y}"
    return told if first == last else f"{first.day} {first:%B %Y} to {told}"


def _figures(facts: DayFacts) -> Figures:
    sums, foreign = facts.total.sums, facts.foreign
    items = [
        ("Potatoes", kg(sums.estimated_g / 1000), f"90 %: {_between(sums.low_g / 1000, sums.high_g / 1000)}")
        if sums.saw
        else ("Potatoes", NONE, "no belt was seen"),
        ("Loads", str(facts.total.loads), _tubers(facts.total)),
        ("Belt seen", _percent(sums.coverage), _unseen(sums.coverage)),
    ]
    if foreign is not None:
        low, high = foreign.percent_low, foreign.percent_high
        items.append(("Clods, stones, haulm", f"{foreign.percent:.1f} %", f"by count; 90 %: {low:.1f} to {high:.1f} %"))
    return Figures(tuple(items))


def _tubers(total: Total) -> str:
    """How many passed, and that some of them, or all, did so without a load."""
    told = f"{total.sums.tubers:,} tubers".replace(",", " ")
    return told if not total.without_load else f"{told}, some without one" if total.loads else f"{told} without one"


def _unseen(coverage: float | None) -> str:
    if coverage is None:
        return "not known how much"
    return "all of it" if coverage > 0.9995 else "the rest is made up for"


def _loads(facts: DayFacts) -> Grid:
    zones = list(dict.fromkeys(load.zone for load in facts.loads if load.began))
    days = _short_days(facts.days)
    rows = [
        (
            load.label,
            load.field or NONE,
            load.variety or NONE,
            _when(load, day=days.get(load.day, ""), zoned=len(zones) > 1),
            str(load.tubers),
            *_weights(load.raw_kg, load.kg, load.low_kg, load.high_kg, saw=load.saw),
            _percent(load.coverage),
            kg(load.ticket_kg, unit=False) if load.ticket_kg is not None else NONE,
        )
        for load in facts.loads
    ]
    sums = facts.total.sums
    total = facts.total
    some = f" ({total.weighed} of {total.loads})" if total.weighed < total.loads else ""
    weighed = f"{kg(total.net_g / 1000, unit=False)}{some}" if total.weighed else NONE
    rows.append(("all", "", "", "", str(sums.tubers), *_of_all(total), _percent(sums.coverage), weighed))
    time = f"Time, {zones[0]}" if len(zones) == 1 else "Time"
    names = ("Load", "Field", "Variety", time, "Tubers", "Raw kg", "kg", "90 % interval", "Seen", "Ticket kg")
    known = "calibrated" if facts.calibrated_by else "the same, for nothing is calibrated"
    note = f"Raw kg: as weighed. kg: {known}. Both for all of the belt."
    return Grid("Loads", _columns(names, left=4), tuple(rows), note, summed=True)


def _short_days(days: Sequence[str]) -> dict[str, str]:
    """What of each day tells it from the others; '' of a single one."""
    several_years = len({day[:4] for day in days}) > 1
    return {day: "" if len(days) == 1 else day if several_years else day.partition("-")[2] for day in days}


def _when(load: LoadFacts, *, day: str, zoned: bool) -> str:
    time = f"{load.began}–{load.ended}" if load.ended else load.began
    return " ".join(filter(None, (day, time, load.zone if zoned and load.began else ""))) or NONE


def _groups(facts: DayFacts) -> list[Block]:
    blocks: list[Block] = []
    for name, totals in (("Field", facts.by_field), ("Variety", facts.by_variety)):
        if len(totals) > 1:
            blocks.append(_group(name, totals))
    return blocks


def _group(name: str, totals: Sequence[Total]) -> Grid:
    rows = tuple(
        (
            total.label,
            str(total.loads) if total.loads else NONE,
            str(total.sums.tubers),
            *_of_all(total)[1:],
            _percent(total.sums.coverage),
            f"{total.weighed} of {total.loads}" if total.loads else NONE,
        )
        for total in totals
    )
    heads = (name, "Loads", "Tubers", "kg", "90 % interval", "Seen", "On scales")
    return Grid(f"By {name.lower()}", _columns(heads, left=1), rows)


def _columns(names: Sequence[str], *, left: int) -> tuple[tuple[str, Align], ...]:
    """The first `left` columns hold words, the others numbers."""
    return tuple((name, "left" if n < left else "right") for n, name in enumerate(names))


def _sizes(facts: DayFacts) -> list[Block]:
    if not facts.classes:
        return [Sentences("Sizes", ("No tuber of these loads has a size: their weights do not tell it.",))]
    whole_kg = facts.total.sums.estimated_g / 1000
    counts = rounded_to_sum([each.count for each in facts.classes])
    percents = rounded_to_sum([each.percent for each in facts.classes], digits=1)
    weights_kg = rounded_to_sum([whole_kg * each.percent / 100 for each in facts.classes], digits=1)
    rows = tuple(
        (
            each.name,
            _edges(each),
            f"{count:.0f}",
            kg(weight_kg, unit=False),
            f"{percent:.1f} %",
            f"{each.percent_low:.0f}–{each.percent_high:.0f} %",
            each.state or NONE,
        )
        for each, count, percent, weight_kg in zip(facts.classes, counts, percents, weights_kg, strict=True)
    )
    heads = ("Class", "mm", "Tubers", "kg", "Of the weight", "90 % interval", "Contract")
    grid = Grid(f"Sizes ({facts.contract.told})", _columns(heads, left=2), rows)
    parts = tuple((each.name, COLOURS[n % len(COLOURS)]) for n, each in enumerate(facts.classes))
    bars = tuple((load.label, _foreign(load), _shares(load.classes, facts.contract)) for load in facts.loads)
    return [grid, Bars("Each load by class, and foreign matter by count", parts, bars, "Shares of the load's weight.")]


def _foreign(load: LoadFacts) -> str:
    return f"{load.foreign.percent:.1f} % foreign" if load.foreign else ""


def _shares(classes: Sequence[ClassTotal], contract: Contract) -> tuple[float, ...]:
    if not classes:
        return (0.0,) * len(contract.classes)
    whole = sum(each.percent for each in classes) or 1.0
    return tuple(each.percent / whole for each in classes)


def _edges(each: ClassTotal) -> str:
    if each.to_mm is None:
        return f"{each.from_mm:g} and more"
    return f"{each.from_mm:g} to {each.to_mm:g}" if each.from_mm else f"less than {each.to_mm:g}"


def _made_of(facts: DayFacts) -> Grid:
    rows = []
    for run in facts.runs:
        models = ", ".join(f"{name} ({n})" for name, n in run.models.items()) or NONE
        rest = run.summary.get("belt", {})
        rows.append((run.run, run.line, run.version, models, _stated(rest), run.end))
    heads = ("Run", "Line", "Version", "Weights (tubers)", "Resting offset", "End")
    note = "Calibrated by " + "; ".join(facts.calibrated_by) + "." if facts.calibrated_by else "Not calibrated."
    return Grid("Made with", _columns(heads, left=len(heads)), tuple(rows), note)


def _stated(rest: Mapping[str, Any]) -> str:
    """The resting offset as the line stated it."""
    offset, sd = rest.get("resting_offset_mm"), rest.get("resting_sd_mm")
    if offset is None:
        return NONE
    return f"{offset:.1f} mm" + (f" ± {sd:.1f}" if sd is not None else ", not known")


def _how(facts: DayFacts) -> tuple[str, ...]:
    parts = facts.total.sums.parts_percent
    made = ", ".join(f"{name} {part:.1f} %" for name, part in parts.items() if part >= 0.05)
    return (
        "An interval holds the true value nine times out of ten. What loads share (camera, resting level) does not "
        f"shrink with their number. Of all loads it is made of: {made or 'nothing known'}. The resting level is how "
        "far below the belt's plane tubers lie; one weighed bucket tells it.",
        "Belt that no camera looked at is made up for in every weight, and widens the interval.",
        "Sizes are told from one side: the smallest square hole that a tuber passes, unless the contract says length.",
    )


def kg(value: float, *, unit: bool = True) -> str:
    """Kilograms as a person reads them: three to four figures; tonnes from 10 000 kg on where the unit is told."""
    if unit and value >= 10_000:
        return f"{value / 1000:.2f} t"
    text = f"{value:.1f}" if value < 1000 else f"{value:,.0f}".replace(",", " ")
    return f"{text} kg" if unit else text


def _between(low: float, high: float, *, unit: bool = True) -> str:
    return f"{kg(low)} to {kg(high)}" if unit else f"{kg(low, unit=False)}–{kg(high, unit=False)}"


def _weights(raw_kg: float, whole_kg: float, low_kg: float, high_kg: float, *, saw: bool) -> tuple[str, str, str]:
    """Raw and calibrated weight and the interval; none where no belt was seen, which is not one of 0 kg."""
    if not saw:
        return NONE, NONE, NONE
    return kg(raw_kg, unit=False), kg(whole_kg, unit=False), _between(low_kg, high_kg, unit=False)


def _of_all(total: Total) -> tuple[str, str, str]:
    """The same of several loads."""
    sums = total.sums
    raw, *whole = (grams / 1000 for grams in (total.raw_g, sums.estimated_g, sums.low_g, sums.high_g))
    return _weights(raw, *whole, saw=sums.saw)


def _percent(share: float | None) -> str:
    return NONE if share is None else f"{100 * share:.1f} %"
