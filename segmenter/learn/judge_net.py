"""The judge's network and its training: a portrait in, log-odds of tuber against other out."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from segmenter.learn.blocks import averaged, convolution
from segmenter.learn.portraits import Sitter, draw_portrait, plain_portrait
from segmenter.portrait import CHANNELS

WIDTHS = (24, 48, 64, 64, 96)
STRIDES = (2, 1, 2, 1, 2)
KERNELS = (5, 3, 3, 3, 3)
SHRINKS = 8
INSIDE = 2
"""Channel of a portrait that says which cells are the instance."""


@dataclass(frozen=True, slots=True)
class JudgeRecipe:
    """How to train. `epochs` over all bodies, each time with other looks; `smoothing`: labels are 1 - that and that."""

    epochs: int = 40
    batch: int = 64
    rate: float = 4e-3
    weight_decay: float = 2e-2
    smoothing: float = 0.005
    seed: int = 1


class JudgeNet(nn.Module):
    """(B, 8, 48, 48) -> (B,), about 140 thousand parameters."""

    def __init__(self) -> None:
        super().__init__()
        inputs = (CHANNELS, *WIDTHS[:-1])
        layers = [
            convolution(a, b, stride=s, kernel=k) for a, b, s, k in zip(inputs, WIDTHS, STRIDES, KERNELS, strict=True)
        ]
        self.features = nn.Sequential(*(module for layer in layers for module in layer))
        self.head = nn.Sequential(nn.Dropout(0.1), nn.Linear(3 * WIDTHS[-1], 32), nn.ReLU(), nn.Linear(32, 1))

    def forward(self, portraits: Tensor) -> Tensor:
        """Log-odds of tuber against other."""
        found = self.features(portraits)
        # What is the body's own, whatever its size: a mean over the cells of the instance.
        # As a product of matrices: OpenCV does not spread one channel over many.
        own = nn.functional.avg_pool2d(portraits[:, INSIDE : INSIDE + 1], SHRINKS).flatten(2)
        of_body = torch.matmul(found.flatten(2), own.transpose(1, 2))[:, :, 0] / (own.sum(dim=2) + 0.1)
        odds: Tensor = self.head(torch.cat([found.mean(dim=(2, 3)), found.amax(dim=(2, 3)), of_body], dim=1))
        return odds[:, 0]


def train_judge(
    sitters: list[Sitter], recipe: JudgeRecipe, *, on_step: Callable[[int, int, float], None]
) -> tuple[JudgeNet, float]:
    """The network with averaged weights, and the processor seconds that it took.

    Its answers are freed of how many tubers there were to learn from: 0 is as likely for a tuber as for another body.
    """
    torch.manual_seed(recipe.seed)
    rng = np.random.default_rng(recipe.seed)
    net = JudgeNet()
    net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    average = torch.optim.swa_utils.AveragedModel(net, avg_fn=averaged, use_buffers=True)
    optimiser = torch.optim.AdamW(net.parameters(), lr=recipe.rate, weight_decay=recipe.weight_decay)
    per_epoch = max(1, len(sitters) // recipe.batch)
    total = recipe.epochs * per_epoch
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, recipe.rate, total_steps=total, pct_start=0.15)
    begun = time.process_time()
    order = rng.permutation(len(sitters))
    for step in range(total):
        if step % per_epoch == 0:
            order = rng.permutation(len(sitters))
        chosen = [sitters[int(n)] for n in order[step % per_epoch * recipe.batch :][: recipe.batch]]
        portraits = torch.from_numpy(np.stack([draw_portrait(sitter, rng) for sitter in chosen]))
        truth = torch.tensor([abs(float(sitter.is_tuber) - recipe.smoothing) for sitter in chosen])
        optimiser.zero_grad(set_to_none=True)
        with torch.autocast("cpu", torch.bfloat16):
            odds = net(portraits.to(memory_format=torch.channels_last))
        loss = nn.functional.binary_cross_entropy_with_logits(odds.float(), truth)
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
        average.update_parameters(net)
        on_step(step + 1, total, float(loss.detach()))
    trained = average.module
    assert isinstance(trained, JudgeNet)
    tubers = sum(sitter.is_tuber for sitter in sitters)
    last = trained.head[-1]
    assert isinstance(last, nn.Linear)
    with torch.no_grad():
        last.bias.sub_(math.log(max(1, tubers) / max(1, len(sitters) - tubers)))
    return trained.eval(), time.process_time() - begun


def judged(net: JudgeNet, sitters: list[Sitter]) -> NDArray[np.float64]:
    """(n,) log-odds of all bodies if tubers and others are as many, from all their looks."""
    odds = []
    with torch.inference_mode():
        for first in range(0, len(sitters), 256):
            portraits = np.stack([plain_portrait(sitter) for sitter in sitters[first : first + 256]])
            odds.append(net(torch.from_numpy(portraits)).numpy())
    return np.concatenate(odds).astype(np.float64)


def scores(odds: NDArray[np.float64], sitters: list[Sitter]) -> dict[str, float]:
    """How well tubers and others are told apart; shares believed at a loss of 0.3 and 1 % of the tubers, by kind."""
    tuber = np.array([sitter.is_tuber for sitter in sitters])
    tubers, others = odds[tuber], np.sort(odds[~tuber])
    found: dict[str, float] = {
        "tubers": len(tubers),
        "others": len(others),
        "auc": float(np.mean(np.searchsorted(others, tubers)) / max(1, len(others))),
    }
    for percent in (0.3, 1.0):
        least = float(np.percentile(tubers, percent))
        found[f"log_odds_at_{percent:g}_percent_of_tubers_lost"] = least
        found[f"others_believed_at_{percent:g}_percent_of_tubers_lost"] = float((others > least).mean())
        for kind in sorted({sitter.kind for sitter in sitters} - {"tuber"}):
            of_kind = odds[np.array([sitter.kind == kind for sitter in sitters])]
            found[f"{kind}_believed_at_{percent:g}_percent_of_tubers_lost"] = float((of_kind > least).mean())
    return found
