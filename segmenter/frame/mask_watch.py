"""Whether given masks tell tubers apart. Looks on; changes no count."""

from __future__ import annotations

from conveyor.islands import labels_apart
from segmenter.frame.instances import Instances


class MaskWatch:
    """A label that lies in several places is no tuber.

    Attributes:
        merged: frames in which there is one.
    """

    def __init__(self) -> None:
        self.merged = 0

    def step(self, instances: Instances, *, cell_mm: float) -> None:
        """Take the instances that the masks of one more frame give."""
        self.merged += bool(labels_apart(instances.labels, cell_mm=cell_mm))
