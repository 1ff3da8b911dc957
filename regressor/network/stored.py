"""Weights on disk: a safetensors file with a JSON sidecar that says what they take, give and were made from.

The tensors carry the names of the authors' checkpoint, so an upstream `.pth` is read by the same code; it has no
sidecar, and gets one that says so. They are read as NumPy arrays: torch, which takes two seconds to import, is asked
only for what NumPy cannot read.
"""

from __future__ import annotations

import hashlib
import io
import pickle
from pathlib import Path
from typing import Any, TypeAlias
from zipfile import is_zipfile

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from safetensors.numpy import load as load_safetensors

from conveyor.errors import InputError
from conveyor.refused import OURS, in_words
from conveyor.text_files import read_text
from regressor.network.architecture import HEIGHT_NAME, parameter_shapes
from regressor.network.sidecar import Sidecar, StartPolicy
from regressor.network.unwrap import objects_within, state_dict_within

SHIPPED = Path(__file__).parents[1] / "weights" / "tuberline-sim.safetensors"
MAX_CHECKPOINT_BYTES = 64 << 20
PICKLED = b"\x80"
"""What torch has saved is a zip file, or, before 2020, begins so."""
NO_WEIGHTS = "no safetensors file or PyTorch state dict"

State: TypeAlias = dict[str, NDArray[Any]]
"""A network's parameters by their names: float32, and counts as whole numbers."""


def load_weights(path: Path | None = None, *, any_target: bool = False) -> tuple[State, Sidecar]:
    """(PointRAFT's parameters, their sidecar) of a .safetensors or an upstream .pth file; the shipped ones by default.

    Raises:
        InputError: missing, unreadable, hash other than the sidecar's, of another architecture, or of another target
            than a weight (unless `any_target`).
    """
    path = path or SHIPPED
    state, sidecar = read_weights(path)
    if sidecar.network != "pointraft":
        raise InputError(f"weights {path} are of a '{sidecar.network}', a baseline that only `ablate` knows")
    if sidecar.target != "weight_g" and not any_target:
        raise InputError(
            f"weights {path} give {sidecar.target}: a line weighs; only `evaluate` and `train` know others"
        )
    check_architecture(state, parameter_shapes(height_embedding=embeds_height(state)), where=str(path))
    return state, sidecar


def check_weights(path: Path) -> None:
    """What can be told of them without torch, which takes two seconds and 200 MB to import.

    Raises:
        InputError: as `load_weights`; of a .pth only that it cannot be read, or is a file of another kind.
    """
    if path.suffix == ".safetensors":
        load_weights(path)
    elif not ((data := _bytes(path)).startswith(PICKLED) or is_zipfile(io.BytesIO(data))):
        raise InputError(f"weights {path} are {NO_WEIGHTS}")


def embeds_height(state: State) -> bool:
    """Whether the network reads the height above the belt."""
    return any(name.startswith(f"{HEIGHT_NAME}.") for name in state)


def read_weights(path: Path) -> tuple[State, Sidecar]:
    """(parameters by name, sidecar) of a checkpoint of any network.

    Raises:
        InputError: missing, unreadable, hash other than the sidecar's; a .pth where torch is not installed.
    """
    data = _bytes(path)
    return _arrays(path, data), _sidecar(path, hashlib.sha256(data).hexdigest())


def _bytes(path: Path) -> bytes:
    try:
        if path.stat().st_size > MAX_CHECKPOINT_BYTES:
            raise InputError(f"weights {path} have {path.stat().st_size} bytes; allowed are {MAX_CHECKPOINT_BYTES}")
        return path.read_bytes()
    except OSError as error:
        raise InputError(
            f"weights {path} cannot be read: {error.strerror or error}; leave the option out to use the shipped ones"
        ) from error


def _arrays(path: Path, data: bytes) -> State:
    try:
        saved: Any = _of_safetensors(data) if path.suffix == ".safetensors" else _of_torch(path)
    except ModuleNotFoundError as error:
        raise InputError(
            f"weights {path} can be read by torch alone, which is not installed here: make a .safetensors file of them "
            "where it is, by `tuberline import-checkpoint`"
        ) from error
    except pickle.UnpicklingError as error:
        raise InputError(f"weights {path} {objects_within(str(error))}") from error
    except Exception as error:  # both libraries raise a wide, undocumented set for broken files
        said = next(iter(str(error).splitlines()), "")
        why = f": {said}" if " " in said else ""  # of a file of another kind pickle says no more than a number
        raise InputError(f"weights {path} are {NO_WEIGHTS}{why}") from error
    return {
        name: value.astype(np.float32, copy=False) if value.dtype.kind == "f" else value
        for name, value in state_dict_within(saved, where=path).items()
    }


def _of_safetensors(data: bytes) -> State:
    try:
        return dict(load_safetensors(data))
    except KeyError:  # a type that NumPy has not: bfloat16
        from safetensors.torch import load

        return {name: _plain(value) for name, value in load(data).items()}


def _of_torch(path: Path) -> Any:
    """What torch saved, with arrays in place of its tensors."""
    import torch

    return _plain(torch.load(path, map_location="cpu", weights_only=True))


def _plain(value: Any) -> Any:
    import torch

    if isinstance(value, torch.Tensor):
        value = value.detach()
        return (value.float() if value.is_floating_point() else value).numpy()
    return {name: _plain(inner) for name, inner in value.items()} if isinstance(value, dict) else value


def _sidecar(path: Path, digest: str) -> Sidecar:
    file = path.with_suffix(".json")
    if not file.is_file():
        # An upstream checkpoint: its network was trained and tested with random first points.
        name = "".join(letter if letter.isalnum() or letter in "._-" else "-" for letter in path.stem) or "weights"
        return Sidecar(name=name[:64], sha256=digest, start=StartPolicy(kind="random"))
    try:
        sidecar = Sidecar.model_validate_json(read_text(file, what="sidecar"))
    except ValidationError as error:
        raise InputError(f"sidecar {file} is refused: {'; '.join(map(_fault, error.errors()))}") from error
    if sidecar.sha256 != digest:
        raise InputError(
            f"sidecar {file} is for weights with sha256 {sidecar.sha256[:16]}..., {path.name} has {digest[:16]}...: "
            "the two files do not belong together"
        )
    return sidecar


def _fault(fault: Any) -> str:
    """What is wrong with one key of a sidecar."""
    key = ".".join(map(str, fault["loc"]))
    if fault["type"] == "extra_forbidden":
        return f"{key} is unknown: it is of another version of this program"
    said = in_words(fault)
    return said if fault["type"] == OURS else f"{key}: {said} (got {str(fault.get('input'))[:80]!r})"


def check_architecture(
    state: State, expected: dict[str, tuple[int, ...]], *, where: str, network: str = "PointRAFT"
) -> None:
    """Compare names and shapes.

    Raises:
        InputError: naming the first entries that differ.
    """
    faults = [f"'{name}' is missing" for name in expected if name not in state]
    faults += [f"'{name}' is unknown" for name in state if name not in expected]
    faults += [
        f"'{name}' has shape {value.shape}, {network} has {expected[name]}"
        for name, value in state.items()
        if name in expected and value.shape != expected[name]
    ]
    faults += [
        f"'{name}' is not finite"
        for name, value in state.items()
        if value.dtype.kind == "f" and not np.isfinite(value).all()
    ]
    if faults:
        more = f" (and {len(faults) - 3} more)" if len(faults) > 3 else ""
        raise InputError(f"weights {where} are not of {network}'s architecture: {'; '.join(faults[:3])}{more}")
