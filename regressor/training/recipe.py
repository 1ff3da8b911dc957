"""Recipes of a training: the paper's and ours."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from conveyor.errors import InputError
from regressor.network.architecture import NEIGHBOURS
from regressor.network.grouping import CLOUD_POINTS, stage_counts
from regressor.network.networks import POINTNET_POINTS, Kind
from regressor.network.pointraft import DROPOUT
from regressor.network.reduced import Resolution
from regressor.training.augment import Augmentation
from regressor.training.cloudset import KEEP, Target
from regressor.weigh.prepare import MAX_HEIGHT_M

OURS = Augmentation()
DECAY = 0.97
"""Of the paper's learning rate, an epoch."""
MOST = 1e6
"""Epochs, minutes (two years), clouds per step: more are a slip of the hand, and steps that cannot be counted."""


@dataclass(frozen=True, slots=True)
class TrainSettings:
    """A recipe. The defaults are ours; `paper()` is the paper's.

    Attributes:
        epochs: passes over the training set; minutes: stop by the clock instead (epochs is then ignored).
        final_lr: learning rate at the end, as a share of `lr`; it falls exponentially (`schedule` 'exponential', the
            paper's 0.97 per epoch; over 50 of them where it trains by the clock) or along a cosine.
        natural_share: last share of the training that draws clouds as they come instead of balanced by weight class.
        warm_share, wide_share: share of the training at 32 neighbours and 32 centroids, and from there on with all
            neighbours but 32 centroids; the rest runs at full resolution.
        average: decay of the moving average of the weights that is evaluated and shipped; 0 ships the last ones.
        start_share: of the weights to start from in what is shipped: the mean of both knows the new views and keeps
            what the old ones taught (Wortsman et al., arXiv 2109.01903); 0 ships the trained ones.
        target: what is learned; where the code says weight and grams, read this target and its unit.
        network: 'pointraft', or the baseline 'pointnet', which has neither groups nor a height.
        points: of a cloud that the network is given: 1024, or 512 or 2048 as in the paper's ablation.
        max_height_m: clamp of the height above the belt. The paper's 80 mm hide how tall an upright tuber is.
        frozen_share: last share of the training with batch-norm statistics fixed at their average: it halved the loss.
        best_epoch: write the weights of the epoch with the least validation loss, as the paper's code does, instead of
            the last ones.
        compute: 'float32', or 'bfloat16' for the wide products.
        device: 'cpu', or 'cuda' where there is a GPU; clouds are drawn and augmented on the CPU either way.
    """

    epochs: float = 50.0
    minutes: float | None = None
    batch: int = 32
    lr: float = 1e-3
    weight_decay: float = 1e-4
    schedule: str = "cosine"
    final_lr: float = 0.01
    beta_g: float = 20.0
    dropout: float = 0.1
    balanced: bool = True
    natural_share: float = 0.45
    warm_share: float = 0.0
    wide_share: float = 0.97
    average: float = 0.999
    start_share: float = 0.0
    height_embedding: bool = True
    points: int = CLOUD_POINTS
    max_height_m: float = 0.16
    frozen_share: float = 0.35
    best_epoch: bool = False
    compute: str = "float32"
    device: str = "cpu"
    seed: int = 133
    augmentation: Augmentation = OURS
    network: Kind = "pointraft"
    target: Target = "weight_g"

    @property
    def full(self) -> Resolution:
        """The network's own resolution: all neighbours, and the second-stage centroids of a cloud of `points`."""
        return Resolution(NEIGHBOURS, stage_counts(self.points)[1])

    @property
    def read_points(self) -> int:
        """How many points of a cloud, in sampling order, a step reads."""
        return POINTNET_POINTS if self.network == "pointnet" else max(NEIGHBOURS, self.full.centroids)

    @property
    def kept_points(self) -> int:
        """How many points of a cloud are kept to draw a step's points from."""
        return max(KEEP, self.read_points)

    @classmethod
    def paper(cls) -> TrainSettings:
        """The paper's recipe, with augmentation fresh in every epoch."""
        return cls(
            schedule="exponential",
            final_lr=DECAY**50,
            dropout=DROPOUT,
            natural_share=0.0,
            warm_share=0.0,
            wide_share=0.0,
            average=0.0,
            max_height_m=MAX_HEIGHT_M,
            frozen_share=0.0,
            best_epoch=True,
            augmentation=Augmentation.paper(),
        )

    @classmethod
    def fine_tuning(cls) -> TrainSettings:
        """From trained weights to better ones, or to another crop: all of it as a prediction will see it.

        Clouds as they come, batch-norm statistics fixed, and of the augmentation only what is a symmetry of a belt:
        turns and flips. Changes of scale make a set whose weights are not those of the tubers (+2 % in the mean). No
        dropout: with it the head learns to answer too high, so that its answers come out right while part of it is
        missing (median +4.5 g on the very views that were trained on).
        """
        return cls(
            epochs=2.0,
            lr=5e-4,
            dropout=0.0,
            natural_share=1.0,
            frozen_share=1.0,
            wide_share=0.95,
            augmentation=Augmentation(jitter_m=0.0, tilt_deg=0.0, plane_shear=0.0, scale=0.0),
        )

    def resolution(self, share: float) -> Resolution:
        """Resolution after `share` (0..1) of the training."""
        if share < self.warm_share:
            return Resolution(32, 32)
        return Resolution(64, 32) if share < self.warm_share + self.wide_share else self.full

    def learning_rate(self, share: float) -> float:
        """Learning rate after `share` (0..1) of the training."""
        if self.schedule == "exponential":
            return self.lr * float(self.final_lr**share)
        return self.lr * float(self.final_lr + (1 - self.final_lr) * 0.5 * (1 + np.cos(np.pi * share)))


def recipe_named(name: str, *, shear: float | None, **given: Any) -> TrainSettings:
    """The recipe 'tuberline', 'paper' or 'fine-tune' with what is `given` in place of its own; None is not given.

    Raises:
        InputError: a share that is none, a number of what there must be some of that is 0 or less, or a batch of one
            cloud where batch norm learns from it.
    """
    share = given.get("start_share")
    if share is not None and not 0 <= share <= 1:
        raise InputError(f"--start-share is {share:g}; a share lies between 0 and 1")
    for option in ("epochs", "minutes", "batch", "lr"):
        if (value := given.get(option)) is not None and not 0 < value < np.inf:
            raise InputError(f"--{option} is {value:g}; it must be above 0")
        if value is not None and value > MOST:
            raise InputError(f"--{option} is {value:g}; at most {MOST:g} is allowed")
    if given.get("epochs") is not None and given.get("minutes") is not None:
        raise InputError(
            f"--epochs {given['epochs']:g} and --minutes {given['minutes']:g} both say when a training ends: give one"
        )
    recipes = {"tuberline": TrainSettings, "paper": TrainSettings.paper, "fine-tune": TrainSettings.fine_tuning}
    settings = replace(recipes[name](), **{key: value for key, value in given.items() if value is not None})
    if name == "paper" and given.get("epochs") is not None:
        settings = replace(settings, final_lr=float(DECAY**settings.epochs))
    if settings.batch == 1 and settings.frozen_share < 1:
        raise InputError("--batch is 1; at least 2 clouds are needed: batch norm takes its statistics from a step's")
    if settings.target == "length_mm":  # stretch and shear in the plane keep a volume and no length
        settings = replace(settings, augmentation=replace(settings.augmentation, plane_shear=0.0))
    return settings if shear is None else replace(settings, augmentation=replace(settings.augmentation, shear=shear))
