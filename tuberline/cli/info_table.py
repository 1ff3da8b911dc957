"""A recording's description as a table for people."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table
from rich.text import Text

from conveyor.formats.inspection import CameraReport, RecordingReport


def print_report(report: RecordingReport) -> None:
    """One column per camera, warnings below, on stdout."""
    table = Table("")
    for camera in report.cameras:
        table.add_column(Text(camera.name))
    for label, *values in zip(_LABELS, *(_values(camera) for camera in report.cameras), strict=True):
        table.add_row(label, *values)
    console = Console()
    # As it is: not cut to the table's width, and brackets in a name are no markup.
    console.print(Text(f"{report.path} ({report.kind})"), soft_wrap=True)
    console.print(table)
    if report.positions:
        console.print(f"{report.positions} positions of the machine")
    for warning in report.warnings:
        console.print(Text(f"warning: {warning}"), soft_wrap=True)
    for camera in report.cameras:
        for warning in camera.warnings:
            console.print(Text(f"warning: camera '{camera.name}': {warning}"), soft_wrap=True)


_LABELS = (
    "size",
    "frames",
    "missing numbers",
    "frames/s given, seen",
    "duration",
    "depth unit",
    "belt distance given, seen",
    "belt travel",
    "masks, colour",
)


def _values(camera: CameraReport) -> tuple[str, ...]:
    fps_seen = "?" if camera.fps_seen is None else f"{camera.fps_seen:g}"
    given = "not given" if camera.belt_given_m is None else f"{camera.belt_given_m:.3f} m"
    seen = "?" if camera.belt_seen_m is None else f"{camera.belt_seen_m:.3f} m"
    return (
        f"{camera.width}x{camera.height}",
        str(camera.frames),
        str(camera.gaps),
        f"{camera.fps_given:g}, {fps_seen}",
        f"{camera.duration_s:.1f} s",
        f"{camera.depth_scale_m * 1000:g} mm",
        f"{given}, {seen}",
        _told(camera.travel, "given", "to be estimated"),
        f"{_told(camera.masks, 'yes', 'no')}, {_told(camera.color, 'yes', 'no')}",
    )


def _told(found: bool | None, yes: str, no: str) -> str:
    return "?" if found is None else yes if found else no
