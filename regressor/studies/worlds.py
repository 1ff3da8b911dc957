"""Bias by class and world: pose, rim, weight, season and belt distance against the simulator's presets, in one table.

A total reads right where two errors hide each other; classes do not. Views of a recording share belt, camera and
cultivar, so the uncertainty of each figure is a bootstrap over recordings, not over views.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from regressor.studies.evaluate import SHIPPED, Evaluation, fused_tubers, load_half_share

BY = ("pose", "rim", "weight", "season", "belt distance", "surface", "soil")
WEIGHT_EDGES_G = (0, 50, 100, 200, 300)
DRAWS = 400
LEVEL = 0.9
FEWEST_VIEWS = 50


@dataclass(frozen=True, slots=True)
class ClassRow:
    """One class of one preset. Biases are of the total, percent; `low` and `high` their 90 % bootstrap interval, None
    where all views are of one recording.
    """

    by: str
    label: str
    preset: str
    views: int
    recordings: int
    bias_percent: float
    low_percent: float | None
    high_percent: float | None
    mae_g: float
    coverage: float


@dataclass(frozen=True, slots=True)
class PresetRow:
    """One preset: errors per view, and how often intervals hold of views, fused tubers and whole recordings."""

    preset: str
    views: int
    recordings: int
    mae_g: float
    bias_percent: float
    low_percent: float | None
    high_percent: float | None
    views_held: float
    tubers_held: float
    loads_held: float
    load_half_percent: float


def by_class(result: Evaluation, by: tuple[str, ...] = BY, *, seed: int = 0) -> list[ClassRow]:
    """A row for each class and preset with at least 50 views."""
    rows = []
    for name, labels in _labels(result, by):
        for label in np.unique(labels):
            for preset, inside in _worlds(result):
                chosen = inside & (labels == label)
                if chosen.sum() < FEWEST_VIEWS:
                    continue
                held = (result.weight_g >= result.low_g) & (result.weight_g <= result.high_g)
                error = np.abs(result.predicted[SHIPPED] - result.weight_g)[chosen]
                rows.append(
                    ClassRow(
                        name,
                        str(label),
                        preset,
                        int(chosen.sum()),
                        len(np.unique(result.recording[chosen])),
                        *bias_percent(result, chosen, seed=seed),
                        round(float(error.mean()), 2),
                        round(float(held[chosen].mean()), 4),
                    )
                )
    return rows


def by_preset(result: Evaluation, *, seed: int = 0) -> list[PresetRow]:
    """A row for each preset, and one for all of them together if there are several."""
    held = (result.weight_g >= result.low_g) & (result.weight_g <= result.high_g)
    middle, truth, below, above = fused_tubers(result)
    _, first = np.unique(result.tuber, return_index=True)
    tubers_held = (truth >= middle - below) & (truth <= middle + above)
    presets = list(_worlds(result))
    if len(presets) > 1:
        presets.append(("all", np.ones(len(held), np.bool_)))
    rows = []
    for preset, inside in presets:
        error = np.abs(result.predicted[SHIPPED] - result.weight_g)[inside]
        loads = [
            _load_held(result, inside & (result.recording == name)) for name in np.unique(result.recording[inside])
        ]
        rows.append(
            PresetRow(
                preset,
                int(inside.sum()),
                len(loads),
                round(float(error.mean()), 2),
                *bias_percent(result, inside, seed=seed),
                round(float(held[inside].mean()), 4),
                round(float(tubers_held[inside[first]].mean()), 4),
                round(float(np.mean([held for held, _ in loads])), 4),
                round(100 * float(np.mean([half for _, half in loads])), 2),
            )
        )
    return rows


def bias_percent(result: Evaluation, rows: NDArray[np.bool_], *, seed: int) -> tuple[float, float | None, float | None]:
    """(bias of the total, 5 % and 95 % quantile over drawn recordings), percent.

    The two are None where all views are of one recording, as those of a 3DPotatoTwin folder: nothing tells then how far
    another one would be off.
    """
    _, owner = np.unique(result.recording[rows], return_inverse=True)
    found = np.bincount(owner, result.predicted[SHIPPED][rows])
    truth = np.bincount(owner, result.weight_g[rows])
    bias = round(100 * float(found.sum() / truth.sum() - 1), 2)
    if len(truth) < 2:
        return bias, None, None
    drawn = np.random.default_rng(seed).integers(0, len(truth), (DRAWS, len(truth)))
    biases = 100 * (found[drawn].sum(1) / truth[drawn].sum(1) - 1)
    low, high = np.quantile(biases, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return bias, round(float(low), 2), round(float(high), 2)


def _load_held(result: Evaluation, rows: NDArray[np.bool_]) -> tuple[bool, float]:
    """Whether a recording's total lies in its interval, and half of that as a share: tubers' own errors and shared."""
    _, owner = np.unique(result.tuber[rows], return_inverse=True)
    count = np.bincount(owner)
    weight, truth, low, high = (
        np.bincount(owner, values[rows]) / count
        for values in (result.predicted[SHIPPED], result.weight_g, result.low_g, result.high_g)
    )
    shared = load_half_share(result, rows)
    # A tuber's interval holds some of what the load shares too; as in the ledger, that is not taken out again.
    own = (high - low) / 2
    half = float(np.hypot(np.sqrt((own**2).sum()), shared * weight.sum()))
    return abs(float(weight.sum() - truth.sum())) <= half, half / float(weight.sum())


def _presets(result: Evaluation) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    labels = result.groups.get("preset", np.full(len(result.weight_g), "all"))
    for preset in np.unique(labels):
        yield str(preset), labels == preset


def _worlds(result: Evaluation) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """The presets, and of those with soil on some tubers the clean ones: no view shows what soil adds to a volume, and
    the truth is without it.
    """
    soil = result.groups.get("soil")
    for name, inside in _presets(result):
        yield name, inside
        if soil is not None and "soil" in soil[inside] and (inside & (soil == "clean")).any():
            yield f"{name}, clean tubers", inside & (soil == "clean")


def _labels(result: Evaluation, by: tuple[str, ...]) -> Iterator[tuple[str, NDArray[np.str_]]]:
    names = [f"{low} to {high} g" for low, high in pairwise(WEIGHT_EDGES_G)]
    names.append(f"over {WEIGHT_EDGES_G[-1]} g")
    for name in by:
        if name == "weight":
            yield name, np.array(names)[np.digitize(result.weight_g, WEIGHT_EDGES_G[1:])]
        elif name in result.groups:
            yield name, result.groups[name]


def markdown(presets: list[PresetRow], classes: list[ClassRow]) -> str:
    """Both tables for people."""
    lines = [
        "| preset | views, recordings | MAE g | bias % (90 % over recordings) | intervals hold: views, tubers, "
        "recordings % | half width of a recording's % |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| {row.preset} | {row.views}, {row.recordings} | {row.mae_g:.2f} | {_bias(row)} | "
        f"{100 * row.views_held:.1f}, {100 * row.tubers_held:.1f}, {100 * row.loads_held:.1f} | "
        f"{row.load_half_percent:.1f} |"
        for row in presets
    ]
    shown = [row.preset for row in presets if row.preset != "all" or len(presets) == 1]
    lines += [
        "",
        "Bias of the total, percent (90 % over recordings), by class:",
        "",
        "| class | | " + " | ".join(shown) + " |",
        "| --- | --- |" + " --- |" * len(shown),
    ]
    for by, label in dict.fromkeys((row.by, row.label) for row in classes):
        cells = {row.preset: _bias(row) for row in classes if (row.by, row.label) == (by, label)}
        lines.append(f"| {by} | {label} | " + " | ".join(cells.get(preset, "-") for preset in shown) + " |")
    return "\n".join(lines) + "\n"


def _bias(row: ClassRow | PresetRow) -> str:
    if row.low_percent is None or row.high_percent is None:
        return f"{row.bias_percent:+.1f} (one recording)"
    return f"{row.bias_percent:+.1f} ({row.low_percent:+.1f} to {row.high_percent:+.1f})"
