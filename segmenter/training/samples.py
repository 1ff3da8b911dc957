"""Training samples of the classifier: bodies with their observations, packed small, and files of them."""

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
from segmenter.classify.patch import SIZE, Observation
from segmenter.training.pack import HEIGHT_STEP_MM

INSIDE_BIT = np.uint16(1 << 15)
GOLDEN = 0.6180339887498949
"""Multiples of it, less their whole parts, fill 0 to 1 as evenly as any number of observations can."""


@dataclass(frozen=True, slots=True)
class TrainingSample:
    """One body with its observations.

    Attributes:
        observations: (n, 48, 48) uint16, in the order of the belt's travel. The highest bit: the cell is the body's;
            the others: 0 where nothing was seen, else 1 + its height in 0.01 mm. Memory is what bounds a training.
        kind: 'tuber' or what else it is.
    """

    observations: NDArray[np.uint16]
    kind: str

    @property
    def is_tuber(self) -> bool:
        """A tuber, no clod, stone or haulm."""
        return self.kind == "tuber"


def sample_of(observations: list[Observation], kind: str) -> TrainingSample:
    """A body's observations in a row. A cell that is partly the body's is so in that share of the observations."""
    packed = np.zeros((len(observations), SIZE, SIZE), np.uint16)
    for n, observation in enumerate(observations):
        steps = np.clip(observation.height_mm / HEIGHT_STEP_MM + 1.5, 1, int(INSIDE_BIT) - 1).astype(np.uint16)
        share = (n + 1) * GOLDEN % 1
        packed[n] = np.where(observation.seen > 0, steps, 0) | np.where(observation.inside > share, INSIDE_BIT, 0)
    return TrainingSample(packed, kind)


def write_samples(path: Path, samples: list[TrainingSample], *, origin: dict[str, Any]) -> None:
    """One file: `observations` in a row, `observations_offset` (bodies + 1,), `kinds`, and `origin` as JSON text."""
    offset = np.cumsum([0] + [len(sample.observations) for sample in samples]).astype(np.int64)
    observations = (
        np.concatenate([sample.observations for sample in samples]) if samples else np.zeros((0, SIZE, SIZE), np.uint16)
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    with part.open("wb") as file:
        np.savez(
            file,
            observations=observations,
            observations_offset=offset,
            kinds=np.array([sample.kind for sample in samples]),
            origin=np.array(json.dumps(origin)),
        )
    part.replace(path)


def sample_files(folder: Path) -> list[Path]:
    """The files of a folder, in order; none where it holds something else.

    Raises:
        InputError: it holds files of before they were called patches.
    """
    old = sorted(folder.glob("portraits-*.npz"))
    if old:
        raise InputError(f"{old[0]} is of an older version: make it again with `tuberline make-patches`")
    return sorted(folder.glob("patches-*.npz"))


def read_samples(path: Path) -> list[TrainingSample]:
    """The bodies of one file.

    Raises:
        InputError: it cannot be read.
    """
    with _opened(path) as stored:
        observations, offset, kinds = (
            stored["observations"],
            stored["observations_offset"].tolist(),
            stored["kinds"].tolist(),
        )
        if observations.dtype != np.uint16 or observations.shape[1:] != (SIZE, SIZE) or len(offset) != len(kinds) + 1:
            raise ValueError(
                f"{len(kinds)} kinds, {len(offset)} offsets, observations {observations.dtype} {observations.shape}"
            )
    return [TrainingSample(observations[a:b], kind) for a, b, kind in zip(offset[:-1], offset[1:], kinds, strict=True)]


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
        raise InputError(f"{path} cannot be read: {error}; make it again with `tuberline make-patches`") from error
