"""A camera that has ended: its final mark, and marks while views are still weighed, which pass nothing that waits."""

from __future__ import annotations

from dataclasses import replace

from conveyor.messages import Mark, Track, TrackEntry, View
from segmenter.camera_run import CameraRun
from tests.segmenter.segmenter_scene import Body, Scene, scattered
from tests.segmenter.test_segmenter_camera_run import SETTINGS, entries, info, weight

FRAMES = 110


def test_an_empty_recording_ends_with_a_final_mark() -> None:
    run = CameraRun("front", "r1", SETTINGS, None)
    run.open()
    scene = Scene([Body(-3.0, 0.0)])
    for i in range(4):
        run.frame(scene.frame(i, i * 0.01), i / 30)
    run.info(info(last_seq=3), 1.0)
    run.tick(1.0, set())
    mark = run.log.last_mark
    assert isinstance(mark, Mark)
    assert mark.final
    assert mark.tracks == {"opened": 0, "counted": 0, "open": 0}
    assert not [e for e in entries(run, 1.0) if isinstance(e.track, Track)]


def test_the_ledger_need_not_wait_for_the_last_view() -> None:
    scene = Scene(scattered(33, seed=4), noise_m=0.001)
    run = CameraRun("front", "r1", replace(SETTINGS, max_pending_views=1000), None)
    run.open()
    for seq in range(FRAMES):
        run.frame(scene.frame(seq, 0.0133 * seq), seq / 30)
        run.tick(seq / 30, set())
    run.info(info(last_seq=FRAMES - 1), 4.0)
    log: list[TrackEntry] = []
    sent: list[View] = []
    for turn in range(200):
        sent += [view for _, view in run.tick(4.0 + 0.01 * turn, {"a"})]
        if sent:
            run.weight(weight(sent.pop(0)))
        log += run.log.due(4.0 + 0.01 * turn)
        if log:
            run.log.commit(log[-1].n)
    marks = [(n, entry.mark) for n, entry in enumerate(log) if entry.mark is not None]
    tracks = [(n, entry.track) for n, entry in enumerate(log) if entry.track is not None]
    assert len(tracks) >= 24
    assert marks[-1][1].final
    after_the_end = [mark for n, mark in marks[:-1] if any(at < n for at, _ in tracks)]
    assert len(after_the_end) >= 2
    places = [mark.complete_place_x_m for _, mark in marks]
    assert places == sorted(places, reverse=True)
    for n, track in tracks:
        assert all(mark.complete_place_x_m > track.place_x_m - 0.003 for at, mark in marks if at < n)
        assert all(mark.complete_ns < track.crossed_ns for at, mark in marks if at < n)
