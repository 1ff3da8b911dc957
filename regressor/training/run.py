"""A whole training from folders to a checkpoint: data, resume, calibration, sidecar."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from conveyor.camera_range import CAMERAS
from conveyor.errors import InputError
from conveyor.files import remove_partials
from conveyor.formats.potatotwin.layout import is_potatotwin
from conveyor.formats.potatotwin.resting import level_of
from conveyor.resting import RestingLevel
from regressor.network.checkpoint import save_checkpoint
from regressor.network.device import usable_device
from regressor.network.grouping import stage_counts
from regressor.network.networks import Network
from regressor.network.sidecar import InputSpec, Range, Sidecar, checked_name
from regressor.network.stored import read_weights
from regressor.studies.metrics import scores
from regressor.training.beginning import CACHE, alone_in, begun_state, check_out, check_views, parts_of, start_weights
from regressor.training.begun import digest_of
from regressor.training.calibration import DISTANCE_MARGIN_M, calibration
from regressor.training.cloudset import KEEP, CloudSet, identity, load_cloudset, without
from regressor.training.loop import LOG, run_training
from regressor.training.plausible import refused_told
from regressor.training.recipe import TrainSettings
from regressor.training.train import Training
from regressor.weigh.blend import BlendRule, best_share, blend
from regressor.weigh.volume import VolumeRule, fit_volume_rule

WEIGHTS, LATEST, STATE = "weights.safetensors", "latest.safetensors", "state.pt"
"""What a training writes: what it is for, where it stands if those are better ones, and all that is needed to go on."""

M_TRIM_THRESHOLD, M_TOP_PAD, M_MMAP_MAX = -1, -2, -4


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Where a training reads and writes. `command` goes into the sidecar as it was typed.

    `cache` holds prepared clouds and may be shared by several trainings; None is a folder in `out`. `start`: weights to
    begin with; None begins with random ones.
    """

    data: Path
    validation: Path
    out: Path
    name: str
    resume: bool
    save_minutes: float
    validate_minutes: float
    max_validation_views: int
    command: str
    cache: Path | None = None
    start: Path | None = None

    def __post_init__(self) -> None:
        """Refuse a name before hours of training that no weights could bear after them."""
        checked_name(self.name)


def keep_memory() -> None:
    """Tell glibc to keep freed memory: a step's large buffers otherwise fault in again each time (2-3x the time)."""
    if sys.platform != "linux":
        return
    try:
        libc = ctypes.CDLL("libc.so.6")
    except OSError:
        return
    libc.mallopt(M_MMAP_MAX, 0)
    libc.mallopt(M_TRIM_THRESHOLD, 2**31 - 1)
    libc.mallopt(M_TOP_PAD, 256 << 20)


def train(
    options: RunOptions,
    settings: TrainSettings,
    *,
    on_prepared: Callable[[str, int], None],
    on_step: Callable[[Training], None],
    on_validated: Callable[[Training, dict[str, Any]], None],
    stop: Callable[[], bool] = lambda: False,
) -> Sidecar:
    """Train, calibrate, write `weights.safetensors` with its sidecar; the sidecar.

    A training that has ended is left as it is: its weights may have been calibrated since.

    Args:
        stop: asked between steps; once it says so the state is written.

    Raises:
        InputError: data that cannot be used, a state to resume that is not there, or a folder that holds weights
            already. OutputError: another process trains there. KeyboardInterrupt: `stop` said so.
    """
    keep_memory()
    state = options.out / STATE
    check_out(state, options.out / WEIGHTS, resume=options.resume)
    usable_device(settings.device)
    check_views(options.data, options.validation, settings)
    start = start_weights(options.start, settings)
    with alone_in(options.out):
        check_out(state, options.out / WEIGHTS, resume=options.resume)  # another one may have ended there since
        begun = begun_state(state, settings, start) if options.resume else None
        _train(
            options,
            settings,
            begun,
            start,
            on_prepared=on_prepared,
            on_step=on_step,
            on_validated=on_validated,
            stop=stop,
        )
    return read_weights(options.out / WEIGHTS)[1]


def _train(
    options: RunOptions,
    settings: TrainSettings,
    begun: dict[str, Any] | None,
    start: dict[str, Tensor] | None,
    *,
    on_prepared: Callable[[str, int], None],
    on_step: Callable[[Training], None],
    on_validated: Callable[[Training, dict[str, Any]], None],
    stop: Callable[[], bool],
) -> None:
    data, validation = load_sets(options, on_prepared, keep=settings.kept_points)
    data, validation = (views.with_target(settings.target) for views in (data, validation))
    rule = fit_volume_rule(data.view_features, data.weight_g)
    training = Training(data, validation, settings)
    if start is not None:
        training.start_from(start, where=str(options.start))
    if begun is not None:
        training.restore(begun)
    if training.share >= 1.0 and is_written(options.out, training.progress.step):
        return
    for name in (WEIGHTS, LATEST, STATE, LOG):
        remove_partials(options.out, name)
    remove_partials(options.out / CACHE, "clouds-*")

    def write(model: Network, predicted: NDArray[np.float64], best: bool) -> None:
        sidecar = make_sidecar(training, predicted, rule, options)
        on_validated(training, sidecar.metrics)
        ends = training.share >= 1.0 and not settings.best_epoch
        save_checkpoint(options.out / (WEIGHTS if best or ends else LATEST), model.state_dict(), sidecar)

    run_training(
        training,
        out=options.out,
        save_minutes=options.save_minutes,
        validate_minutes=options.validate_minutes,
        on_validated=write,
        on_step=on_step,
        stop=stop,
    )


