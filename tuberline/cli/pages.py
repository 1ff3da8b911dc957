"""`tuberline evaluation-page` and `model-card`: pages of results, made from saved ones."""

from __future__ import annotations

import sys
from pathlib import Path

from conveyor.errors import InputError


def evaluation_page(
    *,
    out: Path,
    results: Path | None = None,
    field: Path | None = None,
    easy: Path | None = None,
    one_season: Path | None = None,
    ablation: Path | None = None,
    drift: Path | None = None,
    speed: Path | None = None,
    image: str | None = None,
) -> None:
    """Make docs/evaluation.md from saved results; nothing is measured again.

    Parameters
    ----------
    out
        The Markdown file to write.
    results
        Folder of all results by name: field, easy, worlds, far, season, ablation, drift, speed; instead of one option
        each.
    field
        Folder of `tuberline evaluate` on field views.
    easy
        The same on easy views.
    one_season
        The same on field views of one season (`--season`): as hard for the paper's linear rule as the paper's data.
    ablation
        Folder of `tuberline ablate`.
    drift
        Folder of `tuberline drift`.
    speed
        Folder of `python -m benchmarks regressor --out`.
    image
        Link to the picture of the field evaluation, relative to the page.
    """
    from regressor.studies.page import evaluation_page as page
    from regressor.studies.page import saved_page
    from regressor.studies.saved import Saved

    if results is not None and not any((field, easy, one_season, ablation, drift, speed)):
        text = saved_page(Saved(results), image=image)
    elif results is None and field is not None and easy is not None:
        text = page(field, easy, one_season=one_season, ablation=ablation, drift=drift, speed=speed, image=image)
    else:
        raise InputError("give --results FOLDER, or --field and --easy and what else there is, not both")
    _write(out, text)


def model_card(*, results: Path, out: Path, weights: Path | None = None) -> None:
    """Make the model card of weights from their sidecar, their notes and saved results; nothing is measured again.

    Parameters
    ----------
    results
        Folder of all results by name: field, season, easy, real; those of docs/evaluation.md.
    out
        The Markdown file to write.
    weights
        A .safetensors file with its .json and its .notes.md beside it; default: the shipped ones.
    """
    from regressor.studies.card import model_card as card
    from regressor.studies.saved import Saved

    _write(out, card(Saved(results), weights=weights))


def _write(out: Path, text: str) -> None:
    from conveyor.files import whole_output

    with whole_output(out) as partial:
        partial.write_text(text, encoding="utf-8")
    sys.stderr.write(f"{out} written\n")
