"""View packs: depth crops of single tubers with their truth, in shards `views-00000.npz`, and `meta.json`.

Several packs may lie side by side in one folder. A shard may hold further arrays of n rows beside those of ARRAYS: they
come back by their names in `PackedView.more`, so that what a simulator adds needs no new version.
"""

from __future__ import annotations

import math
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.formats.packs.files import NamedArray, read_meta, read_shard, write_meta
from conveyor.geometry import Intrinsics
from conveyor.stated import BELT_DISTANCE_M, BELT_SD_MM

VERSION = 1
FORMAT_NAME = "view pack"
PATTERN = "views-*.npz"
VIEWS_PER_SHARD = 1500
UNKNOWN = "unknown"

ARRAYS = (
    NamedArray("depth", "(sum of h w,)", "uint16, all crops one after the other, 0 outside the mask"),
    NamedArray("depth_offset", "(n + 1,)", "where each crop begins in depth"),
    NamedArray("crop", "(n, 4)", "u0, v0, h, w of the crop in its image, pixels"),
    NamedArray("depth_scale_m", "(n,) or ()", "metres per unit of depth"),
    NamedArray("intrinsics", "(n, 4)", "fx, fy, cx, cy of the image, pixels"),
    NamedArray("image_size", "(n, 2)", "width, height, pixels"),
    NamedArray("belt_distance_m", "(n,)", "camera to belt along the optical axis, as it is stated"),
    NamedArray("belt_sd_m", "(n,)", "how well that is known, standard deviation", needed=False),
    NamedArray("weight_g", "(n,)", "true weight"),
    NamedArray("volume_ml", "(n,)", "true volume", needed=False),
    NamedArray("length_mm", "(n,)", "longest caliper axis", needed=False),
    NamedArray("width_mm", "(n,)", "middle caliper axis", needed=False),
    NamedArray("height_mm", "(n,)", "shortest caliper axis", needed=False),
    NamedArray("tuber", "(n,)", "the same number in all views of a tuber"),
    NamedArray("cultivar", "(n,)", "its name", needed=False),
    NamedArray("season", "(n,)", "its year", needed=False),
    NamedArray("v_centre", "(n,)", "image row of the tuber's centre, pixels", needed=False),
)
_COLUMNS = {"crop": 4, "intrinsics": 4, "image_size": 2}
_KNOWN = {array.name for array in ARRAYS}
_ALLOWED = {
    "depth_scale_m": (1e-6, 1.0, "metres per unit of depth"),
    "belt_distance_m": (*BELT_DISTANCE_M, "metres"),
    "belt_sd_m": (BELT_SD_MM[0] / 1e3, BELT_SD_MM[1] / 1e3, "metres"),
}
"""From and to, and the unit."""


@dataclass(frozen=True, slots=True)
class PackedView:
    """One view of a pack.

    Attributes:
        depth: (h, w) uint16 crop, units of `depth_scale_m` metres, 0 outside the tuber; `u0`, `v0`: its first pixel.
        intrinsics: of the whole image.
        belt_sd_m, volume_ml, length_mm, width_mm, height_mm, v_centre: None where the pack does not say.
        more: this view's value in every array that ARRAYS does not name.
    """

    depth: NDArray[np.uint16]
    u0: int
    v0: int
    intrinsics: Intrinsics
    depth_scale_m: float
    belt_distance_m: float
    weight_g: float
    tuber: int
    belt_sd_m: float | None = None
    volume_ml: float | None = None
    length_mm: float | None = None
    width_mm: float | None = None
    height_mm: float | None = None
    cultivar: str = UNKNOWN
    season: str = UNKNOWN
    v_centre: float | None = None
    more: Mapping[str, Any] = field(default_factory=dict)


def view_shards(folder: Path) -> list[Path]:
    """Shards of the pack, or of the packs side by side, in `folder`; sorted, none where there is no pack."""
    return sorted(folder.glob(PATTERN)) or sorted(folder.glob(f"*/{PATTERN}"))


def count_views(shard: Path) -> int:
    """How many views a shard holds, without reading their depth; 0 for one that cannot be read."""
    try:
        with np.load(shard, allow_pickle=False) as file:
            return len(np.atleast_1d(file["weight_g"]))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return 0


