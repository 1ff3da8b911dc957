"""Checks of the belt's distance: a belt that is not where its calibration says makes every weight wrong."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from statistics import median

from conveyor.belt_findings import OFF_MM, awaits_travel, belt_findings, belt_leans, belt_off
from conveyor.config import LineConfig
from conveyor.messages import Counters
from tuberline.doctor.finding import Finding, fault, ok, warning

FAR_OFF_MM = 20.0
"""From here on the segmenter refuses the camera where nothing bears it out; from `OFF_MM` on it raises its alarm."""
LEAST_FRAMES = 2
OTHER_WAY = {
    "belt_backwards": "turned_deg = 180 in the camera's section, or turn the camera; an encoder must count upwards",
    "belt_turned": "turn the camera, or `tuberline calibrate cameras RECORDING` and its turned_deg",
    "encoder_off": "look at the encoder's cable and its metres a pulse",
    "encoder_coarse_m": "an encoder with more pulses a metre, or `travel_m` of each frame to a millimetre",
    "encoder_behind_m": "begin a new run, and look at the encoder's power and cable",
    "load_torn_m": "look at the camera's pictures (`tuberline watch`), or connect an encoder",
    "masks_merged": "a label of its own for each tuber, or ignore_masks in the line's file",
    "like_clods": 'look at what lies there; method = "classical" in [segmenter] where it is tubers',
}
"""Levels of a load that moves otherwise than pose or encoder say, or counts as its masks or classifier say, and what to
do."""
SEEN_TWICE = {
    "outline_grown_px": "a smaller matching window in the camera's settings",
    "farther_than_travel": "`tuberline calibrate bucket`, and the encoder over a few metres of belt",
    "travel_not_told": 'connect the encoder ([encoder]), or gauge = "none" in [belt]',
    "picture_stood": "look at the camera's cable and hub; an encoder tells it from a belt that stands",
    "without_depth": "clean the front glass, and look at the light (`tuberline watch` shows the picture)",
}
"""Levels of what the same tubers in several frames say of a camera, or cannot say, or its picture says, and what to
do."""
SCALED = "calibrate the camera's depth when the line next stops; measure the encoder's metres a pulse with a tape"
DRIFTED = "if its depth has drifted, the belt's travel tells so while the line runs and corrects it: leave it as it is"
UNSEEN = 'correct the gauge in [belt] of the line\'s file, or keep it in view; gauge = "none" where there is none'
MOVED = "fasten or calibrate the camera, then `tuberline calibrate belt RECORDING`"
WRONG_SCALE = 3.0
"""Seen this many times too far or too near, it is no belt that moved: the depth is read in other units."""


def check_belt_seen(
    camera: str, *, given_m: float | None, seen_m: Sequence[float], frames: int, by_travel: bool = False
) -> Finding:
    """Compare the belt that a camera's frames show with the distance it is given.

    Args:
        given_m: camera to belt by the config or the recording, metres; None where neither says it.
        seen_m: of the frames in which a belt was seen; `frames` were looked at. by_travel: its gauge is the belt's
            travel, and a running line weighs tubers over a belt that its drifted depth puts elsewhere.
    """
    check = f"belt of {camera}"
    if len(seen_m) < min(LEAST_FRAMES, frames):
        return warning(
            check,
            f"too little belt shows in {frames} frames to measure its distance",
            "look again with an empty belt, or `tuberline calibrate belt` on a recording of one",
        )
    middle_m = median(seen_m)
    measured = f"seen at {middle_m:.4f} m in {len(seen_m)} of {frames} frames"
    setting = f"set cameras.{camera}.belt_distance_m = {middle_m:.4f}"
    again = "measure it with the belt empty (`tuberline calibrate belt RECORDING`)"
    if given_m is None:
        return warning(check, f"{measured}, no distance is given: each start fits it again", f"{again} and {setting}")
    off_mm = 1000 * (middle_m - given_m)
    text = f"{measured}, given {given_m:.4f} m: {off_mm:+.1f} mm"
    ratio = middle_m / given_m
    if not 1 / WRONG_SCALE < ratio < WRONG_SCALE:
        return fault(check, text, f"the depth scale is wrong: correct cameras.{camera}.depth_scale_m")
    if abs(off_mm) > FAR_OFF_MM:
        return fault(check, text, f"if the camera was moved: {again} and {setting}")
    if abs(off_mm) > OFF_MM and by_travel:
        return warning(check, text, f"{DRIFTED}; where that does not explain it, {again}")
    if abs(off_mm) > OFF_MM:
        return warning(check, text, f"{again}; if it stays so, {setting}")
    return ok(check, text)


def check_running_belts(config: LineConfig, nodes: Mapping[str, Counters], *, alive: set[str]) -> list[Finding]:
    """What the segmenters say of their belts while the line runs."""
    found: list[Finding] = []
    for camera in sorted(config.cameras):
        name = f"segmenter/{camera}"
        if name not in nodes or name not in alive:
            continue
        gauges = nodes[name].gauges
        found += _told(camera, gauges)
        if "belt_drift_mm" not in gauges:  # no belt was seen beside the load, or there is no distance to compare with
            continue
        tilt_deg = gauges.get("belt_tilt_off_deg", 0.0)
        leans = f", leaning {tilt_deg:.1f} deg" if tilt_deg else ""
        text = f"{name} sees it {gauges['belt_drift_mm']:+.1f} mm off its calibration{leans}"
        if gauges.get("belt_alarm"):
            if belt_leans(gauges) and not belt_off(gauges):
                text = f"{name} sees it leaning {tilt_deg:.1f} deg against its calibration"
            fix = "has the camera or the belt's frame moved? `tuberline calibrate belt RECORDING` of the empty belt"
            if awaits_travel(gauges):
                fix = "wait until some tubers have passed: the belt's travel tells whether its depth has drifted"
            found.append(fault(f"belt of {camera}", text, fix))
        else:
            found.append(ok(f"belt of {camera}", text))
    return found


def _told(camera: str, gauges: Mapping[str, float]) -> Iterator[Finding]:
    """What a segmenter's levels say beside where the belt is."""
    for key, text in belt_findings(camera, gauges).items():
        if key.startswith("gauge_"):
            make = fault if gauges.get("gauge_beyond") else warning
            yield make(f"gauge of {camera}", text, UNSEEN if key == "gauge_unseen" else MOVED)
        elif key in SEEN_TWICE:
            scaled = key == "farther_than_travel" and gauges.get("scaled_by_travel")
            yield warning(f"tubers of {camera}", text, SCALED if scaled else SEEN_TWICE[key])
        elif key != "belt_alarm":
            yield fault(f"belt of {camera}", text, OTHER_WAY.get(key, "it says what to do"))
    if scaled := gauges.get("scaled_by_travel"):
        size = 100 * (1 / (1 + scaled) - 1)
        yield ok(f"gauge of {camera}", f"tubers are weighed {size:+.1f} % in size, as the belt's travel says")
