"""Checks of where the cameras hang: two that disagree on it count what both see twice, or take two tubers for one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from conveyor.config import LineConfig
from conveyor.config_camera import at_one_place, hang_together
from conveyor.exchanged import exchanged_told
from conveyor.messages import CameraExchanged, CamerasApart
from tuberline.doctor.finding import Finding, fault, ok, warning

EXCHANGED_FIX = "`tuberline calibrate belt` and `calibrate cameras`, then a bucket or a load's ticket; or hang it back"
FIX = "has a camera moved? Record both with tubers on the belt, then `tuberline calibrate cameras RECORDING`"


def check_places(config: LineConfig) -> list[Finding]:
    """What the line's file says of its live cameras."""
    together = at_one_place(config.cameras)
    return [warning("places of cameras", hang_together(together), FIX)] if together else []


def check_exchanged(totals: Mapping[str, Any] | None) -> list[Finding]:
    """Cameras of a running line that are not those that were calibrated."""
    changes = [CameraExchanged(**told) for told in (totals or {}).get("exchanged", ())]
    return [warning(f"device of {change.camera}", exchanged_told(change), EXCHANGED_FIX) for change in changes]


def check_agreement(totals: Mapping[str, Any] | None) -> list[Finding]:
    """What the tubers of a running line say that two cameras saw."""
    found = []
    for told in (totals or {}).get("apart", ()):
        apart = CamerasApart(**told)
        check = f"places by {apart.first} and {apart.second}"
        text = f"the same tubers {apart.along_mm:+.0f} mm along the belt, {apart.across_mm:+.0f} mm across"
        if not apart.alarm:
            found.append(ok(check, f"{text} ({apart.shared} of them)"))
        elif apart.twice:
            found.append(fault(check, f"{text}: {apart.twice} of {apart.shared} counted twice", FIX))
        else:
            found.append(warning(check, f"{text}: none of {apart.shared} counted twice yet", FIX))
    return found
