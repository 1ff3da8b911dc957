"""PointRAFT on the reduced graph, for training: same parameters, far fewer edges.

Potatoes are smaller than both search radii, so all centroids of a stage share the first 64 points in sampling order
as neighbours, and with a sampling start of 0 the centroids of both stages are prefixes of the cloud. The second stage
reads only its 64 shared neighbours, so the first stage is evaluated for 64 centroids instead of 512. In evaluation this
is exact; in training the batch statistics of stage one are those of the edges that are used.

The first layer of each stage is linear in the neighbour and in the centroid, so it is computed per point, and its
batch statistics follow from per-point moments without forming the edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from regressor.network.edge_maximum import Statistics, edge_maximum
from regressor.network.pointraft import PointRaft, SharedMlp


@dataclass(frozen=True, slots=True)
class Resolution:
    """How many shared neighbours and second-stage centroids are used; 64 and 128 are the network's own."""

    neighbours: int = 64
    centroids: int = 128


FULL = Resolution()


def reduced_forward(
    model: PointRaft,
    points: Tensor,
    heights_m: Tensor,
    *,
    resolution: Resolution = FULL,
    compute: torch.dtype | None = None,
) -> Tensor:
    """Weights of B clouds whose radius does not bind.

    Args:
        model: in train or eval mode; its batch-norm statistics are updated in train mode.
        points: (B, 128, 3), metres, centred, in sampling order.
        heights_m: (B,) metres.
        resolution: fewer neighbours and centroids for a cheap start of a training.
        compute: dtype of the wide products; bfloat16 where the processor has it, None for the model's own.

    Returns:
        (B,) grams.
    """
    neighbours = points[:, : resolution.neighbours]
    centroids = points[:, : resolution.centroids]
    return shared_forward(model, neighbours, neighbours, centroids, heights_m, compute=compute)


def shared_forward(
    model: PointRaft,
    neighbours: Tensor,
    centroids1: Tensor,
    centroids2: Tensor,
    heights_m: Tensor,
    *,
    resolution: Resolution = FULL,
    compute: torch.dtype | None = None,
) -> Tensor:
    """(B,) grams from the three lists of `SharedGroups`, (B, n, 3) each, metres, and (B,) clamped heights.

    Of `centroids2` those are used that `resolution` names. All else as in `reduced_forward`.
    """
    centroids2 = centroids2[:, : resolution.centroids]
    stage1 = edge_features(model.sa1_module.conv.local_nn, neighbours, centroids1, compute)
    pairs = torch.cat([stage1, centroids1], dim=2)
    stage2 = edge_features(model.sa2_module.conv.local_nn, pairs, centroids2, compute)
    return grams_of(model, torch.cat([stage2, centroids2], dim=2), heights_m, compute)


def grams_of(model: PointRaft, centroids: Tensor, heights_m: Tensor, compute: torch.dtype | None) -> Tensor:
    """(B,) grams: global stage and head over (B, C, 259) features and places of the second stage's centroids."""
    described = global_feature(model.sa3_module.nn, centroids, compute)
    if model.height_embed is not None:
        described = torch.cat([described, model.height_embed(heights_m[:, None])], dim=1)
    out: Tensor = model.regression_head(described)
    return out[:, 0]


def edge_features(mlp: SharedMlp, inputs: Tensor, centroids: Tensor, compute: torch.dtype | None) -> Tensor:
    """(B, C, F) features of (B, C, 3) `centroids`: max over K shared neighbours with `inputs` (B, K, G + 3)."""
    first, second, third = mlp.linear(0), mlp.linear(1), mlp.linear(2)
    from_source = inputs @ first.weight.T
    from_centroid = centroids @ first.weight[:, -3:].T
    scale, shift = _first_norm(mlp.norm(0), from_source, from_centroid, first.bias)
    return _edges_max(from_source * scale + shift, from_centroid * scale, second, mlp.norm(1), third, compute)


def _edges_max(
    source: Tensor,
    centroid: Tensor,
    second: nn.Linear,
    norm: nn.BatchNorm1d,
    third: nn.Linear,
    compute: torch.dtype | None,
) -> Tensor:
    """max over j of third(relu(norm(second(relu(source_j - centroid_i))))): (B, K, F), (B, C, F) to (B, C, O)."""
    if _is_trained_here(source):
        return _edges_max_by_blocks(source, centroid, second, norm, third, compute)
    dtype = compute or source.dtype
    batch, neighbours, width = source.shape
    pairs = torch.relu(source.to(dtype)[:, None] - centroid.to(dtype)[:, :, None]).reshape(-1, width)
    hidden = torch.relu(normed(pairs @ second.weight.T.to(dtype), second.bias, norm))
    values = (hidden @ third.weight.T.to(dtype)).reshape(batch, -1, neighbours, third.out_features)
    return values.amax(2).to(third.weight.dtype) + third.bias


