"""Outlines that a camera let grow are cut back to the body; all other views stay as they are, to the last bit."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from conveyor.messages import View
from regressor.weigh.grown import LEAST_SHARE, MOST_DROPPED, SCRAPS_CUT, cut_back
from regressor.weigh.prepare import prepare_view
from tests.regressor.ellipsoids import ellipsoid_view

RING_PX = (2.0, 4.0)
"""Scraps lie so far outside the body, with a gap before them."""


def with_scraps(view: View, share: float, *, over: float = 1.0) -> View:
    """The view with scraps around its outline, as high above the belt as `share` of the top, over so much of it."""
    reach = int(RING_PX[1]) + 2
    depth = np.pad(view.depth, reach)
    away = cv2.distanceTransform((depth == 0).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    ring = (away > RING_PX[0]) & (away <= RING_PX[1])
    ring[:, int(over * ring.shape[1]) :] = False
    belt = float(view.belt_from_camera[2, 3]) / view.depth_scale_m
    depth[ring] = round(belt - share * (belt - float(view.depth[view.depth > 0].min())))
    return replace(view, depth=depth, u0=view.u0 - reach, v0=view.v0 - reach)


@pytest.mark.parametrize("over", [1.0, 0.5])
def test_what_a_camera_grew_beyond_a_gap_is_cut_off(over: float) -> None:
    """The gap was filled, and the tuber weighed as large as the scraps around it."""
    view = ellipsoid_view()
    clean, grown = prepare_view(view), prepare_view(with_scraps(view, 0.65, over=over))
    assert grown.surface.area_cm2 == pytest.approx(clean.surface.area_cm2, rel=0.01)
    assert grown.surface.volume_ml == pytest.approx(clean.surface.volume_ml, rel=0.01)
    assert (clean.flags, grown.flags) == ((), (SCRAPS_CUT,))


@pytest.mark.parametrize(("share", "cut"), [(0.3, False), (0.45, False), (0.65, True)])
def test_low_scraps_of_mixed_pixels_change_nothing(share: float, cut: bool) -> None:
    """The weights were trained on views that have them."""
    view = with_scraps(ellipsoid_view(), share)
    heights_m = view.belt_from_camera[2, 3] - view.depth * view.depth_scale_m
    assert (cut_back(view.depth, view.depth, heights_m) is not None) is cut


def test_few_high_scraps_change_nothing() -> None:
    view = ellipsoid_view()
    few = np.where(view.depth > 0, view.depth, 0)
    few = np.pad(few, 6)
    row = 6 + view.depth.shape[0] // 2
    first = int(np.flatnonzero(few[row])[0])
    few[row : row + 2, first - 4 : first - 2] = few[row, first]
    assert LEAST_SHARE * np.count_nonzero(few) > 4
    heights_m = np.where(few > 0, 0.345 - few * view.depth_scale_m, 0.0)
    assert cut_back(few.astype(np.uint16), few.astype(np.uint16), heights_m) is None


def test_a_hole_in_the_skin_cuts_nothing_off() -> None:
    """A seam without depth through the middle of a grown view is the skin's, and both halves are the body's."""
    view = with_scraps(ellipsoid_view(), 0.65)
    depth = view.depth.copy()
    middle = depth.shape[1] // 2
    inner = slice(depth.shape[0] // 4, -(depth.shape[0] // 4))
    depth[inner, middle : middle + 3] = 0
    grown = prepare_view(replace(view, depth=depth))
    assert grown.flags == (SCRAPS_CUT,)
    assert grown.surface.area_cm2 == pytest.approx(prepare_view(ellipsoid_view()).surface.area_cm2, rel=0.01)


@pytest.mark.parametrize("depth", [np.zeros((9, 9)), np.full((3, 40), 300), np.full((1, 1), 300)])
def test_what_has_no_body_is_left_alone(depth: np.ndarray) -> None:
    image = depth.astype(np.uint16)
    assert cut_back(image, image, np.where(depth > 0, 0.045, 0.0)) is None


def test_a_flank_that_noise_tore_off_is_not_cut_away() -> None:
    """Where cleaning takes many pixels of a view, the strips beyond its gaps are the tuber's own."""
    view = with_scraps(ellipsoid_view(), 0.65)
    heights_m = view.belt_from_camera[2, 3] - view.depth * view.depth_scale_m
    noisy = view.depth.copy()
    rows, columns = np.nonzero(view.depth == 0)
    torn = round(1.2 * MOST_DROPPED * np.count_nonzero(view.depth))
    noisy[rows[:torn], columns[:torn]] = 300
    assert cut_back(view.depth, view.depth, heights_m) is not None
    assert cut_back(noisy, view.depth, heights_m) is None
