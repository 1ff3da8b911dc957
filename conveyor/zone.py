"""The zone of a time of day: who reads one at a distance may live in another zone than the line."""

from __future__ import annotations

import time


def zone_told(offset_s: float) -> str:
    """'UTC', 'UTC+2' or 'UTC-3:30': by how much clocks are ahead of UTC."""
    if not round(offset_s / 60):
        return "UTC"
    hours, minutes = divmod(round(abs(offset_s) / 60), 60)
    return f"UTC{'-' if offset_s < 0 else '+'}{hours}{f':{minutes:02d}' if minutes else ''}"


def local_clock(unix_s: float, form: str) -> tuple[str, str]:
    """(the time `unix_s` by this computer's clock, as `form` of strftime says; the zone that this is of)."""
    local = time.localtime(unix_s)
    return time.strftime(form, local), zone_told(local.tm_gmtoff)
