"""Tubers that a side of the image cuts: their own centre where their outline tells it, one track, counted by it."""

from __future__ import annotations

import numpy as np
import pytest
from segmenter_scene import MEDIUM, Body, Scene

from conveyor.geometry import straight_down_belt_from_camera
from conveyor.reasons import TrackRefusal
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.heights import height_map
from segmenter.frame.instances import Instances, SplitSettings, split
from segmenter.frame.sides import with_own_centres
from segmenter.track.counting import CountSettings, crossing, refusal
from segmenter.track.history import TravelHistory
from segmenter.track.track import TrackState
from segmenter.track.tracker import Tracker, TrackSettings

BELT = BeltGeometry(MEDIUM, straight_down_belt_from_camera(0.46))
SIDE_M = 0.424
"""So far across the image ends for the middle of a tuber of 54 mm."""
STEP_M = 0.02


def instance(x_m: float, y_m: float, *, part: bool) -> Instances:
    """One instance as large as an ordinary tuber, cut by the right side; `part` as there."""
    return Instances(
        labels=np.zeros((240, 424), np.int32),
        stride=2,
        centre_m=np.array([[x_m, y_m]]),
        centroid_px=np.zeros((1, 2)),
        area_m2=np.array([4.2e-3]),
        volume_m3=np.array([150e-6]),
        height_m=np.array([0.054]),
        cut=np.array([[False, False, False, True]]),
        part=np.array([part]),
        box=np.zeros((1, 4), np.int64),
        contact=np.array([0.0]),
        refused={},
    )


def followed(y_m: float, part_y_m: float, parts: str) -> tuple[Tracker, TravelHistory, float]:
    """A tuber at `y_m` over a moving belt; in each frame '.' its own centre is known, 'p' that of the part seen."""
    tracker, history, travel_m = Tracker(BELT, TrackSettings(), (0.0,)), TravelHistory(), 0.0
    for seq, kind in enumerate(parts):
        travel_m = seq * STEP_M
        moved = history.step(seq * 50_000_000, travel_m)
        seen = instance(-0.15 + travel_m, part_y_m if kind == "p" else y_m, part=kind == "p")
        pairs = tracker.match(seen, travel_m)
        tracker.update(seq, seen, pairs, travel_m, moved=moved, travel_before_m=travel_m - STEP_M)
    return tracker, history, travel_m


def counted(tracker: Tracker, history: TravelHistory, travel_m: float) -> tuple[TrackState, float, TrackRefusal | None]:
    (track,) = tracker.tracks
    at = crossing(track, tracker, history)
    return track, at.y_m, refusal(track, at, tracker, history, CountSettings(), travel_m)


@pytest.mark.parametrize("parts", ["ppppp..pp......p...pp.pp", "........pppppp..........", "p.p.p.p.p.p.p.p.p.p.p.p."])
def test_a_tuber_whose_centre_is_known_now_and_then_is_one_track(parts: str) -> None:
    """Its centre jumped by 29 mm, a second track was opened, and it counted twice: two of 960 tubers did."""
    track, y_m, reason = counted(*followed(0.396, 0.367, parts))
    assert len(track.hits) == len(parts)
    assert (y_m, reason) == (pytest.approx(0.396), None)


def test_a_tuber_that_never_shows_its_centre_counts_where_it_is_seen() -> None:
    _, y_m, reason = counted(*followed(0.396, 0.367, "p" * 24))
    assert (y_m, reason) == (pytest.approx(0.367), None)


@pytest.mark.parametrize("parts", ["." * 24, "pp..ppp.pppp.ppp..pppp.p"])
def test_a_tuber_whose_centre_lies_beyond_the_side_is_another_camera_s(parts: str) -> None:
    """Parts of it lie inside the image whatever it is; with their places it counted here, too."""
    _, y_m, reason = counted(*followed(SIDE_M + 0.006, SIDE_M - 0.02, parts))
    assert (y_m, reason) == (pytest.approx(SIDE_M + 0.006), TrackRefusal.OUTSIDE)


def test_an_outline_that_is_free_on_three_sides_tells_the_centre() -> None:
    bodies = [Body(-0.1, 0.400), Body(0.0, -0.405), Body(0.1, 0.45, 0.022, 0.06), Body(0.02, 0.1)]
    scene = Scene(bodies, MEDIUM, BELT.belt_from_camera)
    depth, _ = scene.render(0.0)
    found = split(height_map(depth, depth_scale_m=0.001, belt=BELT, pixel_mm=1.45), BELT, SplitSettings())
    whole = with_own_centres(found, BELT)
    by_place = {int(np.argmin(np.hypot(*(found.centre_m - [b.place_x_m, b.y_m]).T))): b for b in bodies}
    assert len(by_place) == len(bodies)
    for index, body in by_place.items():
        told = np.hypot(*(whole.centre_m[index] - [body.place_x_m, body.y_m]))
        if body.b_m == 0.06:  # it lies across, and its centre is farther off than its outline can tell
            assert whole.part[index]
            assert (whole.centre_m[index] == found.centre_m[index]).all()
        else:
            assert not whole.part[index]
            assert told < 0.004
            assert found.part[index] == found.cut[index].any() == (body.y_m != 0.1)
