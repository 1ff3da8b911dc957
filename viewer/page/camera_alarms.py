"""What is wrong with one camera and its segmenter: (key, serious, text, fix) for each."""

from __future__ import annotations

from collections.abc import Iterator

from conveyor.reasons import ViewLoss
from viewer.page.state import LineState, NodeState
from viewer.page.words import FRAME_DROPS, VIEW_LOSSES, plain, span

Found = tuple[str, bool, str, str]
SILENT_S = 5.0
"""A camera that waits for its segmenter may rest for so long."""
DEAD_S = 1.8
"""A camera that waits for no one and sends nothing for so long; the slowest ones send several frames a second."""
BRIEF_S = 2.0
"""Drops that last no longer than this are a hiccup: they stand in the table, not among the alarms."""


def camera_alarms(camera: str, state: LineState) -> Iterator[Found]:
    """Everything that is wrong with `camera`; nothing once it has ended or the load is complete."""
    info = state.cameras.get(camera)
    if info is not None and info.state == "failed":
        yield (
            "failed",
            True,
            f"Camera {camera} failed: {info.error or 'it did not say why'}",
            "Fix that, then start it again.",
        )
        return
    if state.final or (info is not None and info.state == "ended"):
        return
    source, segmenter = state.role("camera").get(camera), state.role("segmenter").get(camera)
    yield from _gone(camera, source, segmenter)
    if segmenter is not None and segmenter.alive:
        yield from _belt(camera, segmenter)
        yield from _gauge(camera, segmenter)
        yield from _frames(
            camera, source, segmenter, waits=info is not None and info.waits, frame_s=_frame_s(camera, state)
        )
        yield from _views(camera, segmenter)
    if state.totals is not None and state.totals.cameras.get(camera) == "silent":
        yield (
            "given-up",
            True,
            f"The ledger goes on without camera {camera}: it has been silent for too long.",
            "What passes under it is missing from the load as seen. Start it and its segmenter again.",
        )


def _gone(camera: str, source: NodeState | None, segmenter: NodeState | None) -> Iterator[Found]:
    for role, node, fix in (
        ("Camera", source, "Look at its cable and its computer."),
        ("The segmenter of camera", segmenter, "Start it again; a live camera's frames are lost meanwhile."),
    ):
        if node is not None and node.left:
            yield f"{role[:3]}-gone", True, f"{role} {camera} stopped {span(node.away_s)} ago.", fix
        elif node is not None and node.state == "silent":
            yield f"{role[:3]}-quiet", True, f"{role} {camera} has said nothing for {span(node.age_s)}.", fix


def _belt(camera: str, segmenter: NodeState) -> Iterator[Found]:
    drift_mm = segmenter.level("belt_drift_mm")
    if drift_mm is None or not segmenter.level("belt_alarm"):
        return
    side = "further than" if drift_mm > 0 else "nearer than"
    text = f"Under camera {camera} the belt is {abs(drift_mm):.0f} mm {side} calibrated: weights are wrong."
    fix = (
        "See that the camera's mount has not moved and that no soil lies on the belt. Then measure the distance again."
    )
    yield "belt", True, text, fix


def _gauge(camera: str, segmenter: NodeState) -> Iterator[Found]:
    """Why the belt is not where it was, by the gauge: a mount that moved (1), a depth scale that drifted (2), both."""
    cause = segmenter.level("gauge_cause") or 0.0
    moved, drifted = segmenter.level("gauge_shift_mm") or 0.0, segmenter.level("gauge_drift_px") or 0.0
    beyond = bool(segmenter.level("gauge_beyond"))
    if cause in (1.0, 3.0):
        text = f"The mount of camera {camera} moved by {abs(moved):.1f} mm."
        yield "gauge-mount", False, text, "Fasten it. Then measure the belt's distance again."
    if cause in (2.0, 3.0):
        done = "too much to correct: weights are wrong" if beyond else "it is corrected"
        text = f"The depth scale of camera {camera} drifted by {drifted:+.2f} px; {done}."
        yield "gauge-drift", beyond, text, "Calibrate the camera when the line stands."


def _frame_s(camera: str, state: LineState) -> float:
    """Since the camera's last frame, where its segmenter has reported since; 0 where nothing is known of it."""
    since_s = state.frame_s.get(camera, 0.0)
    segmenter = state.role("segmenter").get(camera)
    return since_s if segmenter is not None and segmenter.age_s < since_s else 0.0


def _frames(
    camera: str, source: NodeState | None, segmenter: NodeState, *, waits: bool, frame_s: float
) -> Iterator[Found]:
    dropping = False
    for counter, seconds in sorted(segmenter.growing_s.items()):
        reason = counter.removeprefix("frames_dropped_")
        if reason == counter or seconds < BRIEF_S:
            continue
        dropping = True
        words = FRAME_DROPS.get(reason)
        if words is None:
            text = f"Frames of camera {camera} have been dropped for {span(seconds)}: {plain(reason)}."
            yield reason, True, text, "Read the segmenter's log."
        else:
            yield reason, True, f"Camera {camera} {words.now}, for {span(seconds)}.", words.fix
    lost_s = segmenter.growing_s.get("frames_gaps", 0.0)
    if lost_s >= BRIEF_S and not waits:
        yield (
            "gaps",
            True,
            f"Frames of camera {camera} have been getting lost on the way for {span(lost_s)}.",
            "Look at its cable, and at the network between camera and segmenter.",
        )
    rests_s = segmenter.resting_s.get("frames_processed", 0.0)
    dropping = dropping or any(counter.startswith("frames_dropped_") for counter in segmenter.growing_s)
    dead = not waits and frame_s > DEAD_S
    if not dropping and (dead or rests_s > SILENT_S) and source is not None and source.alive:
        still_s = source.level("waiting_for_segmenter_s")
        if still_s is not None and still_s > SILENT_S:
            text = f"Camera {camera} has waited for its segmenter for {span(still_s)}; no frame is lost."
            yield "waits", False, text, "Look at the regressors: the segmenter goes on when tubers are weighed."
        else:
            text = f"No frames have come from camera {camera} for {span(frame_s if dead else rests_s)}."
            yield "no-frames", True, text, "Look at its cable; unplug it and plug it in again."


def _views(camera: str, segmenter: NodeState) -> Iterator[Found]:
    for counter, seconds in sorted(segmenter.growing_s.items()):
        reason = counter.removeprefix("views_lost_")
        if reason in (counter, ViewLoss.NOT_CHOSEN) or seconds < BRIEF_S:  # what was not chosen is missed by no one
            continue
        words = VIEW_LOSSES.get(reason)
        if words is None:
            yield (
                f"views-{reason}",
                False,
                f"Views of camera {camera} are lost: {plain(reason)}.",
                "Read the segmenter's log.",
            )
        else:
            yield f"views-{reason}", False, f"Camera {camera} {words.now}.", words.fix
