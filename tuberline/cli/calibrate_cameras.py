"""`tuberline calibrate cameras`: where the cameras of one belt hang, by the load that passes under them."""

from __future__ import annotations

import json as json_module
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from conveyor.camera_place import CameraPlace
from conveyor.errors import InputError
from conveyor.statistics import NORMAL_90
from tuberline.cli.numbers import within
from tuberline.cli.recordings import tell_doubts
from tuberline.setup.line_file import toml_key

if TYPE_CHECKING:
    from rich.table import Table

    from segmenter.calibrate_cameras import PlacedCamera

STRAIGHT_DEG = 0.5
"""Up to here a camera is told as one that looks straight down."""
HEIGHTS_AGREE_MM = 2.0
"""Beyond it the belt distance of one of two cameras is off: a millimetre is worth 2.2 % of a load."""


def calibrate_cameras(
    recording: Path,
    /,
    *,
    seconds: Annotated[float, within(5, 3600)] = 60.0,
    across_m: Annotated[float, within(-20, 20)] | None = None,
    along_m: Annotated[float, within(-100, 100)] | None = None,
    json: bool = False,
) -> None:
    """Measure how each camera is turned against the belt, and where it hangs beside the others.

    Record all cameras at once, with tubers on the belt. Each camera's tilt is that of the plane that it sees, its turn
    that of the way its load moves, and its place beside another camera that of the tubers which both see. The first
    camera's own place cannot be seen: give it, or it stays what the recording says.

    Exits with 2 where not every camera is placed; what was measured is printed all the same.

    Parameters
    ----------
    recording
        Recording of all cameras, of any kind that `replay` takes.
    seconds
        How much of it to use, from its beginning.
    across_m
        Where the first camera hangs across the belt, positive to the left of who looks along the travel.
    along_m
        Where it hangs along the belt, positive with the travel.
    json
        Print what was measured as JSON on stdout, belt_from_camera included.
    """
    from conveyor.formats.cameras import open_cameras, told_unreadable
    from segmenter.calibrate_cameras import place_cameras, see_load
    from tuberline.cli.progress import work_bar

    tell_doubts(recording, masks=False)
    cameras = open_cameras(recording, ignore_masks=True, follow=True)
    told = cameras[0].description.belt_from_camera
    said = CameraPlace() if told is None else CameraPlace.of(cameras[0].recorded_pose(told))
    first = CameraPlace(said.along_m if along_m is None else along_m, said.across_m if across_m is None else across_m)
    with work_bar("frames") as on_work:
        seen = [see_load(camera, seconds=seconds, on_frame=on_work) for camera in cameras]
    placed = place_cameras(seen, first=first)
    if json:
        sys.stdout.write(json_module.dumps([_plain(one) for one in placed], indent=2) + "\n")
    else:
        from rich.console import Console

        console = Console(stderr=True)
        console.print(_table(placed))
        unread = {camera.description.name: told_unreadable(camera.unreadable, camera.first_fault) for camera in cameras}
        for text in (*(f"camera '{name}': {text}" for name, text in unread.items() if text), *_findings(placed)):
            console.print(text, markup=False, highlight=False, soft_wrap=True)
        sys.stdout.write("".join(_section(one) for one in placed if one.placed))
    if lost := [one.seen.camera for one in placed if not one.placed]:
        raise InputError(
            f"{recording}: camera {', '.join(lost)} shares too few tubers with the others to say where it hangs; "
            "record more load, with tubers where the pictures overlap; where they do not overlap, measure across_m "
            "and along_m by hand"
        )


