"""What a weight is read from beside the network: the surface, the noise on it, and how well its level is known.

The same surface stands for different weights. Noise raises the top and makes the rim ragged; over a level that is known
to half a millimetre a low tuber is a flat one, over one known to 3 mm it may as well be a belt that was stated wrong,
and its outline says more than its height. Rules that are told both are off by less, in every world.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from regressor.weigh.surface import NAMES

LEAST_PX, MOST_PX, TYPICAL_PX = 0.02, 0.15, 0.03
"""Local noise below which less makes no difference, above which no camera was simulated, and where it is not known."""
LEAST_SD_MM, MOST_SD_MM = 0.6, 2.5
"""Of the resting level: a belt calibrated well, and one about which no more is known than that it is there. Fits see
little between the two, so nothing but a straight line in its logarithm may be taken from it: all well-known belts of
the fit must clip to the same number, for a square fitted to what parts two of them goes anywhere in between."""

VIEW_NAMES = (*NAMES, "noise_px", "level_sd_mm")


def view_features(features: NDArray[np.float64], noise_px: ArrayLike, level_sd_m: ArrayLike) -> NDArray[np.float64]:
    """(n, 37) in the order of `VIEW_NAMES`.

    Args:
        features: (n, 35) as in `surface.NAMES`.
        noise_px: (n,) local noise on the skin, pixels of disparity at a baseline of 18 mm; NaN: not known.
        level_sd_m: (n,) standard deviation of the resting level: of the belt's height and of the offset below it.
    """
    noise = np.asarray(noise_px, np.float64)
    noise = np.clip(np.where(np.isfinite(noise), noise, TYPICAL_PX), LEAST_PX, MOST_PX)
    level_sd_mm = np.clip(1e3 * np.asarray(level_sd_m, np.float64), LEAST_SD_MM, MOST_SD_MM)
    return np.column_stack([features, noise, level_sd_mm])
