"""Weights as torch has them: saved, and loaded into the readable network for training, import and export.

What is on disk, and how it is read without torch, is `regressor.network.stored`'s.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from safetensors.torch import save as save_safetensors
from torch import Tensor, nn

from conveyor.files import cause, fault_of, replacing
from regressor.network.pointraft import PointRaft
from regressor.network.sidecar import FORMAT, Sidecar
from regressor.network.stored import State, embeds_height, load_weights, read_weights


def save_checkpoint(path: Path, state: dict[str, Tensor], sidecar: Sidecar) -> Sidecar:
    """Write `path` (.safetensors) and its sidecar (.json), together or not at all; the sidecar with its hash filled in.

    Raises:
        InputError: they cannot be written. OutputError: their disk is full, read-only, away or reports errors.
    """
    data = save_safetensors({name: value.cpu().contiguous() for name, value in state.items()}, {"format": FORMAT})
    text = _text(sidecar.model_copy(update={"sha256": hashlib.sha256(data).hexdigest()}))
    again = Sidecar.model_validate_json(text)
    with _written(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as tensors, replacing(path.with_suffix(".json")) as told:
            for file, content in ((tensors, data), (told, text.encode())):
                file.write(content)
                # Both are on the disk before either takes its place: weights beside a former sidecar are no use.
                file.flush()
                os.fsync(file.fileno())
    return again


def save_sidecar(path: Path, sidecar: Sidecar) -> Sidecar:
    """Write the sidecar (.json) of the weights at `path`, atomically; as it is read again. The tensors stay.

    Raises:
        InputError, OutputError: as `save_checkpoint`.
    """
    text = _text(sidecar)
    again = Sidecar.model_validate_json(text)  # before the old one is gone: it must be readable
    with _written(path.with_suffix(".json")), replacing(path.with_suffix(".json")) as file:
        file.write(text.encode())
    return again


def _text(sidecar: Sidecar) -> str:
    return json.dumps(sidecar.model_dump(mode="json"), indent=1, allow_nan=False)


@contextmanager
def _written(path: Path) -> Iterator[None]:
    """What the operating system refuses, in words."""
    try:
        yield
    except OSError as error:
        raise fault_of(error, f"{path} cannot be written: {cause(error)}") from error


def load_checkpoint(path: Path | None = None, *, any_target: bool = False) -> tuple[PointRaft, Sidecar]:
    """(model in eval mode, its sidecar) of a .safetensors or an upstream .pth file; the shipped ones by default.

    Raises:
        InputError: as for `load_weights`.
    """
    state, sidecar = load_weights(path, any_target=any_target)
    return model_of(state), sidecar


def read_checkpoint(path: Path) -> tuple[dict[str, Tensor], Sidecar]:
    """(tensors by name, sidecar) of a checkpoint of any network.

    Raises:
        InputError: as for `read_weights`.
    """
    state, sidecar = read_weights(path)
    return tensors_of(state), sidecar


def model_of(state: State) -> PointRaft:
    """The readable network with these parameters, in eval mode."""
    model = PointRaft(height_embedding=embeds_height(state))
    model.load_state_dict(tensors_of(state))
    return model.eval()


def tensors_of(state: State) -> dict[str, Tensor]:
    """The parameters as tensors of their own."""
    return {name: torch.tensor(value) for name, value in state.items()}


def state_of(model: nn.Module) -> State:
    """A network's parameters as arrays of their own."""
    return {name: value.detach().cpu().numpy().copy() for name, value in model.state_dict().items()}
