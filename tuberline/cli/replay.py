"""`tuberline replay`: count and weigh everything in a recording."""

from __future__ import annotations

import json as json_module
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Annotated

from conveyor.errors import InputError, TuberlineError
from conveyor.files import check_place, unwritable
from tuberline.cli.leaving import told_to_end
from tuberline.cli.numbers import RestingOffset, RestingSd, within
from tuberline.forks import MODULES, ForkServer


def replay(
    recording: Path,
    /,
    *,
    out: Path,
    speed: str = "max",
    weights: Path | None = None,
    regressors: Annotated[int, within(1, 64)] | None = None,
    rrd: Path | None = None,
    ignore_masks: bool = False,
    resting_offset_mm: RestingOffset | None = None,
    resting_sd_mm: RestingSd | None = None,
    contract: Path | None = None,
    places: Path | None = None,
    fast: bool = False,
    resume: bool = False,
    json: bool = False,
) -> None:
    """Count and weigh everything in a recording. Writes ledger.db, summary.json and tubers.csv.

    The first 60 bodies are looked at before anything is counted: what the camera does to outlines, and whether the belt
    carries clods, is then known to the first of them.

    Parameters
    ----------
    recording
        Folder, .mcap file or 3DPotatoTwin folder; all its cameras are used.
    out
        Folder for the results; it must not hold a run yet, unless that one is resumed.
    speed
        real, max, or a factor such as 2.5. Nothing is lost at any speed: a replay waits for the line.
    weights
        PointRAFT weights (.safetensors or the authors' .pth); default: the shipped ones.
    regressors
        Number of weighing processes; default: two, or one on a single processor.
    rrd
        Also write a Rerun recording to this file.
    ignore_masks
        Find the tubers on depth though the recording has masks of its own.
    resting_offset_mm
        How far tubers' undersides lie below the belt distance, millimetres; default: what the recording states.
    resting_sd_mm
        How well that is known, standard deviation in millimetres.
    contract
        A buyer's classes of size (TOML): count and weight of each come with the totals.
    places
        A line's file whose sections of the recording's cameras say where they hang, instead of what the recording says:
        what `tuberline calibrate cameras` prints. Its section [belt] says what tubers lie on, rods for example, or
        names a gauge; a file may have that alone.
    fast
        Weigh as a busy live line does: one view of a tuber from each camera, in the fastest form within 0.1 g of the
        exact one. Every weight is flagged with the form; what is counted stays the same.
    resume
        Go on with a replay into the same folder that was killed or gave up. The options of its first start hold.
    json
        Print the summary as JSON on stdout.
    """
    factor = parse_speed(speed)
    if rrd is not None:
        check_place(rrd, option="--rrd")
    # The nodes' process loads what they need while this one looks at the recording.
    with _says_how_to_go_on(recording, out), ForkServer.if_usable(tuple(MODULES)) or nullcontext() as forks:
        from tuberline.replayer import replay_recording, resume_replay

        if resume:
            summary = resume_replay(recording, out=out, show=not json, forks=forks)
        else:
            summary = replay_recording(
                recording,
                out=out,
                speed=factor,
                weights=weights,
                regressors=regressors,
                rrd=rrd,
                ignore_masks=ignore_masks,
                resting_offset_mm=resting_offset_mm,
                resting_sd_mm=resting_sd_mm,
                contract=contract,
                places=places,
                fast=fast,
                show=not json,
                forks=forks,
            )
    if rrd is not None and (trouble := unwritable(rrd.absolute().parent)):
        sys.stderr.write(f"warning: --rrd {rrd} ends early, its disk takes no more: {trouble}\n")
    if json:
        sys.stdout.write(json_module.dumps(summary, indent=2) + "\n")
    else:
        from rich.console import Console

        from tuberline.cli.report import print_summary

        print_summary(Console(), summary, out=out)
    if summary["state"] == "nothing seen":
        raise TuberlineError(f"nothing was seen of {recording}: {summary['reason']}")


@contextmanager
def _says_how_to_go_on(recording: Path, out: Path) -> Iterator[None]:
    """A replay that is told to end before it has ended: what was counted is in its ledger."""
    from tuberline.replayer import RUN_FILE

    try:
        yield
    except BaseException as error:
        if told_to_end(error) is not None and (out / RUN_FILE).is_file():
            again = shlex.join(["tuberline", "replay", str(recording), "--out", str(out), "--resume"])
            sys.stderr.write(f"tuberline: stopped before the end; `{again}` goes on\n")
        raise


def parse_speed(text: str) -> float:
    """Times real time; 0 means as fast as the line takes it."""
    if text in ("max", "real"):
        return 0.0 if text == "max" else 1.0
    try:
        factor = float(text)
    except ValueError:
        factor = -1.0
    if not 0 < factor < 1000:
        raise InputError(f"--speed {text}: give real, max or a factor above 0 and below 1000")
    return factor
