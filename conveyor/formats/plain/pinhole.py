"""Intrinsics as cameras' own software writes them: JSON of several layouts, or a 3x3 matrix as text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.geometry import Intrinsics
from conveyor.text_files import json_of, read_text

MATRICES = ("k", "intrinsic_matrix", "intrinsicmatrix", "camera_matrix", "cameramatrix", "matrix", "intrinsics")
DISTORTIONS = ("d", "distortion_coefficients", "distortioncoeff", "dist_coeffs", "coeffs", "distortion")
LOOK_DEPTH = 5
MOST_SKEW_PX = 1.0
MATTERS = 1e-3
"""Distortion coefficients below this move no pixel of the image by a tenth of one."""
EXPECTED = (
    'a JSON file with fx, fy, cx, cy (and width, height), or with a 3x3 matrix "K", or a text file of three rows of '
    "three numbers"
)


@dataclass(frozen=True, slots=True)
class Pinhole:
    """What a file says of a camera; None is what it does not say. Pixels; `depth_scale_m` is metres per depth unit."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int | None = None
    height: int | None = None
    depth_scale_m: float | None = None
    distortion: tuple[float, ...] = ()

    @property
    def distorted(self) -> bool:
        """Whether its images are bent so far that it can be seen, unless they were rectified."""
        return any(abs(value) > MATTERS for value in self.distortion)

    def intrinsics(self, width: int, height: int, *, where: Path) -> Intrinsics:
        """For images of this size.

        Raises:
            InputError: the file is for another size, or holds what no camera has.
        """
        if (self.width or width, self.height or height) != (width, height):
            raise InputError(
                f"{where} is for images of {self.width}x{self.height}, the frames are {width}x{height}: take the "
                "intrinsics of the size that was recorded"
            )
        try:
            return Intrinsics(width, height, self.fx, self.fy, self.cx, self.cy)
        except InputError as error:
            raise InputError(f"intrinsics {where}: {error}") from error


def read_pinhole(path: Path) -> Pinhole:
    """The intrinsics in a file: fx, fy, cx, cy (also ppx, ppy), a 3x3 matrix (nested, or 9 numbers by rows or by
    columns), Open3D's camera_intrinsic, a ROS CameraInfo, a recording's camera.json, or one of these within a
    larger JSON file.

    Raises:
        InputError: unreadable, none of these, or several cameras of which none is named after depth.
    """
    text = read_text(path, what="intrinsics")
    if not text.lstrip().startswith(("{", "[")):
        return _of_text(text, path)
    value = json_of(text, where=f"intrinsics {path}")
    found, fault = dict(_cameras(value, path.stem, 0)), _no_number(value)
    if len(found) > 1:
        found = {name: camera for name, camera in found.items() if "depth" in name.lower()} or found
    if len(found) == 1:
        return next(iter(found.values()))
    if not found:
        raise InputError(
            f"intrinsics {path}: {fault}"
            if fault
            else f"intrinsics {path} holds no camera's intrinsics; expected {EXPECTED}"
        )
    raise InputError(
        f"intrinsics {path} holds those of {len(found)} cameras ({', '.join(found)}): save the depth camera's alone"
    )


