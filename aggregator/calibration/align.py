"""Single weights in belt order laid beside the tubers of a run, though one is missing here or there.

Dynamic programming on the logarithms of both: a pair costs by how far it is from the run's common ratio, a weight or a
tuber that is left out costs as much as a pair three standard deviations apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from conveyor.errors import InputError

PAIR_SD = 0.12
"""Of ln scale over weighed within a run: a tuber's own 8 %, and what an offset does to small and large ones."""

LEFT_OUT_COST = 4.5
"""Half of three standard deviations squared."""

MOST_APART = 20
"""Beside the difference of the two numbers: how far the two rows may slip against each other."""

LEAST_SHARE = 0.8
MOST_SCATTER = 0.25
ROUNDS = 5


@dataclass(frozen=True, slots=True)
class Alignment:
    """Pairs (weight, tuber) by their index, and what has no partner on either side."""

    pairs: tuple[tuple[int, int], ...]
    weights_left_out: tuple[int, ...]
    tubers_left_out: tuple[int, ...]


def align(scale_g: Sequence[float], weighed_g: Sequence[float]) -> Alignment:
    """The best alignment of single weights with the tubers of a run, both in belt order, grams above 0.

    Raises:
        InputError: they are not of the same tubers in the same order.
    """
    fewest, most = sorted((len(scale_g), len(weighed_g)))
    if fewest < LEAST_SHARE * most:
        raise InputError(
            f"{len(scale_g)} weights and {len(weighed_g)} tubers: more than {100 * (1 - LEAST_SHARE):.0f} % apart. "
            "Name the part of the run that was weighed (--first, --last or --from-x, --to-x)"
        )
    logs_scale, logs_weighed = [math.log(g) for g in scale_g], [math.log(g) for g in weighed_g]
    ratio = median(logs_scale) - median(logs_weighed) if logs_scale and logs_weighed else 0.0
    pairs: list[tuple[int, int]] = []
    for _ in range(ROUNDS):
        pairs = _best(logs_scale, logs_weighed, ratio)
        found = median(logs_scale[i] - logs_weighed[j] for i, j in pairs) if pairs else ratio
        if abs(found - ratio) < 1e-6:
            break
        ratio = found
    _check(logs_scale, logs_weighed, pairs, ratio)
    paired_weights, paired_tubers = {i for i, _ in pairs}, {j for _, j in pairs}
    return Alignment(
        tuple(pairs),
        tuple(i for i in range(len(scale_g)) if i not in paired_weights),
        tuple(j for j in range(len(weighed_g)) if j not in paired_tubers),
    )


def _best(scale: list[float], weighed: list[float], ratio: float) -> list[tuple[int, int]]:
    band = abs(len(scale) - len(weighed)) + MOST_APART
    cost = [{j: LEFT_OUT_COST * j for j in range(min(band, len(weighed)) + 1)}]
    came = [dict.fromkeys(cost[0], "tuber")]
    for i, log_scale in enumerate(scale, start=1):
        above = cost[-1]
        here: dict[int, float] = {}
        steps: dict[int, str] = {}
        for j in range(max(0, i - band), min(len(weighed), i + band) + 1):
            ways = {
                "weight": above.get(j, math.inf) + LEFT_OUT_COST,
                "tuber": here.get(j - 1, math.inf) + LEFT_OUT_COST,
            }
            if j:
                apart = (log_scale - weighed[j - 1] - ratio) / PAIR_SD
                ways["pair"] = above.get(j - 1, math.inf) + 0.5 * apart * apart
            steps[j] = min(ways, key=lambda way: ways[way])
            here[j] = ways[steps[j]]
        cost.append(here)
        came.append(steps)
    pairs, i, j = [], len(scale), len(weighed)
    while i or j:
        step = came[i][j]
        if step == "pair":
            pairs.append((i - 1, j - 1))
        i, j = i - (step != "tuber"), j - (step != "weight")
    return pairs[::-1]


def _check(scale: list[float], weighed: list[float], pairs: list[tuple[int, int]], ratio: float) -> None:
    most = max(len(scale), len(weighed))
    apart = [abs(scale[i] - weighed[j] - ratio) for i, j in pairs]
    scatter = 1.48 * median(apart) if apart else math.inf
    if len(pairs) < LEAST_SHARE * most or scatter > MOST_SCATTER:
        raise InputError(
            f"{len(scale)} weights and {len(weighed)} tubers: {len(pairs)} of them follow each other"
            f"{f', scattering by {100 * scatter:.0f} %' if apart else ''}; at least {100 * LEAST_SHARE:.0f} % must, "
            f"within {100 * MOST_SCATTER:.0f} %. Give the weights in the order of the belt, in grams, and the part of "
            "the run they are of (--first, --last or --from-x, --to-x)"
        )
