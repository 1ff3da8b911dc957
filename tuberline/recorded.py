"""What a replay makes of a recording beside its frames: positions that are told again, frames that are not there, why
nothing was counted.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from conveyor.errors import InputError
from conveyor.messages import CamerasApart
from conveyor.reasons import FrameDrop, TrackRefusal

DISCARDED, DROPPED = "discarded_", "dropped_"
"""What begins the names of tracks that do not count on a camera's sheet, and of frames left out; the reason follows."""
_MEANINGS = {str(reason): reason.meaning for reason in (*TrackRefusal, *FrameDrop)}


def lost_frames(cameras: Mapping[str, Any], *, logs: Path) -> list[str]:
    """In words, which cameras of a summary had frames that are missing, could not be read, or showed no belt."""
    told = []
    for name, sheet in cameras.items():
        frames = sheet["frames"]
        if gaps := frames.get("gaps", 0):
            told.append(
                f"camera '{name}': {gaps} of {frames['published']} frames are missing or cannot be read; what can be "
                f"said of each stands in {logs / f'camera-{name}.log'}"
            )
        dropped = {key.removeprefix(DROPPED): n for key, n in frames.items() if key.startswith(DROPPED) and n}
        if dropped:
            told.append(
                f"camera '{name}': {sum(dropped.values())} of {frames['published']} frames were left out: "
                f"{_reasons_told(dropped)}; "
                f"more stands in {logs / f'segmenter-{name}.log'}"
            )
    return told


def none_counted(summary: Mapping[str, Any]) -> list[str]:
    """In words, by camera of a summary, why what was seen does not count, where nothing does."""
    if summary["totals"]["count"] or summary["state"] == "nothing seen":
        return []
    told = []
    for name, sheet in summary["cameras"].items():
        tracks = {key.removeprefix(DISCARDED): n for key, n in sheet["tracks"].items() if key.startswith(DISCARDED)}
        told += not_counted_told(
            name, tracks, frames=sheet["frames"].get("processed", 0), travelled_m=sheet.get("travelled_m", 0.0)
        )
    return told


def not_counted_told(camera: str, discarded: Mapping[str, int], *, frames: int, travelled_m: float) -> list[str]:
    """In words, why no track of a camera counts; nothing where it had none. `discarded`: how many, by reason."""
    if not discarded:
        return []
    return [
        f"camera '{camera}': none of {sum(discarded.values())} tracks counts, in {frames} frames over "
        f"{travelled_m:.2f} m of belt: {_reasons_told(discarded)}"
    ]


def _reasons_told(counts: Mapping[str, int]) -> str:
    """How many by reason, and what each reason means."""
    return "; ".join(f"{n} {reason} ({_MEANINGS.get(reason, '')})" for reason, n in sorted(counts.items()))


def other_zeros(out: Path, *, run: str, totals: Mapping[str, Any]) -> list[str]:
    """In words, which cameras of a run that was counted into `out` count their travel from another zero."""
    from aggregator.ledger.reader import ledger_file, reading
    from aggregator.ledger.zeros import zeros_told

    apart = [CamerasApart(**told) for told in totals.get("apart", ())]
    with reading(ledger_file(out)) as view:
        return zeros_told(view, run, list(totals["cameras"]), apart)


def has_positions(out: Path, *, run: str) -> tuple[bool, list[str]]:
    """Whether the recording's positions can be told again; if they cannot be read that is a finding, and tubers count
    all the same.
    """
    from camera_sim.gnss.recorded import recorded_positions
    from conveyor.formats.positions import POSITIONS_FILE

    if not (out / POSITIONS_FILE).is_file():
        return False, []
    try:
        return bool(recorded_positions(out / POSITIONS_FILE, run=run)), []
    except InputError as error:
        return False, [f"the machine's positions are not replayed: {error}"]
