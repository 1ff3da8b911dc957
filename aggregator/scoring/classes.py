"""A run's classes of size against the truth: shares of weight, as the contract cuts them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from aggregator.ledger.class_list import classes_of_run
from aggregator.ledger.load_totals import ReadLoads
from aggregator.ledger.reader import ledger_file, reading, the_run
from aggregator.scoring.truth import truth_file
from conveyor.contract import Contract
from conveyor.errors import InputError
from conveyor.messages.base import plain
from conveyor.text_files import read_json

TRUE_KEYS = {"mesh": "square_mesh_mm", "length": "length_mm"}


def true_percents(truth: Path, contract: Contract) -> list[float]:
    """The true share of weight of each class, percent.

    Raises:
        InputError: the truth does not say how large its tubers are by that measure.
    """
    key, truth = TRUE_KEYS[contract.measure], truth_file(truth)
    told = read_json(truth, what="truth")
    try:
        tubers = [(float(row[key]), float(row["weight_g"])) for row in told["tubers"]]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"truth {truth} says no '{key}' of each tuber ({error!r}), so its classes are not known; record it again "
            "with `tuberline simulate`"
        ) from error
    total_g = sum(weight_g for _, weight_g in tubers)
    return [
        100 * sum(g for mm, g in tubers if each.low_mm <= mm < each.high_mm) / total_g if total_g else 0.0
        for each in contract.classes
    ]


def score_classes(path: Path, *, truth: Path, contract: Contract, run: str | None = None) -> list[dict[str, Any]]:
    """Each class of the run as plain `ClassTotal`, as its tickets calibrate it, with its `true_percent`.

    Raises:
        LedgerError: no ledger, or not that run. InputError: the truth does not say sizes.
    """
    expected = true_percents(truth, contract)
    ledger = ledger_file(path)
    with reading(ledger) as view:
        found = classes_of_run(ReadLoads(view), the_run(view, ledger, run), contract)
    return [{**plain(each), "true_percent": percent} for each, percent in zip(found, expected, strict=False)]
