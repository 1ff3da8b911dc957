"""Single weights of tubers: the file they come in, and how well one tuber is known after them."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from aggregator.calibration.correction import Prior
from aggregator.calibration.evidence import single_weights
from aggregator.calibration.robust import correction_of
from aggregator.calibration.tickets import Ticket
from conveyor.errors import InputError
from conveyor.small_sample import holding_half_width
from conveyor.text_files import read_text

COLUMN = "weight_g"
MOST_ROWS = 5000
HEAVIEST_G = 5000.0
MISSING = ("", "-", "?")
APART = (";", "\t", ",")
"""What keeps columns apart, the most certain first: spreadsheets write semicolons where decimals have commas."""


def read_weights(path: Path) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """(rows, grams) of the single weights in the CSV file at `path`, in its order; rows are counted from 1.

    The first line may name the columns, one of them `weight_g`; without names there is one column. It says, too, by
    what columns are kept apart: commas, semicolons or tabs. Where they are not kept apart by commas, decimals may have
    one. A row whose weight is empty, '-' or '?' is a tuber that was not weighed.

    Raises:
        InputError: unreadable, without such a column, or with a weight that cannot be one in grams.
    """
    text = read_text(path, what="weights").splitlines()
    apart = next((mark for mark in APART if text and mark in text[0]), ";")
    try:
        lines = list(csv.reader(text, delimiter=apart))
    except csv.Error as error:
        raise InputError(f"weights {path} cannot be read: {error}") from error
    names = [name.strip().lower() for name in lines[0]] if lines else []
    named = COLUMN in names
    if not named and any(len(line) > 1 for line in lines):
        raise InputError(
            f"weights {path}: want a column {COLUMN}, or one column alone; found {', '.join(names)}. Name the column "
            "of the grams so; write decimals with a point, or keep columns apart by semicolons"
        )
    column = names.index(COLUMN) if named else 0
    rows, grams = [], []
    for row, line in enumerate(lines[1:] if named else lines, start=2 if named else 1):
        if any(cell.strip() for cell in line[max(1, len(names)) :]):
            raise InputError(
                f"weights {path}, row {row}: {len(line)} values, its first row names {len(names)}; write decimals with "
                "a point, or keep columns apart by semicolons"
            )
        found = line[column].strip() if column < len(line) else ""
        if found not in MISSING:
            rows.append(row)
            grams.append(_grams(found, row, path, decimal_comma=apart != ","))
    if not 1 <= len(rows) <= MOST_ROWS:
        raise InputError(f"weights {path} holds {len(rows)} weights; allowed are 1 to {MOST_ROWS}")
    return tuple(rows), tuple(grams)


def _grams(text: str, row: int, path: Path, *, decimal_comma: bool) -> float:
    try:
        grams = float(text.replace(",", ".") if decimal_comma else text)
    except ValueError:
        grams = math.nan
    if not 1.0 <= grams <= HEAVIEST_G:
        named = f", and no column is named {COLUMN}" if row == 1 else ""
        raise InputError(
            f"weights {path}, row {row}: {text!r} is no weight in grams{named}; allowed are 1 to {HEAVIEST_G:g}"
        )
    return grams


def tuber_half_width(tickets: Sequence[Ticket], ticket: Ticket) -> float | None:
    """90 % half-width of a single tuber after the correction, as a share, that holds in nine calibrations of ten.

    From the errors that are left of the single weights in `ticket`; None where there are fewer than 22.
    """
    prior = Prior(stated_offset_mm=ticket.stated_offset_mm)
    correction = correction_of(tickets, ticket.model, prior, cultivar=ticket.cultivar)
    left = single_weights(ticket, correction.mean, correction.cultivars).residuals
    log_half_width = holding_half_width(left.tolist())
    return None if log_half_width is None else math.expm1(log_half_width)
