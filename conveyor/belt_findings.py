"""What a segmenter's levels say of its belt, in words, and how to fix it."""

from __future__ import annotations

from collections.abc import Mapping

OFF_MM = 6.0
"""Farther from where it is given the belt seen is an alarm."""
LEANS_DEG = 1.0
"""So many degrees between the belt seen and the belt given are one."""
TAKEN_BACK = ("outline_grown_px", "farther_than_travel", "travel_not_told", "gauge_unseen")
"""Findings of what was seen so far: a few tubers say too much, and more of them put it right."""


def belt_findings(camera: str, gauges: Mapping[str, float]) -> dict[str, str]:
    """Findings about one camera's belt by the level that says so; empty where all is well.

    Args:
        camera: its name.
        gauges: levels of its segmenter: belt_alarm, belt_drift_mm, belt_tilt_off_deg, belt_backwards, belt_turned,
            belt_turned_deg, encoder_off, encoder_told_m, encoder_seen_m, encoder_coarse_m, encoder_behind_m,
            load_torn_m, masks_merged, without_depth, picture_stood, like_clods, outline_grown_px,
            farther_than_travel, scaled_by_travel, travel_not_told, and those of its gauge.
    """
    found = {}
    if gauges.get("belt_alarm"):
        fix = "belt_from_camera" if belt_leans(gauges) else "belt_distance_m or belt_from_camera"
        then = _WAIT if awaits_travel(gauges) else _MEASURE.format(fix=fix)
        found["belt_alarm"] = f"camera '{camera}': the belt {_where_seen(gauges)}: counts and {then}"
    if gauges.get("belt_backwards"):
        found["belt_backwards"] = (
            f"camera '{camera}': the belt runs against the direction that the camera's pose or the encoder says, so "
            "tubers do not cross as expected. Set turned_deg = 180 for it in the line's file (`tuberline calibrate "
            "cameras` measures it), or give a belt_from_camera whose x points along the travel: negate its first two "
            "rows (instead of null: [[0,-1,0,0],[-1,0,0,0],[0,0,-1,H],[0,0,0,1]], H the belt distance in metres); an "
            "encoder must count upwards"
        )
    if gauges.get("belt_turned"):
        found["belt_turned"] = (
            f"camera '{camera}': the load moves {gauges.get('belt_turned_deg', 0.0):+.1f} degrees aside of the way "
            "that the camera's pose says: from 9 degrees on tubers are counted several times. Turn the camera, or "
            "correct its turned_deg in the line's file (`tuberline calibrate cameras RECORDING` measures it)"
        )
    if gauges.get("encoder_off"):
        told_m, seen_m = gauges.get("encoder_told_m", 0.0), gauges.get("encoder_seen_m", 0.0)
        found["encoder_off"] = (
            f"camera '{camera}': the load moved {seen_m:.2f} m while the encoder told {told_m:.2f} m: tubers are "
            f"counted several times or not at all. Correct the encoder: {_factor(told_m, seen_m)}its cable (travel_m "
            "of a recording is in metres); or leave it out, and travel is taken from the frames"
        )
    if coarse_m := gauges.get("encoder_coarse_m"):
        found["encoder_coarse_m"] = (
            f"camera '{camera}': travel is told in steps of {1000 * coarse_m:.0f} mm, and stands still between them "
            "while the load moves: from 40 mm on tubers count twice. Give travel_m of each frame to a millimetre; or "
            "leave it out, and travel is taken from the frames"
        )
    if behind_m := gauges.get("encoder_behind_m"):
        found["encoder_behind_m"] = (
            f"camera '{camera}': the encoder came back {behind_m:.2f} m behind where the load had gone, so it counts "
            "from another zero: the load alone tells the travel until the next run. Start a new run to use it again"
        )
    if torn_m := gauges.get("load_torn_m"):
        found["load_torn_m"] = (
            f"camera '{camera}': the load jumped back {torn_m:.2f} m in all, from one frame to the next, as no belt "
            "does: pictures are out of order, or not all of this belt. Tubers may be missing, or counted twice, and so "
            "much belt counts as not seen. Look at the pictures (`tuberline watch`); an encoder tells travel without "
            "them"
        )
    found |= _picture(camera, gauges)
    found |= _seen_twice(camera, gauges)
    if gauges.get("gauge_unseen"):
        found["gauge_unseen"] = (
            f"camera '{camera}': the gauge of [belt] has not been seen once, so a depth scale that drifts goes unseen. "
            "Compare what [belt] says of it with the belt (rod_pitch_mm, gauge_width_m, gauge_size_mm, "
            "gauge_place_mm), keep it in view, and give the camera a belt_distance_m or a belt_from_camera"
        )
    cause = _CAUSES.get(gauges.get("gauge_cause", 0.0))
    if cause is not None:
        found["gauge_" + cause] = _gauge_finding(camera, cause, gauges)
    return found


