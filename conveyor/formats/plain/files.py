"""Arrays out of the files that depth frames are saved in: PNG, TIFF, NPY, NPZ and MAT."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.formats.numpy_files import numpy_fault
from conveyor.formats.png16 import is_whole_png
from conveyor.wire import MAX_ARRAY_BYTES

IMAGES = (".png", ".tif", ".tiff")
MASKS, MOST_OBJECTS = "mask", 2000
ENDINGS = (*IMAGES, ".npy", ".npz", ".mat")


def frame_files(folder: Path, pattern: str) -> list[Path]:
    """The files in `folder` (or that file itself) that may hold depth frames, numbers in their names in order.

    Raises:
        InputError: there are none; the text says what is there.
    """
    if folder.is_file():
        return [folder]
    if not folder.is_dir():
        raise InputError(f"{folder} does not exist; name the folder that holds the depth frames")
    try:
        inside = sorted((path for path in folder.glob(pattern) if path.is_file()), key=_by_number)
    except (NotImplementedError, ValueError) as error:
        raise InputError(f"--pattern '{pattern}' is none for files within {folder}; give one like '*.png'") from error
    files = [path for path in inside if path.suffix.lower() in ENDINGS]
    if not files:
        there = ", ".join(sorted({path.suffix or path.name for path in inside})) or "nothing"
        raise InputError(f"{folder}: no depth frames ({', '.join(ENDINGS)}) match '{pattern}'; there is {there}")
    return files


def read_frames(path: Path) -> NDArray[Any]:
    """(N, H, W) of the frames in one file, as they are stored.

    Raises:
        InputError: broken, a colour picture, or several arrays of which none is named depth.
    """
    suffix = path.suffix.lower()
    array = _image(path) if suffix in IMAGES else _numpy(path) if suffix != ".mat" else _mat(path)
    if array.ndim == 3 and array.shape[2] in (3, 4) and suffix in IMAGES:
        raise InputError(f"{path} is a colour picture and no depth; {_choose(path)}")
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[..., 0]
    if array.dtype == np.uint8:
        raise InputError(
            f"{path} has 8 bits per pixel: it is a picture of depth, not depth itself; save depth as 16 bits, or "
            f"{_choose(path)}"
        )
    if array.dtype.kind not in "fiu" or array.ndim not in (2, 3):
        raise InputError(f"{path} holds {array.dtype} {array.shape}; a frame is (rows, columns) of depths")
    if array.ndim == 3 and array.shape[2] in (3, 4):
        raise InputError(
            f"{path} holds {array.shape}: a colour picture or a cloud, and no depth; a frame is (rows, columns), "
            "several are (frames, rows, columns)"
        )
    return array[None] if array.ndim == 2 else array


def read_labels(path: Path) -> NDArray[np.int64]:
    """(H, W) the number of the object that each pixel belongs to, 0 = background, from any of these files.

    Raises:
        InputError: broken, a colour picture, no whole numbers, or more objects than a frame can hold.
    """
    suffix = path.suffix.lower()
    if suffix not in ENDINGS:
        raise InputError(f"instances {path} have the ending '{suffix}'; known: {', '.join(ENDINGS)}")
    array = _image(path) if suffix in IMAGES else _numpy(path, MASKS) if suffix != ".mat" else _mat(path, MASKS)
    if array.ndim != 2 or array.dtype.kind not in "biu":
        raise InputError(
            f"instances {path} hold {array.dtype} {array.shape}; expected one whole number per pixel, of shape (rows, "
            "columns): 0 for background, 1, 2, ... for the objects"
        )
    objects = np.unique(array)
    if len(objects) > MOST_OBJECTS or (len(objects) and objects[0] < 0):
        raise InputError(
            f"instances {path} hold {len(objects)} different numbers from {objects[0]} on: that is no mask of objects; "
            f"allowed are 0 and at most {MOST_OBJECTS} others"
        )
    return np.asarray(array, np.int64)


def _image(path: Path) -> NDArray[Any]:
    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error
    whole = path.suffix.lower() != ".png" or is_whole_png(data)
    _, pages = cv2.imdecodemulti(data, cv2.IMREAD_UNCHANGED) if whole and len(data) else (False, ())
    if not pages:
        raise InputError(f"{path} is cut short or no image; copy it again, or remove it: its number is then a gap")
    if len(pages) > 1:
        raise InputError(f"{path} holds {len(pages)} pages; save each frame as a file, or all of them as one .npy")
    return np.asarray(pages[0])


def _numpy(path: Path, wanted: str = "depth") -> NDArray[Any]:
    try:
        loaded = np.load(path, mmap_mode="r", allow_pickle=False)
        if isinstance(loaded, np.lib.npyio.NpzFile):
            with loaded as file:
                return _chosen({name: file[name] for name in file.files}, path, wanted)
    except InputError:
        raise
    except Exception as error:  # NumPy lets errors of zip, zlib, tokenizer and memory through for broken files
        raise InputError(f"{path} is no whole NumPy file: {numpy_fault(path, error)}") from error
    return np.asarray(loaded)


def _mat(path: Path, wanted: str = "depth") -> NDArray[Any]:
    from scipy.io import loadmat

    try:
        loaded = loadmat(path)
    except NotImplementedError as error:
        raise InputError(f"{path} is of MATLAB's format 7.3: save it again with save(..., '-v7')") from error
    except Exception as error:  # SciPy lets errors of zlib, struct and its own through for broken files
        raise InputError(f"{path} is no whole MAT file: {error}") from error
    return _chosen({name: array for name, array in loaded.items() if not name.startswith("__")}, path, wanted)


def _chosen(arrays: Mapping[str, Any], path: Path, wanted: str) -> NDArray[Any]:
    """The array that is `wanted`: the one named so, else the only one with rows and columns."""
    wide = {
        name: array
        for name, array in arrays.items()
        if isinstance(array, np.ndarray) and array.ndim >= 2 and min(array.shape[:2]) > 4
    }
    named = {name: array for name, array in wide.items() if name.lower() == wanted}
    named = named or {name: array for name, array in wide.items() if wanted in name.lower()} or wide
    if len(named) != 1:
        there = ", ".join(f"{name} {getattr(array, 'shape', '')}" for name, array in arrays.items()) or "none"
        raise InputError(f"{path} needs one image, or one named '{wanted}'; it has {there}")
    array = next(iter(named.values()))
    if array.nbytes > MAX_ARRAY_BYTES * 64:
        raise InputError(f"{path} holds {array.nbytes} bytes: save fewer frames in one file")
    return np.asarray(array)


def _choose(path: Path) -> str:
    """How to leave out what is no depth."""
    depths = [other.name for other in path.parent.glob("*depth*") if other.suffix.lower() in ENDINGS]
    example = f"*depth*{path.suffix}" if depths and "depth" not in path.name else "NAMES*.png"
    return f"choose the depth frames by name: --pattern '{example}'"


def _by_number(path: Path) -> tuple[list[tuple[int, str]], str]:
    """Sorts frame 10 after frame 9."""
    parts = re.findall(r"\d+|\D+", path.name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts], path.name