def _of_text(text: str, path: Path) -> Pinhole:
    try:
        matrix = _matrix([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        matrix = None
    if matrix is None:
        raise InputError(f"intrinsics {path} cannot be used; expected {EXPECTED}")
    return _of_matrix(matrix)


def _cameras(value: Any, name: str, depth: int) -> Iterator[tuple[str, Pinhole]]:
    """Every camera within a JSON value, by the names that lead to it."""
    if depth > LOOK_DEPTH:
        return
    if depth == 0 and (matrix := _matrix(value)) is not None:
        yield name, _of_matrix(matrix)
    elif isinstance(value, dict):
        camera = _of_mapping({str(key).lower(): inner for key, inner in value.items()})
        if camera is not None:
            yield name, camera
            return
        for key, inner in value.items():
            yield from _cameras(inner, f"{name}.{key}" if depth else str(key), depth + 1)
    elif isinstance(value, list):
        for at, inner in enumerate(value):
            yield from _cameras(inner, f"{name}.{at}" if depth else str(at), depth + 1)


def _no_number(value: Any, name: str = "", depth: int = 0) -> str:
    """Which of a camera's numbers is none, by the names that lead to it; empty where that is not what is wrong."""
    if depth > LOOK_DEPTH:
        return ""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, given in inner:
        where = f"{name}.{key}" if name else str(key)
        small = str(key).lower()
        if small in ("fx", "fy", "cx", "cy", "ppx", "ppy") and _number(given) is None:
            return f"{where} is {given!r:.40}; a finite number of pixels is needed"
        if small in MATRICES and (odd := _not_finite(given)):
            return f"{where} holds {', '.join(odd)}; nine finite numbers of pixels are needed"
        if fault := _no_number(given, where, depth + 1):
            return fault
    return ""


def _not_finite(value: Any) -> list[str]:
    """What is no finite number in a matrix's nine, as it is written."""
    value = value.get("data") if isinstance(value, dict) else value
    rows = value if isinstance(value, list) else []
    flat = [one for row in rows for one in (row if isinstance(row, list) else [row])]
    return [f"{one!r:.40}" for one in flat if _number(one) is None] if len(flat) == 9 else []


def _of_mapping(data: Mapping[str, Any]) -> Pinhole | None:
    """The camera that a mapping with small letters' keys describes, if it does."""
    values = {
        "fx": _number(data.get("fx")),
        "fy": _number(data.get("fy")),
        "cx": _number(data.get("cx", data.get("ppx"))),
        "cy": _number(data.get("cy", data.get("ppy"))),
    }
    if None in values.values():
        matrix = next((m for key in MATRICES if (m := _matrix(data.get(key))) is not None), None)
        if matrix is None:
            return None
        values = dict(zip(("fx", "fy", "cx", "cy"), _of_four(matrix), strict=True))
    width, height = (_number(data.get(key, data.get(f"image_{key}"))) for key in ("width", "height"))
    return Pinhole(
        **{key: value for key, value in values.items() if value is not None},
        width=int(width) if width else None,
        height=int(height) if height else None,
        depth_scale_m=_scale_m(data),
        distortion=_numbers(next((data[key] for key in DISTORTIONS if key in data), None)),
    )


def _of_matrix(matrix: NDArray[np.float64]) -> Pinhole:
    return Pinhole(*_of_four(matrix))


def _of_four(matrix: NDArray[np.float64]) -> tuple[float, float, float, float]:
    return float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2])


def _matrix(value: Any) -> NDArray[np.float64] | None:
    """(3, 3) of three rows, of 9 numbers by rows or (Open3D) by columns, or of a mapping with 'data'; None: none."""
    if isinstance(value, dict):
        value = value.get("data")
    try:
        flat = np.asarray(value, np.float64).ravel() if isinstance(value, list) else np.empty(0)
    except (ValueError, TypeError, OverflowError):
        return None
    if flat.shape != (9,) or not np.isfinite(flat).all():
        return None
    matrix = flat.reshape(3, 3)
    if np.allclose(matrix[:2, 2], 0):
        matrix = matrix.T
    fits = np.allclose(matrix[2], [0, 0, 1]) and matrix[0, 0] > 0 and matrix[1, 1] > 0
    straight = abs(matrix[1, 0]) < MOST_SKEW_PX and abs(matrix[0, 1]) < MOST_SKEW_PX
    return matrix if fits and straight else None


def _scale_m(data: Mapping[str, Any]) -> float | None:
    """Metres per unit: `depth_scale_m`, or `depth_scale`, which Open3D gives in units per metre."""
    given = _number(data.get("depth_scale_m"))
    if given:
        return given
    scale = _number(data.get("depth_scale"))
    if not scale:
        return None
    return 1.0 / round(scale, 3) if scale >= 1 else scale  # 999.99993896 of the D405 is 1 mm


def _numbers(value: Any) -> tuple[float, ...]:
    value = value.get("data") if isinstance(value, dict) else value
    numbers = [_number(inner) for inner in value] if isinstance(value, list) else []
    return tuple(number for number in numbers if number is not None)


def _number(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:  # whole numbers have no limit in JSON
        return None
    return number if np.isfinite(number) else None
