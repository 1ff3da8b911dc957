"""PointRAFT's shape in numbers, without torch: radii, neighbours, widths, and what its parameters are called.

A line that weighs needs these and the parameters, and does not wait two seconds for torch. The names are those of the
authors' checkpoint; `regressor.network.pointraft` builds the network from the same numbers.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

NEIGHBOURS = 64
RADIUS_1_M, RADIUS_2_M = 0.2, 0.4
RATIO_1, RATIO_2 = 0.5, 0.25
STAGE_1, STAGE_2, STAGE_3 = (3, 64, 64, 128), (128 + 3, 128, 128, 256), (256 + 3, 256, 512, 1024)
"""Widths of the shared MLPs of the three set abstractions, from what goes in to what comes out."""
HEIGHT = (1, 32, 32)
HEAD = (512, 256, 1)
"""Without what goes in (`head_widths`)."""
STAGES = {"sa1_module.conv.local_nn": STAGE_1, "sa2_module.conv.local_nn": STAGE_2, "sa3_module.nn": STAGE_3}
"""The shared MLPs by the names before their parameters."""
HEIGHT_NAME, HEAD_NAME = "height_embed", "regression_head"
NORM_EPSILON = 1e-5
"""Added to the variances of batch norms, as torch does."""


def head_widths(*, height_embedding: bool) -> tuple[int, ...]:
    """Widths of the head, which reads the whole cloud's features and, where there is one, the height's."""
    return (STAGE_3[-1] + (HEIGHT[-1] if height_embedding else 0), *HEAD)


def parameter_shapes(*, height_embedding: bool) -> dict[str, tuple[int, ...]]:
    """Shape of every parameter by its name, in the order of the network's state dict."""
    mlps: list[tuple[str, tuple[int, ...], bool]] = [(name, widths, True) for name, widths in STAGES.items()]
    if height_embedding:
        mlps.append((HEIGHT_NAME, HEIGHT, True))
    mlps.append((HEAD_NAME, head_widths(height_embedding=height_embedding), False))
    return {name: shape for mlp, widths, norm in mlps for name, shape in _shapes(mlp, widths, norm=norm)}


def _shapes(mlp: str, widths: tuple[int, ...], *, norm: bool) -> Iterator[tuple[str, tuple[int, ...]]]:
    for index, (before, after) in enumerate(pairwise(widths)):
        yield f"{mlp}.lins.{index}.weight", (after, before)
        yield f"{mlp}.lins.{index}.bias", (after,)
    for index, width in enumerate(widths[1:-1] if norm else ()):
        for name in ("weight", "bias", "running_mean", "running_var"):
            yield f"{mlp}.norms.{index}.module.{name}", (width,)
        yield f"{mlp}.norms.{index}.module.num_batches_tracked", ()
