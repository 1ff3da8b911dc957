"""What a person may state of a belt: in a line's file, on the command line and to the Python API. From and to."""

from __future__ import annotations

BELT_DISTANCE_M = (0.05, 5.0)
"""Camera to belt along the optical axis."""
BELT_SD_MM = (0.0, 100.0)
"""How well that is known, standard deviation."""
RESTING_OFFSET_MM = (-20.0, 40.0)
"""How far undersides of tubers lie below the belt."""
RESTING_SD_MM = (0.0, 20.0)
"""How well that is known, standard deviation."""
TICKET_KG = (0.001, 200_000.0)
"""What a scale says of a load or of a part of one: from a gram to more than any trailer carries."""
SCALE_ERROR_KG = (0.0, 100_000.0)
"""Its standard deviation."""
LEAST_LEVEL_MM = 0.05
"""Of a resting level, and of how well it is known; who states less but 0 stated metres."""


def level_fault(stated_mm: float) -> str:
    """Why a height in millimetres is none that was measured; empty where it may be one."""
    if not 0 < abs(stated_mm) < LEAST_LEVEL_MM:
        return ""
    return f"less than {LEAST_LEVEL_MM} mm cannot be known; {stated_mm:g} m are {1000 * stated_mm:g} mm"
