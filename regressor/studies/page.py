"""The page of an evaluation (docs/evaluation.md), made from saved results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from conveyor.errors import InputError
from regressor.studies import ablate, drift, report

INTRODUCTION = """# Evaluation of the shipped weights

Simulated tubers that neither training nor any choice has seen. `field` has tumbling poses, 2-3 mm of belt-height error
and more noise; `easy` has resting poses and a well calibrated belt. How far this carries over to a real harvester is
not known; the one real cloud at hand is in the model card, `regressor/weights/MODEL_CARD.md`, with the commands that
make these sets.

Each table is made by the command above it, and this page by `tuberline evaluation-page` from what those commands saved.
"""


def evaluation_page(
    field: Path,
    easy: Path,
    *,
    one_season: Path | None = None,
    ablation: Path | None,
    drift: Path | None,
    speed: Path | None,
    image: str | None,
) -> str:
    """The page's Markdown from the folders that `evaluate`, `ablate`, `drift` and the speed benchmark wrote.

    Raises:
        InputError: a folder without the file it should hold.
    """
    parts = [INTRODUCTION]
    if image:
        parts.append(f"![Estimated over true weight, cumulative error, error over weight]({image})\n")
    for name, folder in (("field", field), ("easy", easy)):
        parts.append(_section(name, f"tuberline evaluate --data PACK --out {name}", _evaluation(folder, name)))
    if one_season:
        body, _, _ = _evaluation(one_season, "one season").partition("\n### ")
        parts.append(_section("Field, one season", "tuberline evaluate --data PACK --season 2023 --out season", body))
    if ablation:
        table, words = ablate.read_table(ablation)
        parts.append(
            _section(
                "Ablations and other networks",
                "tuberline ablate --data TRAIN --val VAL --test PACK --out ablation",
                ablate.markdown(table, recipe=words),
            )
        )
    if drift:
        parts.append(_section("Domain drift", "tuberline drift --data PACK --out drift", _drift(drift)))
    if speed:
        parts.append(_section("Speed", "python -m benchmarks regressor --out speed", _text(speed / "speed.md")))
    return "\n".join(parts)


def _section(title: str, command: str, body: str) -> str:
    return f"## {title}\n\n    {command}\n\n{body.strip()}\n"


def _evaluation(folder: Path, name: str) -> str:
    body = report.markdown(_json(folder / "metrics.json"), title=name).partition("\n")[2]
    return body.replace("\n## As weighed, by group", f"\n### {name}: as weighed, by group")


def _drift(folder: Path) -> str:
    measured = _json(folder / "drift.json")
    return f"Weights `{measured['model']}` on `{measured['data']}`.\n\n{drift.markdown(measured)}"


def _json(path: Path) -> dict[str, Any]:
    try:
        loaded: dict[str, Any] = json.loads(_text(path))
    except ValueError as error:
        raise InputError(f"{path} is not JSON: {error}") from error
    return loaded


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}; make it first, see --help") from error
