"""Weights on their way between processes, and what a regressor says about those it weighs with."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError, MessageError
from conveyor.messages.base import ArraySpec, Message
from conveyor.ranges import MAX_COUNT, Items, Line, Model, Name, Range, Text, Word

MAX_PARCEL_BYTES = 32 << 20
SUFFIXES = (".safetensors", ".pth", ".pt")
MAX_SIDECAR_CHARACTERS = 64 << 10
Grams = Annotated[float, Range(-1e12, 1e12, "g")]
"""What weights say that are on trial: below zero, or of a tonne, is bad and is told."""
Digest = Annotated[str, Text(64, r"^([0-9a-f]{64})?$")]
"""SHA-256 in hex digits; empty where there is none."""
_FILE = re.compile(r"[A-Za-z0-9._-]{1,80}\.(safetensors|pth|pt)")


@dataclass(frozen=True, slots=True)
class WeightsParcel(Message):
    """A checkpoint as one value; its name is the SHA-256 of its bytes on the wire, so a parcel cannot change.

    Attributes:
        file: name of the checkpoint, with its suffix.
        sidecar: text of its JSON sidecar; empty where it has none.
        data: (n,) uint8, the checkpoint's bytes.
    """

    file: Word
    sidecar: Annotated[str, Text(MAX_SIDECAR_CHARACTERS)]
    data: NDArray[np.uint8]

    ARRAYS: ClassVar[dict[str, ArraySpec]] = {"data": ArraySpec("u1", ((0, MAX_PARCEL_BYTES),))}

    def __post_init__(self) -> None:
        if not _FILE.fullmatch(self.file) or self.file.startswith("."):
            raise MessageError(f"WeightsParcel.file is '{self.file}', not the name of a .safetensors or .pth file")


@dataclass(frozen=True, slots=True)
class CloudAnswer(Message):
    """What weights say of one reference cloud, grams; `network_g` is the network's own word, if it has one."""

    cloud: Word
    true_g: Grams
    weight_g: Grams
    low_g: Grams
    high_g: Grams
    network_g: Grams | None


@dataclass(frozen=True, slots=True)
class WeightsReport(Message):
    """The outcome of a check that was passed: the new weights' answers, and those of the weights now in use."""

    regressor: Name
    model: Model
    now_model: Model
    answers: Annotated[tuple[CloudAnswer, ...], Items(256)]
    now_answers: Annotated[tuple[CloudAnswer, ...], Items(256)]


@dataclass(frozen=True, slots=True)
class WeightsState(Message):
    """Which weights a regressor weighs with.

    Attributes:
        n: number of the order it follows; 0 means the weights of its config.
        digest: of the parcel in use; previous_digest: of the one before it, kept for a roll-back ('' without one).
        refused: why it does not follow a newer order; '' where it does.
    """

    regressor: Name
    host: Word
    n: Annotated[int, Range(0, MAX_COUNT, "orders")]
    digest: Digest
    model: Model
    previous_digest: Digest
    previous_model: Model
    refused: Line


def read_parcel(path: Path) -> bytes:
    """The checkpoint at `path` and its sidecar, if it has one, as an encoded parcel.

    Raises:
        InputError: it cannot be read, is too large, or is no checkpoint by its name.
    """
    if path.suffix not in SUFFIXES:
        raise InputError(f"weights {path} are no .safetensors or .pth file")
    sidecar = path.with_suffix(".json")
    try:
        if path.stat().st_size > MAX_PARCEL_BYTES - (1 << 20):
            raise InputError(
                f"weights {path} have {path.stat().st_size} bytes; at most {MAX_PARCEL_BYTES - (1 << 20)} are sent to "
                "regressors: PointRAFT's are 6 MB"
            )
        data = np.frombuffer(path.read_bytes(), np.uint8)
        told = sidecar.read_text(encoding="utf-8") if sidecar.is_file() else ""
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"weights {path} or their sidecar cannot be read: {error}") from error
    if len(told) > MAX_SIDECAR_CHARACTERS:
        raise InputError(f"sidecar {sidecar} has {len(told)} characters; at most {MAX_SIDECAR_CHARACTERS} are sent")
    name = re.sub(r"[^A-Za-z0-9._-]", "-", path.stem)[:80].lstrip(".") or "weights"
    return WeightsParcel(name + path.suffix, told, data).encode()


def write_checkpoint(parcel: bytes, folder: Path) -> Path:
    """Unpack `parcel` into `folder`; the path of the checkpoint.

    Raises:
        MessageError: it is no parcel.
    """
    found = WeightsParcel.decode(parcel)
    path = folder / found.file
    path.write_bytes(found.data.tobytes())
    if found.sidecar:
        path.with_suffix(".json").write_text(found.sidecar, encoding="utf-8")
    return path


def digest_of(parcel: bytes) -> str:
    """The name of an encoded parcel: 64 hex digits."""
    return hashlib.sha256(parcel).hexdigest()
