"""Where a network is computed."""

from __future__ import annotations

import torch

from conveyor.errors import InputError


def usable_device(name: str) -> torch.device:
    """The device `name`, as torch names it.

    Raises:
        InputError: a CUDA device without a GPU that this torch can use.
    """
    if name.startswith("cuda") and not torch.cuda.is_available():
        fix = (
            "take torch with CUDA (`make install TORCH_INDEX=`)"
            if torch.version.cuda is None
            else "see that `nvidia-smi` lists it and that this process may open /dev/nvidia*"
        )
        raise InputError(f"device '{name}': torch {torch.__version__} finds no CUDA GPU here; use 'cpu', or {fix}")
    return torch.device(name)
