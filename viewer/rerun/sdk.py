"""The only module (with `layout`) that knows rerun-sdk: it changes every few weeks, and costs a second to import."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from conveyor.errors import ConfigError
from conveyor.extras import check_version, install_hint
from conveyor.formats.rvl import MEDIA_TYPE, encode_ros_rvl
from viewer.scene.primitives import (
    Bars,
    BeltAxes,
    Box,
    Cloud,
    ColorPicture,
    DepthPicture,
    Entry,
    Gone,
    Ground,
    Lane,
    Lens,
    LogLine,
    Measured,
    Moment,
    Number,
    Page,
    PlotStyle,
    Pose,
    Shift,
    State,
    YieldCells,
)

INSTALL = f"install it {install_hint('viewer')}"

try:
    import rerun as rr
    import rerun.blueprint as rrb
except ImportError as error:
    raise ConfigError(f"the viewer needs rerun-sdk, which cannot be imported ({error}); {INSTALL}") from error
check_version("rerun-sdk", "0.41.", extra="viewer", what="the viewer")

__all__ = ["INSTALL", "Pen", "new_stream", "rrb"]

APPLICATION = "tuberline"
EPOCH_FROM_NS = 10**17
"""Capture times below (before 1973) do not count from the epoch: recordings and simulations start near zero."""
_STATE_COLORS = {
    "ok": (70, 150, 80),
    "starting": (80, 110, 170),
    "stalled": (220, 150, 40),
    "gone": (200, 60, 50),
}
_LABEL_RGB = (255, 255, 255)
_YIELD_AT = (0.0, 0.5, 1.0)
_YIELD_RGB = ((247, 120, 0), (252, 198, 69), (185, 121, 41))
"""Red, green and blue over the yield's range: light to dark, as `tuberline map` draws it."""
FLUSH_TICK_S = 0.1
FLUSH_BYTES = 16 << 20


def new_stream(recording_id: str) -> Any:
    """A recording without a sink yet.

    The batcher flushes by time, not by bytes: with Rerun's defaults a depth stream at 30 Hz starves all small entities.
    """
    batching = rr.ChunkBatcherConfig(flush_tick=FLUSH_TICK_S, flush_num_bytes=FLUSH_BYTES)
    return rr.RecordingStream(APPLICATION, recording_id=recording_id, batcher_config=batching)


class Pen:
    """Draws entries into one stream, in one thread: Rerun keeps the time per thread.

    The first moment decides whether the capture timeline counts from the epoch or from the recording's start.
    """

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self._epoch: bool | None = None

    def draw(self, entry: Entry) -> None:
        """Log one entry; blocks as long as Rerun does."""
        archetypes = _ARCHETYPES[type(entry.primitive)](entry.primitive)
        if entry.moment is not None:
            self._set_time(entry.moment)
        self._stream.log(entry.path, *archetypes, static=entry.moment is None)

    def _set_time(self, moment: Moment) -> None:
        if self._epoch is None:
            self._epoch = moment.captured_ns >= EPOCH_FROM_NS
        self._stream.reset_time()
        if moment.seq is not None:
            self._stream.set_time("frame", sequence=moment.seq)
        if self._epoch:
            self._stream.set_time("capture", timestamp=np.datetime64(moment.captured_ns, "ns"))
        else:
            self._stream.set_time("capture", duration=np.timedelta64(moment.captured_ns, "ns"))


def _lens(primitive: Lens) -> list[Any]:
    k = primitive.intrinsics
    return [
        rr.Pinhole(
            focal_length=(k.fx, k.fy),
            principal_point=(k.cx, k.cy),
            width=k.width,
            height=k.height,
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=0.04,
        )
    ]


def _depth(primitive: DepthPicture) -> list[Any]:
    return [
        rr.EncodedDepthImage(
            encode_ros_rvl(primitive.depth),
            media_type=MEDIA_TYPE,
            meter=1.0 / primitive.depth_scale_m,
            colormap="turbo",
            depth_range=None if primitive.range_m is None else [r / primitive.depth_scale_m for r in primitive.range_m],
        )
    ]


