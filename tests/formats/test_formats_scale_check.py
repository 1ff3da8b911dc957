"""A depth scale is judged by where the belt is said to be, also where only the rods of a web lie there."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest

from conveyor.errors import InputError
from conveyor.formats import Refused, open_source, scale_check
from conveyor.formats.scale_check import ENOUGH_FIT, ScaleCheck, median_depth_m
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame

BELT_M, GROUND_M = 0.46, 0.62


def web(rods: int) -> Frame:
    """A frame of 100 rows: so many of rods at the belt, the ground between them."""
    depth = np.full((100, 100), round(GROUND_M / 0.001), dtype=np.uint16)
    depth[:rods] = round(BELT_M / 0.001)
    return Frame("c", "r", 0, 0, None, 0.001, Intrinsics(100, 100, 90.0, 90.0, 50.0, 50.0), BELT_M, depth)


def test_rods_where_the_belt_is_said_to_be_are_enough() -> None:
    assert ScaleCheck("web").refusal(web(12)) is None
    refused = ScaleCheck("ground alone").refusal(web(0))
    assert refused is not None
    assert re.search(r"median depth is 0\.62 m but the belt is said to be 0\.46 m", refused.text)


@pytest.mark.parametrize(("blocked", "refused"), [([0], {0}), (range(9), set(range(9))), ([1, 3, 5], {1, 3})])
def test_a_view_that_is_blocked_at_the_start_is_no_wrong_scale(
    small_recording: Path, blocked: Iterable[int], refused: set[int]
) -> None:
    """One saturated picture, the first, and a whole recording was refused for its depth unit."""
    block(small_recording, blocked)
    source = open_source(small_recording)
    items = list(source.frames(run="x"))
    assert {item.seq for item in items if isinstance(item, Refused) and item.reason == "depth_scale"} == refused
    assert len(items) == len(source.keys())
    block(small_recording, range(10))
    with pytest.raises(InputError, match=r"frame 0: the median depth is 65\.5\d? m .*something is before the camera"):
        list(source.frames(run="x"))


def test_once_frames_have_fitted_no_more_pictures_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """The median of each picture was a quarter of a playing camera's processor time, and nobody asked for it."""
    check, looks = ScaleCheck("web"), 0

    def looked_at(frame: Frame) -> float | None:
        nonlocal looks
        looks += 1
        return median_depth_m(frame)

    monkeypatch.setattr(scale_check, "median_depth_m", looked_at)
    assert [check.refusal(web(100)) for _ in range(9)] == [None] * 9
    assert looks == ENOUGH_FIT


def block(recording: Path, seqs: Iterable[int]) -> None:
    for seq in seqs:
        cv2.imwrite(str(recording / f"front/depth/{seq:06d}.png"), np.full((180, 320), 65535, np.uint16))
