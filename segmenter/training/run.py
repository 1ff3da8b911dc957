"""Whole trainings, from packs of belts to an ONNX file and the sidecar that says where it comes from."""

from __future__ import annotations

import io
import json
import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import cv2
import numpy as np
import torch
from torch import nn

from conveyor import __version__
from conveyor.errors import InputError
from conveyor.files import whole_output
from conveyor.formats.packs.belts import belt_pack_meta, belt_shards
from segmenter.classify.patch import CHANNELS, SIZE
from segmenter.training.blocks import export_net
from segmenter.training.classifier_net import ClassifierNet, ClassifierRecipe, classified, scores, train_classifier
from segmenter.training.cut import cut_pack
from segmenter.training.samples import (
    TrainingSample,
    origin_of,
    read_samples,
    sample_files,
)

OnStep = Callable[[int, int, float], None]
KEPT = ("command", "recipe", "trained_on", "processor_seconds")
"""What a sidecar keeps of the training before."""


@dataclass(frozen=True, slots=True)
class TrainingRun:
    """Where a training reads and writes: folders of belts or of patches, to learn from and to validate by.

    `command` goes into the sidecar as it was typed. `start`: the .pt of an earlier training, which goes on.
    """

    data: tuple[Path, ...]
    validation: Path
    out: Path
    name: str
    command: str
    start: Path | None = None


def make_classifier(run: TrainingRun, recipe: ClassifierRecipe, *, on_step: OnStep) -> dict[str, Any]:
    """Train the classifier, validate it on other belts, write `<name>.onnx`, `<name>.pt` and `<name>.json`; the last.

    Raises:
        InputError: packs that cannot be used, a validation on the belts of the training or of the one before it, or a
            start that is none.
    """
    before = earlier(run.start) if run.start is not None else None
    origins = _prepare(run, before)
    samples = [sample for folder in run.data for sample in _samples(folder)]
    held_out = _samples(run.validation)
    net, seconds = train_classifier(samples, recipe, on_step=on_step, start=before.net if before else None)
    origins["bodies"] = len(samples)
    sidecar = _sidecar(run, net, asdict(recipe), origins, seconds, scores(classified(net, held_out), held_out))
    state = io.BytesIO()
    torch.save(net.state_dict(), state)  # into memory: on a full disk torch raises what is no error of a disk
    with whole_output(run.out) as partial:
        partial.mkdir()
        export_net(net, partial / f"{run.name}.onnx", torch.zeros(1, CHANNELS, SIZE, SIZE))
        (partial / f"{run.name}.pt").write_bytes(state.getbuffer())
        (partial / f"{run.name}.json").write_text(json.dumps(sidecar, indent=1) + "\n", encoding="utf-8")
    return sidecar


@dataclass(frozen=True, slots=True)
class Earlier:
    """A training that ended before: its network, and what its sidecar says of it and of those before it (`start`)."""

    net: ClassifierNet
    sidecar: dict[str, Any]

    def trained_on(self) -> list[dict[str, Any]]:
        """The origins of all that it learned from, and those before it."""
        found, said = [], self.sidecar
        while said:
            found += said["trained_on"]
            said = said.get("start", {})
        return found


def earlier(path: Path) -> Earlier:
    """What `make_classifier` left: the network in `path`, and the sidecar beside it.

    Raises:
        InputError: one of the two is missing, or not a training's.
    """
    net = ClassifierNet()
    try:
        net.load_state_dict(torch.load(path, weights_only=True))
        sidecar = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
        before = {"start": sidecar["start"]} if "start" in sidecar else {}
        return Earlier(net, {key: sidecar[key] for key in KEPT} | before)
    except (OSError, RuntimeError, UnpicklingError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path} is no training to go on from: {_why(error)}; give the .pt that `tuberline train-classifier` "
            "wrote, with its .json beside it"
        ) from error


def _why(error: Exception) -> str:
    """In words: what torch says of another network goes on for pages, and of another file it is a number."""
    match error:
        case OSError():
            return error.strerror or str(error)
        case KeyError():
            return f"its .json lacks {error}"
        case _:
            return "it holds something else"


def _prepare(run: TrainingRun, before: Earlier | None) -> dict[str, Any]:
    trained_on, validated_on = [origin for folder in run.data for origin in _origins(folder)], _origins(run.validation)
    learned = [*trained_on, *(before.trained_on() if before else ())]
    seeds = {origin.get("seed") for origin in learned} & {origin.get("seed") for origin in validated_on} - {None}
    if seeds:
        raise InputError(
            f"{run.validation} was simulated with a seed of the training's packs ({seeds.pop()}): the network would be "
            "validated on belts that it learned from; make one with another --seed"
        )
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    start = {"start": before.sidecar} if before else {}
    return {**start, "trained_on": trained_on, "validated_on": validated_on}


def _sidecar(
    run: TrainingRun,
    net: nn.Module,
    recipe: dict[str, Any],
    origins: dict[str, Any],
    seconds: float,
    found: dict[str, float],
) -> dict[str, Any]:
    return {
        "name": run.name,
        "command": run.command,
        "recipe": recipe,
        "parameters": sum(p.numel() for p in net.parameters()),
        **origins,
        "processor_seconds": round(seconds, 1),
        "held_out": found,
        "versions": {
            "tuberline": __version__,
            "torch": torch.__version__,
            "opencv": cv2.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
    }


def _origins(folder: Path) -> list[dict[str, Any]]:
    """Of the patches or belts of a folder; whether there are any is told before those of another are cut."""
    if files := sample_files(folder):
        return [origin_of(path) for path in files]
    belt_shards(folder)
    return [belt_pack_meta(folder)]


def _samples(folder: Path) -> list[TrainingSample]:
    """The bodies of a folder of patches, or of a pack of belts."""
    files = sample_files(folder)
    return [sample for path in files for sample in read_samples(path)] if files else cut_pack(folder)
