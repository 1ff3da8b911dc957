"""Whole trainings, from packs of belts to an ONNX file and the sidecar that says where it comes from."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch import nn

from conveyor import __version__
from conveyor.errors import InputError
from conveyor.formats.packs.belts import belt_pack_meta
from segmenter.classify.patch import CHANNELS, SIZE
from segmenter.training.blocks import export_net
from segmenter.training.classifier_net import ClassifierRecipe, classified, scores, train_classifier
from segmenter.training.cut import cut_pack
from segmenter.training.samples import (
    TrainingSample,
    origin_of,
    read_samples,
    sample_files,
)

OnStep = Callable[[int, int, float], None]


@dataclass(frozen=True, slots=True)
class TrainingRun:
    """Where a training reads and writes: folders of belts or of patches, to learn from and to validate by.

    `command` goes into the sidecar as it was typed.
    """

    data: tuple[Path, ...]
    validation: Path
    out: Path
    name: str
    command: str


def make_classifier(run: TrainingRun, recipe: ClassifierRecipe, *, on_step: OnStep) -> dict[str, Any]:
    """Train the classifier, validate it on other belts, write `<name>.onnx` and `<name>.json`; the sidecar.

    Raises:
        InputError: packs that cannot be used, or a validation on the belts of the training.
    """
    origins = _prepare(run)
    samples = [sample for folder in run.data for sample in _samples(folder)]
    held_out = _samples(run.validation)
    net, seconds = train_classifier(samples, recipe, on_step=on_step)
    export_net(net, run.out / f"{run.name}.onnx", torch.zeros(1, CHANNELS, SIZE, SIZE))
    origins["bodies"] = len(samples)
    return _sidecar(run, net, asdict(recipe), origins, seconds, scores(classified(net, held_out), held_out))


def _prepare(run: TrainingRun) -> dict[str, Any]:
    trained_on, validated_on = [origin for folder in run.data for origin in _origins(folder)], _origins(run.validation)
    seeds = {origin.get("seed") for origin in trained_on} & {origin.get("seed") for origin in validated_on} - {None}
    if seeds:
        raise InputError(
            f"{run.validation} was simulated with a seed of the training's packs ({seeds.pop()}): the network would be "
            "validated on belts that it learned from; make one with another --seed"
        )
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    return {"trained_on": trained_on, "validated_on": validated_on}


def _sidecar(
    run: TrainingRun,
    net: nn.Module,
    recipe: dict[str, Any],
    origins: dict[str, Any],
    seconds: float,
    found: dict[str, float],
) -> dict[str, Any]:
    sidecar = {
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
    (run.out / f"{run.name}.json").write_text(json.dumps(sidecar, indent=1) + "\n", encoding="utf-8")
    return sidecar


def _origins(folder: Path) -> list[dict[str, Any]]:
    return [origin_of(path) for path in sample_files(folder)] or [belt_pack_meta(folder)]


def _samples(folder: Path) -> list[TrainingSample]:
    """The bodies of a folder of patches, or of a pack of belts."""
    files = sample_files(folder)
    return [sample for path in files for sample in read_samples(path)] if files else cut_pack(folder)
