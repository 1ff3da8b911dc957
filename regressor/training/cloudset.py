"""Labelled views as arrays: prepared once, cached, and ready for training and evaluation.

Each cloud is kept as its first `KEEP` farthest points, which hold the network's 128 exactly and enough more to draw a
fresh sample from for every epoch (PointNet reads 1024). The cache carries a hash of the input files and of the code
that prepares them, so it is made again when either changed.
"""

from __future__ import annotations

import hashlib
import json
import math
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from conveyor import crop_depth, depth_noise
from conveyor.errors import InputError
from conveyor.files import whole_output
from conveyor.formats import ply
from conveyor.formats.packs import views as packed
from conveyor.formats.plain import pinhole
from conveyor.formats.potatotwin import intrinsics, layout, pairs, resting
from conveyor.formats.potatotwin import views as twin
from conveyor.formats.potatotwin.layout import SPLITS
from regressor.network import sampling
from regressor.network.sampling import farthest_points
from regressor.training import labelled, plausible
from regressor.training.labelled import NUMBERS, LabelledView, labelled_files, read_labelled, tubers_without_views
from regressor.training.plausible import Seen
from regressor.weigh import finer, outline, pixel_grid, prepare, profile, surface
from regressor.weigh.prepare import PreparedCloud, RefusedCloud
from regressor.weigh.view_features import view_features

KEEP = 384
READERS = (labelled, plausible, ply, packed, pinhole, intrinsics, layout, pairs, resting, twin)
PREPARERS = (prepare, crop_depth, finer, sampling, outline, pixel_grid, surface, profile, depth_noise)

LABELS = (
    *("weight_g", "volume_ml", "length_mm", "belt_distance_m", "belt_sd_m", "row_share", "resting_sd_m", *NUMBERS),
    *("tuber", "cultivar", "season", "recording", "preset", "surface", "pose", "rim", "calibrated"),
)

TOLD = ("refused", "refused_first")
"""Fields of a set that have no row for each view."""

Target = Literal["weight_g", "volume_ml", "length_mm"]
TARGET_POWER: dict[Target, int] = {"weight_g": 3, "volume_ml": 3, "length_mm": 1}
"""What a network may learn, and the power of a tuber's scale that it grows with."""


@dataclass(frozen=True, slots=True)
class Asked:
    """A network that is asked of each whole cloud: a set keeps no more than its first points.

    Attributes:
        network_g: grams of a cloud. name: of all that its answers depend on; a cache is another one with another name.
    """

    network_g: Callable[[PreparedCloud], float | None]
    name: str


