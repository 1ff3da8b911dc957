"""Single clouds and depth/mask pairs from files to weights, without any network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from conveyor.camera_flags import CUT
from conveyor.errors import InputError
from conveyor.formats.clouds import CLOUDS, ending_said, read_cloud
from conveyor.formats.potatotwin.intrinsics import find_intrinsics, read_intrinsics
from conveyor.formats.potatotwin.layout import pair_of
from conveyor.formats.potatotwin.pairs import farthest_m, read_pair
from conveyor.geometry import TYPICAL_BELT_SD_M, straight_down_belt_from_camera
from regressor.weigh.place import distance_fault
from regressor.weigh.prepare import PreparedCloud, RefusedCloud, prepare_cloud, prepare_depth
from regressor.weigh.weigher import Weighed, Weigher


@dataclass(frozen=True, slots=True)
class FileOptions:
    """How files are read. `depth_scale_m` None takes what the intrinsics file says (1 mm where it says nothing).

    `resting_offset_m`: how far the tuber's underside lies below the belt; the sd of each widens intervals
    and moves weights a little.
    """

    belt_distance_m: float
    belt_sd_m: float = TYPICAL_BELT_SD_M
    depth_scale_m: float | None = None
    intrinsics: Path | None = None
    resting_offset_m: float = 0.0
    resting_sd_m: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a depth unit that cannot be."""
        if self.depth_scale_m is not None and not 0 < self.depth_scale_m <= 1:
            raise InputError(
                f"--depth-scale-m is {self.depth_scale_m:g}: allowed is above 0 to 1 metre per unit of depth, 0.001 "
                "where a unit is a millimetre"
            )


@dataclass(frozen=True, slots=True)
class FileResult:
    """What came of one file, or of one object of a frame: a weight or an error."""

    path: Path
    points: int
    height_mm: float | None
    weighed: Weighed | None
    error: str = ""
    object: int | None = None

    @property
    def name(self) -> str:
        """For tables: the file's name, and which object."""
        return self.path.name if self.object is None else f"{self.path.name} #{self.object}"

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        answer = asdict(self.weighed) if self.weighed else {}
        return {
            "path": str(self.path),
            "object": self.object,
            "points": self.points,
            "height_mm": self.height_mm,
            **answer,
            "error": self.error or None,
        }


def files_within(paths: Sequence[Path]) -> list[Path]:
    """The same paths, with the clouds in a folder and the folders below it in place of the folder; where there are
    none, its pairs of images.

    Raises:
        InputError: a folder holds neither, or a path is not there.
    """
    if missing := [str(path) for path in paths if not path.exists()]:
        more = f" and {len(missing) - 5} more" if len(missing) > 5 else ""
        raise InputError(f"not there: {', '.join(missing[:5])}{more}; nothing was weighed")
    found: list[Path] = []
    for path in paths:
        if not path.is_dir():
            found.append(path)
            continue
        inside = sorted(file for file in path.rglob("*") if file.is_file())
        files = [file for file in inside if file.suffix.lower() in CLOUDS]
        files = files or [file for file in inside if _is_pair(file)]
        if not files:
            recording = any(file.name in ("camera.json", "metadata.yaml") for file in inside)
            hint = (
                "it is a recording: `tuberline replay` counts and weighs what is in it"
                if recording
                else f"{ending_said(file.suffix for file in inside)}; pairs of images are named <label>_depth_<row>.png"
            )
            raise InputError(f"{path} holds no cloud and no pair of images; {hint}")
        found += files
    return found


def _is_pair(file: Path) -> bool:
    try:
        return file.suffix.lower() == ".png" and bool(pair_of(file))
    except InputError:
        return False


def once_per_pair(paths: Sequence[Path]) -> list[Path]:
    """The files that make one result each, in order: of a pair of images, the depth."""
    kept: dict[Path, None] = {}
    for path in paths:
        try:
            entry = pair_of(path)[0] if path.suffix.lower() == ".png" else path
        except InputError:
            entry = path
        kept[entry] = None
    return list(kept)


def weigh_file(path: Path, options: FileOptions, weigher: Weigher) -> FileResult:
    """The weight of one cloud or pair, or what is wrong with it."""
    try:
        cloud = prepare_file(path, options)
    except RefusedCloud as refusal:
        return FileResult(path, 0, None, None, error=f"{path}: {refusal}")
    except InputError as error:
        return FileResult(path, 0, None, None, error=str(error))
    fault = distance_fault(cloud)
    if fault:
        return FileResult(path, len(cloud.points), round(cloud.height_m * 1e3, 2), None, error=f"{path}: {fault}")
    weighed = weigher.weigh(cloud, belt_sd_m=options.belt_sd_m, resting_sd_m=options.resting_sd_m)
    return FileResult(path, len(cloud.points), round(cloud.height_m * 1e3, 2), weighed)


def prepare_file(path: Path, options: FileOptions) -> PreparedCloud:
    """The prepared cloud of a cloud file or of a depth/mask pair.

    Raises:
        InputError: unreadable or unusable.
    """
    if path.suffix.lower() != ".png":
        return prepare_cloud(
            read_cloud(path), belt_distance_m=options.belt_distance_m, resting_offset_m=options.resting_offset_m
        )
    intrinsics, stored_scale_m = read_intrinsics(options.intrinsics or find_intrinsics(path))
    scale_m = stored_scale_m if options.depth_scale_m is None else options.depth_scale_m
    far_m = farthest_m(options.belt_distance_m)
    masked = read_pair(path, intrinsics=intrinsics, depth_scale_m=scale_m, max_depth_m=far_m)
    cloud = prepare_depth(
        masked.depth,
        depth_scale_m=scale_m,
        fx=masked.intrinsics.fx,
        fy=masked.intrinsics.fy,
        cx=masked.intrinsics.cx,
        cy=masked.intrinsics.cy,
        belt_from_camera=straight_down_belt_from_camera(options.belt_distance_m),
        resting_offset_m=options.resting_offset_m,
    )
    return replace(cloud, flags=(*cloud.flags, CUT)) if masked.cut else cloud
