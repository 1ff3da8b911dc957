"""Counters' reasons in plain words: what happened, and what to do about it. Others are shown by their own names."""

from __future__ import annotations

from dataclasses import dataclass

from conveyor.reasons import FrameDrop, ViewLoss


@dataclass(frozen=True, slots=True)
class Words:
    """`now` follows a camera's name while it happens, `what` stands behind a count, `fix` says what to do."""

    now: str
    what: str
    fix: str


FRAME_DROPS: dict[str, Words] = {
    FrameDrop.BLIND: Words(
        "is dark",
        "dark or covered",
        "Switch its light on, clean the glass, and look for something that covers it.",
    ),
    FrameDrop.FROZEN: Words(
        "shows a still picture while the belt moves",
        "same picture again",
        "Unplug the camera, plug it in again, and look at its cable.",
    ),
    FrameDrop.CAMERA_CHANGED: Words(
        "sends frames of another resolution or depth unit than at the start",
        "of another camera setting",
        "Set the camera back, or start a new run.",
    ),
    FrameDrop.NO_BELT: Words(
        "sees no belt",
        "no belt seen",
        "See that it looks at the belt; give its belt_distance_m in the line's file.",
    ),
    FrameDrop.TOO_OLD: Words(
        "is ahead of this computer: frames are too old when their turn comes",
        "too old",
        "Run fewer programs on that computer, or set the camera to a lower resolution.",
    ),
    FrameDrop.OVERWRITTEN: Words(
        "is ahead of this computer: frames are pushed out by newer ones",
        "pushed out by newer ones",
        "Run fewer programs on that computer, or set the camera to a lower resolution.",
    ),
    FrameDrop.OVERLOAD: Words(
        "skips frames: too few weighing computers for so many tubers",
        "skipped: too few weighing computers",
        "Start another regressor on any computer of the line.",
    ),
}
VIEW_LOSSES: dict[str, Words] = {
    ViewLoss.SHED: Words(
        "has too few weighing computers: only some views of each tuber are weighed",
        "left out: too few weighing computers",
        "Start another regressor on any computer of the line.",
    ),
    ViewLoss.LATE: Words(
        "has busy weighing computers: some second views of tubers come too late",
        "left out: answered too late",
        "Start another regressor on any computer of the line, if it stays so.",
    ),
    ViewLoss.OVERLOAD: Words(
        "has more tubers than can be weighed: the newest are weighed by their volume alone",
        "not weighed: more tubers than the weighing computers manage",
        "Start another regressor on any computer of the line, or slow the belt down.",
    ),
    ViewLoss.MAX_ATTEMPTS: Words(
        "has views that no weighing computer answers",
        "not answered",
        "Look at the weighing computers and the network between them and the camera.",
    ),
    ViewLoss.WEIGH_DEADLINE: Words(
        "waits too long for weights: some tubers are weighed by their volume alone",
        "answered too late",
        "Start another regressor, or look at the network between it and the camera.",
    ),
    ViewLoss.RESTART: Words("lost views at a restart", "lost at a restart", "Read the segmenter's log."),
}
AGGREGATOR_REFUSALS = {
    "entries_conflicting": "A camera's log contradicts the ledger: its segmenter lost its state and started again.",
    "entries_refused_other_run": "A camera sends another run than the one that is counted.",
    "entries_refused_unknown_camera": "A camera that this line does not know sends tubers.",
    "entries_refused_malformed": "A camera sends entries that cannot be read.",
    "entries_set_aside": "A camera sent entries that no one can read: what they said is lost.",
    "entries_dropped_waiting_full": "Entries come faster than the gap before them is filled.",
}
AGGREGATOR_FIX = "Start a new run on every host of the line with the same run id, and read the aggregator's log."


def plain(reason: str) -> str:
    """A reason by its own name."""
    return reason.replace("_", " ")


def dropped(reason: str) -> str:
    """What happened to frames dropped for `reason`."""
    return FRAME_DROPS[reason].what if reason in FRAME_DROPS else plain(reason)


def lost(reason: str) -> str:
    """What happened to views lost for `reason`."""
    return VIEW_LOSSES[reason].what if reason in VIEW_LOSSES else plain(reason)


def span(seconds: float) -> str:
    """A time for a person: '12 s', '3 min', '2 h 5 min'."""
    whole = int(seconds)
    if whole < 120:
        return f"{whole} s"
    if whole < 7200:
        return f"{whole // 60} min"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