def is_written(out: Path, step: int) -> bool:
    """Whether the weights of a training that ended with `step` are in `out`: it may have been killed before."""
    for path in (out / WEIGHTS, out / LATEST):
        try:
            trained = read_weights(path)[1].training
        except InputError:  # not there, or with a sidecar of others: they are written again
            continue
        if trained.get("steps") == step and trained.get("numbers", {}).get("share_done") == 1.0:
            return True
    return False


def load_sets(
    options: RunOptions, on_prepared: Callable[[str, int], None], *, keep: int = KEEP
) -> tuple[CloudSet, CloudSet]:
    """(training, validation) sets without a tuber in both: shared ones are left out of the training and counted.

    Of a folder with a splits.csv its own part is read, also where the two sets are of different folders.
    So are tubers under soil (counted as refused): their truth is their weight without it, nothing in a view tells it,
    and clean tubers would read light for it.
    """
    cache = options.cache or options.out / CACHE
    part, validation_part = parts_of(options.data, options.validation)
    validation = load_cloudset(
        options.validation,
        cache=cache,
        split=validation_part,
        max_views=options.max_validation_views,
        keep=keep,
        progress=lambda done: on_prepared("validation", done),
    )
    data = load_cloudset(
        options.data,
        cache=cache,
        split=part,
        keep=keep,
        progress=lambda done: on_prepared("training", done),
    )
    shared = np.isin(identity(data), identity(validation))
    if shared.all():
        raise InputError(f"every tuber of {options.data} is also in {options.validation}: nothing is left to train on")
    return clean_views(without(data, shared, "in_validation"), options.data), validation


def clean_views(data: CloudSet, source: Path) -> CloudSet:
    """The views of tubers that are not known to be under soil; the others are counted as refused.

    Raises:
        InputError: all are.
    """
    if not data.clean.any():
        raise InputError(f"every tuber of {source} is under soil: nothing is left to train on")
    return without(data, ~data.clean, "under_soil")


def make_sidecar(training: Training, predicted: NDArray[np.float64], rule: VolumeRule, options: RunOptions) -> Sidecar:
    """What the weights take, were made from and are worth on the validation set.

    Validation figures are a little kind: the volume rule's share and the intervals were chosen on the same views.
    """
    data, validation, progress = training.data, training.validation, training.progress
    by_volume = rule.weights_g(validation.view_features)
    share = best_share(predicted, by_volume, validation.weight_g)
    blended = blend(predicted, by_volume, share)
    worlds = tuple(str(name) for name in np.unique(data.preset) if name in CAMERAS)
    calibrated = calibration(predicted, by_volume, validation, rule=BlendRule(share))
    return Sidecar(
        name=options.name,
        target=training.settings.target,
        network=training.settings.network,
        input=InputSpec(
            points=training.settings.points,
            centroids=stage_counts(training.settings.points),
            height_embedding=training.settings.height_embedding,
            max_height_m=training.settings.max_height_m,
        ),
        belt_distance_m=_range(data.belt_distance_m, DISTANCE_MARGIN_M),
        weight_g=_range(data.weight_g, 0.0),
        length_mm=_range(data.features[:, 2], 0.0),
        worlds=worlds,
        volume_share=share,
        **calibrated.sidecar_keys(),
        volume_rule=rule.to_json(),
        training={
            "command": options.command,
            "views": len(data),
            "data": digest_of(data),
            "tubers": len(np.unique(data.tuber)),
            "refused_views": data.refused,
            "left_out": {
                "training": refused_told(data.refused, data.refused_first),
                "validation": refused_told(validation.refused, validation.refused_first),
            },
            **_resting(options.data),
            "hours": round(progress.seconds / 3600, 3),
            "steps": progress.step,
            "settings": asdict(training.settings),
            "numbers": {"share_done": round(training.share, 4), "train_loss": round(progress.loss, 4)},
        },
        metrics={
            "validation": scores(blended, validation.weight_g, validation.tuber),
            "validation_network": scores(predicted, validation.weight_g, validation.tuber),
            "validation_volume": scores(by_volume, validation.weight_g, validation.tuber),
            "interval": calibrated.counted,
        },
    )


def _resting(folder: Path) -> dict[str, Any]:
    """How far below the belt the tubers of a 3DPotatoTwin folder were read; nothing where they lie on it."""
    level, source = level_of(folder) if is_potatotwin(folder) else (RestingLevel(), "belt")
    if level == RestingLevel():
        return {}
    told = {"offset_mm": round(1000 * level.offset_m, 3), "sd_mm": round(1000 * level.sd_m, 3), "source": source}
    return {"resting": told}


def _range(values: NDArray[np.float64], margin: float) -> Range:
    return Range(low=round(float(values.min()) - margin, 4), high=round(float(values.max()) + margin, 4))
