"""Tuber or not, from a track's patch, by a small network that OpenCV runs from an ONNX file: no torch here."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from segmenter.classify.patch import CHANNELS, SIZE, Patch

CLEAR_OTHER, CLEAR_TUBER = -7.0, 3.0
"""Log-odds below and above which turning the patch changes no decision, on a clean belt or a cloddy one."""
SHIPPED = Path(__file__).parents[1] / "weights" / "tuberline-classifier.onnx"


class Classifier:
    """The network, read once. Not for several threads.

    Raises:
        InputError: the file is missing, or no network that takes patches.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path or SHIPPED
        self._net = read_network(self.path)
        odds = self._answer(np.zeros((CHANNELS, SIZE, SIZE), np.float32))
        if odds.size != 1:
            raise InputError(f"{self.path} answers {odds.shape} to a patch; one number is needed")

    def log_odds(self, patch: Patch) -> float:
        """Log of how much likelier a patch of at least one observation is for a tuber than for a clod or a stone.

        A patch that is not clear at once is turned and mirrored: the mean of all eight answers errs less.
        """
        channels = patch.channels()
        first = self._answer(channels).ravel()[0]
        if not CLEAR_OTHER < first < CLEAR_TUBER:
            return float(first)
        turned = [np.rot90(side, turns, (1, 2)) for side in (channels, channels[:, :, ::-1]) for turns in range(4)]
        others = [self._answer(np.ascontiguousarray(one)).ravel()[0] for one in turned[1:]]
        return float(np.mean([first, *others]))

    def _answer(self, channels: NDArray[np.float32]) -> NDArray[np.float32]:
        self._net.setInput(channels[None])
        try:
            return np.asarray(self._net.forward(), np.float32)
        except cv2.error as error:
            raise InputError(
                f"{self.path} does not take patches {channels.shape}: train it again with this version's "
                f"`tuberline train-classifier` ({error})"
            ) from error


def read_network(path: Path) -> cv2.dnn.Net:
    """A network of `tuberline train-classifier`.

    Raises:
        InputError: the file is missing, or no network that OpenCV reads.
    """
    if not path.is_file():
        raise InputError(
            f"the segmenter's weights {path} do not exist: give segmenter.weights an .onnx file made by `tuberline "
            'train-classifier`, or set segmenter.method to "classical"'
        )
    try:
        return cv2.dnn.readNetFromONNX(str(path))
    except cv2.error as error:
        raise InputError(f"{path} is no network that OpenCV {cv2.__version__} can read: {error}") from error
