"""What a millimetre of resting level is worth on a tuber's weight, from its own size."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from conveyor.messages import Tuber

DENSITY_G_PER_MM3 = 1.07e-3
"""Of 339 tubers weighed in air and water (1.071 g/ml +- 0.021)."""

K_OUTLINE = 0.75
"""Share of density times outline (pi/4 of length times width by caliper) that a shift is worth. Ledgers hold sums made
with it, which are compared with their tubers: another value needs a migration. `python -m benchmarks sensitivity` fits
it to simulated views lowered by 1 to 6 mm: 0.77 (easy) and 0.73 (field) by the weights that it was chosen with, 0.84
and 0.82 by those of 28 November; two whole recordings say 0.80."""

LEDGER_OUTLINE = 1.14
"""Length times width in the ledger over that by caliper: the segmenter's outlines are some 7 % wide of the tuber (1.11,
1.15 and 1.16 in three replayed recordings). An error here scales the offset in mm, and no load that is calibrated with
it."""

TYPICAL_PER_MM = 0.020
"""Per millimetre, as a share of a load's weight, where no outlines are known: the same recordings lost 1.9 and 2.0 % of
their true weight per millimetre."""


def outline_g_per_mm(length_mm: float, width_mm: float, *, k: float = K_OUTLINE) -> float:
    """Grams per millimetre that a tuber of that size by caliper lies lower than thought: k * density * outline area.

    To first order the volume under the visible surface grows by the outline's area times the shift.
    """
    return k * DENSITY_G_PER_MM3 * math.pi / 4 * length_mm * width_mm


def tuber_g_per_mm(tuber: Tuber) -> float:
    """The same of a tuber of the ledger; of one that was never measured what is typical of its weight."""
    if min(tuber.length_mm, tuber.width_mm) > 0:
        return outline_g_per_mm(tuber.length_mm, tuber.width_mm) / LEDGER_OUTLINE
    return TYPICAL_PER_MM * tuber.weight_g


def share_of_weight(scale_g: NDArray[np.float64], per_mm_g: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) per millimetre and gram, smooth over the scale's weights: outline grows as weight to the power of 2/3.

    Args:
        scale_g: (n,) grams on the scale. per_mm_g: (n,) grams per mm of each tuber's own outline.
    """
    level = float(np.median(per_mm_g / scale_g ** (2 / 3)))
    return level * scale_g ** (-1 / 3)
