"""`tuberline import`: a recording from plain depth frames of any camera."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from conveyor.errors import InputError
from tuberline.cli.numbers import BeltDistance, within
from tuberline.cli.recordings import leave_on_losses

if TYPE_CHECKING:
    from conveyor.formats.conversion import Converted
    from conveyor.formats.plain.reader import PlainFrames


def import_frames(
    frames: Path,
    /,
    *,
    intrinsics: Path | None = None,
    depth_unit: Annotated[float | None, Parameter(name=["--depth-unit"])] = None,
    fps: Annotated[float | None, within(0.01, 1000)] = None,
    belt_distance_m: BeltDistance | None = None,
    out: Path | None = None,
    camera: str = "front",
    pattern: str = "*",
    format: Literal["auto", "folder", "mcap", "ros2"] = "auto",
    json: bool = False,
) -> None:
    """Make a recording of depth frames that any camera's software saved: PNG, TIFF, NPY, NPZ or MAT.

    Frames that contradict the belt distance are left out and told, and the exit code is 1 then.

    Parameters
    ----------
    frames
        Folder of the frames of one camera, in the order of the numbers in their names; or one file of frames.
    intrinsics
        JSON with fx, fy, cx, cy (and width, height) or with a 3x3 matrix "K"; a ROS camera info, Open3D's and other
        common layouts are read too, and a text file of three rows.
    depth_unit
        Metres per unit of the files: 0.001 for millimetres, 1 for decimal metres. Default: what the intrinsics say.
    fps
        Frames per second.
    belt_distance_m
        Camera to belt along the optical axis, metres; without it the belt is fitted.
    out
        What to write: a folder, or a name ending in .mcap. Default: recordings/NAME, by the name of the folder.
    camera
        What to call the camera.
    pattern
        Which files of the folder are frames, e.g. '*.depth.png'.
    format
        As for `convert`: folder, mcap, ros2, or auto: by the name.
    json
        Say what was written as JSON.
    """
    from conveyor.files import whole_output
    from conveyor.formats.beside import check_new
    from conveyor.formats.conversion import write_recording
    from conveyor.formats.plain.reader import PlainFrames
    from conveyor.formats.prepared import PreparedSource
    from conveyor.topics import check_name
    from tuberline.cli.progress import frames_bar

    if intrinsics is None:
        raise InputError(
            'give --intrinsics K.json, a file like {"fx": 612.4, "fy": 612.1, "cx": 320.0, "cy": 240.0}: without them '
            "depth says nothing of sizes"
        )
    if fps is None:
        raise InputError("give --fps, frames per second: the files do not say when they were taken")
    target = out or Path("recordings") / frames.resolve().stem
    check_new(target, fix="choose another name with --out")
    found = PlainFrames(
        frames,
        intrinsics=intrinsics,
        depth_unit_m=depth_unit,
        fps=fps,
        camera=check_name(camera, what="--camera: camera"),
        pattern=pattern,
        belt_distance_m=belt_distance_m,
    )
    with whole_output(target) as partial, frames_bar() as on_frame:
        done = write_recording(
            [PreparedSource(found, where=str(frames))],
            partial,
            files={},
            form=format,
            on_frame=on_frame,
        )
    _tell(found, done, target, json=json)
    leave_on_losses(done)


def _tell(found: PlainFrames, done: Converted, target: Path, *, json: bool) -> None:
    from conveyor.formats.inspection import described_doubtfully

    d = found.description
    notes = described_doubtfully(d)
    report = {
        "out": str(target),
        "frames": done.frames,
        "refused": done.refused,
        "missing": found.missing,
        "width": d.intrinsics.width,
        "height": d.intrinsics.height,
        "depth_scale_m": d.depth_scale_m,
        "notes": list(notes),
    }
    if json:
        sys.stdout.write(json_module.dumps(report) + "\n")
        return
    gaps = f", {found.missing} missing between them" if found.missing else ""
    unit = f"in units of {d.depth_scale_m * 1000:g} mm"
    frames_of = "1 frame" if done.frames == 1 else f"{done.frames} frames"
    sys.stdout.write(f"{frames_of} of {d.intrinsics.width}x{d.intrinsics.height} {unit}{gaps} in {target}\n")
    for note in notes:
        sys.stderr.write(f"warning: {note}\n")
    sys.stdout.write(f"look at it: tuberline info {target}\n")
