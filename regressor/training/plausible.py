"""What labelled views cannot be: tubers in the air or under their belt, and weights that are no grams.

`weigh` refuses such a cloud. A training that takes it learns from it, and an evaluation judges by it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from conveyor.errors import InputError
from regressor.weigh.place import OFF_THE_BELT, distance_fault
from regressor.weigh.prepare import PreparedCloud, RefusedCloud

GRAMS_PER_ML = (0.05, 20.0)
"""No crop is so light or heavy for its visible volume; a tuber has about 1. A wrong unit is a thousand times off."""
OFF = (OFF_THE_BELT, "below_belt", "empty_cloud")
"""Reasons of refusals that a wrong distance or unit gives."""
HEAVIER = 10.0
"""So many times the median weighs none that is mostly hidden: the heaviest of 859 tubers weighs 4 times as much."""
MOST_OFF = 0.5
"""Share of a set's views that may float above or lie under their belts, or show nothing: with a wrong distance or unit
all of them do."""
CHECK = (
    "Check that weights are grams, that belt distances are metres from the camera to the belt, and the depth images' "
    "scale"
)


class OffTheBelt(RefusedCloud):
    """A view whose `cloud` floats high above its belt or lies wholly below it."""

    def __init__(self, name: str, cloud: PreparedCloud) -> None:
        nearest_m = cloud.belt_distance_m + cloud.resting_offset_m - cloud.height_m
        InputError.__init__(
            self,
            f"the nearest point of '{name}' is {nearest_m:.3f} m from the camera and its belt "
            f"{cloud.belt_distance_m:.3f} m",
        )
        self.reason = OFF_THE_BELT
        self.cloud = cloud


def check_place(name: str, cloud: PreparedCloud) -> None:
    """Refuse a view as `weigh` does.

    Raises:
        OffTheBelt: its cloud is far from its belt. `name`: of its tuber.
    """
    if distance_fault(cloud):
        raise OffTheBelt(name, cloud)


def refused_told(refused: Mapping[str, int], first: Mapping[str, str]) -> str:
    """In words, how many views were left out by reason, with the `first` of each that has a name; empty for none."""
    told = []
    for reason, count in sorted(refused.items()):
        more = ", ..." if count > 1 else ""
        told.append(f"{reason} {count}" + (f" ({first[reason]}{more})" if reason in first else ""))
    return ", ".join(told)


class Seen:
    """What was seen of a set's views, to refuse the set where it cannot be right.

    Attributes:
        first: the name of the first view that was refused, by reason.
    """

    def __init__(self, where: str) -> None:
        """`where`: they are from."""
        self._where = where
        self._seen: list[tuple[str, float, float]] = []
        self._floating: list[tuple[str, float, float]] = []
        self._off = 0
        self._example = ""
        self.first: dict[str, str] = {}

    def usable(self, tuber: str, weight_g: float, cloud: PreparedCloud) -> None:
        """One more view that can be used; a weight that is not known is NaN."""
        self._seen.append((tuber, weight_g, cloud.surface.volume_ml))

    def refused(self, tuber: str, weight_g: float, refusal: RefusedCloud, *, name: str) -> None:
        """One more that cannot."""
        self.first.setdefault(refusal.reason, name)
        if refusal.reason not in OFF:
            return
        self._off += 1
        if isinstance(refusal, OffTheBelt):
            self._floating.append((tuber, weight_g, refusal.cloud.surface.volume_ml))
            self._example = self._example or str(refusal)
        elif refusal.reason == "empty_cloud":
            self._example = self._example or f"'{name}' shows no depth of its tuber"
        else:
            self._example = self._example or f"no part of '{tuber}' stands above its belt"

    def check(self, refused: Mapping[str, int]) -> None:
        """Refuse the set. `refused`: how many views were, by reason.

        Raises:
            InputError: the median weight is none for the median volume, most views are off their belts, none can be
                used, or tubers are too light or too heavy for what is seen of them.
        """
        low, high = GRAMS_PER_ML
        known = [view for view in [*self._seen, *self._floating] if np.isfinite(view[1])]
        if known:
            weight_g, volume_ml = (float(np.median([view[at] for view in known])) for at in (1, 2))
            if not low <= weight_g / max(volume_ml, 1e-3) <= high:
                raise InputError(
                    f"{self._where}: a median weight of {weight_g:.3g} stands beside a median visible volume of "
                    f"{volume_ml:.3g} ml; allowed are {low:g} to {high:g} g a ml. {CHECK}"
                )
        all_views = self._off + len(self._seen)
        if self._off > MOST_OFF * all_views:
            raise InputError(
                f"{self._where}: {self._off} of {all_views} views float above their belt or lie under it, or "
                f"show nothing, where `weigh` refuses them: {self._example}. {CHECK}"
            )
        if not self._seen:
            told = refused_told(refused, self.first) or "none"
            raise InputError(f"{self._where} holds no view that can be weighed; refused: {told}")
        self._check_each()

    def _check_each(self) -> None:
        """Refuse the set for single tubers.

        Raises:
            InputError: some are too light or too heavy for what is seen of them.
        """
        low, high = GRAMS_PER_ML
        light = {view[0]: view for view in self._seen if view[1] < low * view[2]}  # nothing makes a view too large
        self._refuse(light, "light", f"at least {low:g} g a ml are allowed")
        known = [view for view in self._seen if np.isfinite(view[1])]
        median_g = float(np.median([weight_g for _, weight_g, _ in known])) if known else 0.0
        largest_ml: dict[str, float] = {}
        for tuber, _, volume_ml in known:
            largest_ml[tuber] = max(volume_ml, largest_ml.get(tuber, 0.0))
        heavy = {
            tuber: (tuber, weight_g, largest_ml[tuber])
            for tuber, weight_g, _ in known
            if weight_g > max(HEAVIER * median_g, high * largest_ml[tuber])
        }
        most = f"at most {high:g} g a ml are allowed where it is more than {HEAVIER:g} times the median"
        self._refuse(heavy, "heavy", most)

    def _refuse(self, found: Mapping[str, tuple[str, float, float]], too: str, allowed: str) -> None:
        """Raise InputError where tubers were found, each with its name, weight (g) and visible volume (ml)."""
        if found:
            name, weight_g, volume_ml = min(found.values())
            raise InputError(
                f"{self._where}: {len(found)} of {len({tuber for tuber, *_ in self._seen})} tubers are too {too} for "
                f"what is seen of them: '{name}' weighs {weight_g:g}, with a visible volume of {volume_ml:.3g} ml; "
                f"{allowed}. {CHECK}"
            )
