"""Views with known weights, from wherever they lie: view packs of the simulator, or a 3DPotatoTwin folder.

`read_labelled` tells the layouts apart and yields `LabelledView`s of either; the formats are
`conveyor.formats.packs.views` and `conveyor.formats.potatotwin`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.formats.packs.views import PackedView, count_views, read_views, view_shards
from conveyor.formats.potatotwin.layout import INTRINSICS, RGBD, SPLITS, TRUTH, is_potatotwin
from conveyor.formats.potatotwin.resting import twin_resting
from conveyor.formats.potatotwin.views import TwinView, count_twin, labels_without_views, read_twin
from conveyor.geometry import TYPICAL_BELT_SD_M, straight_down_belt_from_camera
from conveyor.resting import RestingLevel
from regressor.training.plausible import check_place
from regressor.weigh.prepare import PreparedCloud, prepare_cloud, prepare_depth

SAME_WEIGHT = 0.1
"""By so much of it two weights of one tuber may differ: one that dries out is weighed again."""
Resting = Literal["calibrated", "stated"]
"""Which resting level a simulated view is read with. 'stated': as its user would state it, known or not. 'calibrated':
as a calibration finds it, the mean level of the recording's undersides, with soil under them and play between rods, and
with that calibration's error. What no one can know is no part of a training."""
CALIBRATED_SD_M = 0.001
OWN_ERROR = ("easy", "field", "exact", "matched")
"""Presets whose undersides lie on the belt plane: what is not known of it is in their belt distance."""
UNKNOWN = "unknown"
RESTING_MM = ("stated_resting_mm", "stated_resting_sd_mm", "resting_recording_mm", "resting_mm")
"""Arrays of a pack whose belts have a resting level, beside `recording`, `calibrated` and `preset`."""
NUMBERS = ("rim_lost", "shortest_deg", "longest_deg", "soil_mm")
"""What only the simulator knows of a view, as numbers; the fields of `LabelledView` of these names."""


@dataclass(frozen=True, slots=True)
class LabelledView:
    """One view with its truth. `depth` is a crop (uint16, zero outside the tuber); cx, cy count from its first pixel.

    `belt_sd_m` is how well the belt distance is known, standard deviation; a typical value where nothing says it.
    `resting_offset_m` is how far its underside lies below the belt, as far as the line knows, to `resting_sd_m`.
    `recording` is what it shares camera, belt and offset with. Only the simulator knows `preset`, `surface`, `pose`,
    `rim` and `calibrated` (whether the resting level was), 'unknown' elsewhere, and `rim_lost`, the share of the
    silhouette without depth, the angles of the shortest and longest axis to the vertical, and `soil_mm`, how thick
    soil sticks to tubers that weigh without it, NaN elsewhere.
    `row_share` is the tuber's place in the image along the belt, 0 (top) to 1 (bottom). Either `depth` or `cloud`
    ((N, 3), camera frame, metres) is given. `name` is that of its file, else of its tuber.
    """

    depth: NDArray[np.uint16] | None
    cloud: NDArray[np.float64] | None
    depth_scale_m: float
    fx: float
    fy: float
    cx: float
    cy: float
    belt_distance_m: float
    belt_sd_m: float
    weight_g: float
    volume_ml: float
    length_mm: float
    tuber: str
    cultivar: str
    season: str
    row_share: float
    resting_offset_m: float = 0.0
    resting_sd_m: float = 0.0
    recording: str = UNKNOWN
    preset: str = UNKNOWN
    surface: str = UNKNOWN
    pose: str = UNKNOWN
    rim: str = UNKNOWN
    calibrated: str = UNKNOWN
    rim_lost: float = math.nan
    shortest_deg: float = math.nan
    longest_deg: float = math.nan
    soil_mm: float = math.nan
    name: str = UNKNOWN

    @property
    def soil(self) -> str:
        """Whether soil sticks to the tuber: 'soil', 'clean' or 'unknown'."""
        if math.isnan(self.soil_mm):
            return UNKNOWN
        return "soil" if self.soil_mm > 0 else "clean"

    @property
    def level_sd_m(self) -> float:
        """How well the resting level is known, the belt's height and the offset taken together."""
        return math.hypot(self.belt_sd_m, self.resting_sd_m)

    def prepare(self) -> PreparedCloud:
        """The cleaned, level, centred cloud.

        Raises:
            RefusedCloud: the view cannot be weighed, or is off its belt.
        """
        cloud = self._prepared()
        check_place(self.tuber, cloud)
        return cloud

    def _prepared(self) -> PreparedCloud:
        if self.cloud is not None:
            return prepare_cloud(
                self.cloud, belt_distance_m=self.belt_distance_m, resting_offset_m=self.resting_offset_m
            )
        if self.depth is None:
            raise ValueError("a labelled view needs a depth crop or a cloud")
        return prepare_depth(
            self.depth,
            depth_scale_m=self.depth_scale_m,
            fx=self.fx,
            fy=self.fy,
            cx=self.cx,
            cy=self.cy,
            belt_from_camera=straight_down_belt_from_camera(self.belt_distance_m),
            resting_offset_m=self.resting_offset_m,
        )


