"""`tuberline calibrate-interval`: the intervals of saved weights."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tuberline.cli.numbers import Many
from tuberline.cli.twin_told import tell_left_out, tell_twin

if TYPE_CHECKING:
    import torch


def calibrate_interval(
    weights: Path,
    /,
    *,
    data: Path,
    cache: Path | None = None,
    max_views: Many | None = None,
    compute: Literal["float32", "bfloat16"] = "float32",
) -> None:
    """Calibrate the intervals of saved weights on views with known weights; rewrites the sidecar, not the tensors.

    A training does the same at its end on its validation views. Give tubers that no training has seen, as the line
    meets them; never the set that the weights are judged on.

    Parameters
    ----------
    weights
        The .safetensors file; its .json sidecar lies beside it.
    data
        A folder of view packs (`tuberline simulate-views`) or a 3DPotatoTwin folder, of which its part `val` is read.
    cache
        Folder of prepared clouds, to save the preparing; default: none.
    max_views
        Taken evenly over the set.
    compute
        As for `train`.
    """
    import torch

    from regressor.training.calibration import recalibrate
    from regressor.training.tuber_interval import interval_told
    from tuberline.cli.progress import work_bar

    tell_twin(data)
    torch.set_num_threads(1)
    with work_bar("reading views") as on_work:
        sidecar = recalibrate(
            weights,
            data,
            cache=cache,
            max_views=max_views,
            compute=wide(compute),
            on_work=on_work,
            on_left_out=tell_left_out,
        )
    figures, counted = sidecar.metrics["calibration"], sidecar.metrics["interval"]
    sys.stderr.write(
        f"{weights.with_suffix('.json')}: calibrated on {figures['views']:.0f} views of {figures['tubers']:.0f} "
        f"tubers; views of a tuber share {100 * sidecar.shared_sd_share:.0f} % of an error, tubers of a load "
        f"{100 * sidecar.shared_bias_share:.1f} % of its weight\n"
        f"{interval_told(int(counted['tubers']), int(counted['recordings']))}\n"
    )


def wide(compute: str) -> torch.dtype | None:
    """The type of wide products; None for that of the weights."""
    import torch

    return torch.bfloat16 if compute == "bfloat16" else None
