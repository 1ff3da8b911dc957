"""A lump of a knobby tuber is sewn back on; a small neighbour is not."""

from __future__ import annotations

import numpy as np
import pytest

from segmenter.age import FrameAge
from segmenter.seams import SeamSettings, sew


def two_domes(*, valley_mm: float, step_mm: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A large and a small instance side by side; the surface dips to `valley_mm` along their seam."""
    labels = np.zeros((80, 80), np.int32)
    labels[10:60, 10:50] = 1
    labels[20:42, 50:62] = 2
    height = np.where(labels == 1, 50.0, np.where(labels == 2, 45.0 - step_mm, 0.0)).astype(np.float32)
    height[:, 48:52] = np.where(labels[:, 48:52] > 0, np.minimum(height[:, 48:52], valley_mm), 0)
    return labels, height


@pytest.mark.parametrize(
    ("valley_mm", "step_mm", "sewn"),
    [(44.0, 0.0, 1), (20.0, 0.0, 0), (44.0, 25.0, 0)],
    ids=["a lump", "a valley between", "one over the other"],
)
def test_only_a_lump_is_sewn_on(valley_mm: float, step_mm: float, sewn: int) -> None:
    labels, height = two_domes(valley_mm=valley_mm, step_mm=step_mm)
    if step_mm:
        height[labels == 1] = 50.0
        height[labels == 2] = 50.0 - step_mm
    assert sew(labels, 2, height, 1.0, SeamSettings()) == sewn
    assert len(np.unique(labels)) == 3 - sewn


def test_a_large_neighbour_is_never_sewn() -> None:
    labels, height = two_domes(valley_mm=44.0)
    assert sew(labels, 2, height, 2.5, SeamSettings()) == 0


def test_age_is_what_a_frame_waited_whatever_the_clocks_say() -> None:
    age = FrameAge()
    offset_ns = 1_760_000_000_000_000_000
    assert age.age_ms(offset_ns, 1_000_000_000) == 0
    assert age.age_ms(offset_ns + 33_000_000, 1_033_000_000) == 0
    assert age.age_ms(offset_ns + 66_000_000, 1_266_000_000) == pytest.approx(200)
    assert age.age_ms(offset_ns - 60_000_000_000, 1_300_000_000) == 0