def labelled_files(folder: Path, *, split: str | None = None) -> list[Path]:
    """The files that `read_labelled` would read, sorted: what a cache depends on.

    Raises:
        InputError: neither a view pack nor a 3DPotatoTwin folder, or a `split` of a pack.
    """
    shards = view_shards(folder)
    if shards and split is not None:
        raise InputError(
            f"{folder} is a view pack and has no split '{split}': only a 3DPotatoTwin folder has a splits.csv; give a "
            "pack of its own for each part"
        )
    if shards:
        return shards
    if is_potatotwin(folder) and (folder / TRUTH).is_file():
        cameras = sorted((folder / RGBD / INTRINSICS).glob("*.json"))
        return [folder / TRUTH, *cameras, *sorted((folder / RGBD).rglob("*.p[nl][gy]"))]
    if not folder.is_dir():
        raise InputError(
            f"{folder} is a file: give the folder that it is in"
            if folder.exists()
            else f"{folder} is not there: give a folder of view packs (`tuberline simulate-views`) or a 3DPotatoTwin "
            "folder"
        )
    raise InputError(
        f"{folder} holds no labelled views: expected views-*.npz (a view pack) or 1_rgbd/ with ground_truth.csv "
        "(a 3DPotatoTwin folder)"
    )


def part_of(folder: Path, part: str) -> str | None:
    """`part` where `folder` has a splits.csv: its other parts are kept for something else. None reads all of it."""
    return part if is_potatotwin(folder) and (folder / SPLITS).is_file() else None


def count_labelled(folder: Path, *, split: str | None = None) -> int:
    """About how many views `read_labelled` would read: for a bar with a remaining time.

    Raises:
        InputError: unknown layout.
    """
    files = labelled_files(folder, split=split)
    return sum(map(count_views, files)) if files[0].suffix == ".npz" else count_twin(folder, split=split)


def tubers_without_views(folder: Path, *, split: str | None = None) -> int:
    """How many labels of a 3DPotatoTwin folder's table have no view; a pack has no table.

    Raises:
        InputError: none of them has one.
    """
    return len(labels_without_views(folder, split=split)) if not view_shards(folder) else 0


def read_labelled(folder: Path, *, split: str | None = None, resting: Resting = "calibrated") -> Iterator[LabelledView]:
    """All labelled views of `folder`, in a fixed order. `split` selects by splits.csv (3DPotatoTwin only).

    Raises:
        InputError: unknown layout, unreadable shard, missing key, or two tubers of one number.
    """
    files = labelled_files(folder, split=split)
    if files[0].suffix == ".npz":
        first: dict[str, tuple[float, Path]] = {}
        for shard in files:
            for packed in _read_shard(shard, resting):
                _check_same(packed, shard, first)
                yield packed
    else:
        level = twin_resting(folder)
        for view in read_twin(folder, split=split):
            yield _from_twin(view, level)


def _check_same(view: LabelledView, shard: Path, first: dict[str, tuple[float, Path]]) -> None:
    """Refuse two tubers of one number, as where packs that each count from 0 were put together: both would be taken for
    one. `first`: of each tuber the weight in grams and the shard that it was met with.

    Raises:
        InputError: with both weights.
    """
    weight_g, where = first.setdefault(view.tuber, (view.weight_g, shard))
    if abs(view.weight_g - weight_g) > SAME_WEIGHT * weight_g:
        raise InputError(
            f"shard {shard}: tuber {view.tuber.rpartition('/')[2]} weighs {view.weight_g:.4g} g, and {weight_g:.4g} g "
            f"in {where.name} before: give each tuber of a pack a number of its own, or put packs into folders side by "
            "side"
        )


def _read_shard(path: Path, resting: Resting) -> Iterator[LabelledView]:
    views = list(read_views(path))
    more = {name: np.array([view.more[name] for view in views]) for name in (views[0].more if views else ())}
    _check_resting(path, more)
    offset_m, sd_m = _stated_resting(more, len(views), resting)
    for at, view in enumerate(views):
        try:
            labelled = _from_pack(
                path.parent.name, view, resting_offset_m=float(offset_m[at]), resting_sd_m=float(sd_m[at])
            )
        except (ValueError, TypeError) as error:
            raise InputError(f"shard {path}, view {at}: {error}") from error
        yield labelled


