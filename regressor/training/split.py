"""Training, validation and test tubers of a 3DPotatoTwin folder: 60/20/20, stratified by weight deciles, by tuber.

The paper cuts the weights into ten classes of equal size (pandas' `qcut`) and draws within each with random state 20.
The classes here are the same; the draw is NumPy's with that seed, so the same tuber need not fall into the same part:
the authors' own draw is the `splits.csv` of their download, which is read as it is.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.files import whole_output
from conveyor.formats.potatotwin.layout import read_truth, weight_said

PARTS = ("train", "val", "test")
SHARES = (0.6, 0.2, 0.2)
CLASSES = 10
SEED = 20


def stratified_split(
    weight_g: NDArray[np.float64], *, shares: Sequence[float] = SHARES, classes: int = CLASSES, seed: int = SEED
) -> NDArray[np.str_]:
    """(n,) part of each of n tubers; every weight class of equal size is shared out in proportion.

    What does not divide evenly in a class is carried over to the next: the parts keep their shares of the whole.
    """
    edges = np.quantile(weight_g, np.linspace(0, 1, classes + 1))
    owner = np.clip(np.searchsorted(edges, weight_g, side="left") - 1, 0, classes - 1)
    rng = np.random.default_rng(seed)
    part = np.empty(len(weight_g), "<U5")
    given = np.zeros(len(shares))
    for which in range(classes):
        rows = rng.permutation(np.nonzero(owner == which)[0])
        for row in rows:
            # The part that lacks most of its due gets the next tuber.
            due = np.array(shares) * (given.sum() + 1) - given
            chosen = int(due.argmax())
            given[chosen] += 1
            part[row] = PARTS[chosen]
    return part


def write_splits(folder: Path, *, seed: int = SEED, force: bool = False) -> dict[str, int]:
    """Write `folder`/splits.csv from its ground_truth.csv; how many tubers each part has.

    Raises:
        InputError: no table, no weights in it, too few tubers, or splits that are there already.
    """
    out = folder / "splits.csv"
    if out.is_file() and not force:
        raise InputError(f"{out} exists (the authors' download brings theirs): keep it, or add --force to draw again")
    labels, weights = _weights(folder / "ground_truth.csv")
    if len(labels) < CLASSES * len(PARTS):
        raise InputError(f"{folder} has {len(labels)} tubers; at least {CLASSES * len(PARTS)} are needed for a split")
    part = stratified_split(weights, seed=seed)
    with whole_output(out) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["label", "split"])
        writer.writerows(sorted(zip(labels, part.tolist(), strict=True)))
    return {name: int((part == name).sum()) for name in PARTS}


def _weights(table: Path) -> tuple[list[str], NDArray[np.float64]]:
    """Each label once, with its weight."""
    if not table.is_file():
        raise InputError(f"table {table} cannot be read: there is no such file")
    rows = read_truth(table.parent)
    unknown = [label for label, row in rows.items() if row.weight_g is None]
    if not rows:
        raise InputError(f"table {table} has no rows")
    if unknown:
        raise InputError(f"table {table}: {weight_said(table.parent, unknown[0])} ({len(unknown)} labels have none)")
    return list(rows), np.array([row.weight_g for row in rows.values()], np.float64)
