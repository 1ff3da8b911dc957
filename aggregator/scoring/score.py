"""A run against the truth: who was counted, missed, counted twice, or never there, and how far the weights are off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from aggregator.calibration.correction import Prior
from aggregator.calibration.together import together
from aggregator.core.load_sums import LoadSums
from aggregator.core.totals import LoadTotals
from aggregator.ledger.line_tickets import tickets_beside
from aggregator.ledger.load_totals import ReadLoads
from aggregator.ledger.reader import RunRow, ledger_file, read_marks, read_tubers, reading, the_run
from aggregator.ledger.totals_by import run_loads
from aggregator.scoring.align import Alignment, align
from aggregator.scoring.compare import Comparison, compare
from aggregator.scoring.truth import TrueTuber, read_truth
from conveyor.errors import InputError
from conveyor.messages import Tuber


@dataclass(frozen=True, slots=True)
class Score:
    """How far a run was from the truth. Errors are counted minus true; None where nothing was matched or passed.

    Weights are as weighed, before any ticket; where nothing was seen (`saw`) they are zero, which says nothing of the
    load, and None in `as_dict`. Beside them stands what tickets make of the estimate, by what
    `calibrated_by` says; None and '' where none calibrate.
    """

    true_count: int
    count: int
    matched: int
    missed: int
    double_counted: int
    false: int
    true_weight_g: float
    weight_g: float
    low_g: float
    high_g: float
    estimated_weight_g: float
    estimated_low_g: float
    estimated_high_g: float
    coverage: float | None
    mae_g: float | None
    rmse_g: float | None
    bias_g: float | None
    interval_hit_percent: float | None
    place_mean_mm: float | None
    place_p95_mm: float | None
    aligned: bool
    scale: float
    offset_mm: float
    match_mm: float
    missed_ids: tuple[str, ...]
    double_ids: tuple[int, ...]
    false_ids: tuple[int, ...]
    calibrated_weight_g: float | None = None
    calibrated_low_g: float | None = None
    calibrated_high_g: float | None = None
    calibrated_by: str = ""

    @property
    def saw(self) -> bool:
        """Some belt was looked at, or a tuber counted; without either there is no weight."""
        return self.count > 0 or bool(self.coverage)

    @property
    def count_error_percent(self) -> float | None:
        """(counted - true) / true."""
        return _error_percent(self.count, self.true_count)

    @property
    def weight_error_percent(self) -> float | None:
        """(weight as seen - true) / true; None where nothing was seen."""
        return _error_percent(self.weight_g, self.true_weight_g) if self.saw else None

    @property
    def estimated_error_percent(self) -> float | None:
        """(weight as estimated for the whole belt - true) / true; None where nothing was seen."""
        return _error_percent(self.estimated_weight_g, self.true_weight_g) if self.saw else None

    @property
    def calibrated_error_percent(self) -> float | None:
        """(weight as calibrated, for the whole belt - true) / true; None where no ticket calibrates."""
        return (
            None if self.calibrated_weight_g is None else _error_percent(self.calibrated_weight_g, self.true_weight_g)
        )

    def as_dict(self) -> dict[str, Any]:
        """For machines; weights are None where nothing was seen."""
        values = {name: getattr(self, name) for name in Score.__dataclass_fields__}
        values |= {} if self.saw else dict.fromkeys(_WEIGHTS)
        percents = ("count", "weight", "estimated", "calibrated")
        return {**values, **{f"{name}_error_percent": getattr(self, f"{name}_error_percent") for name in percents}}


_WEIGHTS = ("weight_g", "low_g", "high_g", "estimated_weight_g", "estimated_low_g", "estimated_high_g")


def score_run(path: Path, *, truth: Path, match_mm: float = 25.0, run: str | None = None) -> Score:
    """Score the run in the folder (or ledger) `path` against truth.json.

    Args:
        match_mm: a ledger tuber and a true one farther apart than this are two.
        run: which run, where the ledger holds several.

    Raises:
        LedgerError: no ledger, or not that run. InputError: truth or `match_mm` unusable.
    """
    if not 1 <= match_mm <= 500:
        raise InputError(f"--match-mm {match_mm:g}: give 1 to 500 mm")
    true_tubers = read_truth(truth)
    ledger = ledger_file(path)
    with reading(ledger) as view:
        chosen = the_run(view, ledger, run)
        tubers = list(read_tubers(view, chosen.run))
        marks = read_marks(view, chosen)
        read = ReadLoads(view)
        found = read.whole(chosen)
        prior, told = read.prior(chosen.run), _loads_told(read, chosen) | _calibrated(read, chosen)
    score = score_tubers(
        tubers,
        true_tubers,
        match_mm=match_mm,
        travel_estimated=any(mark.travel_estimated for mark in marks.values()),
        coverage=found.coverage,
        belt_m=found.belt_m,
        most_m=found.most_m,
        prior=prior,
    )
    return replace(score, **told)


def _loads_told(ledger: ReadLoads, run: RunRow) -> dict[str, Any]:
    """What the loads of a run come to as weighed, as the run's own totals and `ledger totals` add them up, as `Score`
    names it; {} of a run without loads, which is one by itself.
    """
    if run.run not in ledger.loads.spans:
        return {}
    sums = together(run_loads(ledger, run, ()))
    low_g, high_g = sums.seen_g
    return {
        "weight_g": sums.weight_g,
        "low_g": low_g,
        "high_g": high_g,
        "estimated_weight_g": sums.estimated_g,
        "estimated_low_g": sums.low_g,
        "estimated_high_g": sums.high_g,
    }


def _calibrated(ledger: ReadLoads, run: RunRow) -> dict[str, Any]:
    """What the tickets of a ledger and of the config beside it make of a run, as `Score` names it; {} without any."""
    loads = run_loads(ledger, run, tickets_beside(ledger))
    sums = together(loads)
    if not sums.tickets:
        return {}
    by = dict.fromkeys(filter(None, (load.totals.calibrated().told for load in loads)))
    return {
        "calibrated_weight_g": sums.estimated_g,
        "calibrated_low_g": sums.low_g,
        "calibrated_high_g": sums.high_g,
        "calibrated_by": "; ".join(by),
    }


def score_tubers(
    tubers: Sequence[Tuber],
    truth: Sequence[TrueTuber],
    *,
    match_mm: float,
    travel_estimated: bool,
    coverage: float | None,
    belt_m: float | None = None,
    most_m: float | None = None,
    prior: Prior | None = None,
) -> Score:
    """The score of a ledger's tubers; places are aligned first where travel was estimated.

    Args:
        coverage, belt_m, most_m: of the run's belt, as `LoadTotals.estimated` takes them.
        prior: what the line states of its resting level; None: nothing.
    """
    sums = LoadSums(50.0)
    for tuber in tubers:
        sums.add(tuber)
    load = LoadTotals(sums, prior=prior)
    places_m = np.array([(t.place_x_m, t.place_y_m) for t in tubers]).reshape(-1, 2)
    true_m = np.array([(t.place_x_m, t.place_y_m) for t in truth]).reshape(-1, 2)
    alignment = align(places_m, true_m, gate_m=match_mm / 1000) if travel_estimated and tubers else Alignment()
    found = compare(
        alignment.applied(places_m),
        true_m,
        gate_m=match_mm / 1000,
        half_lengths_m=np.array([t.length_mm / 2000 for t in truth]),
    )
    low_g, high_g = load.interval_g()
    whole_g, whole_low_g, whole_high_g = load.estimated(coverage, belt_m=belt_m, most_m=most_m)
    return Score(
        true_count=len(truth),
        count=len(tubers),
        matched=len(found.pairs),
        missed=len(found.missed),
        double_counted=len(found.doubles),
        false=len(found.false),
        true_weight_g=sum(t.weight_g for t in truth),
        weight_g=load.weight_g,
        low_g=low_g,
        high_g=high_g,
        estimated_weight_g=whole_g,
        estimated_low_g=whole_low_g,
        estimated_high_g=whole_high_g,
        coverage=coverage,
        **_weight_errors(tubers, truth, found),
        **_place_errors(found),
        aligned=travel_estimated,
        scale=alignment.scale,
        offset_mm=1000 * alignment.offset_m,
        match_mm=match_mm,
        missed_ids=tuple(truth[i].name for i in found.missed),
        double_ids=tuple(tubers[i].tuber_id for i in found.doubles),
        false_ids=tuple(tubers[i].tuber_id for i in found.false),
        calibrated_by="",
    )


def _error_percent(found: float, true: float) -> float | None:
    """None where nothing passed: then any error is infinitely large."""
    return 100.0 * (found - true) / true if true else None


def _weight_errors(tubers: Sequence[Tuber], truth: Sequence[TrueTuber], found: Comparison) -> dict[str, float | None]:
    if not found.pairs:
        return dict.fromkeys(("mae_g", "rmse_g", "bias_g", "interval_hit_percent"))
    errors_g = np.array([tubers[i].weight_g - truth[j].weight_g for i, j in found.pairs])
    hits = [tubers[i].low_g <= truth[j].weight_g <= tubers[i].high_g for i, j in found.pairs]
    return {
        "mae_g": float(np.abs(errors_g).mean()),
        "rmse_g": float(np.sqrt((errors_g**2).mean())),
        "bias_g": float(errors_g.mean()),
        "interval_hit_percent": 100.0 * sum(hits) / len(hits),
    }


def _place_errors(found: Comparison) -> dict[str, float | None]:
    if not found.pairs:
        return {"place_mean_mm": None, "place_p95_mm": None}
    apart_mm = 1000 * np.array(found.apart_m)
    return {"place_mean_mm": float(apart_mm.mean()), "place_p95_mm": float(np.percentile(apart_mm, 95))}
