"""A training step of 32 clouds: its edges by blocks beside plain tensor operations; and what rounding does to it.

    python -m benchmarks training [--rounds 5] [--threads 1]
    python -m benchmarks training --data packs/train --weights runs/paper/weights.safetensors

Without data: both forms take turns on the same made-up clouds, forward, backward and the optimiser's step, in both
dtypes and at both numbers of second-stage centroids; the least of the rounds counts, for other work on the machine only
adds to a step. With data: how far the gradient of a batch is turned by computing it in bfloat16, beside how far it is
turned by drawing another batch, which is the noise that a training lives with anyway.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from itertools import pairwise, product
from pathlib import Path
from unittest import mock

import numpy as np
import torch
from torch import Tensor

from benchmarks.options import parser_of, whole_number
from conveyor.errors import InputError
from regressor.network import reduced
from regressor.network.checkpoint import load_checkpoint
from regressor.network.pointraft import PointRaft
from regressor.network.reduced import Resolution, reduced_forward
from regressor.training.cloudset import load_cloudset

BATCH, BATCHES, SEED = 32, 8, 5


def main(arguments: Sequence[str]) -> int:
    """Print the table."""
    parser = parser_of("training", __doc__)
    parser.add_argument("--rounds", type=whole_number(1), default=5)
    parser.add_argument("--threads", type=whole_number(1), default=1)
    parser.add_argument("--data", type=Path, help="view pack: tell how far gradients are turned, instead of times")
    parser.add_argument("--weights", type=Path, help="where in a training; default: the shipped ones")
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)
    say = sys.stdout.write
    if options.data is not None:
        say("| gradients | turned by, median and largest, degrees |\n| --- | --- |\n")
        for name, angles in _turned(options.data, options.weights).items():
            say(f"| {name} | {np.median(angles):.1f}, {max(angles):.1f} |\n")
        return 0
    say(f"torch {torch.__version__}, {options.threads} threads, batches of {BATCH}, least of {options.rounds}\n\n")
    say("| dtype, centroids | plain s | by blocks s | ratio |\n| --- | --- | --- | --- |\n")
    for dtype, centroids in product((torch.float32, torch.bfloat16), (128, 32)):
        plain_s, blocks_s = _steps_s(dtype, Resolution(64, centroids), options.rounds)
        name = str(dtype).removeprefix("torch.")
        say(f"| {name}, {centroids} | {plain_s:.2f} | {blocks_s:.2f} | {plain_s / blocks_s:.1f} |\n")
    return 0


def _steps_s(dtype: torch.dtype, resolution: Resolution, rounds: int) -> tuple[float, float]:
    """Least seconds of a step, (plain, by blocks), after one of each to warm up."""
    torch.manual_seed(SEED)
    model = PointRaft()
    optimiser = torch.optim.Adam(model.parameters())
    points, heights_m, weight_g = torch.randn(BATCH, 128, 3) * 0.02, torch.rand(BATCH) * 0.05, torch.rand(BATCH) * 300

    def step_s() -> float:
        begun = time.perf_counter()
        optimiser.zero_grad(set_to_none=True)
        found_g = reduced_forward(model, points, heights_m, resolution=resolution, compute=dtype)
        _loss(found_g, weight_g).backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        return time.perf_counter() - begun

    plain_s, blocks_s = [], []
    for _ in range(rounds + 1):
        with mock.patch.object(reduced, "_is_trained_here", return_value=False):
            plain_s.append(step_s())
        blocks_s.append(step_s())
    return min(plain_s[1:]), min(blocks_s[1:])


def _turned(folder: Path, weights: Path | None) -> dict[str, list[float]]:
    """Degrees between gradients of all parameters, by what differs."""
    model, sidecar = load_checkpoint(weights)
    if model is None:
        raise InputError(f"{weights} holds no network")
    model.train()
    exact, narrow = [], []
    for batch in _batches(folder, highest_m=sidecar.input.max_height_m):
        exact.append(_gradient(model, batch, torch.float32))
        narrow.append(_gradient(model, batch, torch.bfloat16))
    return {
        "of one batch, float32 and bfloat16": [_degrees(a, b) for a, b in zip(exact, narrow, strict=True)],
        "of two batches, float32": [_degrees(a, b) for a, b in pairwise(exact)],
    }


def _batches(folder: Path, *, highest_m: float) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    data = load_cloudset(folder, max_views=BATCH * BATCHES)
    order = np.random.default_rng(SEED).permutation(len(data))
    for rows in np.array_split(order, BATCHES):
        heights_m = np.clip(data.height_m[rows], 0.0, highest_m)
        arrays = np.ascontiguousarray(data.points[rows, :128]), heights_m, data.weight_g[rows]
        points, heights, weight_g = (torch.from_numpy(np.asarray(array, np.float32)) for array in arrays)
        yield points, heights, weight_g


def _gradient(model: PointRaft, batch: tuple[Tensor, Tensor, Tensor], dtype: torch.dtype) -> Tensor:
    points, heights_m, weight_g = batch
    torch.manual_seed(SEED)  # the same units drop out
    model.zero_grad(set_to_none=True)
    _loss(reduced_forward(model, points, heights_m, compute=dtype), weight_g).backward()  # type: ignore[no-untyped-call]
    return torch.cat([p.grad.flatten() for p in model.parameters() if p.grad is not None])


def _loss(found_g: Tensor, weight_g: Tensor) -> Tensor:
    return torch.nn.functional.smooth_l1_loss(found_g, weight_g, beta=20.0)


def _degrees(a: Tensor, b: Tensor) -> float:
    return float(torch.rad2deg(torch.acos(torch.nn.functional.cosine_similarity(a, b, dim=0).clamp(-1, 1))))
