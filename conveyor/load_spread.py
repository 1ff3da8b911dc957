"""What all tubers of a load share and no one knows before a ticket: one set of figures for ledger and evaluation."""

from __future__ import annotations

import math

OFFSET_SD_MM = 4.0
"""Of the resting offset where nothing is stated. Belts from -2 to +8 mm are real (one tuber measured: 5 to 9); their
root mean square about a stated 0 is 4.2 mm. 3 mm would hold 75 % of them in its 90 % interval."""

FACTOR_SD = 0.03
"""Of density, depth scale within 1 % (3 % of a volume at most) and what weights misjudge in all tubers."""

CULTIVAR_SD = 0.02
"""Of a cultivar's own shape and density beyond that (median densities of three cultivars span 2.4 %)."""

LOAD_SDS = (0.004, 0.008, 0.013, 0.020, 0.030)
LOAD_SD_CHANCES = (0.05, 0.15, 0.25, 0.35, 0.20)
"""What differs from load to load, as a share, and how likely each is before any ticket: root mean square 1.9 %, so that
intervals also hold for loads that differ by 1.5 %. An assumption, for no ticket of a real load was at hand."""

SHARE_PER_MM = 0.020
"""What a millimetre of offset is worth, as a share of a load's weight, where no outlines are known: simulated loads
lost 1.9 and 2.0 % of their true weight per millimetre."""


def load_sd_share() -> float:
    """What differs from load to load, root mean square before any ticket, as a share."""
    pairs = zip(LOAD_SDS, LOAD_SD_CHANCES, strict=True)
    return math.sqrt(sum(chance * sd**2 for sd, chance in pairs))


def shared_sd_share(offset_sd_mm: float) -> float:
    """Of a load's weight before any ticket, as a share of it: standard deviation of what its tubers share."""
    return math.hypot(SHARE_PER_MM * offset_sd_mm, FACTOR_SD, CULTIVAR_SD, load_sd_share())
