"""A gap that is too wide to be filled is told, however little of the tuber lies beyond it; nothing else changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from camera_sim.sim.view_setting import ViewPlan
from camera_sim.sim.views import ViewSimulator
from conveyor.crop_depth import MOST_MISSING, is_parted
from regressor.weigh.grown import SCRAPS_CUT
from regressor.weigh.prepare import MISSING, PARTS, prepare_view
from regressor.weigh.weigher import PARTED, Weigher
from tests.regressor.ellipsoids import ellipsoid_view

SEED = 20261128
HALF_AXES_M = (0.042, 0.033, 0.028)


def gapped(depth: NDArray[np.uint16], *, left: int, wide: int, turned: bool, last: bool) -> NDArray[np.uint16]:
    """`depth` with `wide` empty rows, or columns, that leave `left` of them at one end."""
    out = depth.copy()
    rows = out.T if turned else out
    rows = rows[::-1] if last else rows
    rows[left : left + wide] = 0
    return out


@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(("left", "wide"), [(1, 9), (3, 9), (3, 16), (8, 12), (12, 24)])
def test_what_a_wide_gap_leaves_of_an_end_is_told(left: int, wide: int, turned: bool, last: bool) -> None:
    """No flag, or `scraps_cut` alone, where less than a tenth lay beyond: 2 to 47 % light, with a usual interval."""
    view = ellipsoid_view(HALF_AXES_M)
    parted = prepare_view(replace(view, depth=gapped(view.depth, left=left, wide=wide, turned=turned, last=last)))
    assert PARTS in parted.flags
    assert set(parted.flags) <= {PARTS, SCRAPS_CUT}
    assert parted.surface.volume_ml < prepare_view(view).surface.volume_ml


def test_its_interval_is_wider() -> None:
    view = ellipsoid_view(HALF_AXES_M)
    parted = prepare_view(replace(view, depth=gapped(view.depth, left=4, wide=12, turned=False, last=False)))
    weigher = Weigher.load()
    wide, usual = weigher.weigh(parted), weigher.weigh(replace(parted, flags=()))
    assert wide.weight_g == usual.weight_g
    assert wide.high_g - wide.low_g == pytest.approx(PARTED * (usual.high_g - usual.low_g), abs=0.01)


def test_a_gap_that_is_filled_is_none() -> None:
    view = ellipsoid_view(HALF_AXES_M)
    depth = gapped(view.depth, left=30, wide=MOST_MISSING, turned=False, last=False)
    assert prepare_view(replace(view, depth=depth)).flags == (MISSING,)
    assert not is_parted(np.zeros((5, 5), np.uint16))


def test_one_stray_pixel_of_a_mask_is_no_part() -> None:
    depth = np.zeros((60, 60), np.uint16)
    depth[20:50, 10:50] = 400
    depth[4, 30] = 400
    assert not is_parted(depth)
    depth[4, 31] = 400
    assert is_parted(depth)


def test_an_island_in_a_hole_of_the_skin_is_no_part() -> None:
    depth = np.full((80, 80), 400, np.uint16)
    depth[20:60, 20:60] = 0
    depth[38:42, 38:42] = 400
    assert not is_parted(depth)


@pytest.mark.parametrize("preset", ["easy", "field", "harsh"])
def test_no_view_of_a_camera_is_parted_by_itself(preset: str) -> None:
    simulator = ViewSimulator(ViewPlan(SEED, 2, preset))
    views = [view for tuber in range(12) for view in simulator.views(tuber)]
    assert len(views) > 20
    assert not [view.tuber_id for view in views if is_parted(view.depth)], f"seed {SEED}"
