"""Training on prepared clouds: resumable, by epochs or by the clock, by a recipe (`regressor.training.recipe`).

The reduced graph (`regressor.network.reduced`) makes an epoch affordable on a CPU, and a training may start at a low
resolution (32 neighbours, 32 centroids) and end at the network's own. A state holds everything: a resumed training
takes the steps an unbroken one would take from there.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from conveyor.errors import InputError, TuberlineError
from regressor.network.architecture import NEIGHBOURS
from regressor.network.device import usable_device
from regressor.network.grouped import grouped_forward
from regressor.network.grouping import CLOUD_POINTS, GatheredGroups, general_groups, group_sampled
from regressor.network.networks import POINTNET_POINTS, Network, new_network, run_network
from regressor.network.pointnet import PointNet
from regressor.network.reduced import FULL, Resolution
from regressor.network.stored import check_architecture
from regressor.training.augment import augmented_batch
from regressor.training.begun import differences, digest_of
from regressor.training.cloudset import TARGET_POWER, CloudSet
from regressor.training.recipe import TrainSettings
from regressor.training.work import Work, no_work

CLASS_G = 50.0
CLASSES = 10


class Diverged(TuberlineError):
    """A training whose loss or whose answers are no numbers any more."""


@dataclass(slots=True)
class Progress:
    """Where a training stands. `seconds` counts time spent training over all its sessions; `frozen`: see `_freeze`."""

    step: int = 0
    seconds: float = 0.0
    loss: float = float("nan")
    best_mae_g: float = float("inf")
    best_loss: float = float("inf")
    frozen: bool = False


class Training:
    """One training: model, its moving average, optimiser, draws and log. `start`: weights that it began with."""

    def __init__(self, data: CloudSet, validation: CloudSet, settings: TrainSettings) -> None:
        check_batch(len(data), settings.batch)
        self.device = usable_device(settings.device)
        torch.manual_seed(settings.seed)
        self.settings = settings
        self.data = data
        self.validation = validation
        self.rng = np.random.default_rng(settings.seed)
        self.model = self._new_network()
        start_at_mean(self.model, data.weight_g)
        self.average = {name: value.clone() for name, value in self.model.state_dict().items()}
        self.optimiser = torch.optim.Adam(self.model.parameters(), lr=settings.lr, weight_decay=settings.weight_decay)
        self.progress = Progress()
        self.start: dict[str, Tensor] | None = None
        self._weights = class_weights(data.weight_g)

    @property
    def share(self) -> float:
        """How much of the training is done, 0..1."""
        if self.settings.minutes is not None:
            return min(1.0, self.progress.seconds / (60 * self.settings.minutes))
        return min(1.0, self.progress.step / max(1, self.total_steps))

    @property
    def epoch(self) -> float:
        """Passes over the training set so far."""
        return self.progress.step * self.settings.batch / len(self.data)

    @property
    def total_steps(self) -> int:
        """Steps of a training by epochs."""
        return round(self.settings.epochs * len(self.data) / self.settings.batch)

    def step(self) -> float:
        """One batch, forward and backward; its loss.

        Raises:
            Diverged: it is no number.
        """
        begun = time.perf_counter()
        share = self.share
        for group in self.optimiser.param_groups:
            group["lr"] = self.settings.learning_rate(share)
        points, heights, weights, groups = self._batch(self.rng)
        self.model.train()
        if share >= 1 - self.settings.frozen_share:
            self._freeze()
            for module in self.model.modules():
                if isinstance(module, nn.BatchNorm1d):
                    module.eval()
        self.optimiser.zero_grad(set_to_none=True)
        predicted = run_network(
            self.model,
            points,
            heights,
            resolution=self.settings.resolution(share),
            compute=self.compute,
            groups=groups,
        )
        loss = nn.functional.smooth_l1_loss(predicted, weights, beta=self.settings.beta_g)
        if not torch.isfinite(loss):
            raise Diverged(
                f"the loss of step {self.progress.step + 1} is no number: a smaller --lr (it was {self.settings.lr:g}) "
                "or float32 helps"
            )
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

    def _batch(self, rng: np.random.Generator) -> tuple[Tensor, Tensor, Tensor, list[GatheredGroups] | None]:
        """(clouds, clamped heights, weights) and, where a radius binds in one of the clouds, the groups of all."""
        natural = self.natural
        rows = rng.choice(len(self.data), self.settings.batch, p=None if natural else self._weights)
        arrays = augmented_batch(
            self.data.points[rows],
            self.data.height_m[rows],
            self.data.weight_g[rows],
            rng,
            self.settings.augmentation,
            highest_m=self.settings.max_height_m,
            count=self.settings.read_points,
            resample=not (natural and self.settings.natural_share > 0),
            power=TARGET_POWER[self.settings.target],
        )
        groups = None
        if self.settings.network != "pointnet":
            groups = general_groups(arrays[0], self.data.points_in_cloud[rows], points=self.settings.points)
        points, heights, weights = (torch.from_numpy(np.ascontiguousarray(array)).to(self.device) for array in arrays)
        return points, heights, weights, groups

    def _update_average(self) -> None:
        # The average starts short, so that it forgets the first steps' weights.
        decay = min(self.settings.average, (1 + self.progress.step) / (10 + self.progress.step))
        with torch.no_grad():
            for name, value in self.model.state_dict().items():
                if value.is_floating_point():
                    self.average[name].lerp_(value, 1 - decay)
                else:
                    self.average[name].copy_(value)

    def _new_network(self) -> Network:
        settings = self.settings
        network = new_network(settings.network, height_embedding=settings.height_embedding, dropout=settings.dropout)
        return network.to(self.device)

    def finished_model(self) -> Network:
        """The averaged model in eval mode. Its batch-norm statistics are averaged like its weights.

        The training's random numbers are left as they were: it takes the same steps whenever it is validated.
        """
        with torch.random.fork_rng(devices=[]):
            model = self._new_network()
        state = self.average if self.settings.average else self.model.state_dict()
        model.load_state_dict(mean_of(state, self.start, share=self.settings.start_share) if self.start else state)
        return model.eval()

    def validated(self, *, compute: torch.dtype | None = None) -> tuple[Network, NDArray[np.float64]]:
        """(the finished model, (n,) what it says of the validation views).

        Raises:
            Diverged: one of its answers is no number.
        """
        model = self.finished_model()
        settings = self.settings
        predicted = predict(
            model,
            self.validation,
            highest_m=settings.max_height_m,
            points=settings.points,
            resolution=settings.full,
            compute=compute,
        )
        if not np.isfinite(predicted).all():
            raise Diverged(
                f"the network answers no number after {self.progress.step} steps: a smaller --lr (it was "
                f"{settings.lr:g}) or float32 helps"
            )
        return model, predicted

    def _freeze(self) -> None:
        """Go on from the average, with its batch-norm statistics fixed.

        A batch of 32 tubers has a mean weight of its own, which batch norm lets the network see: noise in training that
        a prediction does not have.
        """
        if self.settings.average and not self.progress.frozen:
            self.model.load_state_dict(self.average)
        self.progress.frozen = True

    def start_from(self, weights: dict[str, Tensor], *, where: str = "to start from") -> None:
        """Begin with the weights and batch-norm statistics of a trained network instead of random ones.

        Raises:
            InputError: they are of another network; says what differs.
        """
        check_start_weights(weights, self.model, where=where, network=self.settings.network)
        self.model.load_state_dict(weights)
        self.average = {name: value.clone() for name, value in self.model.state_dict().items()}
        self.start = {name: value.clone() for name, value in self.model.state_dict().items()}

    def state(self) -> dict[str, Any]:
        """Everything needed to go on."""
        return {
            "settings": asdict(self.settings),
            "data": digest_of(self.data),
            "validation": digest_of(self.validation),
            "start": self.start,
            "model": self.model.state_dict(),
            "average": self.average,
            "optimiser": self.optimiser.state_dict(),
            "rng": self.rng.bit_generator.state,
            "torch_rng": torch.get_rng_state(),
            "cuda_rng": torch.cuda.get_rng_state(self.device) if self.device.type == "cuda" else None,
            "progress": asdict(self.progress),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from `state()`.

        Raises:
            InputError: it is of a training with other settings, or on other views, be it those that it is judged by.
        """
        changed = differences(state["settings"], asdict(self.settings))
        for key, what, views in (("data", "training", self.data), ("validation", "validation", self.validation)):
            if state.get(key, mine := digest_of(views)) != mine:
                changed.append(f"other {what} views")
        if changed:
            raise InputError(_begun_otherwise(changed))
        if state.get("start") is not None:
            self.start = {name: value.to(self.device) for name, value in state["start"].items()}
        self.model.load_state_dict(state["model"])
        self.average = {name: value.to(self.device) for name, value in state["average"].items()}
        self.optimiser.load_state_dict(state["optimiser"])
        self.rng.bit_generator.state = state["rng"]
        torch.set_rng_state(state["torch_rng"])
        if self.device.type == "cuda" and state.get("cuda_rng") is not None:
            torch.cuda.set_rng_state(state["cuda_rng"], self.device)
        self.progress = Progress(**state["progress"])