def read_views(shard: Path) -> Iterator[PackedView]:
    """The views of one shard, in order.

    Raises:
        InputError: unreadable, of a newer version, or with arrays that contradict each other.
    """
    read_meta(shard.parent, newest=VERSION, what=FORMAT_NAME)
    data = read_shard(shard, ARRAYS)
    count = len(np.atleast_1d(data["weight_g"]))
    if data["depth_scale_m"].ndim == 0:
        data["depth_scale_m"] = np.full(count, data["depth_scale_m"])
    for name, array in data.items():
        rows = count + 1 if name == "depth_offset" else count
        if name != "depth" and (array.ndim == 0 or len(array) != rows):
            raise InputError(f"shard {shard}: array '{name}' has shape {array.shape}; {rows} rows are needed")
    for name, columns in _COLUMNS.items():
        if data[name].shape != (count, columns):
            raise InputError(
                f"shard {shard}: array '{name}' has shape {data[name].shape}; ({count}, {columns}) is needed"
            )
    tuber = data["tuber"]
    if tuber.dtype.kind not in "iuf" or not (tuber == np.round(tuber)).all():
        raise InputError(
            f"shard {shard}: array 'tuber' is {tuber.dtype}; allowed are whole numbers, the same in all "
            "views of a tuber"
        )
    depth = data["depth"]
    if depth.dtype != np.uint16 and not (depth.dtype.kind in "ui" and ((depth >= 0) & (depth < 1 << 16)).all()):
        raise InputError(f"shard {shard}: array 'depth' is {depth.dtype}; allowed are whole units of depth, 0 to 65535")
    for i in range(count):
        try:
            yield _view(data, i)
        except (ValueError, TypeError, IndexError, OverflowError, InputError) as error:
            raise InputError(f"shard {shard}, view {i}: {error}") from error


def _view(data: dict[str, NDArray[Any]], i: int) -> PackedView:
    u0, v0, height, width = (int(value) for value in data["crop"][i])
    begin, end = int(data["depth_offset"][i]), int(data["depth_offset"][i + 1])
    crop = data["depth"][begin:end] if 0 <= begin <= end else data["depth"][:0]
    if height <= 0 or width <= 0 or crop.size != height * width:
        raise ValueError(f"{crop.size} depths for a crop of {height}x{width}")
    weight_g = float(data["weight_g"][i])
    if not 0 < weight_g < math.inf:
        raise ValueError(f"weight_g is {weight_g:g}; allowed are grams above 0")
    for name, (low, high, unit) in _ALLOWED.items():
        if name in data and not low <= float(data[name][i]) <= high:
            raise ValueError(f"{name} is {float(data[name][i]):g}; allowed are {low:g} to {high:g} {unit}")
    image_width, image_height = (int(value) for value in data["image_size"][i])
    return PackedView(
        depth=crop.reshape(height, width).astype(np.uint16, copy=False),
        u0=u0,
        v0=v0,
        intrinsics=Intrinsics(image_width, image_height, *(float(value) for value in data["intrinsics"][i])),
        depth_scale_m=float(data["depth_scale_m"][i]),
        belt_distance_m=float(data["belt_distance_m"][i]),
        weight_g=weight_g,
        tuber=int(data["tuber"][i]),
        more={name: array[i] for name, array in data.items() if name not in _KNOWN},
        belt_sd_m=_number(data, "belt_sd_m", i),
        volume_ml=_number(data, "volume_ml", i),
        length_mm=_number(data, "length_mm", i),
        width_mm=_number(data, "width_mm", i),
        height_mm=_number(data, "height_mm", i),
        v_centre=_number(data, "v_centre", i),
        cultivar=str(data["cultivar"][i]) if "cultivar" in data else UNKNOWN,
        season=str(data["season"][i]) if "season" in data else UNKNOWN,
    )


def _number(data: dict[str, NDArray[Any]], name: str, i: int) -> float | None:
    return float(data[name][i]) if name in data else None


class ViewPackWriter:
    """Shards of about VIEWS_PER_SHARD views, then meta.json; use it in a `with`."""

    def __init__(self, out: Path, *, meta: Mapping[str, Any]) -> None:
        self._out = out
        self._meta = dict(meta)
        self._pending: list[PackedView] = []
        self.views = 0
        self.shards = 0

    def __enter__(self) -> Self:
        self._out.mkdir(parents=True, exist_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self._write()
            write_meta(self._out, version=VERSION, what=self._meta | {"views": self.views, "shards": self.shards})

    def add(self, views: Sequence[PackedView]) -> None:
        """Add all views of one tuber: they stay in one shard."""
        self._pending += views
        if len(self._pending) >= VIEWS_PER_SHARD:
            self._write()

    def _write(self) -> None:
        if self._pending:
            np.savez_compressed(self._out / f"views-{self.shards:05d}.npz", **pack_views(self._pending))
            self.views, self.shards, self._pending = self.views + len(self._pending), self.shards + 1, []


def pack_views(views: Sequence[PackedView]) -> dict[str, Any]:
    """The arrays of one shard, by name; an optional one is there where every view has it."""
    k = [view.intrinsics for view in views]
    packed: dict[str, Any] = {
        "depth": np.concatenate([view.depth.ravel() for view in views]),
        "depth_offset": np.concatenate([[0], np.cumsum([view.depth.size for view in views])]).astype(np.int64),
        "crop": np.array([(view.u0, view.v0, *view.depth.shape) for view in views], np.int32),
        "intrinsics": np.array([(i.fx, i.fy, i.cx, i.cy) for i in k]),
        "image_size": np.array([(i.width, i.height) for i in k], np.int32),
        "tuber": np.array([view.tuber for view in views], np.int64),
    }
    for name in (array.name for array in ARRAYS if array.name not in packed):
        values = [getattr(view, name) for view in views]
        if all(value is not None for value in values):
            packed[name] = np.array(values)
    for name in views[0].more:
        packed[name] = np.array([view.more[name] for view in views])
    return packed
