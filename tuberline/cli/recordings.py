"""`tuberline info`, `convert`, `recover`: describe a recording, write it in another format, repair one."""

from __future__ import annotations

import json as json_module
import sys
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from conveyor.errors import InputError
from tuberline.cli.numbers import BeltDistance, within

if TYPE_CHECKING:
    from conveyor.formats.conversion import Converted

TargetFormat = Literal["auto", "folder", "mcap", "ros2", "foxglove"]


def tell_doubts(recording: Path, *, masks: bool = True, part: int | None = None) -> None:
    """A line on stderr for all that is suspicious about a recording before any frame is looked at: camera folders that
    are left out, intrinsics and poses that contradict themselves. `masks`: whether its own are asked for; `part`: which
    run of several.
    """
    from conveyor.formats.inspection import told_at_once

    for text in told_at_once(recording, masks=masks, part=part):
        sys.stderr.write(f"warning: {text}\n")


def leave_on_losses(done: Converted) -> None:
    """End with 1, and say why, where frames were left out of what was written."""
    from conveyor.formats.cameras import told_unreadable

    if done.refused:
        sys.stderr.write(f"tuberline: {told_unreadable(done.refused, done.texts[0])}\n")
        raise SystemExit(1)


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
    from conveyor.formats.mcap.recovery import recover as recover_file
    from tuberline.cli.progress import frames_bar

    target = out or path.with_name(f"{path.stem}.recovered.mcap")
    with frames_bar("bytes") as on_bytes:
        saved = recover_file(path, target, on_bytes=on_bytes)
    total = sum(saved.messages.values())
    if json:
        report = {"out": str(target), "messages": saved.messages, "lost_bytes": saved.lost_bytes, "whole": saved.whole}
        sys.stdout.write(json_module.dumps(report) + "\n")
        return
    sys.stdout.write(f"{total} messages saved in {target}\n")
    for topic, count in sorted(saved.messages.items()):
        sys.stdout.write(f"  {topic}: {count}\n")
    if saved.whole:
        sys.stdout.write(f"{path} was whole and needed no repair: {target} holds the same, and may be deleted\n")
    else:
        sys.stdout.write(f"{saved.lost_bytes} bytes could not be read ({saved.damage})\n")


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
    recording: Path | None = None,
    run: str | None = None,
    belt_distance_m: BeltDistance | None = None,
    depth_scale_m: Annotated[float | None, within(1e-6, 1, "m per unit")] = None,
    part: int | None = None,
    json: bool = False,
) -> None:
    """Convert a recording to a folder, to MCAP or to ROS 2 topics, lossless; or a run with its tubers for Foxglove.

    Frames that cannot be read are left out and told, and the exit code is 1 then.

    Parameters
    ----------
    source
        A recording of any known format; for foxglove also a run's folder (--out of replay and run).
    target
        What to write: a name ending in .mcap, or a folder. Must not exist.
    format
        folder, mcap (Tuberline's own), ros2 (MCAP with ROS 2 topics), foxglove (MCAP with Foxglove's own schemas:
        depth, colour, calibration, points, and of a run its tubers, weights and totals), or auto: by the name.
    recording
        For foxglove: the recording of the run, where the run's line.toml does not name it.
    run
        For foxglove: which run of the ledger, where it holds several.
    belt_distance_m
        Instead of what the recording says.
    depth_scale_m
        Metres per depth unit, instead of what the recording says.
    part
        Which run, from 1 on, of an MCAP file into which several were recorded. Not for foxglove.
    json
        Say what was written as JSON.
    """
    from conveyor.files import whole_output
    from conveyor.formats.beside import check_new
    from conveyor.formats.conversion import convert_recording
    from tuberline.cli.progress import frames_bar

    check_new(target)
    if format != "foxglove" and (recording is not None or run is not None):
        raise InputError("--recording and --run are for --format foxglove, which shows what a run counted")
    if format == "foxglove" and part is not None:
        raise InputError("--part is not for --format foxglove: take the run out with `tuberline convert` first")
    with suppress(InputError) if format == "foxglove" else nullcontext():  # of a run, and of what is nothing, it tells
        tell_doubts(recording or source, part=part)
    with whole_output(target) as partial, frames_bar() as on_frame:
        stated: dict[str, Any] = {"belt_distance_m": belt_distance_m, "depth_scale_m": depth_scale_m}
        if format == "foxglove":
            from tuberline.foxglove_file import write_foxglove

            done = write_foxglove(source, partial, recording=recording, run=run, on_frame=on_frame, **stated)
        else:
            done = convert_recording(source, partial, form=format, part=part, on_frame=on_frame, **stated)
    if json:
        report = {"out": str(target), "frames": done.frames, "refused": done.refused}
        sys.stdout.write(json_module.dumps(report) + "\n")
    else:
        sys.stdout.write(f"{done.frames} frames in {target}\n")
    leave_on_losses(done)
