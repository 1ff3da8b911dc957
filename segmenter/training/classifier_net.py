"""The classifier's network and its training: a patch in, log-odds of tuber against other out."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.utils.data import DataLoader, IterableDataset

from segmenter.classify.patch import CHANNELS
from segmenter.training.blocks import averaged, convolution
from segmenter.training.patches import draw_patches, plain_patches
from segmenter.training.samples import TrainingSample

WIDTHS = (24, 48, 64, 64, 96)
STRIDES = (2, 1, 2, 1, 2)
KERNELS = (5, 3, 3, 3, 3)
SHRINKS = 8
INSIDE = 2
"""Channel of a patch that says which cells are the instance."""


@dataclass(frozen=True, slots=True)
class ClassifierRecipe:
    """How to train. `epochs` over all bodies, with other observations each time; labels: `smoothing`, 1 - that.

    `start_share`: of the network to start from, in what is written: the mean of both knows the new bodies and keeps
    what the old ones taught (Wortsman et al., arXiv 2109.01903). `stretch`: by which its answers
    are multiplied then, for a mean of two is less sure than each of them (Guo et al., arXiv 1706.04599).
    """

    epochs: int = 40
    batch: int = 64
    rate: float = 4e-3
    weight_decay: float = 2e-2
    smoothing: float = 0.005
    seed: int = 1
    start_share: float = 0.0
    stretch: float = 1.0


class ClassifierNet(nn.Module):
    """(B, 10, 48, 48) -> (B,), about 150 thousand parameters."""

    def __init__(self) -> None:
        super().__init__()
        inputs = (CHANNELS, *WIDTHS[:-1])
        layers = [
            convolution(a, b, stride=s, kernel=k) for a, b, s, k in zip(inputs, WIDTHS, STRIDES, KERNELS, strict=True)
        ]
        self.features = nn.Sequential(*(module for layer in layers for module in layer))
        self.head = nn.Sequential(nn.Dropout(0.1), nn.Linear(3 * WIDTHS[-1], 32), nn.ReLU(), nn.Linear(32, 1))

    def forward(self, patches: Tensor) -> Tensor:
        """Log-odds of tuber against other."""
        found = self.features(patches)
        # What is the body's own, whatever its size: a mean over the cells of the instance.
        own = nn.functional.avg_pool2d(patches[:, INSIDE : INSIDE + 1], SHRINKS).flatten(2)
        of_body = torch.matmul(found.flatten(2), own.transpose(1, 2))[:, :, 0] / (own.sum(dim=2) + 0.1)
        odds: Tensor = self.head(torch.cat([found.mean(dim=(2, 3)), found.amax(dim=(2, 3)), of_body], dim=1))
        return odds[:, 0]


class _Batches(IterableDataset[tuple[Tensor, Tensor]]):
    """All batches of a training in their order: patches (B, 10, 48, 48) and labels (B,)."""

    def __init__(self, samples: list[TrainingSample], recipe: ClassifierRecipe) -> None:
        self.samples, self.recipe = samples, recipe
        self.per_epoch = max(1, len(samples) // recipe.batch)

    def __len__(self) -> int:
        return self.recipe.epochs * self.per_epoch

    def __iter__(self) -> Iterator[tuple[Tensor, Tensor]]:
        cv2.setNumThreads(1)
        rng = np.random.default_rng(self.recipe.seed)
        for _ in range(self.recipe.epochs):
            order = rng.permutation(len(self.samples))
            for n in range(self.per_epoch):
                chosen = [self.samples[k] for k in order[n * self.recipe.batch :][: self.recipe.batch].tolist()]
                truth = [abs(float(sample.is_tuber) - self.recipe.smoothing) for sample in chosen]
                yield torch.from_numpy(draw_patches(chosen, rng)), torch.tensor(truth)


def train_classifier(
    samples: list[TrainingSample],
    recipe: ClassifierRecipe,
    *,
    on_step: Callable[[int, int, float], None],
    start: ClassifierNet | None = None,
) -> tuple[ClassifierNet, float]:
    """The network with averaged weights, and the processor seconds of this process; a second one draws the patches.

    Its answers are freed of how many tubers there were to learn from: 0 is as likely for a tuber as for another body.

    Args:
        start: an earlier training's network, which learns on; None: one that knows nothing.
    """
    torch.manual_seed(recipe.seed)
    net = ClassifierNet()
    if start is not None:
        net.load_state_dict(start.state_dict())
    net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    average = torch.optim.swa_utils.AveragedModel(net, avg_fn=averaged, use_buffers=True)
    optimiser = torch.optim.AdamW(net.parameters(), lr=recipe.rate, weight_decay=recipe.weight_decay)
    batches = _Batches(samples, recipe)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, recipe.rate, total_steps=len(batches), pct_start=0.15)
    begun = time.process_time()
    # Where the processor has no bfloat16, products of it take thirty times as long.
    halves = torch.ops.mkldnn._is_mkldnn_bf16_supported()
    # Patches are drawn beside the training: they cost half as much as a step.
    for step, (patches, truth) in enumerate(DataLoader(batches, batch_size=None, num_workers=1, prefetch_factor=8)):
        optimiser.zero_grad(set_to_none=True)
        with torch.autocast("cpu", torch.bfloat16, enabled=halves):
            odds = net(patches.to(memory_format=torch.channels_last))
        loss = nn.functional.binary_cross_entropy_with_logits(odds.float(), truth)
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
        average.update_parameters(net)
        on_step(step + 1, len(batches), float(loss.detach()))
    trained = average.module
    assert isinstance(trained, ClassifierNet)
    tubers = sum(sample.is_tuber for sample in samples)
    last = trained.head[-1]
    assert isinstance(last, nn.Linear)
    with torch.no_grad():
        last.bias.sub_(math.log(max(1, tubers) / max(1, len(samples) - tubers)))
        if start is not None:
            for mine, theirs in zip(trained.state_dict().values(), start.state_dict().values(), strict=True):
                if mine.is_floating_point():
                    mine.lerp_(theirs, recipe.start_share)
        last.weight.mul_(recipe.stretch)
        last.bias.mul_(recipe.stretch)
    return trained.eval(), time.process_time() - begun


def classified(net: ClassifierNet, samples: list[TrainingSample]) -> NDArray[np.float64]:
    """(n,) log-odds of all bodies if tubers and others are as many, from all their observations."""
    parts = [samples[first : first + 256] for first in range(0, len(samples), 256)]
    with torch.inference_mode():
        odds = [net(torch.from_numpy(plain_patches(part))).numpy() for part in parts]
    return np.concatenate(odds).astype(np.float64)


def scores(odds: NDArray[np.float64], samples: list[TrainingSample]) -> dict[str, float]:
    """How well tubers and others are told apart; shares believed at a loss of 0.3 and 1 % of the tubers, by kind."""
    tuber = np.array([sample.is_tuber for sample in samples])
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
        for kind in sorted({sample.kind for sample in samples} - {"tuber"}):
            of_kind = odds[np.array([sample.kind == kind for sample in samples])]
            found[f"{kind}_believed_at_{percent:g}_percent_of_tubers_lost"] = float((of_kind > least).mean())
    return found