def _table(placed: Sequence[PlacedCamera]) -> Table:
    """One column per camera."""
    from rich.markup import escape
    from rich.table import Table

    table = Table("", *(escape(one.seen.camera) for one in placed))
    table.add_row("load that crossed", *(str(len(one.seen.tracks)) for one in placed))
    table.add_row("belt distance", *(f"{one.seen.distance_m:.4f} m" for one in placed))
    table.add_row("tilt", *(_tilt(one) for one in placed))
    table.add_row(
        "turned",
        *(f"{one.place.turned_deg:+.2f}° ± {NORMAL_90 * one.seen.direction.heading_sd_deg:.2f}" for one in placed),
    )
    table.add_row("across", *(_where(one, one.place.across_m, "across_sd_m") for one in placed))
    table.add_row("along", *(_where(one, one.place.along_m, "along_sd_m") for one in placed))
    table.add_row("beside camera", *(escape(one.beside or "-") for one in placed))
    table.add_row(
        "tubers that both see", *("-" if one.offset is None else str(len(one.offset.pairs)) for one in placed)
    )
    higher = ("-" if one.offset is None else f"{one.offset.higher_mm:+.1f} mm" for one in placed)
    table.add_row("which it sees higher", *higher)
    return table


def _where(one: PlacedCamera, at_m: float, error: str) -> str:
    if not one.placed:
        return "not known"
    return f"{at_m:+.4f} m" + ("" if one.offset is None else f" ± {NORMAL_90 * getattr(one.offset, error):.4f}")


def _tilt(one: PlacedCamera) -> str:
    return "not seen" if one.seen.belt is None else f"{one.seen.belt.tilt_deg:.2f}°"


def _findings(placed: Sequence[PlacedCamera]) -> Iterator[str]:
    for one in placed:
        camera = one.seen.camera
        if one.offset is not None and abs(one.offset.higher_mm) > HEIGHTS_AGREE_MM:
            yield (
                f"camera '{camera}' sees the same tubers {one.offset.higher_mm:+.1f} mm higher than '{one.beside}': "
                "measure the belt distance of both (`tuberline calibrate belt`)"
            )
        belt = one.seen.belt
        if belt is None:
            yield f"camera '{camera}' sees no plane of a belt: it is taken to look straight down"
        elif belt.disagreement_mm is not None and abs(belt.disagreement_mm) > HEIGHTS_AGREE_MM:
            yield (
                f"camera '{camera}' sees the belt {belt.disagreement_mm:+.1f} mm off its belt_distance_m, which is "
                "used: measure it again (`tuberline calibrate belt`)"
            )


def _section(one: PlacedCamera) -> str:
    """The camera's keys for the line's file."""
    place = one.place
    lines = [f"[cameras.{toml_key(one.seen.camera)}]"]
    if one.seen.belt is None or one.seen.belt.tilt_deg <= STRAIGHT_DEG:
        lines += [
            f"belt_distance_m = {one.seen.distance_m:.4f}",
            f"across_m = {place.across_m:.4f}",
            f"along_m = {place.along_m:.4f}",
            f"turned_deg = {place.turned_deg:.2f}",
        ]
    else:
        rows = ",\n".join(f"  [{', '.join(f'{value:.6f}' for value in row)}]" for row in one.belt_from_camera.tolist())
        lines += [f"belt_from_camera = [\n{rows},\n]"]
    return "\n".join(lines) + "\n"


def _plain(one: PlacedCamera) -> dict[str, Any]:
    place, offset = one.place, one.offset
    return {
        "camera": one.seen.camera,
        "placed": one.placed,
        "load": len(one.seen.tracks),
        "belt_distance_m": one.seen.distance_m,
        "tilt_deg": None if one.seen.belt is None else one.seen.belt.tilt_deg,
        "across_m": place.across_m if one.placed else None,
        "along_m": place.along_m if one.placed else None,
        "turned_deg": place.turned_deg,
        "turned_sd_deg": one.seen.direction.heading_sd_deg,
        "beside": one.beside,
        "shared": 0 if offset is None else len(offset.pairs),
        "across_sd_m": None if offset is None else offset.across_sd_m,
        "along_sd_m": None if offset is None else offset.along_sd_m,
        "higher_mm": None if offset is None else offset.higher_mm,
        "belt_from_camera": one.belt_from_camera.round(9).tolist() if one.placed else None,
    }
