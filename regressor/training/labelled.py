"""Views with known weights, from wherever they lie: view packs of the simulator, or a 3DPotatoTwin folder.

`read_labelled` tells the layouts apart and yields `LabelledView`s of either; the formats are
`conveyor.formats.packs.views` and `conveyor.formats.potatotwin`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import InputError
from conveyor.formats.packs.views import PackedView, read_views, view_shards
from conveyor.formats.potatotwin.layout import is_potatotwin
from conveyor.formats.potatotwin.views import TwinView, read_twin
from conveyor.geometry import TYPICAL_BELT_SD_M, straight_down_belt_from_camera
from regressor.weigh.prepare import PreparedCloud, prepare_cloud, prepare_depth


@dataclass(frozen=True, slots=True)
class LabelledView:
    """One view with its truth. `depth` is a crop (uint16, zero outside the tuber); cx, cy count from its first pixel.

    `belt_sd_m` is how well the belt distance is known, standard deviation; a typical value where nothing says it.
    `row_share` is the tuber's place in the image along the belt, 0 (top) to 1 (bottom). Either `depth` or `cloud`
    ((N, 3), camera frame, metres) is given.
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

    def prepare(self) -> PreparedCloud:
        """The cleaned, level, centred cloud.

        Raises:
            RefusedCloud: the view cannot be weighed.
        """
        if self.cloud is not None:
            return prepare_cloud(self.cloud, belt_distance_m=self.belt_distance_m)
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
        )


def labelled_files(folder: Path) -> list[Path]:
    """The files that `read_labelled` would read, sorted: what a cache depends on.

    Raises:
        InputError: neither a view pack nor a 3DPotatoTwin folder.
    """
    shards = view_shards(folder)
    if shards:
        return shards
    if is_potatotwin(folder) and (folder / "ground_truth.csv").is_file():
        return [folder / "ground_truth.csv", *sorted((folder / "1_rgbd").rglob("*.p[nl][gy]"))]
    raise InputError(
        f"{folder} holds no labelled views: expected views-*.npz (a view pack) or 1_rgbd/ with ground_truth.csv "
        "(a 3DPotatoTwin folder)"
    )


def read_labelled(folder: Path, *, split: str | None = None) -> Iterator[LabelledView]:
    """All labelled views of `folder`, in a fixed order. `split` selects by splits.csv (3DPotatoTwin only).

    Raises:
        InputError: unknown layout, unreadable shard, missing key.
    """
    files = labelled_files(folder)
    if files[0].suffix == ".npz":
        for shard in files:
            yield from (_from_pack(shard.parent.name, view) for view in read_views(shard))
    else:
        for view in read_twin(folder, split=split):
            yield _from_twin(view)


def _from_pack(pack: str, view: PackedView) -> LabelledView:
    """`pack`: its folder's name, for tubers of several packs have the same numbers."""
    k = view.intrinsics
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
    )


def _from_twin(view: TwinView) -> LabelledView:
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
    )