def found_so_far(before: Mapping[str, str], now: Mapping[str, str]) -> dict[str, str]:
    """The findings of a camera up to now: those of before stay said, but for what more tubers took back."""
    return {key: text for key, text in before.items() if key not in TAKEN_BACK} | dict(now)


def belt_off(gauges: Mapping[str, float]) -> bool:
    """The belt seen lies farther from where it is given than calibration and wear explain."""
    return abs(gauges.get("belt_drift_mm", 0.0)) > OFF_MM


def belt_leans(gauges: Mapping[str, float]) -> bool:
    """The belt seen leans against the one given by more than calibration explains."""
    return gauges.get("belt_tilt_off_deg", 0.0) > LEANS_DEG


def _where_seen(gauges: Mapping[str, float]) -> str:
    """What is wrong with a belt, and only that: how far off it lies, how much it leans, or both."""
    drift_mm, leaning = gauges.get("belt_drift_mm", 0.0), f"{gauges.get('belt_tilt_off_deg', 0.0):.1f} degrees"
    if belt_leans(gauges) and not belt_off(gauges):
        return f"is seen to lean {leaning} against its calibration"
    where = f"is seen {abs(drift_mm):.1f} mm {'farther' if drift_mm > 0 else 'nearer'} than its calibration says"
    return f"{where}, and leans {leaning} against it" if belt_leans(gauges) else where


def awaits_travel(gauges: Mapping[str, float]) -> bool:
    """Whether the belt's travel is the camera's gauge and cannot say yet whether its depth has drifted: too few tubers
    were seen from two sides.
    """
    by_travel = "scaled_by_travel" in gauges and not gauges.get("travel_not_told")
    return by_travel and "farther_than_travel" not in gauges


def _picture(camera: str, gauges: Mapping[str, float]) -> dict[str, str]:
    """What the pictures say, and what is made of them: masks that merge tubers, no depth, clods beyond belief."""
    found = {}
    if merged := gauges.get("masks_merged"):
        found["masks_merged"] = (
            f"camera '{camera}': in {merged:.0f} frames a label of the given masks lies in several places apart, so "
            "tubers are taken for one, or do not count. Give each tuber a label of its own (1, 2, 3, ..., not 255 to "
            "all), or have them found on depth (`replay --ignore-masks`, or ignore_masks in a line's file)"
        )
    if share := gauges.get("without_depth"):
        found["without_depth"] = (
            f"camera '{camera}': {100 * share:.0f} % of its picture shows no depth. Tubers there are missing, cut or "
            "read light, and their belt counts as looked at all the same. Clean the front glass, and look at the "
            "light; where no belt is there, turn the camera to it"
        )
    if stood := gauges.get("picture_stood"):
        found["picture_stood"] = (
            f"camera '{camera}': {stood:.0f} frames in a row are one picture, bit for bit. If the belt ran, the camera "
            "froze, tubers are missing, and their belt counts as looked at all the same: look at its cable and hub. An "
            "encoder tells a frozen camera from a belt that stands"
        )
    if like := gauges.get("like_clods"):
        found["like_clods"] = (
            f"camera '{camera}': {100 * like:.0f} % of the last bodies look like clods, more than the classifier can "
            "be right about: from here on all are counted as tubers, and what was refused before may have been tubers. "
            "Look at what was found (`tuberline segment RECORDING --picture found.png`): where it is tubers, set "
            'method = "classical" in [segmenter], which refuses nothing; where it is clods, do not trust this count'
        )
    return found


