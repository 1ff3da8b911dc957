"""The count rule: which tracks are tubers that crossed the centre row, where and when.

A tuber counts when its centre crosses the image's centre row between the first and the last frame. Its place says
when that is, so it need not have been seen on both sides; a tuber that lay beyond the row when counting began never
counts. What is not counted has a reason.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import median

import numpy as np

from conveyor.reasons import TrackRefusal
from segmenter.classify.evidence import Answer
from segmenter.track.constants import NEAR_ROW_M, ROUND_FILL, VANISHED_FRAMES
from segmenter.track.history import TravelHistory
from segmenter.track.track import State, TrackState
from segmenter.track.tracker import Tracker


@dataclass(frozen=True, slots=True)
class CountSettings:
    """What a track must show to be a tuber.

    Attributes:
        min_frames: fewest frames, or all there were.
        min_share: of the frames in which its place was in view; slivers of knobby tubers show up in fewer.
        min_area_m2, min_height_m: medians over frames that no border cuts.
        min_width_m: haulm is thinner.
        min_thick: height over width of the flattest body; belt that rises, and soil, are flatter. Of 3217 simulated
            tubers, in worlds as bad as `harsh`, the flattest had 0.47, of 1576 of the other world 0.55.
        min_volume_m3: under the visible surface; the smallest tuber of three seasons, 16 g, has 18 ml.
        max_slender, contact_share: a piece split off a tuber is more slender (height over width) than this and shares
            more than this of its outline with another.
        seam_slender, seam_share: or this.
        sliver_area_m2, sliver_height_m: and it is smaller and higher than this; what stands free is a tuber on end.
        fragment_area_m2, fragment_contact: a fragment of an over-segmented tuber is smaller than this, shares more
            than this of its outline, and
        fragment_share: was one with a larger instance in more than this share of the frames that had its place in view,
        wide_share: or, where it is as wide as `knob_width_m` and shares at most `enclosed_contact`, in more than this;
        hidden_area_m2, fragment_seen: or it is smaller than this and stood apart in less than this share of them.
        steady_share: what stood apart in this share of those frames, and was never one with another, is a tuber,
        knob_width_m: unless it is narrower than this, was seen whole and is more slender than `max_slender`.
        same_share: two tracks closer than this share of the larger one's radius are one tuber.
        reject_below: log-odds of tuber against other (clod, stone, haulm) under which a track is no tuber.
    """

    min_frames: int = 3
    min_share: float = 0.35
    min_area_m2: float = 450e-6
    min_height_m: float = 0.018
    min_width_m: float = 0.016
    min_thick: float = 0.35
    min_volume_m3: float = 12e-6
    max_slender: float = 1.5
    contact_share: float = 0.3
    seam_slender: float = 1.2
    seam_share: float = 0.4
    sliver_area_m2: float = 1500e-6
    sliver_height_m: float = 0.033
    fragment_area_m2: float = 3500e-6
    fragment_contact: float = 0.2
    fragment_share: float = 0.12
    wide_share: float = 0.22
    enclosed_contact: float = 0.75
    hidden_area_m2: float = 2000e-6
    fragment_seen: float = 0.75
    steady_share: float = 0.9
    knob_width_m: float = 0.030
    same_share: float = 0.6
    reject_below: float = 0.3


@dataclass(frozen=True, slots=True)
class Crossing:
    """Where and when a tuber's centre crossed the centre row; belt metres."""

    captured_ns: int
    travel_m: float
    x_m: float
    y_m: float


def crossing(track: TrackState, tracker: Tracker, history: TravelHistory) -> Crossing:
    """The crossing of a track, from its readings near the row: what it did at the rims of the view matters less."""
    row_m = tracker.belt.row_crossing_x(track.place_y_m, track.height_m / 2)
    good = [h for h in track.hits if not h.ends_cut] or track.hits
    near = [h for h in good if abs(h.x_m - row_m) <= NEAR_ROW_M] or good
    area_m2 = median(h.area_m2 for h in near)
    usual = [h for h in near if abs(np.log(h.area_m2 / area_m2)) < 0.3] or near
    # That of a part lies inside the image: with some of those, the tuber beyond its side would count here, too.
    usual = [h for h in usual if not h.part] or usual
    place_x_m = median(h.x_m - h.travel_m for h in usual)
    y_m = median(h.y_m for h in usual)
    x_m = tracker.belt.row_crossing_x(y_m, track.height_m / 2)
    travel_m = x_m - place_x_m
    return Crossing(history.ns_at(travel_m), travel_m, x_m, y_m)


