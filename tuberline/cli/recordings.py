"""`tuberline info`, `convert`, `recover`: describe a recording, write it in another format, repair one."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import Literal

from conveyor.errors import InputError

TargetFormat = Literal["auto", "folder", "mcap", "ros2"]


def recover(path: Path, /, *, out: Path | None = None, json: bool = False) -> None:
    """Save what is whole of an MCAP file whose writer was killed, as a new file that every reader takes.

    Parameters
    ----------
    path
        The damaged file; it stays as it is.
    out
        The file to write; default: <name>.recovered.mcap beside it.
    json
        Say what was saved as JSON.
    """
    from conveyor.files import whole_output
    from conveyor.formats.mcap.recovery import recover as recover_file

    target = out or path.with_name(f"{path.stem}.recovered.mcap")
    if target.exists():
        raise InputError(f"{target} exists; recover to another name with --out")
    with whole_output(target) as partial:
        saved = recover_file(path, partial)
    total = sum(saved.messages.values())
    if json:
        report = {"out": str(target), "messages": saved.messages, "lost_bytes": saved.lost_bytes, "whole": saved.whole}
        sys.stdout.write(json_module.dumps(report) + "\n")
        return
    sys.stdout.write(f"{total} messages saved in {target}\n")
    for topic, count in sorted(saved.messages.items()):
        sys.stdout.write(f"  {topic}: {count}\n")
    if saved.whole:
        sys.stdout.write("the file was whole: nothing was lost\n")
    else:
        sys.stdout.write(f"{saved.lost_bytes} bytes at the end could not be read ({saved.damage})\n")


def info(recording: Path, /, *, json: bool = False) -> None:
    """Describe a recording of any known format and warn of its traps.

    Parameters
    ----------
    recording
        Folder, .mcap file, 3DPotatoTwin folder or ROS bag.
    json
        Print the description as JSON.
    """
    from dataclasses import asdict

    from conveyor.formats.inspection import inspect_recording

    report = inspect_recording(recording)
    if json:
        sys.stdout.write(json_module.dumps(asdict(report), indent=1) + "\n")
        return
    from tuberline.cli.info_table import print_report

    print_report(report)


def convert(
    source: Path,
    target: Path,
    /,
    *,
    format: TargetFormat = "auto",
    belt_distance_m: float | None = None,
    depth_scale_m: float | None = None,
    json: bool = False,
) -> None:
    """Convert a recording of any known format to a folder, to MCAP, or to ROS 2 topics in MCAP; lossless.

    Parameters
    ----------
    source
        A recording of any known format.
    target
        What to write: a name ending in .mcap, or a folder. Must not exist.
    format
        folder, mcap (Tuberline's own), ros2 (MCAP with ROS 2 topics, for ROS and Foxglove), or auto: by the name.
    belt_distance_m
        Instead of what the recording says.
    depth_scale_m
        Metres per depth unit, instead of what the recording says.
    json
        Say what was written as JSON.
    """
    from conveyor.files import whole_output
    from conveyor.formats.conversion import convert_recording
    from tuberline.cli.progress import frames_bar

    if target.exists():
        raise InputError(f"{target} exists; recordings are not overwritten, choose another name")
    with whole_output(target) as partial, frames_bar() as on_frame:
        done = convert_recording(
            source,
            partial,
            form=format,
            belt_distance_m=belt_distance_m,
            depth_scale_m=depth_scale_m,
            on_frame=on_frame,
        )
    if json:
        report = {"out": str(target), "frames": done.frames, "refused": done.refused}
        sys.stdout.write(json_module.dumps(report) + "\n")
        return
    sys.stdout.write(f"{done.frames} frames in {target}\n")
    for text in done.texts:
        sys.stderr.write(f"refused {text}\n")
    if done.refused:
        sys.stdout.write(f"{sum(done.refused.values())} frames could not be read: {done.refused}\n")
