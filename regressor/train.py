"""Training on prepared clouds: resumable, by epochs or by the clock, with the paper's recipe or ours.

The reduced graph (`regressor.reduced`) makes an epoch affordable on a CPU, and a training may start at a low
resolution (32 neighbours, 32 centroids) and end at the network's own. The state is written every few minutes,
atomically, and holds everything: a resumed training takes the steps an unbroken one would take from there.
"""

from __future__ import annotations

import csv
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from conveyor.errors import InputError
from regressor.augment import Augmentation, augmented_batch
from regressor.cloudset import CloudSet
from regressor.pointraft import DROPOUT, PointRaft
from regressor.reduced import FULL, Resolution, reduced_forward

CLASS_G = 50.0
CLASSES = 10
LOG_FIELDS = ("minutes", "step", "epoch", "share", "neighbours", "centroids", "lr", "loss", "val_loss", "val_mae_g")

OURS = Augmentation()


@dataclass(frozen=True, slots=True)
class TrainSettings:
    """A recipe. The defaults are ours; `paper()` is the paper's.

    Attributes:
        epochs: passes over the training set; minutes: stop by the clock instead (epochs is then ignored).
        final_lr: learning rate at the end, as a share of `lr`; it falls exponentially (`schedule` 'exponential', the
            paper's 0.97 per epoch over 50 epochs) or along a cosine.
        natural_share: last share of the training that draws clouds as they come instead of balanced by weight class.
        warm_share, wide_share: share of the training at 32 neighbours and 32 centroids, and from there on with all
            neighbours but 32 centroids; the rest runs at full resolution.
        average: decay of the moving average of the weights that is evaluated and shipped; 0 ships the last ones.
        settle_batches: batches that the batch-norm statistics of the final weights are taken from.
        compute: 'float32', or 'bfloat16' for the wide products.
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
    natural_share: float = 0.3
    warm_share: float = 0.4
    wide_share: float = 0.45
    average: float = 0.999
    height_embedding: bool = True
    settle_batches: int = 120
    compute: str = "float32"
    seed: int = 133
    augmentation: Augmentation = OURS

    @classmethod
    def paper(cls) -> TrainSettings:
        """The paper's recipe, with augmentation fresh in every epoch."""
        return cls(
            schedule="exponential",
            final_lr=0.97**50,
            dropout=DROPOUT,
            natural_share=0.0,
            warm_share=0.0,
            wide_share=0.0,
            average=0.0,
            augmentation=Augmentation.paper(),
        )

    def resolution(self, share: float) -> Resolution:
        """Resolution after `share` (0..1) of the training."""
        if share < self.warm_share:
            return Resolution(32, 32)
        return Resolution(64, 32) if share < self.warm_share + self.wide_share else FULL

    def learning_rate(self, share: float) -> float:
        """Learning rate after `share` (0..1) of the training."""
        if self.schedule == "exponential":
            return self.lr * float(self.final_lr**share)
        return self.lr * float(self.final_lr + (1 - self.final_lr) * 0.5 * (1 + np.cos(np.pi * share)))


@dataclass(slots=True)
class Progress:
    """Where a training stands. `seconds` counts time spent training over all its sessions."""

    step: int = 0
    seconds: float = 0.0
    loss: float = float("nan")
    best_mae_g: float = float("inf")


