"""Why something was not processed, counted or weighed: one enum per hop. Ledgers and counters hold their values.

The words on the page, the metrics and the table in docs/segmentation.md are made from these, so that a reason is named
in one place. A value never changes: old ledgers and dashboards know it.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Self


class Reason(StrEnum):
    """A reason: its value is what counters and ledgers hold, `meaning` says what happened."""

    meaning: str

    def __new__(cls, value: str, meaning: str) -> Self:
        member = str.__new__(cls, value)
        member._value_ = value
        member.meaning = meaning
        return member


class FrameDrop(Reason):
    """Why a segmenter did not process a frame that it received."""

    BLIND = "blind", "too little of the image has depth: the lens is dark or covered"
    FROZEN = "frozen", "the same image again though the belt moved on"
    CAMERA_CHANGED = (
        "camera_changed",
        "its intrinsics, depth unit or pose are not those of the first frame the segmenter saw",
    )
    NO_BELT = "no_belt", "no belt is seen: none was yet and no distance is given, or something else is in its place"
    TOO_OLD = "too_old", "the frame waited longer than max_age_ms"
    OVERWRITTEN = "overwritten", "newer frames pushed it out of the ring"
    OVERLOAD = "overload", "left out, for the regressors cannot keep up; tubers are seen in other frames"
    BEHIND = "behind", "left out, for the aggregator is thousands of log entries behind this camera"


class InstanceRefusal(Reason):
    """Why something on the height map is no instance of a tuber."""

    SMALL = "small", "its area is below min_area_mm2"
    FLAT = "flat", "its peak or its mean height is too low"


class TrackRefusal(Reason):
    """Why a track does not count as a tuber."""

    BEFORE_START = "before_start", "it lay beyond the centre row when counting began"
    NOT_CROSSED = "not_crossed", "it did not reach the centre row before the last frame"
    BORN_LATE = "born_late", "it appeared only after the centre row"
    VANISHED = "vanished", "it was gone before the centre row"
    FEW_FRAMES = "few_frames", "it was seen in too few frames"
    FRAGMENT = "fragment", "it was seen in too small a share of the frames that had its place in view"
    SMALL = "small", "its area is too small"
    TINY = "tiny", "its volume is too small"
    FLAT = "flat", "it is too low, or too low for its width"
    OUTSIDE = "outside", "its centre crosses the row outside the image; another camera counts it"
    DUPLICATE = "duplicate", "a counted track lies at the same place"
    THIN = "thin", "it is too narrow: haulm"
    SLIVER = "sliver", "an over-segmentation fragment of its neighbour"
    DISTRACTOR = "distractor", "the classifier takes it for a clod, a stone or haulm"
    OUT_OF_RANGE = "out_of_range", "its size or place is none that a tuber can have"
    NO_VIEW = "no_view", "no frame shows depth inside its mask"
    RESTART = "restart", "it was open when an earlier process of the run ended"


class ViewLoss(Reason):
    """Why a view was not weighed. A regressor's own refusal is 'refused_' and its reason."""

    SHED = "shed", "a spare view that would have waited too long; its tuber has another one"
    LATE = "late", "live: a spare view not answered spare_grace_s after its tuber's first answer"
    NOT_CHOSEN = "not_chosen", "live: sent before its track was decided, which then chose another view"
    OVERLOAD = "overload", "more tubers than the regressors can weigh; weighed by volume"
    MAX_ATTEMPTS = "max_attempts", "no regressor answered in max_attempts attempts"
    WEIGH_DEADLINE = "weigh_deadline", "no answer within weigh_deadline_s"
    RESTART = "restart", "it was outstanding when an earlier process of the run ended"
    REFUSED = "refused", "a regressor refused it"


class Requeue(Reason):
    """Why a view went back into the queue."""

    REGRESSOR_LEFT = "regressor_left", "its regressor left"
    DEADLINE = "deadline", "its regressor did not answer within job_deadline_s, or live in several times its usual time"
    LOST_ON_THE_WAY = "lost_on_the_way", "its regressor answered a later one: this one never arrived"
