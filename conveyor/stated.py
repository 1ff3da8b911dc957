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
