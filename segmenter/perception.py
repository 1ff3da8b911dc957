"""How tracks are told from clods: not at all, or by a small network that looks at each track before it counts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from segmenter.classify.classifier import Judge
from segmenter.classify.patch import COARSEST_MM, LEAST_LOOKS, Portrait, take_look
from segmenter.classify.prior import Prior
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.heights import HeightMap
from segmenter.frame.instances import Instances, SplitSettings, split
from segmenter.track.track import State, TrackState

Method = Literal["classical", "classes"]


@dataclass(frozen=True, slots=True)
class EyesSettings:
    """Which eyes to use.

    Attributes:
        method: 'classical' finds instances by flooding heights and takes all for tubers; 'classes' finds them so too
            and has each track judged by its portrait before it counts.
        weights: the judge, an ONNX file of `tuberline train-eyes`, or None for the shipped one.
        look_every_m: belt travel between two looks of a portrait.
    """

    method: Method = "classes"
    weights: Path | None = None
    look_every_m: float = 0.009


class Eyes:
    """The eyes of one camera. `coarse` counts frames whose cells are too large to show what anything is made of.

    Raises:
        InputError: the weights cannot be read.
    """

    def __init__(self, settings: EyesSettings, split_settings: SplitSettings) -> None:
        self._look_every_m = settings.look_every_m
        self._split = split_settings
        self._judge = None if settings.method == "classical" else Judge(settings.weights)
        self._prior = Prior()
        self._looked_m: float | None = None
        self.coarse = 0

    @property
    def judges(self) -> bool:
        """Tracks are judged by their portraits before they count."""
        return self._judge is not None

    def find(self, heights: HeightMap, belt: BeltGeometry) -> Instances:
        """The instances of a frame."""
        return split(heights, belt, self._split)

    def portray(
        self,
        heights: HeightMap,
        instances: Instances,
        found: list[tuple[TrackState, int]],
        belt: BeltGeometry,
        travel_m: float,
    ) -> None:
        """One more look for the portraits of the open tracks, where this frame is due and shows them whole."""
        if not self.look_due(heights, travel_m):
            return
        for track, index in found:
            whole = not instances.cut[index, :2].any() and not track.is_odd(float(instances.area_mm2[index]))
            if track.state is State.OPEN and whole:
                x_m, y_m = track.place_x_m + travel_m, track.place_y_m
                track.portrait.add(take_look(heights, instances, index, belt, x_m=x_m, y_m=y_m))

    def look_due(self, heights: HeightMap, travel_m: float) -> bool:
        """This frame is one for portraits: the belt moved on, and its cells are fine enough."""
        if self._judge is None:
            return False
        if self._looked_m is not None and abs(travel_m - self._looked_m) < self._look_every_m:
            return False
        if heights.cell_mm > COARSEST_MM:
            self.coarse += 1
            return False
        self._looked_m = travel_m
        return True

    def judge(self, portrait: Portrait) -> float | None:
        """Log-odds of tuber against other, to be asked once per track; None where nobody is asked or too little was
        seen.
        """
        if self._judge is None or portrait.looks < LEAST_LOOKS:
            return None
        return self._prior.log_odds(self._judge.log_odds(portrait))
