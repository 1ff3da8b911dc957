"""A segmenter whose aggregator stays away: its log has an end, and the segmenter goes on without passing it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from conveyor.messages import View
from conveyor.reasons import FrameDrop
from segmenter.camera_run import CameraRun
from tests.segmenter.segmenter_scene import Scene
from tests.segmenter.test_segmenter_camera_run import BODIES, FRAMES, LIVE_SETTINGS, SETTINGS, STEP_M, weight


@pytest.mark.parametrize("waits", [False, True])
def test_an_aggregator_that_stays_away_ends_no_segmenter(monkeypatch: pytest.MonkeyPatch, waits: bool) -> None:
    """An hour without it filled the log, and the segmenter ended with an error, again at every start."""
    monkeypatch.setattr("segmenter.tracklog.MAX_UNCOMMITTED", 32)
    monkeypatch.setattr("segmenter.tracklog.NEARLY_FULL", 0.6, raising=False)
    scene = Scene(BODIES, noise_m=0.001)
    frames = [scene.frame(i, i * STEP_M) for i in range(FRAMES)]
    often = replace(SETTINGS if waits else LIVE_SETTINGS, mark_every_ns=60_000_000, replays=waits)
    run = CameraRun("front", "r1", often, None)
    run.open()
    sent, given = 0, 0
    for i in range(4 * FRAMES):
        if sent < FRAMES and (not waits or sent <= run.progress().done_seq + often.window):
            run.frame(frames[sent], i / 30)
            sent += 1
        given += len(answer_all(run, i / 30))
    assert given > 0
    assert 20 <= run.log.uncommitted <= 32
    left_out = run.counts()["frames"].get(f"dropped_{FrameDrop.BEHIND}", 0)
    if waits:
        assert sent < FRAMES, "its camera is held back"
        assert left_out == 0
    else:
        assert sent == FRAMES
        assert left_out > 10
    run.log.commit(run.log.newest)
    before = run.frames.processed
    run.frame(replace(frames[-1], seq=sent), 99.0)
    assert run.frames.processed == before + 1, "it goes on as soon as the log is taken"


def answer_all(run: CameraRun, now_s: float) -> list[View]:
    """Every view that is due is answered at once."""
    due = run.tick(now_s, {"a"})
    for name, view in due:
        run.weight(weight(view, regressor=name))
    return [view for _, view in due]
