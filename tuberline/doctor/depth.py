"""Checks of what a camera's depth is like, against the cameras that the line's weights were trained for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from conveyor.camera_range import CameraRange, camera_range
from conveyor.config import LineConfig
from conveyor.errors import TuberlineError
from conveyor.messages import Counters, Frame
from tuberline.doctor.finding import Finding, ok, warning

MEASURE = "measure it on a recording of a minute: `tuberline camera profile RECORDING --out PICTURE.png`"


def trained_range(config: LineConfig) -> CameraRange:
    """Of the weights that the line is configured with; of `easy` and `field` where they cannot be read."""
    from regressor.network.stored import SHIPPED, read_weights

    try:
        return camera_range(read_weights(config.regressor.weights or SHIPPED)[1].worlds)
    except TuberlineError:  # a finding of its own, see `weights`
        return camera_range(())


def check_depth(camera: str, frames: Sequence[Frame], trained: CameraRange) -> Finding:
    """What a few frames show of the camera, beside what the weights were trained for."""
    from segmenter.profile.profile import profile_frames
    from segmenter.profile.verdict import judge

    check = f"depth of {camera}"
    if not any(frame.depth.any() for frame in frames):
        return warning(check, f"none of {len(frames)} frames has depth", "is the lens covered, or too near the belt?")
    findings = judge(profile_frames(frames), trained)
    outside = [finding for finding in findings if finding.verdict == "outside"]
    if outside:
        text = "; ".join(f"{f.name} {f.measured}, weights were trained for {f.trained}" for f in outside)
        return warning(check, text, f"intervals are wider, or too narrow: {MEASURE}")
    noise = next(finding for finding in findings if finding.name == "local noise")
    return ok(check, f"like those that the weights were trained for: local noise {noise.measured}")


def check_running_noise(
    config: LineConfig, nodes: Mapping[str, Counters], trained: CameraRange, *, alive: set[str]
) -> list[Finding]:
    """The noise that segmenters measure while the line runs."""
    found = []
    for camera in sorted(config.cameras):
        name = f"segmenter/{camera}"
        noise_px = nodes[name].gauges.get("camera_noise_px") if name in nodes and name in alive else None
        if trained.noisier(noise_px):
            text = f"{name} measures {noise_px:.3f} px of noise, weights were trained for {trained.local_px[1]:.3f} px"
            found.append(
                warning(f"depth of {camera}", text, f"tubers are flagged and the load's interval is wider: {MEASURE}")
            )
    return found
