"""A training step of 32 clouds: its edges by blocks beside the same step as plain tensor operations.

    python -m benchmarks training [--rounds 5] [--threads 1]

Both take turns on the same made-up clouds, forward, backward and the optimiser's step, in both dtypes and at both
numbers of second-stage centroids; the least of the rounds counts, for other work on the machine only adds to a step.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from itertools import product
from unittest import mock

import torch

from regressor.network import reduced
from regressor.network.pointraft import PointRaft
from regressor.network.reduced import Resolution, reduced_forward

BATCH, SEED = 32, 5


def main(arguments: Sequence[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks training", description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)
    say = sys.stdout.write
    say(
        f"torch {torch.__version__}, {options.threads} threads, batches of {BATCH}, least of {options.rounds} rounds\n\n"
    )
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
        torch.nn.functional.smooth_l1_loss(found_g, weight_g, beta=20.0).backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        return time.perf_counter() - begun

    plain_s, blocks_s = [], []
    for _ in range(rounds + 1):
        with mock.patch.object(reduced, "_is_trained_here", return_value=False):
            plain_s.append(step_s())
        blocks_s.append(step_s())
    return min(plain_s[1:]), min(blocks_s[1:])
