"""Checks of the encoder of a running line: whether it tells travel, and whether the load moves as far as it says."""

from __future__ import annotations

from collections.abc import Mapping

from conveyor.config import LineConfig
from conveyor.messages import Counters
from tuberline.doctor.finding import Finding, fault, ok, warning

SILENT_S = 2.0
OFTEN = 0.01
"""Of its counts: so many are no lost power any more."""
SAME_SHARE = 0.02
"""Loads roll and slip: metres that differ by less say nothing of the encoder."""
TOO_FAR_SHARE = 0.12
"""From here on tubers count several times or not at all; the belt's own check says so (`encoder_off`)."""


def check_encoder(config: LineConfig, nodes: Mapping[str, Counters], *, alive: set[str]) -> list[Finding]:
    """What the encoder, the cameras and their segmenters say of it; nothing where the line has none."""
    settings = config.encoder
    if settings is None or not config.hears_encoder:
        return []
    heard = {name: counters for name, counters in nodes.items() if name in alive}
    found = []
    node = heard.get(f"encoder/{settings.name}")
    if node is not None and not node.gauges.get("tells"):
        found.append(_tells_nothing(node))
    for camera in config.hears_encoder:
        source, segmenter = (heard.get(f"{role}/{camera}") for role in ("camera", "segmenter"))
        silent_s = source.gauges.get("encoder_silent_s", 0.0) if source is not None else 0.0
        scale = segmenter.gauges.get("encoder_scale") if segmenter is not None else None
        if silent_s >= SILENT_S:
            text = f"camera/{camera} has heard nothing from it for {silent_s:.0f} s: the load tells the travel"
            found.append(warning("encoder", text, "look at its cable, its process and its log"))
        elif scale is not None and abs(scale - 1.0) < TOO_FAR_SHARE:
            found.append(_scale(camera, scale, settings.metres_per_pulse))
    if not found and node is not None:
        speed = node.gauges.get("belt_mps", 0.0)
        found.append(ok("encoder", f"tells travel: {node.gauges.get('travel_m', 0.0):.2f} m, {speed:.2f} m/s now"))
    return found


def _tells_nothing(node: Counters) -> Finding:
    if node.gauges.get("late"):
        text = "the run had begun without it, and goes on by the load"
        return warning("encoder", text, "begin a new run to use it: stop the line and start it again")
    if node.count("counts_odd") > node.count("counts") * OFTEN:
        text = f"its count jumps ({node.count('counts_odd')} of {node.count('counts')} times)"
        return fault("encoder", text, "encoder.metres_per_pulse is too large, or its cable picks up noise; see its log")
    if not node.count("counts"):
        text = f"no count has come from it (lost {node.count('encoder_lost')} times)"
        return fault("encoder", text, "look at its cable and power, and at encoder.source; its log says what it gave")
    return warning("encoder", "it waits for the segmenters to say where the belt is", "look again in some seconds")


def _scale(camera: str, scale: float, metres_per_pulse: float) -> Finding:
    text = f"under {camera} the load moves {scale:.3f} m for each metre that it tells"
    if abs(scale - 1.0) < SAME_SHARE:
        return ok("encoder", text)
    fix = f"set encoder.metres_per_pulse = {metres_per_pulse * scale:.6g} where every camera says the same"
    return warning("encoder", text, fix)
