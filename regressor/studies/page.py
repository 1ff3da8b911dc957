"""The page of an evaluation (docs/evaluation.md), made from saved results."""

from __future__ import annotations

from pathlib import Path

from conveyor.text_files import read_json, read_text
from regressor.studies import ablate, drift, report, worlds
from regressor.studies.saved import Saved

INTRODUCTION = """# Evaluation of the shipped weights

Simulated tubers that neither training nor any choice has seen. `field` has tumbling poses, 2-3 mm of belt-height error
and more noise; `easy` has resting poses and a well calibrated belt. How far this carries over to a real harvester is
not known; the one real cloud at hand is in the model card, `regressor/weights/MODEL_CARD.md`.

    tuberline simulate-views --out packs/test-field --tubers 1200 --views 3 --seed 515151 --preset field
    tuberline simulate-views --out packs/test-easy --tubers 1200 --views 3 --seed 515152 --preset easy

Each table is made by the command above it; what those commands saved lies in `docs/results`, and this page and the
model card are both made from it (`make docs`).
"""


WORLDS_COMMANDS = """tuberline simulate-views --out packs/easy --tubers 1250 --views 2 --seed 76801 --preset easy
    tuberline simulate-views --out packs/field --tubers 1250 --views 2 --seed 76802 --preset field
    tuberline simulate-views --out packs/harsh --tubers 2500 --views 2 --seed 76803 --preset harsh
    tuberline simulate-views --out packs/exact --tubers 1250 --views 2 --seed 76804 --preset exact
    # the same again with the seeds 76901 to 76904, into packs/easy-2, field-2, harsh-2 and exact-2
    tuberline simulate-views --out packs/matched --tubers 1250 --views 2 --seed 76805 --preset matched
    tuberline evaluate --data packs --by all --out worlds"""
WORLDS_WORDS = (
    "A recording is 25 tubers that share camera, belt and cultivar (those of `exact` have their own); its interval is "
    "as wide as the ledger states a load's before any ticket, with the resting level as well known as the pack says. "
    "The seeds were fixed before the packs were made, choices were made on seeds 71701 to 71713, and each pack was "
    "judged once with these weights, and once with those before them. Half of the recordings of `harsh` are under "
    "soil, which weights take for tuber and the truth does not; its clean tubers have a row and a column of their own. "
    "`exact` is no harvester's world: a camera that only rounds, and half of the shapes of no cultivar. In `matched` a "
    "stereo matcher makes the depth of two images, another one in each recording."
)

FAR = " ".join(f"--distances {metres}" for metres in (0.6, 0.7, 0.8, 0.9, 1.0))
FAR_COMMANDS = f"""tuberline simulate-views --out far/easy --tubers 1000 --views 2 --seed 76811 --preset easy {FAR}
    # the same with the seeds 76812 to 76815: far/field, far/harsh (2000 tubers), far/exact and far/matched
    tuberline evaluate --data far --by "belt distance" --out far-belts"""
FAR_WORDS = (
    "The belt is 0.6 to 1 m away for six tubers in ten, and nearer for the others. All cameras but some of `matched` "
    "have a D405's baseline of 18 mm, which is made for less: 1 m away a tenth of a pixel is 8 mm at 1280x720 and "
    "13 mm at 848x480. The seeds were fixed before the packs were made, and no choice was made on them."
)


def evaluation_page(
    field: Path,
    easy: Path,
    *,
    worlds: Path | None = None,
    far: Path | None = None,
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
    if worlds:
        parts.append(_section("By world and class", WORLDS_COMMANDS, _worlds(worlds, WORLDS_WORDS)))
    if far:
        parts.append(_section("Belts farther away", FAR_COMMANDS, _worlds(far, FAR_WORDS)))
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
        parts.append(_section("Speed", "python -m benchmarks regressor --out speed", read_text(speed / "speed.md")))
    return "\n".join(parts)


def saved_page(saved: Saved, *, image: str | None) -> str:
    """The page's Markdown from a folder of saved results.

    Raises:
        InputError: it lacks field/ or easy/, or a part of it cannot be read.
    """
    return evaluation_page(
        saved.folder / "field",
        saved.folder / "easy",
        worlds=saved.part("worlds"),
        far=saved.part("far"),
        one_season=saved.part("season"),
        ablation=saved.part("ablation"),
        drift=saved.part("drift"),
        speed=saved.part("speed"),
        image=image,
    )


def _section(title: str, command: str, body: str) -> str:
    return f"## {title}\n\n    {command}\n\n{body.strip()}\n"


def _evaluation(folder: Path, name: str) -> str:
    body = report.markdown(read_json(folder / "metrics.json"), title=name).partition("\n")[2]
    return body.replace("\n## As weighed, by group", f"\n### {name}: as weighed, by group")


def _worlds(folder: Path, words: str) -> str:
    """The tables of `evaluate --by`, as its metrics.json has them; poses, rims and worlds are the simulator's."""
    measured = read_json(folder / "metrics.json")
    presets = [worlds.PresetRow(**row) for row in measured["presets"]]
    classes = [worlds.ClassRow(**row) for row in measured["classes"]]
    return f"Weights `{measured['model']}`. {words}\n\n{worlds.markdown(presets, classes)}"


def _drift(folder: Path) -> str:
    measured = read_json(folder / "drift.json")
    return f"Weights `{measured['model']}` on `{measured['data']}`.\n\n{drift.markdown(measured)}"
