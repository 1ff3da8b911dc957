"""The model card of saved weights, made from their sidecar, the saved results of their evaluation, and notes.

The results are those that the evaluation page is made from, so the two cannot contradict each other. What no program
knows (how the weights came to be, what to beware of) stands in `<weights>.notes.md`; the figures go where it says
`<!-- measured -->`.
"""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

from conveyor.errors import InputError
from conveyor.text_files import read_json
from regressor.network.sidecar import Sidecar
from regressor.network.stored import SHIPPED, read_weights
from regressor.studies import report
from regressor.studies.saved import Saved

MEASURED = "<!-- measured -->"
SETS = {
    "field": "field: tumbling poses, a belt height 2-3 mm off, more noise",
    "season": "field, tubers of one season alone: as hard for the paper's rule as the paper's data",
    "easy": "easy: resting poses, a well calibrated belt",
}


def model_card(saved: Saved, *, weights: Path | None = None) -> str:
    """The card's Markdown.

    Args:
        saved: the results; `real` in them is what `tuberline weigh --json` said of real clouds, each with `true_g`.
        weights: default: the shipped ones.

    Raises:
        InputError: results missing or of other weights, or no notes beside the weights.
    """
    path = weights or SHIPPED
    state, sidecar = read_weights(path)
    notes = _notes(path.with_suffix(".notes.md"))
    parameters = sum(value.size for value in state.values())
    before, _, after = notes.partition(MEASURED)
    return (
        "\n\n".join(
            part.strip()
            for part in (
                f"# Model card: {sidecar.name}",
                f"<!-- Made by `make docs` from {path.stem}.json, {path.stem}.notes.md and docs/results. -->",
                _wrapped(
                    f"PointRAFT weights `{sidecar.model_id}`: {parameters / 1e6:.2f} million numbers, "
                    f"{path.stat().st_size / 1e6:.1f} MB."
                ),
                _takes_and_gives(sidecar),
                before,
                _measured(saved, sidecar),
                _real_clouds(saved, sidecar),
                after,
            )
            if part.strip()
        )
        + "\n"
    )


def _notes(path: Path) -> str:
    try:
        notes = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}; a model card needs its notes") from error
    if notes.count(MEASURED) != 1:
        raise InputError(f"{path} must have one line '{MEASURED}': the figures go there")
    return notes


def _takes_and_gives(sidecar: Sidecar) -> str:
    belt, length, weight = sidecar.belt_distance_m, sidecar.length_mm, sidecar.weight_g
    nearer = sidecar.calibrated_belt_m.high
    farther = (
        f", and so it is from {nearer:.3f} m on, where intervals were not calibrated" if nearer < belt.high else ""
    )
    takes = (
        f"One view of one tuber: the depth inside its mask, camera to belt {belt.low:.3f} to {belt.high:.3f} m, "
        f"outline {length.low:.0f} to {length.high:.0f} mm, {weight.low:.0f} to {weight.high:.0f} g; outside of "
        f"these a weight is flagged{farther}. Height above the belt is clamped at "
        f"{1000 * sidecar.input.max_height_m:.0f} mm (the paper: 80). "
        "It gives grams with a conformal 90 % interval whose width follows the view."
    )
    share = sidecar.volume_share
    blended = (
        f"What is weighed is the geometric mean of the network ({100 * (1 - share):.0f} %) and the visible-volume rule "
        f"({100 * share:.0f} %), a share chosen on recordings that neither was trained on; the tables show the network "
        "alone as well. "
        f"Views of a tuber share {100 * sidecar.shared_sd_share:.0f} % of their error's standard deviation, "
        f"tubers of a load {100 * sidecar.shared_bias_share:.1f} % of its weight."
    )
    return f"## What it takes and gives\n\n{_wrapped(takes)}\n\n{_wrapped(blended)}"


def _measured(saved: Saved, sidecar: Sidecar) -> str:
    parts = [
        "## Measured",
        _wrapped(
            "On simulated tubers never trained on and in no choice, whole path from depth crop to grams as the line "
            "runs it. Baselines are cross-validated on the very set they are judged on. By group, with "
            "ablations, drift and speed: docs/evaluation.md, made from the same files."
        ),
    ]
    for name, title in SETS.items():
        measured = saved.evaluation(name)
        if measured is None:
            continue
        if measured["model"] != sidecar.model_id:
            raise InputError(
                f"{saved.folder / name} was measured with {measured['model']}, the card is of {sidecar.model_id}: "
                f"make it again with `tuberline evaluate --data PACK --out {saved.folder / name}`"
            )
        tables, _, _ = report.markdown(measured, title=title).partition("\n## ")
        parts.append(f"##{tables.strip()}")
    return "\n\n".join(parts)


def _real_clouds(saved: Saved, sidecar: Sidecar) -> str:
    clouds: list[dict[str, Any]] = read_json(saved.real) if saved.real.is_file() else []
    lines = []
    for cloud in clouds:
        if cloud["model"] != sidecar.model_id:
            raise InputError(f"{saved.real} was weighed with {cloud['model']}, the card is of {sidecar.model_id}")
        lines.append(
            f"* `{Path(cloud['path']).name}` (belt {cloud['belt_distance_m']:.3f} m, {cloud['true_g']:.1f} g on the "
            f"scale): **{cloud['weight_g']:.1f} g** ({cloud['low_g']:.1f} to {cloud['high_g']:.1f} g); the network "
            f"alone {cloud['network_g']:.1f} g, the volume rule {cloud['volume_g']:.1f} g."
        )
    return "## Real clouds\n\n" + "\n".join(_wrapped(line, indent="  ") for line in lines) if lines else ""


def _wrapped(text: str, *, indent: str = "") -> str:
    return "\n".join(textwrap.wrap(text, 100, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False))