def _box(primitive: Box) -> list[Any]:
    half = primitive.yaw_rad / 2
    # A label of its own: Rerun writes a box's label in the box's colour, pale on what lies behind it.
    label = rr.Points3D(
        [primitive.center_m], radii=[0.0], colors=[_LABEL_RGB], labels=[primitive.label], show_labels=True
    )
    return [
        rr.Boxes3D(
            centers=[primitive.center_m],
            half_sizes=[primitive.half_size_m],
            quaternions=[rr.Quaternion(xyzw=(0.0, 0.0, math.sin(half), math.cos(half)))],
            colors=[primitive.color],
            fill_mode="solid" if primitive.solid else "majorwireframe",
        ),
        *([label] if primitive.label else []),
    ]


def _style(primitive: PlotStyle) -> list[Any]:
    if primitive.points:
        return [rr.SeriesPoints(names=primitive.name, colors=primitive.color, markers="circle", marker_sizes=3.0)]
    return [rr.SeriesLines(names=primitive.name, colors=primitive.color, widths=2.0)]


def _bars(primitive: Bars) -> list[Any]:
    n = len(primitive.counts)
    left = (np.arange(n) + 0.05) * primitive.step  # Rerun draws a bar from its abscissa to the right
    # Without widths bars are one unit wide: invisible on an axis of grams.
    return [
        rr.BarChart(
            np.array(primitive.counts), abscissa=left, widths=np.full(n, 0.9 * primitive.step), color=primitive.color
        )
    ]


def _number(primitive: Number) -> list[Any]:
    details = {name: [value] for name, value in primitive.values}
    return [rr.Scalars(primitive.value), *([rr.AnyValues(drop_untyped_nones=True, **details)] if details else [])]


def _measured(primitive: Measured) -> list[Any]:
    return [
        rr.Measurements(
            [primitive.value],
            variances=[primitive.sigma**2],
            units=[primitive.unit],
            names=[primitive.name],
            colors=[primitive.color],
            widths=[2.0],
            interpolation_mode="StepAfter",  # between two reports the load was not weighed: no slope
        )
    ]


def _ground(primitive: Ground) -> list[Any]:
    if primitive.way:
        return [
            rr.GeoLineStrings(lat_lon=[primitive.lat_lon_deg], colors=[primitive.color], radii=rr.Radius.ui_points(1.0))
        ]
    return [rr.GeoPoints(lat_lon=primitive.lat_lon_deg, colors=[primitive.color], radii=rr.Radius.ui_points(6.0))]


def _cells(primitive: YieldCells) -> list[Any]:
    low, high = np.percentile(primitive.t_ha, [2, 98])
    share = np.clip((primitive.t_ha - low) / max(high - low, 1e-9), 0, 1)
    colors = np.stack([np.interp(share, _YIELD_AT, channel) for channel in _YIELD_RGB], axis=1)
    return [
        rr.GeoPoints(lat_lon=primitive.lat_lon_deg, colors=colors.round().astype(np.uint8), radii=primitive.side_m / 2),
        rr.AnyValues(t_ha=primitive.t_ha, low_t_ha=primitive.low_t_ha, high_t_ha=primitive.high_t_ha),
    ]


_ARCHETYPES: dict[type[Any], Callable[[Any], list[Any]]] = {
    BeltAxes: lambda _: [rr.ViewCoordinates.RIGHT_HAND_Z_UP],
    Pose: lambda m: [rr.Transform3D(translation=m.belt_from_camera[:3, 3], mat3x3=m.belt_from_camera[:3, :3])],
    Lens: _lens,
    DepthPicture: _depth,
    ColorPicture: lambda m: [rr.EncodedImage(contents=m.jpeg, media_type="image/jpeg")],
    Shift: lambda m: [rr.Transform3D(translation=(m.x_m, 0.0, 0.0))],
    Cloud: lambda m: [rr.Points3D(m.points_m, colors=[m.color], radii=[0.0012])],
    Box: _box,
    Gone: lambda _: [rr.Clear(recursive=False)],
    Number: _number,
    Measured: _measured,
    PlotStyle: _style,
    Bars: _bars,
    Lane: lambda _: [rr.StateConfiguration(values=list(_STATE_COLORS), colors=list(_STATE_COLORS.values()))],
    State: lambda m: [rr.StateChange(state=m.state)],
    LogLine: lambda m: [rr.TextLog(m.text, level=m.level)],
    Ground: _ground,
    YieldCells: _cells,
    Page: lambda m: [rr.TextDocument(m.markdown, media_type="text/markdown")],
}
