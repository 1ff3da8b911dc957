"""`tuberline evaluation-page`: pages of results, made from saved ones."""

from __future__ import annotations

import sys
from pathlib import Path


def evaluation_page(
    *,
    out: Path,
    field: Path,
    easy: Path,
    one_season: Path | None = None,
    ablation: Path | None = None,
    drift: Path | None = None,
    speed: Path | None = None,
    image: str | None = None,
) -> None:
    """Make docs/evaluation.md from saved results; nothing is measured anew.

    Parameters
    ----------
    out
        The Markdown file to write.
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

    text = page(field, easy, one_season=one_season, ablation=ablation, drift=drift, speed=speed, image=image)
    out.write_text(text, encoding="utf-8")
    sys.stderr.write(f"{out} written\n")
