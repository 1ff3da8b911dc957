"""Which points form which group: the lists both set abstractions work on.

A tuber is smaller than the search radii, so all centroids of a stage have the same 64 neighbours: the first 64 points
in sampling order. Only what the second stage reads is needed of the first. So three short lists say everything: the
neighbours and centroids of stage one, and the centroids of stage two (whose neighbours are the centroids of stage
one). Padding by repetition gives them one shape for clouds of every size; a maximum does not notice it.

Where a radius binds (a cloud wider than 0.2 m: two tubers in one mask, strays) every centroid has its own list, and
the general form is built instead. The choice is made per cloud by the exact distances.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from regressor.network.architecture import NEIGHBOURS, RADIUS_1_M, RADIUS_2_M, RATIO_1, RATIO_2
from regressor.network.sampling import farthest_points, first_in_range

CLOUD_POINTS = 1024
CENTROIDS_2 = 128
BOX_MARGIN = 1 - 1e-3
"""Keeps the screen by a cloud's box on the safe side of float32 rounding; where it says no, distances decide."""


@dataclass(frozen=True, slots=True)
class SharedGroups:
    """(n, 3) float32, metres: 64 neighbours, 64 first-stage and 128 (for 2048 points: 256) second-stage centroids."""

    neighbours: NDArray[np.float32]
    centroids1: NDArray[np.float32]
    centroids2: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class GatheredGroups:
    """Groups with their own neighbours.

    Attributes:
        points: (N, 3) float32, metres.
        centroids1: (c1, 3) float32, those that stage two reads; neighbours1: (c1, 64) int64 into `points`.
        centroids2: (c2, 3) float32; neighbours2: (c2, 64) int64 into `centroids1`. Both padded by repetition.
    """

    points: NDArray[np.float32]
    centroids1: NDArray[np.float32]
    neighbours1: NDArray[np.int64]
    centroids2: NDArray[np.float32]
    neighbours2: NDArray[np.int64]


def group_prefix(
    cloud: NDArray[np.float32], *, points: int = CLOUD_POINTS, centroids: int | None = None
) -> SharedGroups | GatheredGroups:
    """Groups of `cloud` sampled from its first point on, every stage a prefix of the one before.

    Args:
        cloud: (N, 3) float32, centred, metres, any order.
        points: how many the network is given of a larger cloud.
        centroids: of stage two that will be read, where all have the same neighbours: the others are copies of them,
            so that no more is sampled than that. None is all.
    """
    used = min(len(cloud), points)
    count2 = stage_counts(used)[1]
    free = radius_is_free_of(cloud)
    if free and centroids is not None:
        count2 = min(count2, centroids)
    first = cloud[farthest_points(cloud, min(used, max(NEIGHBOURS, count2)))]
    groups = _prefixes(first, used)
    if free or _all_within_radii(groups):
        return groups
    return gather_prefix(cloud[farthest_points(cloud, used)], of=used)


def group_sampled(first: NDArray[np.float32], *, of: int, points: int = CLOUD_POINTS) -> SharedGroups | GatheredGroups:
    """Groups of a whole cloud as `group_prefix` makes them, from its first points in sampling order.

    Where a radius binds, neighbours are looked for among the points that are here: the same ones if each centroid finds
    64 of them.

    Args:
        first: (M, 3) float32, centred, metres; at least as many as the second stage has centroids, or all.
        of: how many the whole cloud has. points: how many the network is given of a larger cloud.
    """
    used = min(of, points)
    first = first[:used]
    groups = _prefixes(first, used)
    return groups if radius_is_free(groups, first) else gather_prefix(first, of=used)


def general_groups(
    clouds: NDArray[np.float32], of: NDArray[np.int64], *, points: int = CLOUD_POINTS
) -> list[GatheredGroups] | None:
    """The general form of each cloud of a batch where a radius binds in one of them; None where none does.

    Args:
        clouds: (B, M, 3) float32, first points in sampling order, as in `group_sampled`. of: (B,) points of the whole
            clouds. points: how many the network is given of a larger one.
    """
    if all(radius_is_free_of(cloud) for cloud in clouds):
        return None
    groups = [group_sampled(cloud, of=int(n), points=points) for cloud, n in zip(clouds, of, strict=True)]
    if not any(isinstance(group, GatheredGroups) for group in groups):
        return None
    used = [min(int(n), points) for n in of]
    return [gather_prefix(cloud[:n], of=n) for cloud, n in zip(clouds, used, strict=True)]


def gather_prefix(first: NDArray[np.float32], *, of: int) -> GatheredGroups:
    """The general form of a cloud of `of` points from its first (M, 3) in sampling order."""
    count1, count2 = stage_counts(of)
    return gather_groups(first, np.arange(min(count1, len(first))), count2)


