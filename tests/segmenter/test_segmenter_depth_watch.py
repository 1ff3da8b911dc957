"""A lens that is dark or dirty in a part of its picture is told: tubers there are missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from segmenter_scene import SMALL, Scene, scattered

from conveyor.belt_findings import belt_findings
from segmenter.pipeline import Segmenter, Settings

STEP_M = 0.0133
SCENE = Scene(scattered(15, seed=3), SMALL, noise_m=0.001, holes=0.05)
DARK = np.zeros((SMALL.height, SMALL.width), bool)
DARK[:, : SMALL.width // 2] = True


@pytest.mark.parametrize("since", [0, 25])
def test_a_lens_that_is_dark_on_one_side_is_told(since: int) -> None:
    """Half of a load was missing, and 100 % of the belt was told as seen."""
    core = Segmenter(Settings())
    for i in range(80):
        frame = SCENE.frame(i, i * STEP_M)
        core.step(replace(frame, depth=np.where(DARK, 0, frame.depth).astype(np.uint16)) if i >= since else frame)
    found = belt_findings("front", core.gauges())
    assert list(found) == ["without_depth"]
    assert "camera 'front': 50 % of its picture shows no depth" in found["without_depth"]
