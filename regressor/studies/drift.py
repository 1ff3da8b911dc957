"""Domain drift: the same weights on views that differ from what they were trained on, by named shifts.

Some shifts change the views of one pack (noise, belt height, kinds of tuber); others need a pack of their own (another
belt distance), which is given by name. What counts on a belt is the bias of a load's total as much as the error of a
view: weights that drift keep a fair error and lose the total.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator
from scipy.ndimage import gaussian_filter

from conveyor.errors import InputError
from regressor.studies.alone import Scale
from regressor.studies.evaluate import NETWORK, SHIPPED, VOLUME_RULE, coverage, evaluate_views, method_scores
from regressor.training.labelled import LabelledView, count_labelled, part_of, read_labelled
from regressor.training.work import Work, no_work

BASELINE_M = 0.018
SMOOTH_NOISE_PX, SMOOTH_OVER_PX = 0.06, 2.5
"""Sd of the D405's correlated disparity noise as the simulator has it, and over how many pixels it is alike."""

MIN_TUBERS = 10
MANY = 1 << 62
METHODS = (SHIPPED, NETWORK, VOLUME_RULE)
Change = Callable[[LabelledView, Generator], LabelledView | None]


def believe_belt(view: LabelledView, rng: Generator, *, error_m: float) -> LabelledView:
    """The belt is `error_m` nearer to the camera than the system believes."""
    return replace(view, belt_distance_m=view.belt_distance_m + error_m)


def add_noise(view: LabelledView, rng: Generator, *, times: float) -> LabelledView | None:
    """Correlated stereo noise added, until its sd is `times` the simulator's own; a cloud has no image to add it to."""
    if view.depth is None:
        return None
    smooth = gaussian_filter(rng.standard_normal(view.depth.shape), SMOOTH_OVER_PX)
    smooth *= np.sqrt(times**2 - 1) * SMOOTH_NOISE_PX / smooth.std()
    z_m = view.depth * view.depth_scale_m
    noisy = np.where(view.depth > 0, z_m + smooth * z_m**2 / (view.fx * BASELINE_M), 0.0)
    return replace(view, depth=np.round(noisy / view.depth_scale_m).astype(np.uint16))


def only_season(view: LabelledView, rng: Generator, *, season: str) -> LabelledView | None:
    """Tubers of one season alone; 2025 has the knobby ones."""
    return view if view.season == season else None


def only_cultivar(view: LabelledView, rng: Generator, *, cultivar: str) -> LabelledView | None:
    """Tubers of one cultivar alone."""
    return view if view.cultivar == cultivar else None


SHIFTS: dict[str, Change] = {
    "as it is": lambda view, rng: view,
    "belt 3 mm nearer than believed": partial(believe_belt, error_m=0.003),
    "belt 3 mm farther than believed": partial(believe_belt, error_m=-0.003),
    "belt 6 mm nearer than believed": partial(believe_belt, error_m=0.006),
    "belt 6 mm farther than believed": partial(believe_belt, error_m=-0.006),
    "noise x2": partial(add_noise, times=2.0),
    "noise x3": partial(add_noise, times=3.0),
    "only 2025 (knobby)": partial(only_season, season="2025"),
    "only Sayaka": partial(only_cultivar, cultivar="Sayaka"),
    "only Corolle (long)": partial(only_cultivar, cultivar="Corolle"),
}


def drift(
    data: Path,
    others: Mapping[str, Path],
    scale: Scale,
    *,
    max_views: int | None,
    seed: int = 0,
    on_work: Work = no_work,
) -> dict[str, Any]:
    """Figures of every shift of `data` and of every pack in `others`, by name; those of fewer than 10 tubers are left
    out, with their numbers.

    Of a folder with a splits.csv its part 'test' is read.

    Raises:
        InputError: a pack that cannot be read, or none with enough tubers.
    """
    table: dict[str, Any] = {}
    left_out: dict[str, int] = {}
    cases: list[tuple[str, Path, Change]] = [(name, data, change) for name, change in SHIFTS.items()]
    cases += [(name, folder, SHIFTS["as it is"]) for name, folder in others.items()]
    parts = {folder: part_of(folder, "test") for _, folder, _ in cases}
    most = {folder: min(count_labelled(folder, split=part), max_views or MANY) for folder, part in parts.items()}
    total, before = sum(most[folder] for _, folder, _ in cases), 0
    for name, folder, change in cases if max_views is None or max_views >= MIN_TUBERS else ():
        on_work(name, before, total)
        views = list(_shifted(folder, parts[folder], change, np.random.default_rng(seed), max_views))
        if (tubers := len({view.tuber for view in views})) < MIN_TUBERS:
            left_out[name] = tubers
            before += most[folder]
            if not table and not others and most[folder] < (max_views or MANY):
                break  # all of them are read, and every other shift is of these or of fewer
            continue
        said = partial(_said, on_work, name, before, total)
        before += most[folder]
        result = evaluate_views(views, scale, where=f"{folder}, {name}", progress=said)
        scores = method_scores(result)
        table[name] = {"methods": {method: scores[method] for method in METHODS}, "coverage": coverage(result)}
    if not table:
        where = f"the first {max_views} views of {data} are of" if most[data] == max_views else f"{data} holds"
        raise InputError(f"{where} fewer than {MIN_TUBERS} tubers: nothing can be said of a shift")
    return {"model": scale.sidecar.model_id, "data": data.name, "shifts": table, "left_out": left_out}


def _said(on_work: Work, name: str, before: int, total: int, done: int) -> None:
    on_work(name, min(before + done, total), total)


def _shifted(
    folder: Path, part: str | None, change: Change, rng: Generator, max_views: int | None
) -> Iterator[LabelledView]:
    made = 0
    for view in read_labelled(folder, split=part):
        shifted = change(view, rng)
        if shifted is None:
            continue
        made += 1
        yield shifted
        if max_views is not None and made >= max_views:
            return


def write_drift(measured: dict[str, Any], out: Path) -> str:
    """Write drift.json and drift.md to `out`; the table."""
    out.mkdir(parents=True, exist_ok=True)
    text = markdown(measured)
    (out / "drift.json").write_text(json.dumps(measured, indent=1) + "\n", encoding="utf-8")
    (out / "drift.md").write_text(text, encoding="utf-8")
    return text


def markdown(measured: dict[str, Any]) -> str:
    """The table for people."""
    lines = [
        "| shift | views | MAE g: as weighed, network, volume rule | bias of the total %: the same three | "
        "90 % intervals hold of views, tubers % |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, row in measured["shifts"].items():
        of = [row["methods"][method] for method in METHODS]
        errors = ", ".join(f"{figures['mae_g']:.1f}" for figures in of)
        biases = ", ".join(f"{figures['total_bias_percent']:+.1f}" for figures in of)
        held = row["coverage"]
        lines.append(
            f"| {name} | {of[0]['views']:.0f} | {errors} | {biases} | "
            f"{100 * held['views']:.1f}, {100 * held['tubers']:.1f} |"
        )
    if left_out := measured.get("left_out"):
        told = ", ".join(f"{name} ({tubers})" for name, tubers in left_out.items())
        lines += ["", f"Left out, with the number of their tubers, for fewer than {MIN_TUBERS}: {told}."]
    return "\n".join(lines) + "\n"
