"""Which tubers lie on others, and how high: by how a tuber's rim looks, and by whether those around it look like that.

One tuber alone may stand on end and look like one that lies on others. On a belt in more than one layer many do, side
by side. So a tuber's own evidence and that of those around it count together, and a belt in one layer stays as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from segmenter.frame.heights import HeightMap
from segmenter.frame.instances import Instances
from segmenter.frame.rims import RIM_HEIGHTS, rim_heights

# Fitted by logistic and linear regression to 57 simulated belts of 60 tubers, seeds 7101 to 7326: a third in one layer,
# the others with 10 to 60 % of the tubers dropped onto those that lie already. Judged on others (docs/layers.md).
FEATURES = (*RIM_HEIGHTS, "top", "contact")
"""What the evidence is linear in: heights in millimetres, and the share of the outline that touches another."""
WEIGHTS = (-0.0452, 0.0788, 0.0220, -0.0079, -0.0456, -0.0305, 0.0485, 10.9757)
CONSTANT = -13.118
"""Log-odds of lying on others against standing on the belt, as many of each as in those belts."""
SUPPORT_WEIGHTS = (0.0223, 0.1955, 0.4170, 0.1430, 0.1793, 0.0696, -0.1112, -26.3384)
SUPPORT_CONSTANT = 7.64
"""Height of what a tuber on others lies on, millimetres, linear in the same."""
SUPPORT_SD_M = 0.007
"""How far that is off, standard deviation."""
AROUND_M, LEAST_AROUND = 0.25, 4
"""Tubers this near along the belt are around one; with fewer than so many around none lies on others."""
AROUND_WEIGHT = 6.0
"""Log-odds that are added where all around lie on others. More finds more on heaps, and more of their lower tubers."""
BELT_WEIGHT, USUAL_SHARE = 8.0, 0.10
"""The same for the belt so far, beyond the share that belts in one layer seem to have (0.10 at most, on `harsh`)."""
NEEDED = 3.5
"""Log-odds from which a tuber is taken to lie on others. At 3.0 of 1680 tubers on belts in one layer 4 are, at 3.5 one,
at 4.5 none; of those that do lie on others 70, 64 and 52 %."""
LEAST_BELT = 20
"""Tubers of a belt that say something of it."""
LEAST_M = 0.008
MOST_OF_TOP = 0.65
"""Lowest height to lie on, and the highest as a share of the tuber's top."""
KEPT = 9
"""Readings per tuber: errors are shared by them."""


def rim_of(instances: Instances, index: int, heights: HeightMap) -> NDArray[np.float64]:
    """(8,) `FEATURES` of instance `index` of a frame; a ring without cells counts as belt."""
    rim_mm = rim_heights(instances.labels, heights.height_mm, index + 1, instances.box[index], heights.cell_mm)
    reading = np.empty(len(FEATURES))
    reading[:-2] = np.where(np.isnan(rim_mm), 0.0, rim_mm)
    reading[-2:] = 1000 * float(instances.height_m[index]), float(instances.contact[index])
    return reading


def evidence(readings: Sequence[NDArray[np.float64]]) -> float | None:
    """Log-odds of one tuber from its (8,) readings; None without any."""
    if not readings:
        return None
    return CONSTANT + float(_usual(readings) @ np.array(WEIGHTS))


def _usual(readings: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """(8,) medians of a tuber's readings: as `np.median`, without what that does around it."""
    ordered = np.sort(np.array(readings), axis=0)
    half = len(ordered) // 2
    usual: NDArray[np.float64] = ordered[half] if len(ordered) % 2 else (ordered[half - 1] + ordered[half]) / 2
    return usual


@dataclass(slots=True)
class BeltLayers:
    """What the tubers of one camera's belt so far said of its layers."""

    tubers: int = 0
    probable: float = 0.0

    def learn(self, said: float) -> None:
        """Take the evidence of one more tuber, counted."""
        self.tubers += 1
        self.probable += float(_probability(np.array(said)))

    @property
    def share(self) -> float:
        """Of the tubers, beyond what belts in one layer seem to have; 0 while too few were seen."""
        return max(0.0, self.probable / self.tubers - USUAL_SHARE) if self.tubers >= LEAST_BELT else 0.0

    def support_m(self, own: Sequence[NDArray[np.float64]], around: Sequence[float]) -> float:
        """How high the underside of a tuber lies on others, metres; 0 where it lies on the belt.

        Args:
            own: its (8,) readings.
            around: evidence of the tubers around it.
        """
        said = evidence(own)
        if said is None or len(around) < LEAST_AROUND:
            return 0.0
        shared = AROUND_WEIGHT * float(_probability(np.array(around)).mean()) + BELT_WEIGHT * self.share
        return _height_m(own) if said + shared >= NEEDED else 0.0


def _probability(log_odds: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(log_odds, -30.0, 30.0))))


def _height_m(own: Sequence[NDArray[np.float64]]) -> float:
    usual = _usual(own)
    high_m = (SUPPORT_CONSTANT + float(usual @ np.array(SUPPORT_WEIGHTS))) / 1000
    top_m = float(usual[FEATURES.index("top")]) / 1000
    return float(np.clip(high_m, LEAST_M, max(LEAST_M, MOST_OF_TOP * top_m)))
