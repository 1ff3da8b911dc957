"""Is what was measured of a belt good enough to be used? Limits, and what to do where they are passed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from conveyor.formats.inspection import FARTHEST_M, NEAREST_M
from segmenter.calibrate import BeltCalibration
from segmenter.frame.constants import HOLES_TOLD


@dataclass(frozen=True, slots=True)
class Limit:
    """One measure: up to `fine` it is good, beyond `most` it is no calibration at all, in `unit`."""

    name: str
    unit: str
    fine: float
    most: float
    value: Callable[[BeltCalibration], float]
    fix: str


LIMITS = (
    Limit("spread", "mm", 0.5, 8.0, lambda c: c.spread_mm, "hold the camera still; record an empty belt"),
    Limit("tilt", "deg", 1.0, 25.0, lambda c: c.tilt_deg, "let the camera look straight down, or use belt_from_camera"),
    Limit("residual", "mm", 3.0, 25.0, lambda c: c.residual_mm, "record an empty belt; clean the lens"),
    Limit("image without belt", "%", 70.0, 95.0, lambda c: 100 * (1 - c.belt_share), "let the belt fill the image"),
    Limit(
        "image without depth",
        "%",
        100 * HOLES_TOLD,
        95.0,
        lambda c: 100 * c.without_depth,
        "clean the front glass, and look at the light",
    ),
    Limit(
        "frames without belt", "%", 20.0, 70.0, lambda c: 100 * (1 - c.frames / c.asked), "record a belt in full view"
    ),
    Limit(
        "off what is given",
        "mm",
        3.0,
        80.0,
        lambda c: abs(c.disagreement_mm or 0.0),
        "measure the distance with a ruler, then correct belt_distance_m",
    ),
)


@dataclass(frozen=True, slots=True)
class Verdict:
    """`word`: good, usable (with what `findings` say) or refused."""

    word: Literal["good", "usable", "refused"]
    findings: tuple[str, ...]


def verdict(calibration: BeltCalibration) -> Verdict:
    """Each measure against its limits, and the distance against where cameras hang."""
    refused, doubted = [], []
    distance_m = calibration.belt_distance_m
    if not NEAREST_M <= distance_m <= FARTHEST_M:
        refused.append(
            f"the plane lies {distance_m:.3g} m away, and cameras hang {NEAREST_M:g} to {FARTHEST_M:g} m over belts: "
            "check the depth unit (`tuberline info`), or record the belt"
        )
    for limit in LIMITS:
        value = limit.value(calibration)
        text = f"{limit.name} {value:.3g} {limit.unit}"
        if value > limit.most:
            refused.append(f"{text}, more than {limit.most:g} is no calibration: {limit.fix}")
        elif value > limit.fine:
            doubted.append(f"{text}, good is up to {limit.fine:g}: {limit.fix}")
    return Verdict("refused" if refused else "usable" if doubted else "good", (*refused, *doubted))
