"""What becomes of tubers and of distractors, against a recording's truth: counted, rejected, missed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from conveyor.errors import InputError
from conveyor.formats.beside import recording_files
from conveyor.text_files import json_of

WITHIN_M = 0.025


@dataclass(frozen=True, slots=True)
class LoadTruth:
    """Places of what crosses one camera's centre row: (n, 2) tubers, (m, 2) distractors; kinds of the latter."""

    tubers: NDArray[np.float64]
    distractors: NDArray[np.float64]
    kinds: tuple[str, ...]


@dataclass(slots=True)
class LoadScore:
    """Sums over cameras: of tubers and distractors that crossed a centre row, how many were counted.

    `tubers_rejected` were taken for distractors. `distractors_counted` were taken for tubers; `false` counts are near
    neither a tuber nor a distractor, doubles among them.
    """

    tubers: int = 0
    tubers_counted: int = 0
    tubers_rejected: int = 0
    distractors: int = 0
    distractors_counted: int = 0
    distractors_rejected: int = 0
    false: int = 0

    def add(self, truth: LoadTruth, counted: NDArray[np.float64], rejected: NDArray[np.float64]) -> None:
        """Take one camera: places (n, 2) of the counted tracks and of those rejected by their class."""
        hit, left = _matched(truth.tubers, counted)
        taken, left = _matched(truth.distractors, left)
        refused, other = _matched(truth.tubers[~hit], rejected)
        known, _ = _matched(truth.distractors[~taken], other)
        self.tubers += len(truth.tubers)
        self.tubers_counted += int(hit.sum())
        self.tubers_rejected += int(refused.sum())
        self.distractors += len(truth.distractors)
        self.distractors_counted += int(taken.sum())
        self.distractors_rejected += int(known.sum())
        self.false += len(left)

    @property
    def distractors_counted_share(self) -> float:
        """Distractors counted as tubers, over all distractors."""
        return self.distractors_counted / self.distractors if self.distractors else 0.0

    @property
    def tubers_rejected_share(self) -> float:
        """Tubers rejected as distractors, over all tubers."""
        return self.tubers_rejected / self.tubers if self.tubers else 0.0


def load_truth(recording: Path, camera: str) -> LoadTruth | None:
    """What crosses a camera of a recording; None where its truth.json does not say where the distractors are. Null in
    it is as good as no key.

    Raises:
        InputError: truth.json cannot be read.
    """
    text = recording_files(recording).get("truth.json")
    if text is None:
        return None
    truth = json_of(text, where=f"truth.json of {recording}")
    try:
        others = truth.get("distractor_places")
        if others is None and truth.get("distractors"):
            return None
        tubers = [row for row in truth["tubers"] if _seen_by(camera, row)]
        others = [row for row in others or [] if _seen_by(camera, row)]
        return LoadTruth(_places(tubers), _places(others), tuple(str(row["kind"]) for row in others))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"truth.json of {recording} cannot be read as the truth of a recording: {error}") from error


def _seen_by(camera: str, row: dict[str, Any]) -> bool:
    """Where a row does not say which cameras see it, all do."""
    cameras = row.get("cameras")
    return cameras is None or camera in cameras


def _places(rows: list[dict[str, Any]]) -> NDArray[np.float64]:
    return np.array([(row["place_x_m"], row["place_y_m"]) for row in rows], np.float64).reshape(-1, 2)


def _matched(truth: NDArray[np.float64], found: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """(which of the truth has a found one within reach, one to one; the found ones left over)."""
    hit, used = np.zeros(len(truth), bool), np.zeros(len(found), bool)
    if len(truth) and len(found):
        away = np.linalg.norm(truth[:, None] - found[None], axis=2)
        cost = np.where(away <= WITHIN_M, away, 1e3)
        for i, j in zip(*linear_sum_assignment(cost), strict=True):
            if cost[i, j] <= WITHIN_M:
                hit[i] = used[j] = True
    return hit, found[~used]
