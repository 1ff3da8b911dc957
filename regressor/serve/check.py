"""Are these weights fit to weigh? They weigh three potatoes of known weight before they weigh one that counts.

The reference clouds are ellipsoids seen from above over a flat belt, 71, 176 and 338 g: made, not recorded, so they are
the same on every machine and belong to no season. A network that learned to weigh potatoes weighs them to a few percent
(the shipped ones: within 5 %); one that was broken, trained on other units or taken for another camera does not.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from conveyor.config import LineConfig
from conveyor.errors import InputError
from conveyor.geometry import belt_distance_m as distance_along_axis_m
from conveyor.geometry import straight_down_belt_from_camera
from regressor.network.sidecar import Sidecar
from regressor.serve.messages import CloudAnswer
from regressor.weigh.prepare import PreparedCloud, prepare_depth
from regressor.weigh.weigher import Weigher

HALF_AXES_M = {"small": (0.030, 0.025, 0.021), "medium": (0.042, 0.033, 0.028), "large": (0.055, 0.040, 0.034)}
DENSITY_G_PER_ML = 1.08
MOST_FACTOR = 1.6
"""A reference cloud may be weighed this many times too heavy or too light, and no more."""
WIDEST_INTERVAL = 4.0
"""Upper over lower bound of a reference cloud's interval: beyond it the interval says nothing."""
USUAL_BELT_DISTANCE_M = 0.345
NEAREST_BELT_M, FARTHEST_BELT_M = 0.12, 5.0
"""Where the reference camera may hang: nearer, it would stand on the largest tuber; farther, no line has one."""
_FOCAL_PX, _DEPTH_SCALE_M = 650.0, 0.0001


def check_weights(weigher: Weigher, config: LineConfig) -> tuple[CloudAnswer, ...]:
    """The answers to the reference clouds.

    Raises:
        InputError: the weights do not fit the line's cameras, or an answer is not plausible; says what is and what
            would be.
    """
    sidecar = weigher.sidecar
    check_belt_distances(sidecar, config)
    trained = sidecar.belt_distance_m
    if not trained.holds(belt_distance_m(sidecar)):
        raise InputError(
            f"weights {sidecar.model_id} are for cameras {trained.low:.3f} to {trained.high:.3f} m over the belt, from "
            f"where no reference cloud can be seen: allowed is what holds some of {NEAREST_BELT_M:g} to "
            f"{FARTHEST_BELT_M:g} m. Train them again with the distance that cameras have, or correct belt_distance_m "
            "in their sidecar"
        )
    answers = answers_of(weigher)
    faults = [fault for answer in answers for fault in _faults(answer)]
    if faults:
        raise InputError(
            f"weights {sidecar.model_id} fail on the reference clouds: {'; '.join(faults)}. Train them again, or look "
            "at them with `tuberline evaluate`"
        )
    return answers


def check_belt_distances(sidecar: Sidecar, config: LineConfig) -> None:
    """Every camera hangs where the training's cameras hung.

    Raises:
        InputError: naming the first camera that does not.
    """
    trained = sidecar.belt_distance_m
    for name, camera in sorted(config.cameras.items()):
        pose = camera.pose
        distance_m = camera.belt_distance_m if pose is None else distance_along_axis_m(pose)
        if distance_m is not None and not trained.holds(distance_m):
            key = "belt_distance_m" if pose is None else "belt_from_camera"
            raise InputError(
                f"weights {sidecar.model_id} do not fit camera '{name}': it hangs {distance_m:.3f} m over the belt, "
                f"they were trained for {trained.low:.3f} to {trained.high:.3f} m; train for this distance, or fix "
                f"cameras.{name}.{key}"
            )


def answers_of(weigher: Weigher) -> tuple[CloudAnswer, ...]:
    """What `weigher` says of each reference cloud, plausible or not."""
    found = []
    for name, true_g, cloud in reference_clouds(belt_distance_m(weigher.sidecar)):
        weighed = weigher.weigh(cloud)
        found.append(CloudAnswer(name, true_g, weighed.weight_g, weighed.low_g, weighed.high_g, weighed.network_g))
    return tuple(found)


def belt_distance_m(sidecar: Sidecar) -> float:
    """Where the reference camera hangs: as usual, or in the middle of what the training saw, but where one can hang."""
    trained = sidecar.belt_distance_m
    wanted = USUAL_BELT_DISTANCE_M if trained.holds(USUAL_BELT_DISTANCE_M) else (trained.low + trained.high) / 2
    return min(max(wanted, NEAREST_BELT_M), FARTHEST_BELT_M)


def reference_clouds(belt_distance_m: float) -> Iterator[tuple[str, float, PreparedCloud]]:
    """(name, true grams, cloud) of each ellipsoid, lying on the belt under the optical centre."""
    for name, (a, b, c) in HALF_AXES_M.items():
        reach = int(1.2 * _FOCAL_PX * max(a, b) / (belt_distance_m - 2 * c)) + 2
        v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1] / _FOCAL_PX
        # The ray (u, v, 1) z meets the ellipsoid where k2 z^2 - 2 k1 z + k0 = 0; the nearer root is what is seen.
        middle_z = belt_distance_m - c
        k2, k1, k0 = (u / a) ** 2 + (v / b) ** 2 + 1 / c**2, middle_z / c**2, (middle_z / c) ** 2 - 1
        root = k1**2 - k2 * k0
        depth_m = np.where(root > 0, (k1 - np.sqrt(np.maximum(root, 0.0))) / k2, 0.0)
        cloud = prepare_depth(
            np.round(depth_m / _DEPTH_SCALE_M).astype(np.uint16),
            depth_scale_m=_DEPTH_SCALE_M,
            fx=_FOCAL_PX,
            fy=_FOCAL_PX,
            cx=float(reach),
            cy=float(reach),
            belt_from_camera=straight_down_belt_from_camera(belt_distance_m),
        )
        yield name, DENSITY_G_PER_ML * 1e6 * 4 / 3 * math.pi * a * b * c, cloud


def _faults(answer: CloudAnswer) -> Iterator[str]:
    told = f"the {answer.cloud} one of {answer.true_g:.0f} g"
    if answer.network_g is None:
        yield f"the network gives no answer to {told}"
        return
    for what, grams in (("network", answer.network_g), ("weight", answer.weight_g)):
        if not 1 / MOST_FACTOR <= grams / answer.true_g <= MOST_FACTOR:
            yield f"{what} {grams:.0f} g for {told}, allowed are {1 / MOST_FACTOR:.2f} to {MOST_FACTOR:g} times that"
            return
    if not 0 < answer.low_g <= answer.weight_g <= answer.high_g <= WIDEST_INTERVAL * answer.low_g:
        yield f"an interval of {answer.low_g:.0f} to {answer.high_g:.0f} g around {answer.weight_g:.0f} g for {told}"