class Training:
    """One training: model, its moving average, optimiser, draws and log."""

    def __init__(self, data: CloudSet, validation: CloudSet, settings: TrainSettings) -> None:
        if len(data) < settings.batch:
            raise InputError(f"{len(data)} training views are fewer than one batch of {settings.batch}")
        torch.manual_seed(settings.seed)
        self.settings = settings
        self.data = data
        self.validation = validation
        self.rng = np.random.default_rng(settings.seed)
        self.model = PointRaft(height_embedding=settings.height_embedding, dropout=settings.dropout)
        start_at_mean(self.model, data.weight_g)
        self.average = {name: value.clone() for name, value in self.model.state_dict().items()}
        self.optimiser = torch.optim.Adam(self.model.parameters(), lr=settings.lr, weight_decay=settings.weight_decay)
        self.progress = Progress()
        self._weights = class_weights(data.weight_g)

    @property
    def share(self) -> float:
        """How much of the training is done, 0..1."""
        if self.settings.minutes is not None:
            return min(1.0, self.progress.seconds / (60 * self.settings.minutes))
        return min(1.0, self.progress.step / max(1, self.total_steps))

    @property
    def total_steps(self) -> int:
        """Steps of a training by epochs."""
        return round(self.settings.epochs * len(self.data) / self.settings.batch)

    def step(self) -> float:
        """One batch, forward and backward; its loss."""
        begun = time.perf_counter()
        share = self.share
        for group in self.optimiser.param_groups:
            group["lr"] = self.settings.learning_rate(share)
        points, heights, weights = self._batch(self.rng)
        self.model.train()
        self.optimiser.zero_grad(set_to_none=True)
        predicted = reduced_forward(
            self.model, points, heights, resolution=self.settings.resolution(share), compute=self.compute
        )
        loss = nn.functional.smooth_l1_loss(predicted, weights, beta=self.settings.beta_g)
        loss.backward()  # type: ignore[no-untyped-call]
        self.optimiser.step()
        self._update_average()
        self.progress.step += 1
        self.progress.seconds += time.perf_counter() - begun
        value = float(loss.detach())
        old = self.progress.loss
        self.progress.loss = value if not np.isfinite(old) else 0.99 * old + 0.01 * value
        return value

    @property
    def compute(self) -> torch.dtype | None:
        """Dtype of the wide products; None is the model's own."""
        return torch.bfloat16 if self.settings.compute == "bfloat16" else None

    @property
    def natural(self) -> bool:
        """The last part of the training: clouds drawn as they come, and sampled as a prediction samples them."""
        return not self.settings.balanced or self.share >= 1 - self.settings.natural_share

    def _batch(self, rng: np.random.Generator) -> tuple[Tensor, Tensor, Tensor]:
        natural = self.natural
        rows = rng.choice(len(self.data), self.settings.batch, p=None if natural else self._weights)
        arrays = augmented_batch(
            self.data.points[rows],
            self.data.height_m[rows],
            self.data.weight_g[rows],
            rng,
            self.settings.augmentation,
            resample=not (natural and self.settings.natural_share > 0),
        )
        points, heights, weights = (torch.from_numpy(np.ascontiguousarray(array)) for array in arrays)
        return points, heights, weights

    def _update_average(self) -> None:
        # The average starts short, so that it forgets the first steps' weights.
        decay = min(self.settings.average, (1 + self.progress.step) / (10 + self.progress.step))
        with torch.no_grad():
            for name, value in self.model.state_dict().items():
                if value.is_floating_point():
                    self.average[name].lerp_(value, 1 - decay)
                else:
                    self.average[name].copy_(value)

    def finished_model(self, *, batches: int, compute: torch.dtype | None = None) -> PointRaft:
        """The averaged model in eval mode, with batch-norm statistics of `batches` batches as they are drawn now."""
        model = PointRaft(height_embedding=self.settings.height_embedding, dropout=self.settings.dropout)
        model.load_state_dict(self.average if self.settings.average else self.model.state_dict())
        rng = np.random.default_rng(self.settings.seed + 1)
        settle_statistics(model, (self._batch(rng) for _ in range(batches)), compute=compute)
        return model.eval()

    def state(self) -> dict[str, Any]:
        """Everything needed to go on."""
        return {
            "settings": asdict(self.settings),
            "model": self.model.state_dict(),
            "average": self.average,
            "optimiser": self.optimiser.state_dict(),
            "rng": self.rng.bit_generator.state,
            "torch_rng": torch.get_rng_state(),
            "progress": asdict(self.progress),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from `state()`."""
        self.model.load_state_dict(state["model"])
        self.average = state["average"]
        self.optimiser.load_state_dict(state["optimiser"])
        self.rng.bit_generator.state = state["rng"]
        torch.set_rng_state(state["torch_rng"])
        self.progress = Progress(**state["progress"])


def start_at_mean(model: PointRaft, weight_g: NDArray[np.float64]) -> None:
    """Let the last layer start at the mean weight and with a spread of grams: Adam would take thousands of steps."""
    last: nn.Linear = model.regression_head.lins[-1]  # type: ignore[assignment]
    with torch.no_grad():
        last.weight.mul_(float(np.std(weight_g)) / 2)
        last.bias.fill_(float(np.mean(weight_g)))


def class_weights(weight_g: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) chance of each view so that the 10 weight classes of 50 g are drawn equally often (the last is open)."""
    owner = np.minimum(weight_g // CLASS_G, CLASSES - 1).astype(np.int64)
    weights = 1.0 / np.bincount(owner, minlength=CLASSES)[owner]
    chances: NDArray[np.float64] = weights / weights.sum()
    return chances


def settle_statistics(
    model: PointRaft, batches: Iterable[tuple[Tensor, Tensor, Tensor]], *, compute: torch.dtype | None = None
) -> None:
    """Replace the batch-norm statistics by their plain mean over `batches`, at full resolution."""
    norms = [module for module in model.modules() if isinstance(module, nn.BatchNorm1d)]
    model.train()
    with torch.no_grad():
        for done, (points, heights, _) in enumerate(batches):
            for norm in norms:
                norm.momentum = 1.0 / (done + 1)
            reduced_forward(model, points, heights, compute=compute)
    for norm in norms:
        norm.momentum = 0.1


def predict(
    model: PointRaft, data: CloudSet, *, batch: int = 32, compute: torch.dtype | None = None
) -> NDArray[np.float64]:
    """(n,) grams by the readable parameters on the reduced graph, full resolution."""
    model.eval()
    out = []
    with torch.inference_mode():
        for begin in range(0, len(data), batch):
            rows = slice(begin, begin + batch)
            heights = np.clip(data.height_m[rows], 0.0, 0.08).astype(np.float32)
            points = torch.from_numpy(np.ascontiguousarray(data.points[rows, :128]))
            out.append(reduced_forward(model, points, torch.from_numpy(heights), compute=compute).numpy())
    return np.concatenate(out).astype(np.float64)


def run_training(
    training: Training,
    *,
    out: Path,
    save_minutes: float,
    validate_minutes: float,
    on_validated: Callable[[PointRaft, NDArray[np.float64], bool], None],
    on_step: Callable[[Training], None],
) -> PointRaft:
    """Train to the end; the finished model.

    Args:
        out: folder of `state.pt` and `log.csv`.
        on_validated: called with the model, its validation predictions and whether it is the best so far.
        on_step: called after every step.
    """
    next_save = time.monotonic() + 60 * save_minutes
    next_validation = time.monotonic() + 60 * validate_minutes
    while training.share < 1.0:
        training.step()
        on_step(training)
        if time.monotonic() >= next_validation:
            _validate(training, out, on_validated, batches=20, compute=training.compute)
            next_validation = time.monotonic() + 60 * validate_minutes
        if time.monotonic() >= next_save:
            save_state(training, out / "state.pt")
            next_save = time.monotonic() + 60 * save_minutes
    save_state(training, out / "state.pt")
    return _validate(training, out, on_validated, batches=training.settings.settle_batches)


def _validate(
    training: Training,
    out: Path,
    on_validated: Callable[[PointRaft, NDArray[np.float64], bool], None],
    *,
    batches: int,
    compute: torch.dtype | None = None,
) -> PointRaft:
    model = training.finished_model(batches=batches, compute=compute)
    predicted = predict(model, training.validation, compute=compute)
    residual = torch.from_numpy(predicted - training.validation.weight_g)
    loss = float(nn.functional.smooth_l1_loss(residual, torch.zeros_like(residual), beta=training.settings.beta_g))
    mae = float(residual.abs().mean())
    best = mae < training.progress.best_mae_g
    training.progress.best_mae_g = min(mae, training.progress.best_mae_g)
    _log(training, out / "log.csv", loss, mae)
    on_validated(model, predicted, best)
    return model


def _log(training: Training, path: Path, val_loss: float, val_mae_g: float) -> None:
    progress, share = training.progress, training.share
    resolution = training.settings.resolution(share)
    fresh = not path.is_file()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if fresh:
            writer.writerow(LOG_FIELDS)
        epoch = progress.step * training.settings.batch / len(training.data)
        rate = training.settings.learning_rate(share)
        figures = (share, resolution.neighbours, resolution.centroids, rate, progress.loss, val_loss, val_mae_g)
        writer.writerow(
            [f"{progress.seconds / 60:.2f}", progress.step, f"{epoch:.3f}", *(f"{value:.5g}" for value in figures)]
        )


def save_state(training: Training, path: Path) -> None:
    """Write the state atomically: a crash leaves the former one."""
    partial = path.with_suffix(".partial")
    torch.save(training.state(), partial)
    partial.replace(path)


def load_state(path: Path) -> dict[str, Any]:
    """A state written by `save_state`.

    Raises:
        InputError: missing or unreadable.
    """
    try:
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises a wide, undocumented set for broken files
        raise InputError(f"training state {path} cannot be read: {error}; start without --resume") from error
    return state
