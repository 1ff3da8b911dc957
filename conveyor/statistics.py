"""Numbers of statistics that several packages need, once."""

from __future__ import annotations

NORMAL_90 = 1.6448536269514722
"""Half-width of a normal distribution's central 90 % interval, in standard deviations (its 95 % quantile)."""
