"""`tuberline calibrate-blend`: the volume rule of saved weights, and its blend with the network."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from tuberline.cli.calibrate_interval import wide
from tuberline.cli.twin_told import tell_left_out, tell_twin


def calibrate_blend(
    weights: Path,
    /,
    *,
    data: Path,
    unseen: Path,
    cache: Path | None = None,
    correction: Annotated[bool, Parameter(negative="--no-correction")] = True,
    compute: Literal["float32", "bfloat16"] = "float32",
) -> None:
    """Fit the volume rule of saved weights and its blend with the network again; rewrites the sidecar, not the tensors.

    Calibrate the intervals after it, on other views again (`tuberline calibrate-interval`).

    Parameters
    ----------
    weights
        The .safetensors file; its .json sidecar lies beside it.
    data
        Views for the rule alone: a folder of view packs, those that the network was trained on say, or a 3DPotatoTwin
        folder, of which its part `train` is read.
    unseen
        Views of recordings that the network has not seen, for the rule and the blend.
    cache
        Folder of prepared clouds, to save the preparing; default: none.
    correction
        For the weight and the rim that was lost, where views differ in it; off fits the rule and the network's share
        alone.
    compute
        As for `train`.
    """
    import torch

    from regressor.training.stacking import restack
    from tuberline.cli.progress import work_bar

    tell_twin(data, unseen)
    torch.set_num_threads(1)
    with work_bar("reading views") as on_work:
        sidecar = restack(
            weights,
            data,
            unseen,
            cache=cache,
            correction=correction,
            compute=wide(compute),
            on_work=on_work,
            on_left_out=tell_left_out,
        )
    figures = sidecar.metrics["blend"]
    corrected = "nothing"
    if correction and sidecar.blend_rule.seen:
        corrected = "the weight and the rim that was lost"
    elif correction:
        corrected = f"the weight alone: the rim that was lost (rim_lost) is unknown, or the same in all of {unseen}"
    sys.stderr.write(
        f"{weights.with_suffix('.json')}: {100 * (1 - sidecar.volume_share):.0f} % network, "
        f"{100 * sidecar.volume_share:.0f} % volume rule; MAE {figures['mae_g']:.2f} {sidecar.unit} on the unseen "
        f"views; corrected for {corrected}\n"
    )
