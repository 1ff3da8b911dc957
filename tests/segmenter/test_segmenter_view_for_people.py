"""What the segmenter shows to people: the frame, small, with what it thinks of each thing on the belt."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from conveyor.messages import Frame, Picture, Weight
from conveyor.messages.pictures import MAX_PICTURE_BYTES, MOST_OUTLINES
from segmenter.pipeline import Segmenter, Settings
from segmenter.provisional import REMEMBERED, Provisional, ProvisionalWeights
from segmenter.view_for_people import WIDE_PX, jpeg_size, picture_of
from tests.viewer.viewer_line import LENS, crossing_seq, frame, potatoes

TUBERS = potatoes(9, seed=4)
FROM_SEQ = 12


def weight(track: str, grams: float) -> Weight:
    low, high = grams - 10, grams + 10
    return Weight(f"{track}/1", track, "front", "r", 1, "weighed", grams, low, high, "pointraft", "m", (), "r1")


@pytest.fixture(scope="module")
def seen() -> tuple[Segmenter, Frame]:
    """A segmenter after the first tuber was counted and before the others were, with its newest frame."""
    core = Segmenter(Settings())
    for seq in range(FROM_SEQ, crossing_seq(TUBERS[0]) + 14):
        newest = frame(seq, TUBERS)
        core.step(newest)
    return core, newest


def shown(core: Segmenter, newest: Frame, weights: ProvisionalWeights | None = None, *, drop: str = "") -> Picture:
    picture = picture_of(
        newest,
        belt=core.belt,
        instances=None if drop else core.instances,
        found=core.found,
        weights=weights or ProvisionalWeights(),
        drop=drop,
    )
    assert picture is not None
    picture.check()
    return picture


def test_what_lies_on_the_belt_is_outlined_with_state_and_weight(seen: tuple[Segmenter, Frame]) -> None:
    core, newest = seen
    weights = ProvisionalWeights()
    counted = [track for track, _ in core.found if track.state == "counted"]
    assert counted
    for grams in (180.0, 400.0, 190.0):
        weights.add(weight(counted[0].track_id(newest.run, newest.camera), grams))
    picture = shown(core, newest, weights)
    assert core.instances is not None
    assert len(picture.outlines) == len(core.instances) >= 3
    states = [outline.state for outline in picture.outlines]
    assert states.count("counted") == len(counted)
    assert "seen" in states
    assert sorted(o.weight_g for o in picture.outlines if o.weight_g is not None) == [190.0]
    for index, outline in enumerate(picture.outlines):
        corners = np.array(outline.corners).reshape(-1, 2)
        middle = core.instances.centroid_px[index] * picture.width / LENS.width
        assert cv2.pointPolygonTest(corners.astype(np.int32), tuple(middle.tolist()), False) > 0


def test_the_picture_is_small_and_shows_tubers_brighter_than_the_belt(seen: tuple[Segmenter, Frame]) -> None:
    core, newest = seen
    picture = shown(core, newest)
    image = cv2.imdecode(picture.jpeg, cv2.IMREAD_GRAYSCALE)
    assert image is not None
    assert image.shape == (picture.height, picture.width)
    assert picture.width <= WIDE_PX
    assert len(picture.encode()) < 25_000
    assert core.instances is not None
    labels = cv2.resize(core.instances.labels.astype(np.float32), image.shape[::-1], interpolation=cv2.INTER_NEAREST)
    assert image[labels > 0].mean() > 2 * image[labels == 0].mean()


def test_colours_of_the_camera_are_shown_where_they_are_its_own(seen: tuple[Segmenter, Frame]) -> None:
    core, newest = seen
    green = np.zeros((LENS.height, LENS.width, 3), np.uint8)
    green[..., 1] = 200
    _, data = cv2.imencode(".jpg", green)
    jpeg = np.asarray(data, np.uint8).ravel()
    assert jpeg_size(jpeg) == (LENS.width, LENS.height)
    image = cv2.imdecode(shown(core, replace(newest, color_jpeg=jpeg)).jpeg, cv2.IMREAD_COLOR)
    assert image is not None
    assert image[..., 1].mean() > 190
    other = cv2.imencode(".jpg", green[:100])[1]
    for unusable in (np.asarray(other, np.uint8).ravel(), jpeg[:300], jpeg[2:], np.zeros(0, np.uint8)):
        image = cv2.imdecode(shown(core, replace(newest, color_jpeg=unusable)).jpeg, cv2.IMREAD_COLOR)
        assert image is not None
        assert not image[..., 1].mean() > 190, "then its depth is shown"


def test_a_frame_that_is_not_used_is_shown_without_outlines(seen: tuple[Segmenter, Frame]) -> None:
    picture = shown(*seen, drop="blind")
    assert (picture.outlines, picture.drop) == ((), "blind")
    dark = replace(seen[1], depth=np.zeros_like(seen[1].depth))
    before = picture_of(dark, belt=None, instances=None, found=(), weights=ProvisionalWeights())
    assert before is not None


def test_noise_that_cannot_be_made_small_is_left_out_and_weights_have_an_end() -> None:
    rng = np.random.default_rng(5)
    depth = rng.integers(0, 9000, (LENS.height, LENS.width), dtype=np.uint16)
    noise = replace(frame(0, TUBERS), depth=depth)
    picture = picture_of(noise, belt=None, instances=None, found=(), weights=ProvisionalWeights())
    assert picture is None or picture.jpeg.size <= MAX_PICTURE_BYTES
    weights = ProvisionalWeights()
    for n in range(REMEMBERED + 3):
        weights.add(weight(f"r/front/{n}", 100.0))
    assert (weights.of("r/front/2"), weights.of("r/front/3")) == (None, Provisional(100.0, 90.0, 110.0))
    assert MOST_OUTLINES >= 128