def group_given(points: NDArray[np.float32]) -> SharedGroups | GatheredGroups:
    """Groups of a cloud used as it is: its own order for the neighbours, sampling for the centroids.

    Args:
        points: (N, 3) float32, centred, metres, at most 1024.
    """
    count1, count2 = stage_counts(len(points))
    order = farthest_points(points, min(count1, max(NEIGHBOURS, count2)))
    groups = _padded(points[:NEIGHBOURS], points[order[:NEIGHBOURS]], points[order[:count2]])
    if radius_is_free(groups, points):
        return groups
    return gather_groups(points, farthest_points(points, count1), count2)


def group_random(cloud: NDArray[np.float32], *, seed: int, points: int = CLOUD_POINTS) -> SharedGroups | GatheredGroups:
    """Groups with a random first point in each of the three samplings, as the authors' code draws them.

    Three short samplings of 64, 64 and 128 points stand for 1024, 512 and 128 (-0.04 g from the mean of the authors'
    draws). The draw depends on `seed` alone, so a cloud has one answer. Clouds of at most `points` points keep their
    own order for the neighbours, as there. Where the radius binds, sampling starts at the first point.
    """
    used = min(len(cloud), points)
    count1, count2 = stage_counts(used)
    starts = np.random.default_rng(seed).random(3)
    q, c, d = (int(share * len(cloud)) for share in starts)
    small = len(cloud) <= points
    neighbours = cloud[:NEIGHBOURS] if small else cloud[farthest_points(cloud, NEIGHBOURS, start=q)]
    centroids1 = cloud[farthest_points(cloud, min(NEIGHBOURS, count1), start=c)]
    groups = _padded(neighbours, centroids1, cloud[farthest_points(cloud, count2, start=d)])
    if radius_is_free(groups, cloud):
        return groups
    return group_given(cloud if small else cloud[farthest_points(cloud, used)])


def stage_counts(points: int) -> tuple[int, int]:
    """Centroids of both stages for a cloud of `points`, rounded up as in the reference."""
    count1 = int(np.ceil(np.float32(points) * np.float32(RATIO_1)))
    return count1, int(np.ceil(np.float32(count1) * np.float32(RATIO_2)))


def _prefixes(first: NDArray[np.float32], used: int) -> SharedGroups:
    """The three lists of a cloud of `used` points, each a prefix of its `first` ones in sampling order."""
    count1, count2 = stage_counts(used)
    return _padded(first[:NEIGHBOURS], first[: min(NEIGHBOURS, count1)], first[:count2])


def _padded(
    neighbours: NDArray[np.float32], centroids1: NDArray[np.float32], centroids2: NDArray[np.float32]
) -> SharedGroups:
    return SharedGroups(
        _repeat(neighbours, NEIGHBOURS),
        _repeat(centroids1, NEIGHBOURS),
        _repeat(centroids2, max(CENTROIDS_2, len(centroids2))),
    )


def _repeat(points: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    return points[np.resize(np.arange(len(points)), count)]


def radius_is_free(groups: SharedGroups, cloud: NDArray[np.float32]) -> bool:
    """Whether every pair of both stages lies inside its radius: the box first, the distances where it does not tell."""
    return radius_is_free_of(cloud) or _all_within_radii(groups)


def _all_within_radii(groups: SharedGroups) -> bool:
    return _all_within(groups.centroids1, groups.neighbours, RADIUS_1_M) and _all_within(
        groups.centroids2, groups.centroids1, RADIUS_2_M
    )


def radius_is_free_of(cloud: NDArray[np.float32]) -> bool:
    """Whether the cloud's box alone says that every pair lies inside both radii: no tuber is that long."""
    # Axis by axis: np.ptp over the rows of 10,000 points takes longer than sampling them.
    box = [float(axis.max() - axis.min()) for axis in cloud.T]
    return float(np.linalg.norm(box)) < RADIUS_1_M * BOX_MARGIN


def _all_within(a: NDArray[np.float32], b: NDArray[np.float32], radius_m: float) -> bool:
    d = b[None] - a[:, None]
    square = d[..., 0] * d[..., 0] + d[..., 1] * d[..., 1] + d[..., 2] * d[..., 2]
    return bool((square < np.float32(radius_m * radius_m)).all())


def gather_groups(points: NDArray[np.float32], order1: NDArray[np.int64], count2: int) -> GatheredGroups:
    """The general form: (N, 3) points, in which order stage one samples them, how many centroids stage two has."""
    all1 = points[order1]
    centroids2 = all1[:count2]
    reads = _filled(first_in_range(all1, centroids2, RADIUS_2_M, NEIGHBOURS))
    read, inverse = np.unique(reads, return_inverse=True)
    centroids1 = all1[read]
    return GatheredGroups(
        points=points,
        centroids1=centroids1,
        neighbours1=_filled(first_in_range(points, centroids1, RADIUS_1_M, NEIGHBOURS)),
        centroids2=centroids2,
        neighbours2=inverse.reshape(reads.shape),
    )


def _filled(found: NDArray[np.int64]) -> NDArray[np.int64]:
    """Missing neighbours (-1) replaced by the first one."""
    return np.where(found >= 0, found, found[:, :1])
