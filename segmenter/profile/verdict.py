"""A camera's profile beside the range that weights were trained for: inside, better or worse, and what follows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from conveyor.camera_range import BASELINE_M, CameraRange
from segmenter.profile.profile import CameraProfile

Verdict = Literal["inside", "better", "outside", "not seen", ""]
TOLERANCE = 1.1
"""A measured figure may pass a bound by this factor: two recordings of one camera differ by as much."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One property: what was measured, what the weights were trained for, how the two compare, what follows."""

    name: str
    measured: str
    trained: str
    verdict: Verdict
    follows: str = ""


def judge(
    profile: CameraProfile, trained: CameraRange, *, belt_m: tuple[float, float] | None = None
) -> tuple[Finding, ...]:
    """A finding for each property. Pixels of disparity of another baseline stand for other depths: the trained range
    is given in the camera's own pixels.

    Args:
        belt_m: nearest and farthest belt trained for, metres; None: not asked.
    """
    return (
        *(() if belt_m is None else (_distance(profile, belt_m),)),
        _noise(profile, trained),
        _step(profile, trained),
        _neighbours(profile),
        _mid(profile, trained),
        _bow(profile, trained),
        _outlines(profile, trained),
        _missing(profile, trained),
        _islands(profile, trained),
    )


def own_px(profile: CameraProfile) -> float:
    """The camera's own pixels of disparity in one of the trained cameras': longer baselines see finer."""
    return profile.baseline_m / BASELINE_M


def _distance(profile: CameraProfile, belt_m: tuple[float, float]) -> Finding:
    name, told = "distance to the belt", f"{belt_m[0]:.2f} to {belt_m[1]:.2f} m"
    if profile.plane_m is None:
        return Finding(name, "-", told, "not seen", "no belt plane is seen")
    return Finding(
        name,
        f"{profile.plane_m:.3f} m",
        told,
        "inside" if belt_m[0] <= profile.plane_m <= belt_m[1] else "outside",
        "every weight is flagged `belt_distance`; intervals are wider for it, and not known to hold: hang the camera "
        "within that range, or calibrate by a bucket",
    )


def _noise(profile: CameraProfile, trained: CameraRange) -> Finding:
    low, high = (own_px(profile) * px for px in trained.local_px)
    name, told = "local noise", f"median {low:.3f} to {high:.3f} px"
    if profile.noise_px is None:
        return Finding(name, "-", told, "not seen", "too little smooth surface shows")
    p10, p50, p90 = profile.noise_px
    return Finding(
        name,
        f"{p50:.3f} px (10 to 90 %: {p10:.3f} to {p90:.3f})",
        told,
        _compare(p50, low, high),
        "tubers look like clods and outlines are ragged: each is flagged `camera_noise`, the load's interval widens. "
        "Raise the exposure or the light, clean the glass, hang the camera nearer",
    )


def _step(profile: CameraProfile, trained: CameraRange) -> Finding:
    name, told = "step of disparity", f"1/{trained.steps_per_px} px"
    if profile.step is None:
        return Finding(
            name, "-", told, "not seen", f"depth in units of {1000 * profile.depth_scale_m:g} mm hides it, or a filter"
        )
    steps = profile.step.steps_per_px
    verdict: Verdict = "inside" if steps == trained.steps_per_px else "better"
    return Finding(
        name,
        f"1/{steps} px",
        told,
        "outside" if steps < trained.steps_per_px else verdict,
        "skins show terraces: let the camera compute subpixels, or hang it nearer",
    )


def _neighbours(profile: CameraProfile) -> Finding:
    name, told = "step between neighbours", "-"
    if profile.neighbour_px is None:
        return Finding(name, "-", told, "not seen", "too few pixels beside each other have depth")
    p99, p999, most = profile.neighbour_px
    return Finding(name, f"99 %: {p99:.2f}, 99.9 %: {p999:.2f}, largest {most:.1f} px", told, "")


