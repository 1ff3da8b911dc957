"""What the judge learns from: bodies with their looks, as small as they can be kept, and files of them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from segmenter.classify.patch import SIZE, Look
from segmenter.training.pack import HEIGHT_STEP_MM

INSIDE_BIT = np.uint16(1 << 15)
GOLDEN = 0.6180339887498949
"""Multiples of it, less their whole parts, fill 0 to 1 as evenly as any number of looks can."""


@dataclass(frozen=True, slots=True)
class Sitter:
    """One body.

    Attributes:
        looks: (n, 48, 48) uint16, in the order of the belt's travel. The highest bit: the cell is the body's; the
            others: 0 where nothing was seen, else 1 + its height in 0.01 mm. Memory is what bounds a training.
        kind: 'tuber' or what else it is.
    """

    looks: NDArray[np.uint16]
    kind: str

    @property
    def is_tuber(self) -> bool:
        """A tuber, no clod, stone or haulm."""
        return self.kind == "tuber"


def sitter_of(looks: list[Look], kind: str) -> Sitter:
    """A body's looks in a row. A cell that is partly the body's is so in that share of the looks."""
    packed = np.zeros((len(looks), SIZE, SIZE), np.uint16)
    for n, look in enumerate(looks):
        steps = np.clip(look.height_mm / HEIGHT_STEP_MM + 1.5, 1, int(INSIDE_BIT) - 1).astype(np.uint16)
        share = (n + 1) * GOLDEN % 1
        packed[n] = np.where(look.seen > 0, steps, 0) | np.where(look.inside > share, INSIDE_BIT, 0)
    return Sitter(packed, kind)


def write_sitters(path: Path, sitters: list[Sitter], *, origin: dict[str, Any]) -> None:
    """One file of bodies: `looks` in a row, `looks_offset` (bodies + 1,), `kinds`, and `origin` as JSON text."""
    offset = np.cumsum([0] + [len(sitter.looks) for sitter in sitters]).astype(np.int64)
    looks = np.concatenate([sitter.looks for sitter in sitters]) if sitters else np.zeros((0, SIZE, SIZE), np.uint16)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    with part.open("wb") as file:
        np.savez(
            file,
            looks=looks,
            looks_offset=offset,
            kinds=np.array([sitter.kind for sitter in sitters]),
            origin=np.array(json.dumps(origin)),
        )
    part.replace(path)


def sitter_files(folder: Path) -> list[Path]:
    """The files of a folder, in order; none where it holds something else."""
    return sorted(folder.glob("portraits-*.npz"))


def read_sitters(path: Path) -> list[Sitter]:
    """The bodies of one file.

    Raises:
        InputError: it cannot be read.
    """
    with _opened(path) as stored:
        looks, offset, kinds = stored["looks"], stored["looks_offset"].tolist(), stored["kinds"].tolist()
        if looks.dtype != np.uint16 or looks.shape[1:] != (SIZE, SIZE) or len(offset) != len(kinds) + 1:
            raise ValueError(f"{len(kinds)} kinds for {len(offset)} offsets and looks {looks.dtype} {looks.shape}")
    return [Sitter(looks[a:b], kind) for a, b, kind in zip(offset[:-1], offset[1:], kinds, strict=True)]


def origin_of(path: Path) -> dict[str, Any]:
    """Which belts the bodies of a file come from: what their pack said of itself.

    Raises:
        InputError: it cannot be read.
    """
    with _opened(path) as stored:
        return dict(json.loads(str(stored["origin"])))


@contextmanager
def _opened(path: Path) -> Iterator[np.lib.npyio.NpzFile]:
    try:
        with np.load(path) as stored:
            yield stored
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        raise InputError(f"{path} cannot be read: {error}; make it anew with `tuberline cut-portraits`") from error