def check_batch(views: int, batch: int) -> None:
    """Refuse fewer training views than one batch.

    Raises:
        InputError: with both numbers.
    """
    if views < batch:
        raise InputError(
            f"{views} training views are fewer than one batch of {batch}: give more views, or a smaller --batch"
        )


def check_start_weights(weights: dict[str, Tensor], model: Network, *, where: str, network: str) -> None:
    """Refuse weights to begin with that are of another network than `model`, which is called `network`.

    Raises:
        InputError: says what differs.
    """
    expected = {name: tuple(value.shape) for name, value in model.state_dict().items()}
    given = {name: value.numpy() for name, value in weights.items()}
    check_architecture(given, expected, where=where, network=network)


def check_settings(state: dict[str, Any], settings: TrainSettings) -> None:
    """Refuse to go on from a state with other settings, which can be told before a view is read.

    Raises:
        InputError: names them.
    """
    if changed := differences(state["settings"], asdict(settings)):
        raise InputError(_begun_otherwise(changed))


def _begun_otherwise(changed: list[str]) -> str:
    return (
        f"this training was begun otherwise: {'; '.join(changed)}. A training goes on as it was begun: give "
        "the options of its first call with --resume, or begin another one with another --out"
    )


def mean_of(state: dict[str, Tensor], other: dict[str, Tensor], *, share: float) -> dict[str, Tensor]:
    """The weights of `state`, with a `share` of those of `other`; counters are those of `state`."""
    return {
        name: value.lerp(other[name].to(value.device), share) if value.is_floating_point() else value
        for name, value in state.items()
    }


