"""How far a view looks as if a poor camera had taken it, unlike the good ones.

A camera with more noise, or with more holes on skins, than a good one is off in ways that no single view shows: its
depth scale, its drift. Its weights need wider intervals. A logistic regression on what each view tells of its camera
says how likely that is; it is fitted to views of simulated worlds (`conveyor.camera_range.GOOD` and the others).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from regressor.weigh.rule_json import number, numbers
from regressor.weigh.surface import NAMES

TERMS = ("noise", "much_noise", "holes_root", "holes")
TYPICAL_PX, LEAST_PX, MUCH_PX = 0.03, 0.02, 0.05
"""Local noise of good cameras, which one whose noise is not known is taken to have; below `LEAST_PX` a
camera is only better; over `MUCH_PX` nearly no good one is (0.1 mm steps: 0.02 to 0.025; 1 mm: up to 0.052)."""
MANY_HOLES = 0.006
"""Share of the outline without depth, beyond which more makes no difference: nearly no good camera has it."""
RIDGE = 1e-4
HOLES = NAMES.index("hole_share")


def camera_terms(noise_px: NDArray[np.float64], features: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 4) in the order of `TERMS`.

    Args:
        noise_px: (n,) local noise on the skin, pixels of disparity at a baseline of 18 mm; NaN: not known.
        features: (n, 17) or more, as in `surface.NAMES`.
    """
    noise = np.maximum(np.where(np.isfinite(noise_px), noise_px, TYPICAL_PX), LEAST_PX)
    much = np.log(np.maximum(noise / MUCH_PX, 1.0))
    holes = features[:, HOLES]
    return np.column_stack([np.log(noise / TYPICAL_PX), much, np.sqrt(holes), np.minimum(holes / MANY_HOLES, 1.0)])


@dataclass(frozen=True, slots=True)
class CameraRule:
    """The chance is the logistic function of intercept + slopes * terms."""

    intercept: float
    slopes: tuple[float, ...]

    def chance(self, noise_px: NDArray[np.float64], features: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) between 0 and 1: that a camera unlike a good one took the view; arguments of `camera_terms`."""
        odds = self.intercept + camera_terms(noise_px, features) @ np.array(self.slopes)
        chances: NDArray[np.float64] = 1.0 / (1.0 + np.exp(-odds))
        return chances

    def to_json(self) -> dict[str, Any]:
        """For the sidecar of a checkpoint."""
        return {"terms": TERMS, **asdict(self)}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> CameraRule:
        """From the sidecar of a checkpoint.

        Raises:
            ValueError: made from other terms than this code knows, or of numbers that it cannot hold.
        """
        if tuple(data["terms"]) != TERMS:
            raise ValueError(f"a camera rule is made from {data['terms']}; known: {TERMS}")
        return cls(number(data, "intercept"), numbers(data, "slopes", len(TERMS)))


def fit_camera(noise_px: NDArray[np.float64], features: NDArray[np.float64], unlike: NDArray[np.bool_]) -> CameraRule:
    """The rule from n views; `unlike`: (n,) which of them poor cameras took."""
    from scipy.optimize import minimize  # a tenth of a second, which who only weighs does not need

    terms = camera_terms(noise_px, features)
    centre, spread = terms.mean(0), np.maximum(terms.std(0), 1e-9)
    design = np.column_stack([np.ones(len(terms)), (terms - centre) / spread])
    truth = unlike.astype(np.float64)

    def loss(beta: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        odds = design @ beta
        fault = float((np.logaddexp(0.0, odds) - truth * odds).mean() + RIDGE * (beta[1:] ** 2).sum())
        pull = design.T @ (1.0 / (1.0 + np.exp(-odds)) - truth) / len(truth)
        pull[1:] += 2 * RIDGE * beta[1:]
        return fault, pull

    beta = minimize(loss, np.zeros(design.shape[1]), jac=True, method="L-BFGS-B").x
    slopes = beta[1:] / spread
    return CameraRule(float(beta[0] - centre @ slopes), tuple(slopes.tolist()))
