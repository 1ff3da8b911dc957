"""What is said of files that NumPy cannot read."""

from __future__ import annotations

from pathlib import Path

BEGINNINGS = (b"\x93NUMPY", b"PK")
"""Of .npy, and of .npz, which is a zip archive."""


def numpy_fault(path: Path, error: Exception, *, otherwise: str = "") -> str:
    """In words, why `np.load` could not read a file; of what is no NumPy file it says to load it as pickled objects.

    Args:
        otherwise: what to do with a file that is none.
    """
    if isinstance(error, OSError):
        return error.strerror or str(error)
    with path.open("rb") as file:
        begun = file.read(8)
    if not begun:
        return "it is empty"
    if not begun.startswith(BEGINNINGS):
        return f"it begins with {begun!r}, not as np.save writes it{otherwise and '; '}{otherwise}"
    return "it holds Python objects; save numbers alone" if "allow_pickle" in str(error) else str(error)
