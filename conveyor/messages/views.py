"""A tuber in one frame, on its way to a regressor and back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import MessageError
from conveyor.geometry import (
    MAX_SIDE_PIXELS,
    TYPICAL_BELT_SD_M,
    Intrinsics,
    belt_distance_m,
    deproject,
    transform_points,
)
from conveyor.messages.base import ArraySpec, Message
from conveyor.messages.frames import POSE
from conveyor.messages.sizes import Sizes
from conveyor.ranges import DepthScale, Id, Model, Name, Nanoseconds, Range, Seq, ViewGrams, Word, Words
from conveyor.resting import RestingLevel

LATER_PARTS = ("sizes",)
"""Fields of an answer that version 0.1 refuses to read: they are for those who ask for them."""
CROP_SIDES = ((0, MAX_SIDE_PIXELS), (0, MAX_SIDE_PIXELS))
Pixel = Annotated[int, Range(0, MAX_SIDE_PIXELS, "px")]


@dataclass(frozen=True, slots=True)
class View(Message):
    """One tuber in one frame: the depth crop inside its mask, so lossless and about 30 kB.

    Attributes:
        camera: whose tuber it is; the answer goes to its topic `weight/<camera>`.
        view_id: unique and the same in every replay: `<track_id>/<seq>`. A second answer to it changes nothing.
        depth: (h, w) uint16, units of `depth_scale_m` metres, zero outside the tuber's mask.
        u0, v0: column and row of the crop's first pixel in the full image; `intrinsics` are of the full image.
        belt_from_camera: (4, 4) float64, always known here: calibrated, given or fitted by the segmenter.
        belt_sd_m: how well the belt's height is known, standard deviation.
        resting_offset_m: how far under that belt this tuber's underside lies; negative above it, as on others.
        resting_sd_m: how well that is known, standard deviation.
        camera_noise_px: local noise of its camera's depth, pixels of disparity at a baseline of 18 mm; None: not known.
        outline_lost_mm: what the camera takes off outlines beyond what weights know, as the line measured it.
        rank: 0 for the tuber's best view, 1 for the next; under load the high ranks are shed first.
        takes: which of `LATER_PARTS` its sender understands in the answer; 0.1 says nothing of it.
    """

    view_id: Id
    track_id: Id
    camera: Name
    run: Name
    seq: Seq
    captured_ns: Nanoseconds
    rank: Annotated[int, Range(0, 255, "")]
    depth_scale_m: DepthScale
    intrinsics: Intrinsics
    u0: Pixel
    v0: Pixel
    depth: NDArray[np.uint16]
    belt_from_camera: NDArray[np.float64]
    belt_sd_m: Annotated[float, Range(0, 0.1, "m")] = TYPICAL_BELT_SD_M
    resting_offset_m: Annotated[float, Range(-0.2, 0.1, "m")] = 0.0
    resting_sd_m: Annotated[float, Range(0, 0.1, "m")] = 0.0
    camera_noise_px: Annotated[float, Range(0, 100, "px")] | None = None
    outline_lost_mm: Annotated[float, Range(0, 100, "mm")] = 0.0
    takes: Words = ()

    ARRAYS: ClassVar[dict[str, ArraySpec]] = {
        "depth": ArraySpec("u2", CROP_SIDES),
        "belt_from_camera": POSE,
    }

    def __post_init__(self) -> None:
        if self.belt_from_camera.shape != (4, 4):
            raise MessageError(f"View.belt_from_camera is {self.belt_from_camera.shape}, not (4, 4)")
        if not 0 <= self.belt_sd_m <= 0.1:
            raise MessageError(f"View.belt_sd_m is {self.belt_sd_m}; allowed are 0 to 0.1 metres")
        belt_distance_m(self.belt_from_camera)  # raises where the camera does not look down on the belt
        (rows, columns), k = self.depth.shape, self.intrinsics
        if self.u0 + columns > k.width or self.v0 + rows > k.height:
            raise MessageError(
                f"View.depth has {rows} rows and {columns} columns from row {self.v0}, column {self.u0}: more than the "
                f"image of {k.height} rows and {k.width} columns holds"
            )

    @property
    def belt_distance_m(self) -> float:
        """Camera to belt along the optical axis, metres (H_cam)."""
        return belt_distance_m(self.belt_from_camera)

    def points_in_camera_m(self) -> NDArray[np.float32]:
        """(N, 3) float32, camera frame, metres, raster order."""
        return deproject(
            self.depth, depth_scale_m=self.depth_scale_m, intrinsics=self.intrinsics, u0=self.u0, v0=self.v0
        )

    def points_in_belt_m(self) -> NDArray[np.float64]:
        """(N, 3) float64, belt frame, metres, raster order."""
        return transform_points(self.belt_from_camera, self.points_in_camera_m())

    def resting_on(self, level: RestingLevel) -> Self:
        """This view with the resting level of its own tuber: on rods it follows from the tuber's outline."""
        if level.surface != "rods":
            return replace(self, resting_offset_m=level.offset_m, resting_sd_m=level.sd_m)
        points = self.points_in_belt_m()
        if not len(points):
            return replace(self, resting_offset_m=level.offset_m, resting_sd_m=level.sd_m)
        # Single flying pixels are left out of extent and height.
        along_m = float(np.diff(np.quantile(points[:, 0], [0.001, 0.999]))[0])
        offset_m, sd_m = level.under(along_m=along_m, top_m=float(np.quantile(points[:, 2], 0.99)))
        return replace(self, resting_offset_m=offset_m, resting_sd_m=sd_m)


@dataclass(frozen=True, slots=True)
class Weight(Message):
    """The answer to a view: a weight with its 90 % interval, or a refusal with its reason.

    Attributes:
        status: 'weighed', or 'refused' with `reason` (an empty cloud, say); grams are None then.
        low_g, high_g: bounds of the 90 % interval of this view alone.
        method: 'pointraft', or 'volume' where the network could not be used.
        model: name and hash of the weights that weighed it.
        flags: what was out of the model's range, e.g. 'belt_distance', 'few_points', 'extent'.
        sizes: how large the tuber is by this view; None where nothing is said of it.
    """

    view_id: Id
    track_id: Id
    camera: Name
    run: Name
    seq: Seq
    status: Literal["weighed", "refused"]
    weight_g: ViewGrams | None
    low_g: ViewGrams | None
    high_g: ViewGrams | None
    method: Literal["pointraft", "volume"]
    model: Model
    flags: Words
    regressor: Name
    reason: Word = ""
    sizes: Sizes | None = None

    def __post_init__(self) -> None:
        if (self.status == "weighed") != (None not in (self.weight_g, self.low_g, self.high_g)):
            raise MessageError(f"Weight of view {self.view_id} is '{self.status}' with weight_g {self.weight_g}")

    def within(self, takes: tuple[str, ...]) -> Self:
        """This answer without the later parts that are not among `takes`: what the view's sender can read."""
        return self if "sizes" in takes else replace(self, sizes=None)