def _mid(profile: CameraProfile, trained: CameraRange) -> Finding:
    name = "error of 3 to 40 px and relief"
    if profile.field is None or profile.plane_m is None:
        return Finding(
            name, "-", f"{_span(trained.smooth_px, own_px(profile))} px", "not seen", "no belt plane is seen"
        )
    per_m = profile.focal_px * profile.baseline_m / profile.plane_m**2
    low, high = (
        float(np.hypot(own_px(profile) * px, per_m * soil_m))
        for px, soil_m in zip(trained.smooth_px, trained.soil_m, strict=True)
    )
    return Finding(
        name,
        f"{profile.field.mid_px:.3f} px ({1000 * profile.field.mid_px / per_m:.1f} mm at the plane)",
        f"{low:.3f} to {high:.3f} px with its soil",
        _compare(profile.field.mid_px, low, high),
        "soil or cleats on the belt, or a poor camera: record the belt clean and empty to tell; heights of single "
        "tubers scatter more, the load hardly",
    )


def _bow(profile: CameraProfile, trained: CameraRange) -> Finding:
    # Half of the error over 10 to 20 px also shows as slow: a smaller bow cannot be told from none.
    most = own_px(profile) * max(trained.bow_px[1], 0.5 * trained.smooth_px[1])
    name, told = "bow of the field, slower than 40 px", f"at most {most:.2f} px"
    if profile.field is None or profile.field.bow_px is None or profile.plane_m is None:
        return Finding(name, "-", told, "not seen", "too little of a belt plane is seen")
    per_m = profile.focal_px * profile.baseline_m / profile.plane_m**2
    px = profile.field.bow_px
    return Finding(
        name,
        f"{px:.3f} px ({1000 * px / per_m:.1f} mm at the plane)",
        told,
        _compare(px, 0.0, most),
        "tubers on one side of the belt read heavier than on the other, or the belt sags: calibrate the camera "
        "(RealSense self-calibration), and the load by a bucket that covers the whole width",
    )


def _outlines(profile: CameraProfile, trained: CameraRange) -> Finding:
    low, high = trained.outline_px
    name, told = "holes at outlines", f"median {low:.0f} to {high:.0f} px wide"
    if profile.outline_px is None:
        return Finding(name, "-", told, "not seen", "too few outlines show: record a loaded belt")
    p50, p90 = profile.outline_px
    return Finding(
        name,
        f"median {p50:.0f}, 90 %: {p90:.0f} px wide",
        told,
        _compare(p50, low, high),
        "the rims of tubers are lost, 3 to 4 % of a load where the weights do not know it: calibrate by a bucket",
    )


def _missing(profile: CameraProfile, trained: CameraRange) -> Finding:
    low, high = trained.missing
    return Finding(
        "pixels without depth",
        f"{profile.missing:.1%}",
        f"{low:.0%} to {high:.0%}",
        _compare(profile.missing, low, high),
        "clean the glass and light the belt evenly; wet soil and shine show no texture. Volume under holes is filled, "
        "and less certain",
    )


def _islands(profile: CameraProfile, trained: CameraRange) -> Finding:
    low, high = trained.islands
    name = "islands of mismatch"
    told = f"{low:.0f} to {high:.0f} per megapixel"
    measured = f"{profile.islands_per_frame:.1f} per frame, {profile.islands_per_megapixel:.1f} per megapixel"
    if len(profile.island_px):
        off = np.abs(profile.island_px)
        measured += f"; {np.median(off):.0f} px off, at most {off.max():.0f}"
    # A single one in all frames is chance.
    chance = 1e6 / (profile.frames * profile.width * profile.height)
    return Finding(
        name,
        measured,
        told,
        _compare(profile.islands_per_megapixel, low, high + chance),
        "phantom bodies and holes in tubers: raise the camera's speckle or second-peak threshold, or its confidence",
    )


def _compare(value: float, low: float, high: float) -> Verdict:
    if value > TOLERANCE * high + 1e-9:
        return "outside"
    return "better" if value < low / TOLERANCE else "inside"


def _span(limits: tuple[float, float], factor: float) -> str:
    return f"{factor * limits[0]:.3f} to {factor * limits[1]:.3f}"
