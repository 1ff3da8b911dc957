"""A fragment of a knobby tuber is merged back; a small neighbour is not."""

from __future__ import annotations

import numpy as np
import pytest

from segmenter.age import FrameAge
from segmenter.frame.seams import SeamSettings, merge_fragments


def two_domes(*, valley_mm: float, step_mm: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A large and a small instance side by side; the surface dips to `valley_mm` along their seam."""
    labels = np.zeros((80, 80), np.int32)
    labels[10:60, 10:50] = 1
    labels[20:42, 50:62] = 2
    height = np.where(labels == 1, 50.0, np.where(labels == 2, 45.0 - step_mm, 0.0)).astype(np.float32)
    height[:, 48:52] = np.where(labels[:, 48:52] > 0, np.minimum(height[:, 48:52], valley_mm), 0)
    return labels, height


@pytest.mark.parametrize(
    ("valley_mm", "step_mm", "merged"),
    [(44.0, 0.0, 1), (20.0, 0.0, 0), (44.0, 25.0, 0)],
    ids=["a fragment", "a valley between", "one over the other"],
)
def test_only_a_fragment_is_merged(valley_mm: float, step_mm: float, merged: int) -> None:
    labels, height = two_domes(valley_mm=valley_mm, step_mm=step_mm)
    if step_mm:
        height[labels == 1] = 50.0
        height[labels == 2] = 50.0 - step_mm
    assert merge_fragments(labels, 2, height, 1.0, SeamSettings()) == merged
    assert len(np.unique(labels)) == 3 - merged


def test_a_large_neighbour_is_never_merged() -> None:
    labels, height = two_domes(valley_mm=44.0)
    assert merge_fragments(labels, 2, height, 3.2, SeamSettings()) == 0


def test_the_largest_fragment_of_second_growth_that_was_counted_is_merged() -> None:
    """2073 mm2 on a tuber of 573 g: apart in 31 of 43 frames, it was counted as a tuber of its own."""
    labels, height = two_domes(valley_mm=36.0)
    small = labels == 2
    assert merge_fragments(labels, 2, height, float(np.sqrt(2073.0 / small.sum())), SeamSettings()) == 1


def long_seam(*, seam_cells: int, valley_mm: float, top_mm: float = 45.0) -> tuple[np.ndarray, np.ndarray]:
    """A large and a small instance, 22 by 12 cells, that touch along some of the small one's long side only."""
    labels, height = two_domes(valley_mm=100.0)
    labels[20 + seam_cells : 42, 46:50] = 0
    height[labels == 0] = 0.0
    height[labels == 2] = top_mm
    ring = height[:, 48:52]
    ring[labels[:, 48:52] > 0] = np.minimum(ring[labels[:, 48:52] > 0], valley_mm)
    return labels, height


@pytest.mark.parametrize(
    ("seam_cells", "valley_mm", "merged"),
    [(14, 43.0, 1), (14, 35.0, 0), (22, 35.0, 1), (5, 43.0, 0)],
    ids=["short and high", "short and lower", "long and lower", "hardly any"],
)
def test_a_short_seam_must_be_a_high_one(seam_cells: int, valley_mm: float, merged: int) -> None:
    """A fragment of 27 ml on a tuber of 568 g: 22 to 34 % of its outline is seam, at 80 to 91 % of its own height."""
    labels, height = long_seam(seam_cells=seam_cells, valley_mm=valley_mm)
    assert merge_fragments(labels, 2, height, 1.45, SeamSettings()) == merged


def test_what_is_as_large_as_a_small_tuber_needs_a_clearer_seam() -> None:
    """1677 mm2, a tuber of 48 g beside one of 163 g: taken for a fragment in 7 of 30 frames, it was not counted."""
    labels, height = long_seam(seam_cells=22, valley_mm=34.5)
    assert merge_fragments(labels.copy(), 2, height, 1.45, SeamSettings()) == 1
    assert merge_fragments(labels.copy(), 2, height, 2.5, SeamSettings()) == 0


@pytest.mark.parametrize(("gone", "merged"), [(0, 1), (18, 1), (20, 0)])
def test_what_the_first_row_cuts_is_not_merged_it_may_be_a_tuber_that_enters(gone: int, merged: int) -> None:
    labels, height = two_domes(valley_mm=44.0)
    labels, height = labels[gone:].copy(), height[gone:].copy()
    assert merge_fragments(labels, 2, height, 1.45, SeamSettings()) == merged
    labels, height = (np.flipud(each).copy() for each in two_domes(valley_mm=44.0))
    labels, height = labels[: 80 - gone].copy(), height[: 80 - gone].copy()
    assert merge_fragments(labels, 2, height, 1.45, SeamSettings()) == merged


def test_a_cleat_beside_a_tuber_is_not_merged_into_it() -> None:
    labels, height = long_seam(seam_cells=22, valley_mm=17.0, top_mm=17.0)
    height[labels == 1] = 20.0
    assert merge_fragments(labels, 2, height, 1.45, SeamSettings()) == 0
    assert merge_fragments(labels, 2, height, 1.45, SeamSettings(min_top_mm=15.0)) == 1


def test_age_is_what_a_frame_waited_whatever_the_clocks_say() -> None:
    age = FrameAge()
    offset_ns = 1_760_000_000_000_000_000
    assert age.age_ms(offset_ns, 1_000_000_000) == 0
    assert age.age_ms(offset_ns + 33_000_000, 1_033_000_000) == 0
    assert age.age_ms(offset_ns + 66_000_000, 1_266_000_000) == pytest.approx(200)
    assert age.age_ms(offset_ns - 60_000_000_000, 1_300_000_000) == 0
