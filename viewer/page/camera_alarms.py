"""What is wrong with one camera and its segmenter: (key, serious, what to say, what to do, values) for each."""

from __future__ import annotations

from collections.abc import Iterator

from conveyor.belt_findings import awaits_travel, belt_leans, belt_off
from conveyor.reasons import ViewLoss
from viewer.page.state import LineState, NodeState
from viewer.page.words import FRAME_DROPS, VIEW_LOSSES, Value, plain

Found = tuple[str, bool, str, str, dict[str, Value]]
"""The words are keys of the table of words; the camera's name is a value of each."""
TELL_OF_BELT = ("belt_drift_mm", "belt_tilt_off_deg", "scaled_by_travel", "farther_than_travel", "travel_not_told")
"""Levels of a segmenter that say what is wrong with its belt."""
SILENT_S = 5.0
"""A camera that waits for its segmenter may rest for so long."""
DEAD_S = 1.8
"""A camera that waits for no one and sends nothing for so long; the slowest ones send several frames a second."""
COUNTS_TWICE_M = 0.04
"""Steps of travel from which on tubers count twice."""
DARK_SHARE = 0.4
"""Of the picture without depth from which on as much of the load is missing, whatever the mount."""
BRIEF_S = 2.0
"""Drops that last no longer than this are a hiccup: they stand in the table, not among the alarms."""


def camera_alarms(camera: str, state: LineState) -> Iterator[Found]:
    """Everything that is wrong with `camera`; nothing once it has ended or the load is complete."""
    info = state.cameras.get(camera)
    if info is not None and info.state == "failed":
        say = "alarm.camera.failed" if info.error else "alarm.camera.failed_silently"
        yield "failed", True, say, "todo.camera.failed", {"why": info.error}
        return
    if state.final or (info is not None and info.state == "ended"):
        return
    source, segmenter = state.role("camera").get(camera), state.role("segmenter").get(camera)
    yield from _gone(source, segmenter)
    if segmenter is not None and segmenter.alive:
        yield from _belt(segmenter)
        yield from _belt_way(segmenter)
        yield from _gauge(segmenter)
        yield from _tubers(segmenter)
        waits = info is not None and info.waits
        yield from _encoder(source, segmenter)
        yield from _frames(source, segmenter, waits=waits, frame_s=_frame_s(camera, state))
        yield from _views(segmenter)
    if state.totals is not None and state.totals.cameras.get(camera) == "silent":
        yield "given-up", True, "alarm.camera.given_up", "todo.camera.given_up", {}


def _gone(source: NodeState | None, segmenter: NodeState | None) -> Iterator[Found]:
    for role, node in (("camera", source), ("segmenter", segmenter)):
        if node is not None and node.left:
            yield f"{role}-gone", True, f"alarm.{role}.gone", f"todo.{role}.gone", {"for": node.away_s}
        elif node is not None and node.state == "silent":
            yield f"{role}-quiet", True, f"alarm.{role}.quiet", f"todo.{role}.gone", {"for": node.age_s}


def _belt(segmenter: NodeState) -> Iterator[Found]:
    drift_mm = segmenter.level("belt_drift_mm")
    if drift_mm is None or not segmenter.level("belt_alarm"):
        return
    levels = {name: level for name in TELL_OF_BELT if (level := segmenter.level(name)) is not None}
    if belt_leans(levels) and not belt_off(levels):
        deg = levels["belt_tilt_off_deg"]
        yield "belt", True, "alarm.camera.belt_leans", "todo.camera.belt_leans", {"deg": deg}
        return
    say = "alarm.camera.belt_further" if drift_mm > 0 else "alarm.camera.belt_nearer"
    todo = "todo.camera.belt_awaits" if awaits_travel(levels) else "todo.camera.belt"
    yield "belt", True, say, todo, {"mm": round(abs(drift_mm))}


def _belt_way(segmenter: NodeState) -> Iterator[Found]:
    """The load moves otherwise than the camera's pose or the encoder says."""
    if segmenter.level("belt_backwards"):
        yield "backwards", True, "alarm.camera.backwards", "todo.camera.backwards", {}
    if segmenter.level("belt_turned"):
        deg = abs(segmenter.level("belt_turned_deg") or 0.0)
        yield "turned", True, "alarm.camera.turned", "todo.camera.turned", {"deg": deg}
    if segmenter.level("encoder_off"):
        told, seen = segmenter.level("encoder_told_m") or 0.0, segmenter.level("encoder_seen_m") or 0.0
        yield "encoder", True, "alarm.camera.encoder", "todo.camera.encoder", {"told": told, "seen": seen}
    if torn_m := segmenter.level("load_torn_m"):
        yield "torn", True, "alarm.camera.torn", "todo.camera.torn", {"m": torn_m}
    if coarse_m := segmenter.level("encoder_coarse_m"):
        say, todo = "alarm.camera.encoder_coarse", "todo.camera.encoder_coarse"
        yield "encoder-coarse", coarse_m >= COUNTS_TWICE_M, say, todo, {"mm": 1000 * coarse_m}


