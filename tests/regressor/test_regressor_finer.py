"""Depth of wide pixels on a finer grid: a plane stays that plane, an outline its area, a tuber its weight."""

from __future__ import annotations

import numpy as np
import pytest

from camera_sim.sim.optics import D405_848
from camera_sim.sim.view_setting import ViewPlan
from camera_sim.sim.views import SimulatedView, ViewSimulator
from conveyor.crop_depth import WIDEST_PIXEL_M
from conveyor.geometry import straight_down_belt_from_camera
from regressor.weigh.finer import MOST_PIXELS, finer, times_finer
from regressor.weigh.prepare import NETWORK_POINTS, PreparedCloud, prepare_depth
from regressor.weigh.weigher import Weigher
from tests.regressor.ellipsoids import ellipsoid_view

SEED = 20261127


@pytest.mark.parametrize("times", [2, 3, 8])
def test_a_plane_stays_that_plane_up_to_its_outermost_pixels(times: int) -> None:
    v, u = np.mgrid[:9, :12]
    seen = np.pad(np.ones((6, 8), np.bool_), ((2, 1), (1, 3)))
    fine = finer(np.where(seen, 0.4 + 0.002 * u - 0.003 * v, 0.0), (times, times))
    v, u = (np.mgrid[: 9 * times, : 12 * times] - (times - 1) / 2) / times  # of each fine pixel among the wide ones
    assert fine.shape == v.shape
    assert np.count_nonzero(fine) == pytest.approx(times**2 * np.count_nonzero(seen), rel=0.01), "corners are rounded"
    between = (v >= 2) & (v <= 7) & (u >= 1) & (u <= 8)
    assert fine[between] == pytest.approx((0.4 + 0.002 * u - 0.003 * v)[between], abs=1e-9)


def test_a_rounded_rim_falls_to_the_belt_where_it_ends() -> None:
    """A ball's upper half, cut off at its equator: height goes with the root of the distance from the outline."""
    radius, times = 9.0, 8

    def ball(wide: int) -> np.ndarray:
        v, u = (np.mgrid[: 24 * wide, : 24 * wide] - (wide - 1) / 2) / wide - 11.3
        square = radius**2 - v**2 - u**2
        return np.where(square > 0, 0.4 - 0.003 * np.sqrt(np.maximum(square, 0.0)), 0.0)

    told, true = finer(ball(1), (times, times)), ball(times)
    both = (told > 0) & (true > 0)
    assert np.count_nonzero(told) == pytest.approx(np.count_nonzero(true), rel=0.02)
    rim = both & (true > 0.4 - 0.003 * 3)
    assert np.abs((told - true)[rim]).mean() < 0.002, "of pixels of 3 mm, in which it falls by 13 mm"


def test_pixels_of_the_training_stay_as_they_are_and_what_is_no_tuber_too() -> None:
    assert times_finer(WIDEST_PIXEL_M, 4000) == (1, 1)
    assert times_finer(1.01 * WIDEST_PIXEL_M, 4000) == (2, 2)
    assert times_finer(20.0, 4000) == (8, 8)
    assert times_finer(20.0, MOST_PIXELS) == (1, 1)
    assert times_finer(WIDEST_PIXEL_M, 4000, longer=1.4) == (1, 1)
    assert times_finer(1.01 * WIDEST_PIXEL_M, 4000, longer=3.0) == (6, 2)
    assert times_finer(WIDEST_PIXEL_M, 4000, longer=0.5) == (1, 2)


def test_few_wide_pixels_weigh_what_many_do() -> None:
    """Of pixels of 2 and 4 mm the weights were 0.4 and 6.9 % less in the mean, and scattered by 4 and 6 %."""
    weigher = Weigher.load()
    simulator = ViewSimulator(ViewPlan(SEED, 1, "easy", optics=D405_848, distances_m=(0.46,)))
    apart = []
    for number in range(20):
        for view in simulator.views(number):
            ln_g = [np.log(weigher.weigh(every(view, times)).weight_g) for times in (1, 2, 4)]
            apart.append([ln_g[1] - ln_g[0], ln_g[2] - ln_g[0]])
    assert np.abs(np.mean(apart, axis=0)).max() < 0.04, f"seed {SEED}: {np.mean(apart, axis=0)}"
    assert np.std(apart, axis=0).max() < 0.03, f"seed {SEED}: {np.std(apart, axis=0)}"


def test_how_few_were_measured_is_still_said() -> None:
    pixels = ellipsoid_view().depth[::7, ::7]
    assert np.count_nonzero(pixels) < NETWORK_POINTS
    k = ellipsoid_view().intrinsics
    few = prepare_depth(
        pixels,
        depth_scale_m=0.001,
        fx=k.fx / 7,
        fy=k.fy / 7,
        cx=k.cx / 7,
        cy=k.cy / 7,
        belt_from_camera=straight_down_belt_from_camera(0.345),
    )
    assert len(few.points) > NETWORK_POINTS
    assert few.flags == ("few_points",)


@pytest.mark.parametrize("longer", [2, 3])
def test_pixels_that_are_longer_than_wide_weigh_what_square_ones_do(longer: int) -> None:
    """The outline's distance is counted in pixels: such a camera's tubers were weighed 10 and 11 % heavy."""
    weigher, view = Weigher.load(), ellipsoid_view()
    k = view.intrinsics
    told = [
        weigher.weigh(
            prepare_depth(
                view.depth[::rows],
                depth_scale_m=0.001,
                fx=k.fx,
                fy=k.fy / rows,
                cx=k.cx - view.u0,
                cy=(k.cy - view.v0) / rows,
                belt_from_camera=straight_down_belt_from_camera(0.345),
            )
        ).weight_g
        for rows in (1, longer)
    ]
    assert told[1] == pytest.approx(told[0], rel=0.02)


def every(view: SimulatedView, times: int) -> PreparedCloud:
    """The cloud of a camera that has every so many-th pixel of a view alone."""
    k = view.intrinsics
    return prepare_depth(
        view.depth[::times, ::times],
        depth_scale_m=view.depth_scale_m,
        fx=k.fx / times,
        fy=k.fy / times,
        cx=(k.cx - view.u0) / times,
        cy=(k.cy - view.v0) / times,
        belt_from_camera=straight_down_belt_from_camera(view.belt_distance_m),
    )