def start_at_mean(model: Network, weight_g: NDArray[np.float64]) -> None:
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


SWIFT = Resolution(NEIGHBOURS, 32)
"""A quarter of the second-stage centroids: 0.01 to 0.1 g off at less than half the time, for fits over thousands."""


def predict(
    model: Network,
    data: CloudSet,
    *,
    highest_m: float,
    points: int = CLOUD_POINTS,
    resolution: Resolution = FULL,
    batch: int = 32,
    compute: torch.dtype | None = None,
    on_views: Callable[[int, int], None] = lambda done, of: None,
) -> NDArray[np.float64]:
    """(n,) grams, as weights that sample from a cloud's first point on weigh these clouds.

    Args:
        points: how many the network is given of a larger cloud.
        on_views: told how many are done, and of how many.
    """
    model.eval()
    device = next(model.parameters()).device
    out = []
    with torch.inference_mode():
        for begin in range(0, len(data), batch):
            rows = range(begin, min(begin + batch, len(data)))
            heights = torch.from_numpy(np.clip(data.height_m[rows], 0.0, highest_m).astype(np.float32)).to(device)
            if isinstance(model, PointNet):
                clouds = torch.from_numpy(data.points[rows, :POINTNET_POINTS])
                weights = run_network(model, clouds.to(device), heights, compute=compute)
            else:
                groups = [
                    group_sampled(data.points[row], of=int(data.points_in_cloud[row]), points=points) for row in rows
                ]
                weights = grouped_forward(model, groups, heights, resolution=resolution, compute=compute)
            out.append(weights.cpu().numpy())
            on_views(rows.stop, len(data))
    return np.concatenate(out).astype(np.float64)


def predict_swiftly(
    model: Network,
    data: CloudSet,
    *,
    highest_m: float,
    points: int = CLOUD_POINTS,
    compute: torch.dtype | None = None,
    on_work: Work = no_work,
) -> NDArray[np.float64]:
    """(n,) grams as `predict` has them, at `SWIFT` resolution; `on_work` is told how many views are weighed."""
    return predict(
        model,
        data,
        highest_m=highest_m,
        points=points,
        resolution=SWIFT,
        compute=compute,
        on_views=lambda done, of: on_work("weighing", done, of),
    )