def _tubers(segmenter: NodeState) -> Iterator[Found]:
    """What its tubers say of the camera: masks that merge them, outlines and distances that are off."""
    if segmenter.level("masks_merged"):
        yield "masks-merged", True, "alarm.camera.masks_merged", "todo.camera.masks_merged", {}
    if share := segmenter.level("without_depth"):
        say, todo = "alarm.camera.without_depth", "todo.camera.without_depth"
        yield "without-depth", share >= DARK_SHARE, say, todo, {"percent": 100 * share}
    if stood := segmenter.level("picture_stood"):
        yield "picture-stood", False, "alarm.camera.picture_stood", "todo.camera.picture_stood", {"n": stood}
    if like := segmenter.level("like_clods"):
        yield "like-clods", True, "alarm.camera.like_clods", "todo.camera.like_clods", {"percent": 100 * like}
    if grown_px := segmenter.level("outline_grown_px"):
        yield "outline", False, "alarm.camera.outline_grown", "todo.camera.outline_grown", {"px": grown_px}
    if farther := segmenter.level("farther_than_travel"):
        say, todo = "alarm.camera.farther" if farther > 0 else "alarm.camera.nearer", "todo.camera.farther"
        if segmenter.level("scaled_by_travel"):
            say, todo = "alarm.camera.scaled", "todo.camera.scaled"
        yield "farther", False, say, todo, {"percent": 100 * abs(farther)}
    if segmenter.level("travel_not_told"):
        yield "travel-not-told", False, "alarm.camera.travel_not_told", "todo.camera.travel_not_told", {}


def _encoder(source: NodeState | None, segmenter: NodeState) -> Iterator[Found]:
    """The line's encoder does not tell this camera where the belt is."""
    silent_s = source.level("encoder_silent_s") if source is not None and source.alive else None
    if silent_s is not None and silent_s >= SILENT_S:
        say, todo = "alarm.camera.encoder_silent", "todo.camera.encoder_silent"
        yield "encoder-silent", False, say, todo, {"for": silent_s}
    if behind_m := segmenter.level("encoder_behind_m"):
        yield "encoder-behind", False, "alarm.camera.encoder_behind", "todo.camera.encoder_behind", {"m": behind_m}


def _gauge(segmenter: NodeState) -> Iterator[Found]:
    """Why the belt is not where it was, by the gauge: a mount that moved (1), a depth scale that drifted (2), both;
    or that no gauge was seen."""
    if segmenter.level("gauge_unseen"):
        yield "gauge-unseen", False, "alarm.camera.gauge_unseen", "todo.camera.gauge_unseen", {}
    cause = segmenter.level("gauge_cause") or 0.0
    moved, drifted = segmenter.level("gauge_shift_mm") or 0.0, segmenter.level("gauge_drift_px") or 0.0
    beyond = bool(segmenter.level("gauge_beyond"))
    if cause in (1.0, 3.0):
        yield "gauge-mount", False, "alarm.camera.mount", "todo.camera.mount", {"mm": abs(moved)}
    if cause in (2.0, 3.0):
        say = "alarm.camera.drift_beyond" if beyond else "alarm.camera.drift"
        yield "gauge-drift", beyond, say, "todo.camera.drift", {"px": drifted}


def _frame_s(camera: str, state: LineState) -> float:
    """Since the camera's last frame, where its segmenter has reported since, and as long as that has been there to see
    one; 0 where nothing is known of it.
    """
    since_s = state.frame_s.get(camera, 0.0)
    segmenter = state.role("segmenter").get(camera)
    if segmenter is None or segmenter.report is None or segmenter.age_s >= since_s:
        return 0.0
    return min(since_s, segmenter.report.uptime_s + segmenter.age_s)


def _frames(source: NodeState | None, segmenter: NodeState, *, waits: bool, frame_s: float) -> Iterator[Found]:
    for counter, seconds in sorted(segmenter.growing_s.items()):
        reason = counter.removeprefix("frames_dropped_")
        if reason == counter or seconds < BRIEF_S:
            continue
        if reason in FRAME_DROPS:
            yield reason, True, f"drop.{reason}.now", f"drop.{reason}.todo", {"for": seconds}
        else:
            values: dict[str, Value] = {"for": seconds, "why": plain(reason)}
            yield reason, True, "alarm.camera.dropping", "todo.segmenter_log", values
    lost_s = segmenter.growing_s.get("frames_gaps", 0.0)
    if lost_s >= BRIEF_S and not waits:
        yield "gaps", True, "alarm.camera.gaps", "todo.camera.gaps", {"for": lost_s}
    yield from _no_frames(source, segmenter, dead_s=0.0 if waits else frame_s)


def _no_frames(source: NodeState | None, segmenter: NodeState, *, dead_s: float) -> Iterator[Found]:
    """A camera that lives and sends nothing, or waits."""
    if any(counter.startswith("frames_dropped_") for counter in segmenter.growing_s):
        return
    rests_s = segmenter.resting_s.get("frames_processed", 0.0)
    dead = dead_s > DEAD_S
    if not (dead or rests_s > SILENT_S) or source is None or not source.alive:
        return
    still_s = source.level("waiting_for_segmenter_s")
    if still_s is not None and still_s > SILENT_S:
        yield "waits", False, "alarm.camera.waits", "todo.camera.waits", {"for": still_s}
    else:
        values: dict[str, Value] = {"for": dead_s if dead else rests_s}
        yield "no-frames", True, "alarm.camera.no_frames", "todo.camera.no_frames", values


def _views(segmenter: NodeState) -> Iterator[Found]:
    for counter, seconds in sorted(segmenter.growing_s.items()):
        reason = counter.removeprefix("views_lost_")
        if reason in (counter, ViewLoss.NOT_CHOSEN) or seconds < BRIEF_S:  # what was not chosen is missed by no one
            continue
        if reason in VIEW_LOSSES:
            yield f"views-{reason}", False, f"lost.{reason}.now", f"lost.{reason}.todo", {}
        else:
            yield f"views-{reason}", False, "alarm.camera.losing", "todo.segmenter_log", {"why": plain(reason)}
