"""Training of the network of cells: a fixed number of steps, the same seed and machine give the same weights."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from segmenter.classes import OTHER, TUBER, as_channels
from segmenter.training.blocks import averaged
from segmenter.training.cells_crops import Crop, draw_crop
from segmenter.training.cells_net import BeltNet
from segmenter.training.pack import LabelledGrid

LEAST_CELLS = 20
"""Output cells of a body that is judged as a whole."""
LOG_ODDS_CAP = 6.0
CLASS_WEIGHTS = (1.0, 1.0, 2.0)
"""Of belt, tuber, other: distractors are smaller and fewer."""


@dataclass(frozen=True, slots=True)
class CellsRecipe:
    """How to train. 2400 steps take about three minutes of one core."""

    steps: int = 2400
    batch: int = 8
    rate: float = 4e-3
    weight_decay: float = 1e-3
    seed: int = 1
    body_weight: float = 2.0
    offset_weight: float = 0.5


def train_cells(
    grids: list[LabelledGrid], recipe: CellsRecipe, *, on_step: Callable[[int, float], None] = lambda step, loss: None
) -> tuple[BeltNet, float]:
    """The network with averaged weights, and the processor seconds that it took."""
    torch.manual_seed(recipe.seed)
    rng = np.random.default_rng(recipe.seed)
    net = BeltNet()
    average = torch.optim.swa_utils.AveragedModel(net, avg_fn=averaged, use_buffers=True)
    optimiser = torch.optim.AdamW(net.parameters(), lr=recipe.rate, weight_decay=recipe.weight_decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, recipe.rate, total_steps=recipe.steps, pct_start=0.1)
    begun = time.process_time()
    net.train()
    for step in range(recipe.steps):
        crops = [draw_crop(grids[int(n)], rng) for n in rng.integers(0, len(grids), recipe.batch)]
        optimiser.zero_grad(set_to_none=True)
        loss = _loss(net, crops, recipe)
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
        average.update_parameters(net)
        on_step(step + 1, float(loss.detach()))
    trained = average.module
    assert isinstance(trained, BeltNet)
    return trained.eval(), time.process_time() - begun


def _loss(net: BeltNet, crops: list[Crop], recipe: CellsRecipe) -> Tensor:
    """Cell by cell: class, and way to the tuber's centre. Body by body: tuber or other."""
    answer = net(torch.from_numpy(np.stack([c.image for c in crops])))
    classes = torch.from_numpy(np.stack([c.classes for c in crops]).astype(np.int64))
    loss = nn.functional.cross_entropy(answer[:, :3], classes, weight=torch.tensor(CLASS_WEIGHTS))
    tuber = classes == TUBER
    if tuber.any():
        towards = torch.from_numpy(np.stack([c.towards for c in crops]))
        away = nn.functional.smooth_l1_loss(answer[:, 3:], towards, reduction="none", beta=0.2).sum(dim=1)
        loss = loss + recipe.offset_weight * away[tuber].mean()
    bodies = torch.from_numpy(np.stack([c.bodies for c in crops]).astype(np.int64))
    odds, is_tuber = _judged(answer, bodies, tuber)
    if len(odds):
        loss = loss + recipe.body_weight * nn.functional.binary_cross_entropy_with_logits(odds, is_tuber)
    return loss


def _judged(answer: Tensor, bodies: Tensor, tuber: Tensor) -> tuple[Tensor, Tensor]:
    """(n,) log-odds of each body, the mean over its load cells, and (n,) 1 where it is a tuber."""
    most = int(bodies.max()) + 1
    named = (bodies + most * torch.arange(len(bodies))[:, None, None]).flatten()
    load = torch.sigmoid(torch.logsumexp(answer[:, 1:3], dim=1) - answer[:, 0]).flatten()
    odds = (answer[:, TUBER] - answer[:, OTHER]).clamp(-LOG_ODDS_CAP, LOG_ODDS_CAP).flatten()
    size = most * len(bodies)
    weight = torch.zeros(size).index_add(0, named, load)
    total = torch.zeros(size).index_add(0, named, load * odds)
    cells = torch.bincount(named, minlength=size)
    tubers = torch.zeros(size).index_add(0, named, tuber.flatten().float())
    judged = (cells >= LEAST_CELLS) & (torch.arange(size) % most > 0)
    return total[judged] / weight[judged].clamp(min=1e-6), (tubers[judged] > 0.5).float()


def agreement(net: BeltNet, grids: list[LabelledGrid]) -> dict[str, float]:
    """Overlap of found and true cells (intersection over union) by class, on whole frames."""
    hits, either = np.zeros(3), np.zeros(3)
    for grid in grids:
        image = as_channels(grid.height_mm, grid.seen.astype(np.float32) / np.float32(255))
        with torch.inference_mode():
            answer = net(torch.from_numpy(image[None]))[0].numpy()
        rows, columns = grid.classes.shape
        found = answer[:3, :rows, :columns].argmax(axis=0)
        for name in range(3):
            hits[name] += ((found == name) & (grid.classes == name)).sum()
            either[name] += ((found == name) | (grid.classes == name)).sum()
    shares = hits / np.maximum(either, 1)
    return {f"iou_{name}": float(share) for name, share in zip(("belt", "tuber", "other"), shares, strict=True)}
