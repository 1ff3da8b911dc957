"""What all tubers of a load share and no one knows before a ticket: one set of figures for ledger and evaluation."""

from __future__ import annotations

import math

OFFSET_SD_MM = 4.0
"""Of the resting offset where nothing is stated. Belts from -2 to +8 mm are real (one tuber measured: 5 to 9); their
root mean square about a stated 0 is 4.2 mm. 3 mm would hold 75 % of them in its 90 % interval."""

DENSITY_SD = 0.025
"""Of density, and of what weights misjudge in all tubers of a load."""

SCALE_SD = 0.017
"""Of the depth scale: within 1 % of the true one, evenly, and 3 % of a volume for each per cent."""

DRIFT_SD = 0.022
"""Of disparity that has drifted since the camera was made: 2 mm of belt distance (users report 4 mm between morning and
afternoon), 1.1 % of a volume for each."""

GAUGED_DRIFT_SD = 0.007
"""The same where rods of a known pitch are in view: their distance is known to some 0.6 mm (docs/cameras.md). A gauge
that only tells what changed since the run began leaves the drift before it."""

FACTOR_SD = math.hypot(DENSITY_SD, SCALE_SD, DRIFT_SD)
"""Of all that multiplies a load's weight: 3.8 %."""

UNGAUGED_SD = math.sqrt(DRIFT_SD**2 - GAUGED_DRIFT_SD**2)
"""Beside that of a line whose rods are its gauge, of the tubers for which they were looked for in vain."""

OTHER_CAMERA_SD = 0.05
"""The same beside that for a camera unlike a good one, by its noise and holes: 4.9 % in 161 recordings of `harsh`
(`regressor.training.calibration.load_shares`): their scale, their drift, and the soil under which half of these tubers
lie."""

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


def factor_sd(*, gauged: bool) -> float:
    """Of all that multiplies a load's weight; `gauged`: a gauge says how far the belt is, see `GAUGED_DRIFT_SD`."""
    return math.hypot(DENSITY_SD, SCALE_SD, GAUGED_DRIFT_SD) if gauged else FACTOR_SD


def shared_sd_share(offset_sd_mm: float, *, other_share: float = 0.0) -> float:
    """Of a load's weight before any ticket, as a share of it: standard deviation of what its tubers share.

    `other_share`: of it, seen by cameras unlike good ones.
    """
    return math.hypot(
        SHARE_PER_MM * offset_sd_mm, FACTOR_SD, CULTIVAR_SD, load_sd_share(), OTHER_CAMERA_SD * other_share
    )
