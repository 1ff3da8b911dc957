"""Clouds from files: .ply, .npy, .npz. Camera frame, metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.formats.ply import read_ply


def read_cloud(path: Path) -> NDArray[np.float64]:
    """(N, 3) float64 points of a .ply, .npy or .npz file.

    Raises:
        InputError: missing, truncated, of another layout, or not finite.
    """
    suffix = path.suffix.lower()
    if not path.is_file():
        raise InputError(f"cloud {path} does not exist")
    if suffix == ".ply":
        points = read_ply(path)
    elif suffix in (".npy", ".npz"):
        points = _read_numpy(path)
    else:
        raise InputError(
            f"cloud {path} has the ending '{suffix}'; known: .ply, .npy, .npz, or a depth/rgb pair of .png"
        )
    if not np.isfinite(points).all():
        bad = int((~np.isfinite(points)).any(1).sum())
        raise InputError(f"cloud {path} has {bad} of {len(points)} points that are not finite: remove them first")
    if len(points) and float(np.abs(points).max()) > 100.0:
        raise InputError(
            f"cloud {path} reaches {float(np.abs(points).max()):.0f} m: it must be in metres (is it in millimetres?)"
        )
    return points


def _read_numpy(path: Path) -> NDArray[np.float64]:
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.lib.npyio.NpzFile):  # by what it is, not by what it is called
            with loaded as file:
                fitting = [key for key in file.files if file[key].ndim == 2 and file[key].shape[1] == 3]
                if len(fitting) != 1 and "points" not in fitting:
                    raise InputError(
                        f"cloud {path} needs one array of shape (N, 3) or one named 'points'; it has "
                        + (", ".join(f"{key} {file[key].shape}" for key in file.files) or "none")
                    )
                loaded = file["points" if "points" in fitting else fitting[0]]
    except InputError:
        raise
    except Exception as error:  # NumPy lets errors of zip, zlib, tokenizer and memory through for broken files
        raise InputError(f"cloud {path} is not a NumPy file: {error}") from error
    if loaded.ndim != 2 or loaded.shape[1] != 3 or loaded.dtype.kind not in "fiu":
        raise InputError(f"cloud {path} holds {loaded.dtype} {loaded.shape}; expected numbers of shape (N, 3)")
    return np.asarray(loaded, np.float64)