def refusal(
    track: TrackState, at: Crossing, tracker: Tracker, history: TravelHistory, settings: CountSettings, travel_m: float
) -> TrackRefusal | None:
    """Why a track is not counted; None where it is."""
    if at.travel_m <= history.start_m:
        return TrackRefusal.BEFORE_START
    if at.travel_m > travel_m:
        return TrackRefusal.NOT_CROSSED
    if not track.countable:
        return TrackRefusal.BORN_LATE
    if track.vacant >= VANISHED_FRAMES and track.hits[-1].x_m < at.x_m - 0.03:
        return TrackRefusal.VANISHED
    in_view = tracker.frames_in_view(track, history, travel_m)
    inner = [h for h in track.hits if not h.ends_cut]
    # Where frames are few, those that showed it cut by a border were no chance to see it whole.
    chances = max(1, in_view - (len(track.hits) - len(inner)))
    if len(inner) < min(settings.min_frames, chances):
        return TrackRefusal.FEW_FRAMES
    if len(inner) < settings.min_share * (chances if in_view < 2 * settings.min_frames else in_view):
        return TrackRefusal.FRAGMENT
    if median(h.area_m2 for h in inner) < settings.min_area_m2:
        return TrackRefusal.SMALL
    if median(h.volume_m3 for h in inner) < settings.min_volume_m3:
        return TrackRefusal.TINY
    if median(h.height_m for h in inner) < settings.min_height_m:
        return TrackRefusal.FLAT
    u, _ = tracker.belt.project(at.x_m, at.y_m, track.height_m / 2)
    if not -0.5 <= u <= tracker.belt.intrinsics.width - 0.5:
        return TrackRefusal.OUTSIDE
    return TrackRefusal.DUPLICATE if _is_double(track, tracker, settings) else None


def shape_refusal(track: TrackState, *, width_m: float, in_view: int, settings: CountSettings) -> TrackRefusal | None:
    """Why the shape of a track is no tuber's; None where it may be one.

    Haulm is thin, and belt that rises at its sides lies flat. A piece split off a knobby tuber's flank stands as high
    as the tuber but is narrow, and much of its outline is seam: no tuber rests on its edge like that. A knob on a tuber
    may look like a small tuber beside it in one frame; in others it is found as a part of its neighbour.
    """
    if width_m < settings.min_width_m:
        return TrackRefusal.THIN
    if median(h.height_m for h in track.hits) < settings.min_thick * width_m:
        return TrackRefusal.FLAT
    if _is_fragment(track, width_m, in_view, settings):
        return TrackRefusal.SLIVER
    height_m = median(h.volume_m3 / h.area_m2 for h in track.hits) / ROUND_FILL
    slender = height_m / width_m
    contact = median(h.contact for h in track.hits)
    if height_m < settings.sliver_height_m or track.area_m2 > settings.sliver_area_m2:
        return None
    mostly_seam = contact > settings.seam_share and slender > settings.seam_slender
    narrow = contact > settings.contact_share and slender > settings.max_slender
    if track.covered == 0 and _apart(track) >= settings.steady_share * in_view:
        mostly_seam = False
        # What a side cut is as narrow as that made it, and what is wider a tuber on end.
        narrow &= width_m < settings.knob_width_m and all(hit.whole or hit.ends_cut for hit in track.hits)
    return TrackRefusal.SLIVER if mostly_seam or narrow else None


def _is_fragment(track: TrackState, width_m: float, in_view: int, settings: CountSettings) -> bool:
    """`in_view`: frames that had the track's place in view so far."""
    contact = median(h.contact for h in track.hits)
    if track.area_m2 >= settings.fragment_area_m2 or contact <= settings.fragment_contact:
        return False
    wide = width_m >= settings.knob_width_m and contact <= settings.enclosed_contact
    share = settings.wide_share if wide else settings.fragment_share
    swallowed = track.covered >= max(2.0, share * in_view)
    hidden = track.area_m2 < settings.hidden_area_m2 and _apart(track) + 2 < settings.fragment_seen * in_view
    return swallowed or hidden


def _apart(track: TrackState) -> int:
    """Frames that showed it as an instance of its own, not cut by the first or last row."""
    return sum(not h.ends_cut for h in track.hits)


def class_refusal(answer: Answer | None, settings: CountSettings) -> TrackRefusal | None:
    """Why what was seen is no tuber; None where it is one, where the classifier is unsure, and without one."""
    return TrackRefusal.DISTRACTOR if answer is not None and answer.log_odds < settings.reject_below else None


def _is_double(track: TrackState, tracker: Tracker, settings: CountSettings) -> bool:
    """A counted track lies so close that both must be one tuber."""
    for other in tracker.tracks:
        if other is not track and other.state is State.COUNTED:
            radius_m = math.sqrt(max(track.area_m2, other.area_m2) / math.pi)
            away_m = math.hypot(track.place_x_m - other.place_x_m, track.place_y_m - other.place_y_m)
            if away_m < settings.same_share * radius_m:
                return True
    return False
