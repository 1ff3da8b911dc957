"""What is said of an array that is no cloud of shape (N, 3), and how to make one of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST_COLUMNS = 16
"""Of a point: x, y, z, a colour, a normal and the like. What has more both ways is an image."""

UNMASKED = "cloud[~np.ma.getmaskarray(cloud).any(axis=1)].data, the points without one"


def masked_fault(array: Any, instead: str) -> str:
    """In words, that values of `array` are masked, which are read as if they were not, and to take `instead`; empty
    where none are.
    """
    if not np.ma.is_masked(array):
        return ""
    return f"a masked array, {int(np.ma.getmaskarray(array).sum())} of its values masked: take {instead}"


def cloud_fault(array: NDArray[Any]) -> str:
    """In words, what `array` is and what to take in its place; empty where it is numbers of shape (N, 3). Nothing is
    guessed: six columns may begin with a colour, and axes that are exchanged make another cloud.
    """
    if array.ndim == 2 and array.shape[1] == 3 and array.dtype.kind in "fiu":
        return ""
    return f"{_what(array)}: take {_instead(array)}"


def _what(array: NDArray[Any]) -> str:
    if array.dtype.kind == "O" and array.ndim == 0:
        return f"a {type(array.item()).__name__}"
    return f"columns {', '.join(array.dtype.names)}" if array.dtype.names else f"{array.dtype} {array.shape}"


def _instead(array: NDArray[Any]) -> str:
    """What of `array`, called cloud, would be (N, 3)."""
    if array.dtype.names and {"x", "y", "z"} <= set(array.dtype.names):
        return "np.stack([cloud['x'], cloud['y'], cloud['z']], axis=1)"
    if array.dtype.kind == "O" and array.ndim == 0:
        return "an array: of Open3D's clouds np.asarray(cloud.points)"
    if array.dtype.kind not in "fiu":
        return "real numbers, float64, in metres"
    match array.shape:
        case (3, _):
            return "its transpose, cloud.T"
        case (rows, columns) if 3 < rows <= MOST_COLUMNS < columns:
            return "cloud[:3].T, where its first three rows are x, y, z"
        case (_, columns) if 3 < columns <= MOST_COLUMNS:
            return "cloud[:, :3], where its first three columns are x, y, z"
        case (_, 1 | 2):
            return "x, y and z of each point; without z nothing can be weighed"
        case (_, _):
            return (
                "the points of one tuber; a depth image is for weigh_depth, its file for `tuberline weigh --instances`"
            )
        case (1, _, 3):
            return "cloud[0]"
        case (_, _, 3):
            return "the points of one tuber: cloud[mask] with its mask, or cloud.reshape(-1, 3) where all are of it"
        case (number,) if number and number % 3 == 0:
            return "cloud.reshape(-1, 3), where x, y, z of each point follow each other"
        case _:
            return "an array of two axes, x, y, z along the second"
