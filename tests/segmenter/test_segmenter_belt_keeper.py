"""The belt in use: given ones stay, unless they are to be followed; what is seen far off is left to the alarm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from segmenter_scene import SMALL, Scene, scattered, tilted

from conveyor.config import parse_config
from conveyor.errors import InputError
from conveyor.geometry import belt_distance_m, straight_down_belt_from_camera
from conveyor.messages import Frame
from segmenter.frame.belt_keeper import BeltKeeper
from segmenter.frame.constants import BELT_PATIENCE, CHECK_EVERY, FITTED_OVER
from segmenter.frame.plane import fit_plane
from segmenter.setup import core_settings

TRUE_M = 0.460


def frames(given_m: float, *, n: int) -> list[Frame]:
    """A belt at `TRUE_M` with tubers, said to lie at `given_m`."""
    scene = Scene(scattered(12, seed=3, spacing_m=0.09), SMALL, noise_m=0.0015, seed=8)
    said = straight_down_belt_from_camera(given_m)
    return [replace(scene.frame(i, 0.2 + 0.002 * i), belt_from_camera=said) for i in range(n)]


def used_m(keeper: BeltKeeper, given_m: float, *, n: int) -> list[float]:
    belts = [keeper.belt_of(frame) for frame in frames(given_m, n=n)]
    return [belt.distance_m for belt in belts if belt is not None]


def test_a_given_belt_stays_as_given_unless_it_is_followed() -> None:
    assert used_m(BeltKeeper(), 0.457, n=5) == [pytest.approx(0.457, abs=1e-9)] * 5


@pytest.mark.parametrize("given_m", [0.456, 0.4585, 0.463])
def test_a_followed_belt_is_where_it_is_seen_from_the_first_frame_on(given_m: float) -> None:
    used = used_m(BeltKeeper(0.006), given_m, n=FITTED_OVER + 3)
    assert used == [pytest.approx(TRUE_M, abs=0.0007)] * len(used)
    assert len(set(used[FITTED_OVER:])) == 1, "between two checks the belt does not move"


def test_what_is_seen_farther_off_than_allowed_is_not_followed_and_alarms() -> None:
    keeper = BeltKeeper(0.006)
    assert used_m(keeper, 0.450, n=2) == [pytest.approx(0.450, abs=1e-9)] * 2
    assert keeper.check.alarm
    assert keeper.check.drift_m == pytest.approx(0.010, abs=0.0007)


def test_the_check_says_how_far_the_calibration_is_off_though_the_belt_is_followed() -> None:
    keeper = BeltKeeper(0.006)
    used_m(keeper, 0.457, n=3)
    assert keeper.check.drift_m == pytest.approx(0.003, abs=0.0007)


def test_a_tilted_belt_keeps_its_tilt_and_gets_the_height_that_is_seen() -> None:
    true = tilted(TRUE_M, 5, -3)
    frame = Scene([], SMALL, true, noise_m=0.001, seed=2).frame(0, 0.0)
    said = true.copy()
    said[2, 3] -= 0.004
    belt = BeltKeeper(0.008).belt_of(replace(frame, belt_from_camera=said))
    assert belt is not None
    np.testing.assert_array_equal(belt.belt_from_camera[:3, :3], true[:3, :3])
    assert belt_distance_m(belt.belt_from_camera) == pytest.approx(belt_distance_m(true), abs=0.0005)


def test_a_full_belt_that_shows_too_little_of_itself_leaves_the_followed_one_as_it_was() -> None:
    keeper = BeltKeeper(0.006)
    before = used_m(keeper, 0.457, n=CHECK_EVERY)[-1]
    full = frames(0.457, n=1)[0]
    rng = np.random.default_rng(9)
    load = replace(full, depth=rng.integers(380, 455, full.depth.shape).astype(np.uint16))
    belt = keeper.belt_of(load)
    assert belt is not None
    assert belt.distance_m == before


def test_the_config_says_how_far_a_belt_may_be_followed() -> None:
    assert core_settings(parse_config({}, where="of the test")).belt_follow_m == pytest.approx(0.006)
    config = parse_config({"segmenter": {"belt_follow_mm": 4}}, where="of the test")
    assert core_settings(config).belt_follow_m == pytest.approx(0.004)


def test_cleats_and_soil_are_not_taken_for_the_belt() -> None:
    """Cleats of 3 mm, as a stereo camera blurs them, on a third of the rows; least squares lies 0.7 mm too near."""
    depth = np.full((SMALL.height, SMALL.width), 4600.0)
    depth[(np.arange(SMALL.height) // 12) % 3 == 0] -= 30
    depth += np.random.default_rng(4).normal(0, 8, depth.shape)
    fit = fit_plane(depth.round().astype(np.uint16), depth_scale_m=0.0001, intrinsics=SMALL)
    assert fit is not None
    assert fit.distance_m == pytest.approx(TRUE_M, abs=0.0003)


def test_a_belt_that_is_known_well_moves_less_and_one_that_is_known_exactly_stays() -> None:
    given_m, sds_m = 0.457, (0.0, 0.0005, 0.002, 0.010)
    moved = [used_m(BeltKeeper(0.006, given_sd_m=sd), given_m, n=FITTED_OVER)[-1] - given_m for sd in sds_m]
    assert moved[0] == pytest.approx(0.0, abs=1e-9)
    assert moved == sorted(moved)
    assert moved[1] == pytest.approx(moved[3] / 2, rel=0.02), "seen and given are known equally well"


def test_a_belt_that_is_seen_now_here_now_there_is_not_followed() -> None:
    keeper, shaken = BeltKeeper(0.006), frames(0.457, n=FITTED_OVER)
    for i, frame in enumerate(shaken):
        shift = 3 if i % 2 else -3
        keeper.belt_of(replace(frame, depth=(frame.depth.astype(np.int32) + shift).astype(np.uint16)))
    assert keeper.belt is not None
    assert keeper.belt.distance_m == pytest.approx(0.457, abs=1e-9)


def covered(frame: Frame, at_m: float) -> Frame:
    """The frame with a board in front of the belt."""
    return replace(frame, depth=np.full(frame.depth.shape, round(at_m / frame.depth_scale_m), np.uint16))


def test_a_board_before_a_belt_in_use_hides_it_until_it_is_seen_again() -> None:
    """A hand, a sheet or a board in front of a running camera ended its segmenter with an error that no one restarts
    (exit code 2), at the next check of the belt."""
    keeper, clear = BeltKeeper(), frames(TRUE_M, n=CHECK_EVERY + 4)
    for frame in clear[:CHECK_EVERY]:
        assert keeper.belt_of(frame) is not None
    for frame in clear[CHECK_EVERY : CHECK_EVERY + 3]:
        assert keeper.belt_of(covered(frame, 0.12)) is None
    assert "calibrated for a belt at 0.460 m, but the belt seen in the frame lies at 0.120 m" in keeper.hidden
    belt = keeper.belt_of(clear[-1])
    assert belt is not None
    assert belt.distance_m == pytest.approx(TRUE_M, abs=1e-9)
    assert keeper.hidden == ""


def test_a_belt_in_use_that_is_said_to_be_elsewhere_stays_hidden_under_load() -> None:
    """A camera that was knocked sees its belt elsewhere now and then, and load all the time: it must not weigh that
    by where its belt was."""
    keeper, knocked = BeltKeeper(), frames(0.42, n=3)
    bare = Scene([], SMALL, noise_m=0.0015).frame(0, 0.0)
    at_first = replace(bare, depth=(bare.depth - 40).astype(np.uint16), belt_from_camera=knocked[0].belt_from_camera)
    assert keeper.belt_of(at_first) is not None
    for _ in range(CHECK_EVERY - 1):
        keeper.belt_of(at_first)
    seen_elsewhere = replace(bare, belt_from_camera=at_first.belt_from_camera)
    assert keeper.belt_of(seen_elsewhere) is None
    rng = np.random.default_rng(9)
    load = replace(at_first, depth=rng.integers(380, 455, bare.depth.shape).astype(np.uint16))
    assert keeper.belt_of(load) is None
    assert keeper.hidden
    assert keeper.belt_of(at_first) is not None


def test_first_looks_that_all_contradict_are_an_error_but_for_a_run_that_goes_on() -> None:
    """A segmenter that was started, or started again, while a board lay there gave up for good."""
    board, bare = covered(frames(TRUE_M, n=1)[0], 0.12), frames(TRUE_M, n=1)[0]
    for looks in (1, BELT_PATIENCE - 1):
        wrong, right = BeltKeeper(), BeltKeeper()
        assert {keeper.belt_of(board) for _ in range(looks) for keeper in (wrong, right)} == {None}
        with pytest.raises(InputError, match=r"lies at 0\.120 m"):
            wrong.finish()
        belt, alone = right.belt_of(bare), BeltKeeper().belt_of(bare)
        right.finish()
        assert belt is not None
        assert alone is not None
        assert np.array_equal(belt.belt_from_camera, alone.belt_from_camera), "a board says nothing of the camera"
    with pytest.raises(InputError, match=r"lies at 0\.120 m"):
        wrong.belt_of(board)
    keeper = BeltKeeper(in_use=True)
    assert keeper.belt_of(board) is None
    assert keeper.belt_of(frames(TRUE_M, n=1)[0]) is not None
    beltless = BeltKeeper(in_use=True)
    nothing = replace(board, depth=np.zeros_like(board.depth), belt_from_camera=None)
    assert {beltless.belt_of(nothing) for _ in range(BELT_PATIENCE + 5)} == {None}
