"""Cameras whose depth is matched (`benchmarks/matched*`): what they see lies where it is, and rides with the belt."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.matched import SCENES
from benchmarks.matched_camera import MatchedView, Matcher
from benchmarks.otherworld import chosen
from benchmarks.otherworld_camera import Camera
from benchmarks.otherworld_shapes import Body, tuber
from conveyor.errors import InputError

CAMERA = Camera("cam", width=424, height=240, focal_px=216.0, height_m=0.35)
SEEDS = (3, 4)


@pytest.fixture(scope="module")
def body() -> Body:
    return tuber(np.random.default_rng(SEEDS[0]), "smooth")


def _view(matcher: Matcher) -> MatchedView:
    return matcher.view(CAMERA, np.random.default_rng(SEEDS[1]))


def _seen(view: MatchedView, body: Body, travel_m: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measured and exact depth, metres, and where the tuber is; `travel_m` down the belt."""
    bodies = [(body.vertices_m + np.array([travel_m, 0.03, 0.0]), body.triangles)]
    exact_m, label = view.exact(bodies)
    return view.measured(exact_m, label, bodies, travel_m) * view.matcher.unit_m, exact_m, label > 0


@pytest.mark.parametrize(
    ("matcher", "most_mm"),
    [(Matcher(), 1.5), (Matcher(semi_global=True, window_px=9), 3.0)],
    ids=["windows", "semi-global"],
)
def test_a_surface_is_seen_where_it_is(body: Body, matcher: Matcher, most_mm: float) -> None:
    """A pixel of disparity is 31 mm of depth here; semi-global matching leans towards whole half pixels."""
    seen_m, exact_m, mask = _seen(_view(matcher), body)
    off_mm = 1000 * (seen_m - exact_m)
    for where in (mask, ~mask):
        known = where & (seen_m > 0)
        assert np.count_nonzero(known) > 0.75 * np.count_nonzero(where), SEEDS
        assert abs(float(np.median(off_mm[known]))) < most_mm, SEEDS
    assert 0.2 < float(np.std(off_mm[mask & (np.abs(off_mm) < 10)])) < 5, SEEDS


def test_what_only_the_left_imager_sees_has_no_depth(body: Body) -> None:
    seen_m, exact_m, _ = _seen(_view(Matcher()), body)
    first = int(CAMERA.focal_px * Matcher().baseline_m / exact_m.max()) - 2
    assert first > 5
    assert not seen_m[:, :first].any()


def test_what_matching_does_wrong_stays_on_a_tuber_as_it_passes(body: Body) -> None:
    """Unlike noise, which is drawn for each frame: it follows the texture. One row of the image is 1.6 mm of travel."""
    view = _view(Matcher(noise=1.0))
    rows = 8
    first, then = (_seen(view, body, travel_m) for travel_m in (0.0, rows * CAMERA.height_m / CAMERA.focal_px))
    off = [seen_m - exact_m for seen_m, exact_m, _ in (first, then)]
    belt = [~mask & (seen_m > 0) for seen_m, _, mask in (first, then)]
    both = belt[0][:-rows] & belt[1][rows:]
    same = np.corrcoef(off[0][:-rows][both], off[1][rows:][both])[0, 1]
    assert same > 0.5, SEEDS


def test_the_same_seed_gives_the_same_frame(body: Body) -> None:
    first, second = (_seen(_view(Matcher()), body)[0] for _ in range(2))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, _seen(Matcher().view(CAMERA, np.random.default_rng(9)), body)[0])


def test_an_unknown_recording_is_named() -> None:
    assert [scene.seed - 500 for scene in chosen(SCENES, None, None, 500)] == [scene.seed for scene in SCENES]
    with pytest.raises(InputError, match="scene 'flat' is unknown; known: smooth, mixed"):
        chosen(SCENES, ["flat"], None, 0)