def _is_trained_here(source: Tensor) -> bool:
    """Whether gradients are wanted of float32 on the CPU: then the edges are worth going through by blocks."""
    return (
        source.requires_grad
        and torch.is_grad_enabled()
        and source.device.type == "cpu"
        and source.dtype is torch.float32
    )


def _edges_max_by_blocks(
    source: Tensor,
    centroid: Tensor,
    second: nn.Linear,
    norm: nn.BatchNorm1d,
    third: nn.Linear,
    compute: torch.dtype | None,
) -> Tensor:
    """As `_edges_max`."""
    if norm.running_mean is None or norm.running_var is None:
        raise ValueError("batch norm without running statistics cannot be used here")
    # As in `normed`: a norm by the batch's own statistics cancels the bias, one by fixed statistics takes it off them.
    fixed = None if norm.training else Statistics(norm.running_mean - second.bias.detach(), norm.running_var, 0)
    out, used = edge_maximum(
        source,
        centroid,
        (second.weight, third.weight),
        (norm.weight, norm.bias),
        fixed=fixed,
        eps=norm.eps,
        compute=compute or source.dtype,
    )
    if norm.training:
        _update_running(norm, used.mean + second.bias, used.variance, used.rows)
    return out + third.bias


def normed(x: Tensor, bias: Tensor, norm: nn.BatchNorm1d) -> Tensor:
    """norm(x + bias). In train mode the bias cancels, so it is left out and only moves the running mean."""
    if norm.running_mean is None or norm.running_var is None or norm.num_batches_tracked is None:
        raise ValueError("batch norm without running statistics cannot be used here")
    if not norm.training:
        centre = norm.running_mean - bias.detach()
        return nn.functional.batch_norm(x, centre, norm.running_var, norm.weight, norm.bias, False, 0.0, norm.eps)
    momentum = norm.momentum or 0.0
    mean, variance = torch.zeros_like(norm.running_mean), torch.zeros_like(norm.running_var)
    # Momentum 1 makes batch_norm hand out the batch's own statistics, which are then mixed in with the bias.
    out = nn.functional.batch_norm(x, mean, variance, norm.weight, norm.bias, True, 1.0, norm.eps)
    with torch.no_grad():
        norm.num_batches_tracked += 1
        norm.running_mean.lerp_(mean + bias, momentum)
        norm.running_var.lerp_(variance, momentum)
    return out


def _first_norm(norm: nn.BatchNorm1d, source: Tensor, centroid: Tensor, bias: Tensor) -> tuple[Tensor, Tensor]:
    """Scale and shift of the batch norm over all edges source_j - centroid_i + bias, from per-point moments."""
    if not norm.training:
        if norm.running_mean is None or norm.running_var is None:
            raise ValueError("batch norm without running statistics cannot be evaluated")
        scale = norm.weight / torch.sqrt(norm.running_var + norm.eps)
        return scale, norm.bias + (bias - norm.running_mean) * scale
    mean_s, mean_c = source.mean(1), centroid.mean(1)
    mean = (mean_s - mean_c).mean(0)
    square = (source.square().mean(1) + centroid.square().mean(1) - 2 * mean_s * mean_c).mean(0)
    variance = square - mean.square()
    edges = source.shape[0] * source.shape[1] * centroid.shape[1]
    _update_running(norm, mean + bias, variance, edges)
    scale = norm.weight * torch.rsqrt(variance + norm.eps)
    return scale, norm.bias - mean * scale


def _update_running(norm: nn.BatchNorm1d, mean: Tensor, variance: Tensor, rows: int) -> None:
    """Move the running statistics as `BatchNorm1d` does (unbiased variance, momentum)."""
    momentum = norm.momentum
    if norm.running_mean is None or norm.running_var is None or momentum is None or norm.num_batches_tracked is None:
        raise ValueError("batch norm without running statistics cannot be trained here")
    with torch.no_grad():
        norm.num_batches_tracked += 1
        norm.running_mean.lerp_(mean.detach().to(norm.running_mean.dtype), momentum)
        norm.running_var.lerp_(variance.detach().to(norm.running_var.dtype) * rows / max(rows - 1, 1), momentum)


def global_feature(mlp: SharedMlp, inputs: Tensor, compute: torch.dtype | None) -> Tensor:
    """(B, O): a shared MLP over (B, C, G) `inputs`, then the max over C."""
    x = inputs.flatten(0, 1)
    for index in range(len(mlp.norms)):
        x = torch.relu(mlp.norm(index)(_linear(x, mlp.linear(index), compute)))
    values = _linear(x, mlp.linear(len(mlp.norms)), compute)
    return values.reshape(*inputs.shape[:2], -1).amax(1)


def _linear(x: Tensor, lin: nn.Linear, compute: torch.dtype | None) -> Tensor:
    if compute is None:
        out: Tensor = lin(x)
        return out
    return (x.to(compute) @ lin.weight.T.to(compute)).to(lin.weight.dtype) + lin.bias
