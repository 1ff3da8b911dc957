"""The network's tensors out of what trainings save: a state dict alone, or a checkpoint of Lightning or of a loop."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError

WITHIN = ("state_dict", "model_state_dict", "model", "net", "network", "weights", "params")
"""Under which of these names checkpoints keep the network, in the order they are looked for."""
PREFIXES = ("_orig_mod.", "module.", "model.", "net.", "network.")
"""What compiled, distributed and Lightning modules put before the names of the network's tensors."""


def state_dict_within(saved: Any, *, where: Path) -> dict[str, NDArray[Any]]:
    """The tensors, as arrays, by their names in the network.

    Raises:
        InputError: no state dict there; names what is.
    """
    state = saved
    if isinstance(saved, dict) and not _is_state(saved):
        state = next((saved[name] for name in WITHIN if _is_state(saved.get(name))), None)
    if not _is_state(state):
        holds = f"a checkpoint of {_listed(saved)}" if isinstance(saved, dict) else f"a {type(saved).__name__}"
        raise InputError(
            f"weights {where} hold {holds}, not a state dict of tensors, alone or under {', '.join(WITHIN)}: save it "
            "with torch.save(network.state_dict(), NAME)"
        )
    while state:
        prefix = next((prefix for prefix in PREFIXES if all(name.startswith(prefix) for name in state)), None)
        if prefix is None:
            break
        state = {name.removeprefix(prefix): value for name, value in state.items()}
    return dict(state)


def objects_within(refusal: str) -> str:
    """Why torch refuses to load a file that would have to run code; goes after 'weights FILE'."""
    named = re.search(r"GLOBAL ([\w.]+)", refusal)
    if named is None:
        return "are no safetensors file or PyTorch state dict: give the .safetensors or the authors' .pth file"
    return (
        f"hold Python objects ({named[1]}), and loading those would run code from the file: where you trust it, load "
        "it yourself and save its tensors with torch.save(checkpoint['state_dict'], NAME)"
    )


def _is_state(value: Any) -> bool:
    """Whether it is a mapping of names to tensors."""
    return (
        isinstance(value, dict)
        and bool(value)
        and all(isinstance(name, str) and isinstance(inner, np.ndarray) for name, inner in value.items())
    )


def _listed(saved: dict[Any, Any]) -> str:
    return ", ".join(str(name) for name in list(saved)[:8]) or "nothing"