@dataclass(frozen=True, slots=True)
class CloudSet:
    """n prepared clouds with their labels.

    Attributes:
        points: (n, `keep`, 3) float32, level frame, centred on the mean of all points, in sampling order; short clouds
            repeat their points.
        height_m: (n,) float64, above the belt, not clamped. features: (n, 35) as in `surface.NAMES`.
        weight_g, volume_ml, length_mm, belt_distance_m, belt_sd_m, row_share: (n,) float64.
        rim_lost, shortest_deg, longest_deg, soil_mm: (n,) as in `LabelledView`, NaN where unknown.
        resting_sd_m: (n,) how well the resting offset is known; heights and features count from the stated level.
        tuber, cultivar, season, recording, preset, surface, pose, rim, calibrated: (n,) str.
        noise_px: (n,) local noise on the skin, NaN where it is not known (`PreparedCloud.noise_px`).
        points_in_cloud: (n,) how many points the whole cloud had.
        network_g: (n,) float64, what the network said that was asked of the whole cloud; NaN where none was.
        refused: how many views could not be prepared, by reason. refused_first: the name of the first of them.
    """

    points: NDArray[np.float32]
    height_m: NDArray[np.float64]
    features: NDArray[np.float64]
    weight_g: NDArray[np.float64]
    volume_ml: NDArray[np.float64]
    length_mm: NDArray[np.float64]
    belt_distance_m: NDArray[np.float64]
    belt_sd_m: NDArray[np.float64]
    row_share: NDArray[np.float64]
    resting_sd_m: NDArray[np.float64]
    rim_lost: NDArray[np.float64]
    shortest_deg: NDArray[np.float64]
    longest_deg: NDArray[np.float64]
    soil_mm: NDArray[np.float64]
    tuber: NDArray[np.str_]
    cultivar: NDArray[np.str_]
    season: NDArray[np.str_]
    recording: NDArray[np.str_]
    preset: NDArray[np.str_]
    surface: NDArray[np.str_]
    pose: NDArray[np.str_]
    rim: NDArray[np.str_]
    calibrated: NDArray[np.str_]
    noise_px: NDArray[np.float64]
    points_in_cloud: NDArray[np.int64]
    network_g: NDArray[np.float64]
    refused: dict[str, int]
    refused_first: dict[str, str]

    def __len__(self) -> int:
        return len(self.weight_g)

    @property
    def level_sd_m(self) -> NDArray[np.float64]:
        """(n,) how well the resting level is known: the belt's height and the offset below it."""
        return np.hypot(self.belt_sd_m, self.resting_sd_m)

    @property
    def clean(self) -> NDArray[np.bool_]:
        """(n,) whether no soil is known to stick to the tuber: what soil adds to a volume no view shows."""
        return ~(self.soil_mm > 0)

    @property
    def view_features(self) -> NDArray[np.float64]:
        """(n, 37) what rules read, as in `view_features.VIEW_NAMES`."""
        return view_features(self.features, self.noise_px, self.level_sd_m)

    def subset(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> CloudSet:
        """The chosen rows."""
        parts = {f.name: getattr(self, f.name) for f in fields(self)}
        return CloudSet(**{k: v if k in TOLD else v[rows] for k, v in parts.items()})

    def with_target(self, target: Target) -> CloudSet:
        """The set with `target` in the place of the weight; views where it is not known are refused.

        Raises:
            InputError: it is known for no view.
        """
        if target == "weight_g":
            return self
        known = np.isfinite(getattr(self, target)) & (getattr(self, target) > 0)
        if not known.any():
            raise InputError(f"no view of this set has a known {target}: it cannot be the target")
        chosen = self.subset(known)
        refused = {**self.refused, f"no_{target}": int((~known).sum())} if not known.all() else self.refused
        return replace(chosen, weight_g=getattr(chosen, target), refused=refused)


def load_cloudset(
    folder: Path,
    *,
    split: str | None = None,
    cache: Path | None = None,
    max_views: int | None = None,
    keep: int = KEEP,
    asked: Asked | None = None,
    progress: Callable[[int], None] | None = None,
) -> CloudSet:
    """All labelled views of `folder`, prepared.

    Args:
        folder: view pack or 3DPotatoTwin folder. split: as in its splits.csv.
        cache: folder for the cache file; None prepares without one.
        max_views: take this many at most, evenly over the set.
        keep: points to keep of each cloud, in sampling order.
        asked: who says something of each whole cloud.
        progress: called with the number of views done so far.

    Raises:
        InputError: nothing usable in the folder.
    """
    # Each pack has a cache of its own: one more pack prepares only itself.
    packs = sorted({path.parent for path in labelled_files(folder)}) if split is None else [folder]
    packs = packs if all(any(pack.glob("views-*.npz")) for pack in packs) else [folder]
    return evenly(joined([_load_pack(pack, split, cache, keep, asked, progress) for pack in packs]), max_views)


def without(data: CloudSet, rows: NDArray[np.bool_], reason: str) -> CloudSet:
    """The other rows; these are counted as refused."""
    if not rows.any():
        return data
    return replace(data.subset(~rows), refused={**data.refused, reason: int(rows.sum())})


def evenly(data: CloudSet, most: int | None) -> CloudSet:
    """So many views at most, evenly over the set; None is all of them."""
    if most is None or most >= len(data):
        return data
    return data.subset(np.linspace(0, len(data) - 1, most).astype(np.int64))


def _load_pack(
    folder: Path,
    split: str | None,
    cache: Path | None,
    keep: int,
    asked: Asked | None,
    progress: Callable[[int], None] | None,
) -> CloudSet:
    key = _fingerprint(folder, split, keep, asked)
    file = cache / f"clouds-{folder.resolve().name}-{split or 'all'}-{key}.npz" if cache else None
    if file is not None and (stored := _read_cache(file)) is not None:
        return stored
    without = tubers_without_views(folder, split=split)
    data = _prepare_all(read_labelled(folder, split=split), folder, keep, asked, progress)
    data = replace(data, refused={**data.refused, "tubers_without_views": without}) if without else data
    if file is not None:
        _write_cache(file, data)
    return data


def joined(sets: list[CloudSet]) -> CloudSet:
    """One set after the other; there must be one."""
    if len(sets) == 1:
        return sets[0]
    names = [f.name for f in fields(CloudSet) if f.name not in TOLD]
    refused: Counter[str] = Counter()
    first: dict[str, str] = {}
    for part in sets:
        refused.update(part.refused)
        first = part.refused_first | first
    columns = {name: np.concatenate([getattr(part, name) for part in sets]) for name in names}
    return CloudSet(**columns, refused=dict(refused), refused_first=first)


def identity(data: CloudSet) -> NDArray[np.str_]:
    """(n,) whose view each is, by its truth: each pack numbers its own tubers, and one name need not be one tuber.

    Where volume or length is not known, a weight alone is no truth to tell tubers by: many weigh the same gram. There
    the name counts too, without the pack's.
    """
    measured = np.isfinite(data.volume_ml) & np.isfinite(data.length_mm)
    names = np.where(measured, "", [tuber.rpartition("/")[2] for tuber in data.tuber.tolist()])
    rows = zip(names, data.weight_g, data.volume_ml, data.length_mm, data.cultivar, strict=True)
    return np.array([f"{name}/{w:.4f}/{v:.4f}/{length:.4f}/{cultivar}" for name, w, v, length, cultivar in rows])


def _fingerprint(folder: Path, split: str | None, keep: int, asked: Asked | None) -> str:
    """Changes with the input files (name, size, time), with the code that reads and prepares them and who is asked."""
    columns = [f.name for f in fields(CloudSet)]
    digest = hashlib.sha256(json.dumps([keep, split, asked and asked.name, columns]).encode())
    tables = [folder / SPLITS] if split is not None and (folder / SPLITS).is_file() else []
    for path in [*labelled_files(folder, split=split), *tables]:
        stat = path.stat()
        digest.update(f"{path.name}|{stat.st_size}|{stat.st_mtime_ns}".encode())
    for module in (*READERS, *PREPARERS):
        digest.update(Path(str(module.__file__)).read_bytes())
    return digest.hexdigest()[:16]


def _prepare_all(
    views: Iterable[LabelledView],
    folder: Path,
    keep: int,
    asked: Asked | None,
    progress: Callable[[int], None] | None,
) -> CloudSet:
    kept: list[tuple[LabelledView, NDArray[np.float32], PreparedCloud, int]] = []
    network_g: list[float | None] = []
    refused: Counter[str] = Counter()
    seen = Seen(str(folder))
    for done, view in enumerate(views, start=1):
        try:
            cloud = view.prepare()
        except RefusedCloud as error:
            refused[error.reason] += 1
            seen.refused(view.tuber, view.weight_g, error, name=view.name)
            continue
        seen.usable(view.tuber, view.weight_g, cloud)
        # The whole cloud is let go: its first points are what is kept of it.
        points = _first_points(cloud.points, keep)
        kept.append((view, points, replace(cloud, points=cloud.points[:0]), len(cloud.points)))
        network_g.append(asked.network_g(cloud) if asked is not None else None)
        if progress is not None and done % 200 == 0:
            progress(done)
    seen.check(refused)
    labels = [view for view, *_ in kept]
    return CloudSet(
        points=np.stack([points for _, points, *_ in kept]),
        height_m=np.array([cloud.height_m for *_, cloud, _ in kept]),
        features=np.stack([cloud.surface.as_array() for *_, cloud, _ in kept]),
        noise_px=np.array([math.nan if cloud.noise_px is None else cloud.noise_px for *_, cloud, _ in kept]),
        points_in_cloud=np.array([count for *_, count in kept]),
        network_g=np.array([math.nan if grams is None else grams for grams in network_g]),
        refused=dict(refused),
        refused_first=seen.first,
        **{name: np.array([getattr(view, name) for view in labels]) for name in LABELS},
    )


def _first_points(points: NDArray[np.float32], keep: int) -> NDArray[np.float32]:
    order = farthest_points(points, min(keep, len(points)))
    return points[np.resize(order, keep)]


def _write_cache(file: Path, data: CloudSet) -> None:
    """Whole, or not at all: trainings that share a cache may write the same file at the same time."""
    columns = {f.name: getattr(data, f.name) for f in fields(data)}
    with whole_output(file) as partial:
        np.savez(partial, **columns | {name: json.dumps(columns[name]) for name in TOLD})


def _read_cache(file: Path) -> CloudSet | None:
    """What is stored there; None where nothing is, or nothing that can be read: it is prepared again then."""
    try:
        with np.load(file, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        return CloudSet(**arrays | {name: json.loads(str(arrays[name])) for name in TOLD})
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error):
        return None
