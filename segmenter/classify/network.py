"""The classifier's network as onnxruntime runs it: no torch here."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from segmenter.classify.patch import CHANNELS, SIZE

QUIET = 3
"""Of onnxruntime's log levels: errors, which are raised here, and nothing else."""


def check_there(path: Path) -> None:
    """Before onnxruntime is imported for it.

    Raises:
        InputError: the file is missing.
    """
    if not path.is_file():
        raise InputError(
            f"the segmenter's weights {path} do not exist: give segmenter.weights an .onnx file made by `tuberline "
            'train-classifier`, or set segmenter.method to "classical"'
        )


class PatchNetwork:
    """A network of `tuberline train-classifier`, read once, on the thread that asks it.

    Raises:
        InputError: the file is missing, or no network that takes patches and answers one number.
    """

    def __init__(self, path: Path) -> None:
        check_there(path)
        import onnxruntime  # it starts a thread, which a process that forks must not have

        self._path = path
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = QUIET
        try:
            self._session: Any = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # its classes of errors derive from no common one
            raise InputError(
                f"{path} is no network that onnxruntime {onnxruntime.__version__} can read: {error}"
            ) from error
        self._input = self._session.get_inputs()[0].name
        answer = self.answer(np.zeros((CHANNELS, SIZE, SIZE), np.float32))
        if not isfinite(answer):
            raise InputError(
                f"{path} answers {answer} to an empty patch; a finite number is needed: train it again, or set "
                'segmenter.method to "classical"'
            )

    def answer(self, channels: NDArray[np.float32]) -> float:
        """The network's number for one patch, (10, 48, 48) float32."""
        try:
            (answer,) = self._session.run(None, {self._input: channels[None]})
        except Exception as error:
            raise InputError(
                f"{self._path} does not take patches {channels.shape}: train it again with this version's "
                f"`tuberline train-classifier` ({error})"
            ) from error
        if answer.size != 1:
            raise InputError(f"{self._path} answers {answer.shape} to a patch; one number is needed")
        return float(answer.ravel()[0])
