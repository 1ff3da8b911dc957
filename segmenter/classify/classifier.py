"""Tuber or not, from a track's patch, by a small network."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from segmenter.classify.network import PatchNetwork
from segmenter.classify.patch import Patch

SHIPPED = Path(__file__).parents[1] / "weights" / "tuberline-classifier.onnx"
SIDES = (
    (False, 0), (True, 2), (False, 1), (True, 3),
    (False, 2), (True, 0), (False, 3), (True, 1),
)  # fmt: skip
"""(mirrored, quarter turns) of a patch in the order in which they are asked about: the first ones differ most."""


class Classifier:
    """The network, read once. Not for several threads.

    Raises:
        InputError: the file is missing, or no network that takes patches.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path or SHIPPED
        self._network = PatchNetwork(self.path)

    def answers(self, patch: Patch) -> Iterator[float]:
        """Log of how much more likely a patch of at least one observation is for a tuber than for a clod or a stone:
        eight answers, of the patch turned and mirrored, each made when it is asked for. Their mean is better than one.
        """
        channels = patch.channels()
        for mirrored, turns in SIDES:
            side = np.rot90(channels[:, :, ::-1] if mirrored else channels, turns, (1, 2))
            yield self._network.answer(np.ascontiguousarray(side))
