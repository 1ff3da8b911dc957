"""What can be drawn, as plain values: the scene makes them; `viewer.rerun` and `viewer.foxglove` draw them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from conveyor.geometry import Intrinsics

Color = tuple[int, int, int]
Level = Literal["INFO", "WARN", "ERROR"]


@dataclass(frozen=True, slots=True)
class Moment:
    """Capture time in nanoseconds of the camera's clock, and the camera's sequence number where there is one."""

    captured_ns: int
    seq: int | None = None


@dataclass(frozen=True, slots=True)
class BeltAxes:
    """The belt frame: x along the travel, y across, z up."""


@dataclass(frozen=True, slots=True)
class Pose:
    """(4, 4) float64 rigid transform of a camera into the belt frame, metres."""

    belt_from_camera: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Lens:
    """Pinhole of the picture as drawn (already scaled to its stride)."""

    intrinsics: Intrinsics
    belt_distance_m: float | None


@dataclass(frozen=True, slots=True)
class DepthPicture:
    """(h, w) uint16 depth in units of `depth_scale_m` metres.

    `range_m`: distances drawn in the first and the last colour; None spans what is there.
    """

    depth: NDArray[np.uint16]
    depth_scale_m: float
    range_m: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class ColorPicture:
    """A JPEG file."""

    jpeg: bytes


@dataclass(frozen=True, slots=True)
class Shift:
    """Translation along the belt's x, metres."""

    x_m: float


@dataclass(frozen=True, slots=True)
class Cloud:
    """(N, 3) float32 points, metres, in the frame of the entity's parent."""

    points_m: NDArray[np.float32]
    color: Color


@dataclass(frozen=True, slots=True)
class Box:
    """A box with a label, turned by `yaw_rad` about z; metres, in the frame of the entity's parent. `values` go along
    for machines, where the program has a place for them."""

    center_m: tuple[float, float, float]
    half_size_m: tuple[float, float, float]
    color: Color
    label: str = ""
    yaw_rad: float = 0.0
    solid: bool = False
    values: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Gone:
    """What was drawn here is there no more."""


@dataclass(frozen=True, slots=True)
class Number:
    """One value of a plot; `values` of other names are kept beside it for machines."""

    value: float
    values: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Measured:
    """One value of a plot with its standard deviation, drawn as a band."""

    value: float
    sigma: float
    unit: str
    name: str
    color: Color


@dataclass(frozen=True, slots=True)
class PlotStyle:
    """How the numbers of this entity are plotted."""

    name: str
    color: Color
    points: bool


@dataclass(frozen=True, slots=True)
class Bars:
    """A histogram: `counts[i]` things between i and i + 1 times `step`."""

    counts: tuple[int, ...]
    step: float
    color: Color


@dataclass(frozen=True, slots=True)
class Lane:
    """A lane of the health view, with the colours of its states."""


@dataclass(frozen=True, slots=True)
class State:
    """The state that a lane of the health view is in from now on."""

    state: str


@dataclass(frozen=True, slots=True)
class LogLine:
    """One line of the log."""

    text: str
    level: Level


@dataclass(frozen=True, slots=True)
class Page:
    """A page of Markdown."""

    markdown: str


@dataclass(frozen=True, slots=True)
class Ground:
    """(N, 2) float64 latitudes and longitudes, WGS84 degrees: places, or the way from each to the next."""

    lat_lon_deg: NDArray[np.float64]
    color: Color
    way: bool = False


@dataclass(frozen=True, slots=True)
class YieldCells:
    """The field's cells: (N, 2) latitudes and longitudes of their centres, degrees; (N,) yield with its 90 % interval,
    t/ha; their side in metres."""

    lat_lon_deg: NDArray[np.float64]
    t_ha: NDArray[np.float64]
    low_t_ha: NDArray[np.float64]
    high_t_ha: NDArray[np.float64]
    side_m: float


@dataclass(frozen=True, slots=True)
class Layout:
    """Which views the window shows.

    `cameras`: name, width and height (pixels, as drawn) of each; `belt_x_m`, `belt_y_m` bound the belt that is drawn;
    `field`: the machine's place is known.
    """

    cameras: tuple[tuple[str, int, int], ...]
    pictures: bool
    belt_x_m: tuple[float, float]
    belt_y_m: tuple[float, float]
    field: bool = False


@dataclass(frozen=True, slots=True)
class NewRun:
    """What follows belongs to another run, and to another recording."""

    run: str


Primitive = (
    BeltAxes
    | Pose
    | Lens
    | DepthPicture
    | ColorPicture
    | Shift
    | Cloud
    | Box
    | Gone
    | Number
    | Measured
    | PlotStyle
    | Bars
    | Lane
    | State
    | LogLine
    | Page
    | Ground
    | YieldCells
    | Layout
    | NewRun
)


@dataclass(frozen=True, slots=True)
class Entry:
    """One primitive at one path.

    Attributes:
        path: where it hangs; a path below another moves with it.
        moment: when; None for what always holds and must be said again to a new hub.
        heavy: only the newest of its path matters and it may be left out; light entries are kept in order.
    """

    path: str
    primitive: Primitive
    moment: Moment | None
    heavy: bool = False