def _check_resting(path: Path, more: dict[str, NDArray[Any]]) -> None:
    """What a resting level is told by belongs together, as the simulator writes it.

    Raises:
        InputError: a part of it is missing, or is no number.
    """
    if RESTING_MM[0] not in more:
        return
    missing = [name for name in (*RESTING_MM, "recording", "calibrated", "preset") if name not in more]
    if missing:
        raise InputError(
            f"shard {path} has {RESTING_MM[0]} and lacks {', '.join(missing)}: a simulated resting level is told by "
            "all of them; leave all that name a resting level out where undersides lie on the belt"
        )
    for name in RESTING_MM:
        if more[name].dtype.kind not in "fiu" or not np.isfinite(more[name]).all():
            raise InputError(f"shard {path}: array '{name}' holds what is no number of millimetres")
    recording = more["recording"]
    if recording.dtype.kind not in "iu" or (recording < 0).any():
        raise InputError(f"shard {path}: array 'recording' is {recording.dtype}; allowed are whole numbers from 0")


def _stated_resting(data: dict[str, Any], count: int, resting: Resting) -> tuple[NDArray[np.float64], ...]:
    """(offset, standard deviation), each (n,) metres, of n views of a pack; 0 where the pack knows no such thing."""
    if "stated_resting_mm" not in data:
        return np.zeros(count), np.zeros(count)
    offset_m, sd_m = data["stated_resting_mm"] / 1e3, data["stated_resting_sd_mm"] / 1e3
    if resting == "stated":
        return offset_m, sd_m
    error = np.array([np.random.default_rng([17, n]).standard_normal() for n in data["recording"].tolist()])
    calibrated = data["calibrated"].astype(bool)
    level_m = data["resting_recording_mm"] / 1e3
    error_m = np.where(calibrated, offset_m - level_m, CALIBRATED_SD_M * error)
    sd_m = np.where(calibrated, sd_m, CALIBRATED_SD_M)
    own = np.isin(data["preset"], OWN_ERROR)
    _, recording = np.unique(data["recording"], return_inverse=True)
    mean_m = (np.bincount(recording, data["resting_mm"]) / np.bincount(recording) / 1e3)[recording]
    return mean_m + np.where(own, 0.0, error_m), np.where(own, 0.0, sd_m)


def _from_pack(pack: str, view: PackedView, *, resting_offset_m: float, resting_sd_m: float) -> LabelledView:
    """`pack`: its folder's name, for tubers of several packs have the same numbers."""
    k, more = view.intrinsics, view.more
    return LabelledView(
        depth=view.depth,
        cloud=None,
        depth_scale_m=view.depth_scale_m,
        fx=k.fx,
        fy=k.fy,
        cx=k.cx - view.u0,
        cy=k.cy - view.v0,
        belt_distance_m=view.belt_distance_m,
        belt_sd_m=TYPICAL_BELT_SD_M if view.belt_sd_m is None else view.belt_sd_m,
        weight_g=view.weight_g,
        volume_ml=math.nan if view.volume_ml is None else view.volume_ml,
        length_mm=math.nan if view.length_mm is None else view.length_mm,
        tuber=f"{pack}/{view.tuber}",
        cultivar=view.cultivar,
        season=view.season,
        row_share=math.nan if view.v_centre is None else view.v_centre / min(k.width, k.height),
        resting_offset_m=resting_offset_m,
        resting_sd_m=resting_sd_m,
        recording=f"{pack}/{more.get('recording', UNKNOWN)}",
        preset=str(more.get("preset", UNKNOWN)),
        surface=str(more.get("surface", UNKNOWN)),
        pose=str(more.get("pose", UNKNOWN)),
        rim=str(more.get("rim", UNKNOWN)),
        calibrated=str(more.get("calibrated", UNKNOWN)),
        rim_lost=float(more.get("rim_lost", math.nan)),
        shortest_deg=float(more.get("shortest_deg", math.nan)),
        longest_deg=float(more.get("longest_deg", math.nan)),
        soil_mm=float(more.get("soil_mm", math.nan)),
        name=f"{pack}/{view.tuber}",
    )


def _from_twin(view: TwinView, level: RestingLevel) -> LabelledView:
    return LabelledView(
        depth=view.depth,
        cloud=view.cloud,
        depth_scale_m=view.depth_scale_m,
        fx=view.intrinsics.fx if view.intrinsics else 1.0,
        fy=view.intrinsics.fy if view.intrinsics else 1.0,
        cx=view.intrinsics.cx if view.intrinsics else 0.0,
        cy=view.intrinsics.cy if view.intrinsics else 0.0,
        belt_distance_m=view.belt_distance_m,
        belt_sd_m=TYPICAL_BELT_SD_M,
        weight_g=view.weight_g,
        volume_ml=view.volume_ml,
        length_mm=view.length_mm,
        tuber=view.label,
        cultivar=view.cultivar,
        season=view.season,
        row_share=view.row_share,
        resting_offset_m=level.offset_m,
        resting_sd_m=level.sd_m,
        name=view.name,
    )