def _seen_twice(camera: str, gauges: Mapping[str, float]) -> dict[str, str]:
    """What the same tubers in several frames say of the camera."""
    found = {}
    if grown_px := gauges.get("outline_grown_px"):
        found["outline_grown_px"] = (
            f"camera '{camera}': outlines are {grown_px:.1f} px larger all round than the tubers are, as other frames "
            "show them. Views are cut back by so much before they are weighed; those before this was known read heavy. "
            "A smaller matching window in the camera's settings keeps outlines where they are"
        )
    if gauges.get("travel_not_told"):
        found["travel_not_told"] = (
            f"camera '{camera}': its gauge is the belt's travel, and no encoder tells that, so a depth scale that is "
            'off goes unseen. Connect the encoder ([encoder] in the line\'s file), or set gauge = "none" in [belt]'
        )
    if farther := gauges.get("farther_than_travel"):
        seen = (
            f"camera '{camera}': it puts tubers {100 * abs(farther):.1f} % {'farther' if farther > 0 else 'nearer'} "
            "than the belt's travel says"
        )
        scaled = gauges.get("scaled_by_travel")
        found["farther_than_travel"] = seen + (_SCALED if scaled else _DEPTH_OR_ENCODER)
    return found


_MEASURE = "weights are off. Measure the belt (`tuberline calibrate belt RECORDING`), then give its {fix}"
_WAIT = (
    "weights are off, or its depth has drifted. Its gauge, the belt's travel, tells that once some tubers have passed: "
    "wait for it. Where it explains where the belt is seen that is said here; else measure the belt (`tuberline "
    "calibrate belt RECORDING`)"
)
_SCALED = (
    ", which is its gauge: tubers are weighed at the size that agrees with it. Calibrate the camera's depth when the "
    "line next stops; if it is the encoder that is off, weights are wrong by three times as much"
)
_DEPTH_OR_ENCODER = (
    ". Either its depth has drifted, and weights are off by two to three times as much, or the encoder's metres a "
    "pulse are off: weigh one bucket (`tuberline calibrate bucket`), and measure the encoder over a few metres of belt"
)


def _factor(told_m: float, seen_m: float) -> str:
    """What its metres a pulse must be multiplied by; nothing where it stands still."""
    return f"multiply its metres_per_pulse by {seen_m / told_m:.3f}, or look at " if told_m else "look at "


_CAUSES = {1.0: "mount", 2.0: "drift", 3.0: "both"}


def _gauge_finding(camera: str, cause: str, gauges: Mapping[str, float]) -> str:
    """What the gauge says, and what was done about it."""
    moved, drifted = gauges.get("gauge_shift_mm", 0.0), gauges.get("gauge_drift_px", 0.0)
    away = "away from the belt" if moved > 0 else "towards the belt"
    mount = f"the mount moved by {abs(moved):.1f} mm, {away}"
    drift = f"the depth scale drifted by {drifted:+.2f} px of disparity"
    told = {"mount": mount, "drift": drift, "both": f"{mount}, and {drift}"}[cause]
    if gauges.get("gauge_beyond") or gauges.get("belt_alarm"):
        return (
            f"camera '{camera}': {told}: more than is corrected, so weights are off. Fasten or calibrate the camera, "
            "then measure the belt (`tuberline calibrate belt RECORDING`)"
        )
    return f"camera '{camera}': {told}; corrected. Calibrate the camera when the line next stops"
