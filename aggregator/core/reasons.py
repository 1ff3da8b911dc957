"""States of a load and reasons for belt that was not seen, as words that messages, page and docs are made from."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

from conveyor.messages.tracks import UNFOLLOWED


class LoadState(StrEnum):
    """What the numbers of a load are worth."""

    STARTING = "starting"
    """Some expected camera has not looked yet: what passes is not counted."""
    COUNTING = "counting"
    NOTHING_SEEN = "nothing seen"
    """No frame, no belt, or every frame dropped: there is no number."""
    ENDED = "ended"


class Role(StrEnum):
    """Where a track of a camera's log went."""

    COUNTED = "counted"
    """With others of its place it is a tuber."""
    FOREIGN = "foreign"
    """With others of its place it is a clod, a stone or haulm."""
    LATE_DUPLICATE = "late_duplicate"
    """Its tuber was committed before it came."""
    REPEAT = "repeat"
    """A track of its id had come before."""


class CameraWord(StrEnum):
    """What is said of a camera in one word."""

    WAITING = "waiting"
    RUNNING = "running"
    SILENT = "silent"
    ENDED = "ended"


class Unseen(StrEnum):
    """Why belt of a load was not seen by a camera."""

    BEFORE = "before_first_frame"
    """It passed before the camera's first processed frame."""
    BETWEEN = "between_frames"
    """It passed between two processed frames: frames were lost or dropped, or the segmenter was restarted."""
    AFTER = "after_last_frame"
    """It passed after the last thing that the camera's log holds."""
    NEVER = "camera_never_looked"


_IN_WORDS: Mapping[str, str] = {
    Unseen.BEFORE: "before the first frame used",
    Unseen.BETWEEN: "between two frames used",
    Unseen.AFTER: "after the last frame used",
    Unseen.NEVER: "under a camera that never looked",
}


def unseen_in_words(unseen_m: Mapping[str, float], *, decimals: int, least_m: float = 0.0) -> str:
    """Belt that was not seen, in metres by reason, as commands and reports tell it; what is less than `least_m` is left
    out. A reason that a later version wrote is told as it stands.
    """
    told = ((_IN_WORDS.get(reason, reason), metres) for reason, metres in unseen_m.items() if metres >= least_m)
    return ", ".join(f"{metres:.{decimals}f} m {words}" for words, metres in told)


class NothingSeen(StrEnum):
    """Why a load, or one of its cameras, saw nothing at all, where no reason for dropped frames says more."""

    NO_CAMERA = "no camera was heard of"
    NO_FRAME = "no frame arrived"
    NO_MOTION = "the belt did not move"
    NO_SPEED = "no two frames share any belt, so how fast it runs is not known"
    UNKNOWN = "no frame was processed"


DROPPED = {
    "no_belt": "no belt was found in the frames",
    "blind": "the frames hold hardly any depth (is the lens covered?)",
    "frozen": "the picture stood still",
    "too_old": "the frames came too late",
    "overwritten": "more frames came than could be processed",
    "overload": "the regressors could not keep up",
    "behind": "the aggregator could not keep up",
}
"""Reasons of a segmenter for dropped frames, in words; one that is not here is told as it is."""


def why_nothing(published: int, frames: Mapping[str, int], *, moved: bool = False) -> str:
    """The main reason why nothing was seen, in words.

    Args:
        published: frames that the cameras sent, as far as known.
        frames: the segmenters' sheets, added up (`conveyor.messages.Mark.frames`).
        moved: a camera that processed frames says that the belt moved.
    """
    dropped = {name.removeprefix("dropped_"): n for name, n in frames.items() if name.startswith("dropped_") and n}
    if frames.get(UNFOLLOWED, 0):
        return str(NothingSeen.NO_SPEED)
    if frames.get("processed", 0) and not moved:
        return str(NothingSeen.NO_MOTION)
    if dropped:
        reason = max(sorted(dropped), key=lambda name: dropped[name])
        return f"{DROPPED.get(reason, reason)} ({dropped[reason]} of {max(published, sum(dropped.values()))} frames)"
    if not published and not frames.get("published", 0):
        return str(NothingSeen.NO_CAMERA if not frames else NothingSeen.NO_FRAME)
    return str(NothingSeen.NO_FRAME if not frames.get("received", 0) else NothingSeen.UNKNOWN)
