"""Perception of one camera: find the instances of a frame, and classify tracks as tuber or not before they count."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from segmenter.classify.belief import believe
from segmenter.classify.classifier import Classifier
from segmenter.classify.evidence import Answer, noise_of
from segmenter.classify.patch import COARSEST_MM, LEAST_OBSERVATIONS, Patch, observe_instance
from segmenter.classify.prior import Prior
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.heights import HeightMap
from segmenter.frame.instances import Instances, SplitSettings, split
from segmenter.track.track import State, TrackState

Method = Literal["classical", "classes"]


@dataclass(frozen=True, slots=True)
class PerceptionSettings:
    """How to perceive.

    Attributes:
        method: 'classical' finds instances by flooding heights and takes all for tubers; 'classes' finds them so too
            and classifies each track by its patch before it counts.
        weights: of the classifier, an ONNX file of `tuberline train-classifier`, or None for the shipped one.
        observe_every_m: belt travel between two observations of a patch.
    """

    method: Method = "classes"
    weights: Path | None = None
    observe_every_m: float = 0.009


class Perception:
    """Finds and classifies. `coarse` counts frames whose cells are too large to show what anything is made of,
    `unanswered` tracks of which the classifier said no number.

    Raises:
        InputError: the weights cannot be read.
    """

    def __init__(self, settings: PerceptionSettings, split_settings: SplitSettings) -> None:
        self._observe_every_m = settings.observe_every_m
        self._split = split_settings
        self._classifier = None if settings.method == "classical" else Classifier(settings.weights)
        self._prior = Prior()
        self._observed_m: float | None = None
        self.coarse = 0
        self.unanswered = 0

    @property
    def classifies(self) -> bool:
        """Tracks are classified by their patches before they count."""
        return self._classifier is not None

    def find(self, heights: HeightMap, belt: BeltGeometry) -> Instances:
        """The instances of a frame."""
        return split(heights, belt, self._split)

    def observe(
        self,
        heights: HeightMap,
        instances: Instances,
        found: list[tuple[TrackState, int]],
        belt: BeltGeometry,
        travel_m: float,
    ) -> None:
        """Add this frame to the patches of the open tracks, where it is due and shows them whole."""
        if not self.observation_due(heights, travel_m):
            return
        for track, index in found:
            whole = not instances.cut[index, :2].any() and not track.is_odd(float(instances.area_m2[index]))
            if track.state is State.OPEN and whole:
                x_m, y_m = track.place_x_m + travel_m, track.place_y_m
                track.patch.add(observe_instance(heights, instances, index, belt, x_m=x_m, y_m=y_m))

    def observation_due(self, heights: HeightMap, travel_m: float) -> bool:
        """This frame adds to the patches: the belt moved on, and its cells are fine enough."""
        if self._classifier is None:
            return False
        if self._observed_m is not None and abs(travel_m - self._observed_m) < self._observe_every_m:
            return False
        if heights.cell_mm > COARSEST_MM:
            self.coarse += 1
            return False
        self._observed_m = travel_m
        return True

    def classify(self, patch: Patch, *, limit: float) -> Answer | None:
        """What is believed of a track, which is refused below `limit`. Once per track: the prior learns from it.

        None without a classifier, where a patch has too few observations, where the answer is no number, and where so
        many bodies look like clods that the classifier is not believed.
        """
        if self._classifier is None or patch.observations < LEAST_OBSERVATIONS:
            return None
        answer = believe(self._prior, self._classifier.answers(patch), noise_of(patch), limit=limit)
        self.unanswered += answer is None
        return answer if self._prior.like_clods == 0 else None

    @property
    def belt(self) -> Prior:
        """What the tracks so far say of clods on the belt."""
        return self._prior.copied()

    def recall(self, belt: Prior) -> None:
        """Begin with what an earlier process, or an earlier look, has learned of this belt."""
        self._prior = belt.copied()

    @property
    def like_clods(self) -> float:
        """Share of the bodies that look like clods, where that is too many to believe any of it; else 0."""
        return self._prior.like_clods
