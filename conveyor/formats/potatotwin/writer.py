"""Writing a 3DPotatoTwin folder, tuber by tuber."""

from __future__ import annotations

import csv
import json
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.formats.ply import write_ply
from conveyor.formats.png16 import write_png
from conveyor.formats.potatotwin.intrinsics import intrinsics_json
from conveyor.formats.potatotwin.layout import CLOUDS, IMAGES, INTRINSICS, RGBD, SPLITS, TRUTH
from conveyor.geometry import Intrinsics

_SMALL_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 3]
COLUMNS = (
    "label", "unique_id", "growing_season", "cultivar", "weight_g_inctack", "x1_length_mm", "x2_width_mm",
    "x3_depth_mm", "volume_ml", "volume_metashape",
)  # fmt: skip
"""Of ground_truth.csv, as the data set has them; `belt_distance_m` beside them where it is asked for."""


class TwinFolderWriter:
    """Images, clouds and tables under `out`; use it in a `with`."""

    def __init__(self, out: Path, intrinsics: Intrinsics, *, name: str, belt_distances: bool = False) -> None:
        self._out = out
        self._intrinsics = intrinsics
        self._name = name
        self._columns = (*COLUMNS, "belt_distance_m") if belt_distances else COLUMNS
        self._files = ExitStack()
        self._truth: Any = None
        self._splits: Any = None

    def __enter__(self) -> Self:
        folder = self._out / RGBD / INTRINSICS
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps(intrinsics_json(self._intrinsics), indent=1) + "\n"
        (folder / f"{self._name}_camera_intrinsic.json").write_text(text, encoding="utf-8")
        truth, splits = (
            self._files.enter_context((self._out / name).open("w", newline="", encoding="utf-8"))
            for name in (TRUTH, SPLITS)
        )
        self._truth = csv.DictWriter(truth, self._columns)
        self._truth.writeheader()
        self._splits = csv.writer(splits)
        self._splits.writerow(["label", "split"])
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._files.close()

    def add_tuber(self, truth: dict[str, Any], *, split: str) -> None:
        """Add a tuber's rows to both tables; `truth` by the names of COLUMNS."""
        self._truth.writerow(truth)
        self._splits.writerow([truth["label"], split])

    def add_view(
        self,
        label: str,
        row: int,
        *,
        depth: NDArray[np.uint16],
        rgba: NDArray[np.uint8],
        points: NDArray[np.floating],
    ) -> None:
        """Write one view of a tuber at the image row `row`.

        Args:
            depth: (H, W) uint16, millimetres.
            rgba: (H, W, 4) uint8, blue, green, red, alpha; alpha 255 is the tuber.
            points: (N, 3) camera frame, metres.
        """
        images, clouds = (self._out / RGBD / part / label for part in (IMAGES, CLOUDS))
        for folder in (images, clouds):
            folder.mkdir(parents=True, exist_ok=True)
        write_png(images / f"{label}_depth_{row:03d}.png", depth, _SMALL_PNG)
        write_png(images / f"{label}_rgb_{row:03d}.png", rgba, _SMALL_PNG)
        write_ply(clouds / f"{label}_pcd_{row:03d}.ply", points)
