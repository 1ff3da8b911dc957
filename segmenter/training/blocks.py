"""What the classifier is made of, how its weights are averaged, and how it is written as ONNX."""

from __future__ import annotations

import warnings
from pathlib import Path

import torch
from torch import Tensor, nn

from conveyor.extras import needed

KEEP_AVERAGE = 0.998
OPSET = 17


def convolution(inputs: int, outputs: int, *, stride: int = 1, kernel: int = 3) -> list[nn.Module]:
    """A convolution with batch norm and ReLU; `kernel` is odd."""
    return [
        nn.Conv2d(inputs, outputs, kernel, stride=stride, padding=kernel // 2, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(),
    ]


def averaged(kept: Tensor, new: Tensor, _count: Tensor | int) -> Tensor:
    """Moving average of weights and of batch norm's statistics; counters are taken over."""
    return KEEP_AVERAGE * kept + (1 - KEEP_AVERAGE) * new if kept.is_floating_point() else new


def export_net(net: nn.Module, path: Path, example: Tensor) -> None:
    """Write a network as ONNX: input "image", output "answer".

    Raises:
        InputError: the package onnx is missing.
    """
    needed("onnx", extra="export", what="writing the network")
    path.parent.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        # The tracing exporter is deprecated in favour of one that needs a further package for the same graph.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            net.eval(),
            (example,),
            str(path),
            input_names=["image"],
            output_names=["answer"],
            opset_version=OPSET,
            dynamo=False,
        )
