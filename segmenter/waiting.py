"""The segmenter of a camera whose belt is not known yet: it can tell only what an earlier process of the run left."""

from __future__ import annotations

from dataclasses import dataclass

from conveyor.messages import Frame
from segmenter.belt_segmenter import BeltSegmenter, Settings
from segmenter.frame.belt import BeltGeometry
from segmenter.perception import Perception
from segmenter.resume import Resume


@dataclass(frozen=True, slots=True)
class WaitingSegmenter:
    """Waits for a belt."""

    settings: Settings
    perception: Perception
    resume: Resume | None

    @property
    def travel_m(self) -> float:
        """Travel at which the earlier process left off."""
        return self.resume.travel_m if self.resume else 0.0

    @property
    def looked_at_m(self) -> float:
        """Belt that the earlier process looked at."""
        return self.resume.looked_at_m if self.resume else 0.0

    @property
    def travelled_m(self) -> float:
        """Belt that passed under the earlier process."""
        return self.resume.travelled_m if self.resume else 0.0

    @property
    def unfollowed_ms(self) -> int:
        """How long load passed under it of which it did not know how far it moved."""
        return self.resume.unfollowed_ms if self.resume else 0

    @property
    def carried_ms(self) -> int:
        """How long it saw no load move."""
        return self.resume.carried_ms if self.resume else 0

    def complete_travel_m(self) -> float:
        """Travel up to which the earlier process logged everything."""
        return -self.resume.complete_place_x_m if self.resume else float("-inf")

    def complete_ns(self) -> int:
        """Capture time up to which the earlier process logged everything."""
        return self.resume.complete_ns if self.resume else 0

    def with_belt(self, belt: BeltGeometry, frame: Frame) -> BeltSegmenter:
        """The belt was seen in `frame`, the first to be processed."""
        resume = self.resume.at_first(frame) if self.resume else None
        return BeltSegmenter(self.settings, belt, self.perception, resume)
