"""One camera's run without sockets: what is logged, what the marks promise, and how a killed process is followed."""

from __future__ import annotations

import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from segmenter_scene import SMALL, Scene, scattered

from conveyor.geometry import straight_down_belt_from_camera
from conveyor.messages import CameraInfo, Frame, Mark, TrackEntry, View, Weight
from conveyor.reasons import FrameDrop
from segmenter.camera_run import CameraRun, RunSettings
from segmenter.dispatch.dispatcher import DispatchSettings
from segmenter.pipeline import Settings

STEP_M = 0.0133
BODIES = scattered(12, seed=3)
FRAMES = 62
RUN_FPS = 30
SETTINGS = RunSettings(
    core=Settings(), dispatch=DispatchSettings(), weigh_deadline_s=30.0, max_pending_views=100, window=4
)
KILLED_AFTER = (20, *range(29, 37), 45)
LIVE_SETTINGS = replace(SETTINGS, dispatch=DispatchSettings(shed_over=256))
"""Of a live line, whose first views go first: what passes while a process is dead does not come again."""


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    scene = Scene(BODIES, noise_m=0.001)
    return [scene.frame(i, i * STEP_M) for i in range(FRAMES)]


def info(*, state: str = "ended", last_seq: int = FRAMES - 1, waits: bool = True) -> CameraInfo:
    return CameraInfo("front", "r1", state, "test", 30.0, waits, SMALL, 0.001, 0, last_seq, last_seq + 1, {})  # type: ignore[arg-type]


def weight(view: View, grams: float = 100.0, regressor: str = "a") -> Weight:
    return Weight(
        view.view_id,
        view.track_id,
        "front",
        "r1",
        view.seq,
        "weighed",
        grams,
        90.0,
        110.0,
        "pointraft",
        "m",
        (),
        regressor,
    )


def entries(run: CameraRun, now_s: float = 0.0) -> list[TrackEntry]:
    run.log.resend()
    return run.log.due(now_s)


def play(run: CameraRun, frames: list[Frame], *, names: set[str], start_s: float = 0.0) -> list[View]:
    """Frames in, every view answered at once; returns the views."""
    views = []
    for i, frame in enumerate(frames):
        run.frame(frame, start_s + i / 30)
        for name, view in run.tick(start_s + i / 30, names):
            views.append(view)
            run.weight(weight(view, regressor=name))
    return views


def finish(run: CameraRun, now_s: float, names: set[str], **of_info: int) -> list[View]:
    views = []
    run.info(info(**of_info), now_s)
    for _ in range(200):
        for name, view in run.tick(now_s, names):
            views.append(view)
            run.weight(weight(view, regressor=name))
    return views


def test_the_log_holds_every_tuber_once_with_its_weights_and_a_final_mark(frames: list[Frame]) -> None:
    run = CameraRun("front", "r1", SETTINGS, None)
    run.open()
    views = play(run, frames, names={"a", "b"}) + finish(run, 3.0, {"a", "b"})
    log = entries(run, 3.0)
    assert [e.n for e in log] == list(range(1, len(log) + 1))
    tracks = [e.track for e in log if e.track is not None]
    marks = [e.mark for e in log if e.mark is not None]
    assert len(tracks) == len(BODIES)
    assert len({t.track_id for t in tracks}) == len(BODIES)
    assert all(t.views_sent == len(t.views) == 3 and t.views[0].weight_g == 100.0 for t in tracks)
    assert len(views) == 3 * len(BODIES)
    last = marks[-1]
    assert last.final
    assert log[-1].mark == last
    assert last.frames["published"] == last.frames["received"] == last.frames["processed"] == FRAMES
    assert last.views == {"sent": 36, "weighed": 36, "outstanding": 0}
    assert last.tracks["counted"] == len(BODIES)
    assert last.looked_at_m == last.travelled_m == pytest.approx((FRAMES - 1) * STEP_M)


def test_what_is_refused_as_no_tuber_is_logged_as_what_it_is(frames: list[Frame]) -> None:
    """All that the classifier was asked about is refused here; no one weighs it, and each is in the log once."""
    core = replace(SETTINGS.core, count=replace(SETTINGS.core.count, reject_below=1e6))
    run = CameraRun("front", "r1", replace(SETTINGS, core=core), None)
    with run.log:
        views = play(run, frames, names={"a"})
        views += finish(run, 2.1, {"a"})
        log = entries(run)
    tracks = [entry.track for entry in log if entry.track is not None]
    last = log[-1].mark
    assert last is not None
    assert last.final
    clods = [track for track in tracks if track.kind == "lump"]
    assert len(clods) == last.tracks["foreign"] == last.tracks["discarded_distractor"] > 0
    assert len(tracks) == last.tracks["foreign"] + last.tracks["counted"] == len(BODIES)
    assert all(t.log_odds is not None and t.views == () and t.views_sent == 0 for t in clods)
    assert all(t.visible_volume_ml > 10 and t.length_mm >= t.width_mm > 20 for t in clods)
    assert len(views) == 3 * (len(tracks) - len(clods))
    opened = last.tracks["counted"] + last.tracks["open"] + last.tracks["discarded_distractor"]
    assert last.tracks["opened"] >= opened


def test_marks_never_promise_what_a_later_entry_breaks(frames: list[Frame]) -> None:
    run = CameraRun("front", "r1", SETTINGS, None)
    run.open()
    held: list[tuple[str, View]] = []
    for i, frame in enumerate(frames):
        run.frame(frame, i / 30)
        held += run.tick(i / 30, {"a"})
        if i % 7 == 0 and held:
            name, view = held.pop(0)
            run.weight(weight(view, regressor=name))
    run.info(info(), 3.0)
    for i in range(300):
        held += run.tick(3.0 + i * 0.001, {"a"})
        if held:
            name, view = held.pop(0)
            run.weight(weight(view, regressor=name))
    promised_ns, promised_place_m = -1, np.inf
    for entry in entries(run, 4.0):
        if entry.mark is not None:
            assert entry.mark.complete_ns >= promised_ns
            assert entry.mark.complete_place_x_m <= promised_place_m
            promised_ns, promised_place_m = entry.mark.complete_ns, entry.mark.complete_place_x_m
        if entry.track is not None:
            assert entry.track.crossed_ns > promised_ns
            assert entry.track.place_x_m < promised_place_m
    assert run.log.last_mark is not None
    assert run.log.last_mark.final


def test_frames_balance_with_gaps_duplicates_and_drops(frames: list[Frame]) -> None:
    run = CameraRun("front", "r1", SETTINGS, None)
    run.open()
    for i, frame in enumerate(frames[:40]):
        if i in (5, 6, 20):
            continue
        run.frame(frame, i / 30, drop=FrameDrop.TOO_OLD if i in (9, 10) else None)
        run.frame(frame, i / 30)
    run.info(info(last_seq=42, waits=False), 1.4)
    assert not run.ended
    run.info(info(last_seq=42, waits=False), 4.0)
    assert run.ended
    report = run.frames.report()
    assert report == {"published": 43, "received": 37, "processed": 35, "gaps": 6, "dropped_too_old": 2}
    assert run.frames.duplicates == 37


def test_progress_is_held_while_too_many_views_wait(frames: list[Frame]) -> None:
    run = CameraRun("front", "r1", replace(SETTINGS, max_pending_views=15), None)
    run.open()
    assert run.progress().done_seq == -1
    done = []
    for i, frame in enumerate(frames):
        run.frame(frame, i / 30)
        run.tick(i / 30, set())
        done.append(run.progress().done_seq)
    assert done[10] == 10
    assert done[-1] < FRAMES - 1
    for i in range(60):
        for name, view in run.tick(3.0 + i * 0.01, {"a"}):
            run.weight(weight(view, regressor=name))
    assert run.progress().done_seq == FRAMES - 1


def test_without_a_regressor_tubers_are_logged_after_the_deadline_with_the_reason(frames: list[Frame]) -> None:
    run = CameraRun("front", "r1", replace(SETTINGS, weigh_deadline_s=5.0), None)
    run.open()
    play(run, frames, names=set())
    finish(run, 3.0, set())
    assert not [e for e in entries(run, 3.0) if e.track is not None]
    run.tick(9.0, set())
    tracks = [e.track for e in entries(run, 9.0) if e.track is not None]
    assert len(tracks) == len(BODIES)
    assert all(t.views == () and t.views_lost == {"weigh_deadline": 3} and t.visible_volume_ml > 20 for t in tracks)
    assert run.log.last_mark is not None
    assert run.log.last_mark.views == {"sent": 36, "weighed": 0, "outstanding": 0, "lost_weigh_deadline": 36}


def test_a_refused_view_is_lost_with_the_regressors_reason(frames: list[Frame]) -> None:
    run = CameraRun("front", "r1", SETTINGS, None)
    run.open()
    for i, frame in enumerate(frames):
        run.frame(frame, i / 30)
        for name, view in run.tick(i / 30, {"a"}):
            answer = weight(view, regressor=name)
            if view.rank == 1:
                answer = replace(answer, status="refused", weight_g=None, low_g=None, high_g=None, reason="few_points")
            run.weight(answer)
    tracks = [e.track for e in entries(run, 3.0) if e.track is not None]
    assert tracks
    assert all(t.views_lost == {"refused_few_points": 1} and len(t.views) == 2 for t in tracks)


def test_a_regressor_that_never_refuses_twice_for_one_reason_ends_no_camera(
    frames: list[Frame], tmp_path: Path
) -> None:
    """One that was brought puts numbers into its words: 300 of them made a mark that no one could send."""
    refused = 0
    for process in range(2):
        run = CameraRun("front", "r1", LIVE_SETTINGS, tmp_path / "front.db")
        run.open()
        views = play(run, frames[process * 31 :][:31], names={"a"})
        for n in range(150):
            view_id = f"{process}-{n}"
            run.dispatcher.offer(replace(views[0], view_id=view_id, track_id=view_id), now_s=1.0)
        for _ in range(150):
            for name, view in run.tick(1.0, {"a"}):
                refused += 1
                answer = weight(view, regressor=name)
                answer = replace(answer, status="refused", weight_g=None, low_g=None, high_g=None)
                run.weight(replace(answer, reason=f"{refused + 70} of 300 points"))
        if process == 0:
            run.log.append([run._mark(final=False)])  # what its successor goes on with
    finish(run, 3.0, {"a"})
    mark = run.log.last_mark
    assert mark is not None
    assert mark.final
    for entry in entries(run, 3.0):
        assert TrackEntry.decode(entry.encode()) == entry
    reasons = {name: n for name, n in mark.views.items() if name.startswith("lost_refused_")}
    assert refused == sum(reasons.values()) >= 300
    assert reasons["lost_refused_71 of 300 points"] == 1
    assert reasons["lost_refused_other"] == refused - 64
    assert len(reasons) == 65


@pytest.fixture(scope="module", params=[SETTINGS, LIVE_SETTINGS], ids=["tuber by tuber", "first views first"])
def killed(
    request: pytest.FixtureRequest, frames: list[Frame], tmp_path_factory: pytest.TempPathFactory
) -> tuple[RunSettings, Path]:
    """What lies on the disk after each number of frames in `KILLED_AFTER`: of one process, where it would be killed."""
    settings: RunSettings = request.param
    (disk := tmp_path_factory.mktemp("killed") / "disk").mkdir()
    run = CameraRun("front", "r1", settings, disk / "front.db")
    run.open()
    for done, after in pairwise((0, *KILLED_AFTER)):
        play(run, frames[done:after], names={"a"}, start_s=done / 30)
        shutil.copytree(disk, disk.with_name(str(after)))
    return settings, disk.parent


@pytest.mark.parametrize("killed_after", KILLED_AFTER)
def test_a_killed_process_is_followed_without_a_tuber_lost_or_renumbered(
    frames: list[Frame], killed: tuple[RunSettings, Path], killed_after: int
) -> None:
    """Also where a mark ended right before a tuber that its successor saw a millimetre elsewhere: it was lost."""
    settings, left = killed
    second = CameraRun("front", "r1", settings, left / str(killed_after) / "front.db")
    second.open()
    behind = second.progress().done_seq
    assert behind <= killed_after
    play(second, frames[killed_after:], names={"a"}, start_s=5.0)
    finish(second, 9.0, {"a"})
    log = entries(second, 9.0)
    assert [e.n for e in log] == list(range(1, len(log) + 1))
    places = np.array([[e.track.place_x_m, e.track.y_m] for e in log if e.track is not None])
    gaps = np.hypot(*(np.array([[b.place_x_m, b.y_m] for b in BODIES])[:, None] - places[None]).transpose(2, 0, 1))
    assert gaps.min(axis=1).max() < 0.003, "a tuber was lost with the process"
    assert gaps.min(axis=0).max() < 0.003, "something else was counted"
    mark = second.log.last_mark
    assert mark is not None
    assert mark.final
    assert mark.frames["published"] == FRAMES
    assert mark.frames["received"] + mark.frames["gaps"] == FRAMES
    assert mark.travelled_m == pytest.approx((FRAMES - 1) * STEP_M, abs=1e-6)
    lost = sum(n for name, n in mark.views.items() if name.startswith("lost_"))
    assert mark.views["sent"] == mark.views["weighed"] + lost + mark.views["outstanding"]
    gone = sum(n for name, n in mark.tracks.items() if name.startswith("discarded_"))
    assert mark.tracks["opened"] == mark.tracks["counted"] + gone + mark.tracks["open"]


def test_silence_makes_no_gap_where_the_camera_waits(frames: list[Frame]) -> None:
    """A busy machine or a cut link kept a frame away for 2 s and it was given up, though the camera sends it again."""
    run = CameraRun("front", "r1", SETTINGS, None)
    run.open()
    run.frame(frames[0], 0.0)
    for now_s in (1.0, 30.0):
        run.info(info(state="streaming", last_seq=1), now_s)
        assert run.progress().done_seq == 0
    run.frame(frames[1], 30.1)
    assert run.progress().done_seq == 1
    assert run.frames.gaps == 0


def test_a_restarted_segmenter_does_not_end_before_the_replay_has_come_back(frames: list[Frame]) -> None:
    run = CameraRun("front", "r1", replace(SETTINGS, replays=True), None)
    run.open()
    run.info(info(), 0.0)
    run.info(info(), 10.0)
    assert not run.ended
    play(run, frames, names={"a"}, start_s=10.0)
    run.info(info(), 13.0)
    assert run.ended
    assert run.frames.gaps == 0


def test_a_replay_ends_though_its_last_frames_could_not_be_read(frames: list[Frame]) -> None:
    run = CameraRun("front", "r1", SETTINGS, None)
    run.open()
    play(run, frames[:-2], names={"a"})
    ended = replace(info(), published=FRAMES - 2, refused={"damaged": 2})
    run.info(ended, 2.1)
    assert not run.ended
    run.info(ended, 5.0)
    assert run.ended
    assert run.frames.gaps == 2


def test_a_live_camera_that_failed_comes_back_to_its_run(frames: list[Frame]) -> None:
    """A device that was away for a while closed its run: no frame of it was taken after that."""
    run = CameraRun("front", "r1", SETTINGS, None)
    run.open()
    play(run, frames[:30], names={"a"})
    failed = replace(info(state="failed", last_seq=29, waits=False), live=True)
    run.info(failed, 60.0)
    assert not run.ended
    play(run, frames[40:], names={"a"}, start_s=61.0)
    assert (run.frames.processed, run.frames.gaps) == (FRAMES - 10, 10)


def killed_and_back(
    frames: list[Frame], tmp_path: Path, *, killed_after: int, back_at: int, answered: int = FRAMES
) -> tuple[list[TrackEntry], Mark]:
    """A process that dies after `killed_after` frames, of which `answered` had answers, and one that begins later."""
    path = tmp_path / "front.db"
    first = CameraRun("front", "r1", LIVE_SETTINGS, path)
    first.open()
    answered = min(answered, killed_after)
    play(first, frames[:answered], names={"a"})
    play(first, frames[answered:killed_after], names=set(), start_s=answered / 30)
    second = CameraRun("front", "r1", LIVE_SETTINGS, path)
    second.open()
    play(second, frames[back_at:], names={"a"}, start_s=back_at / 30)
    finish(second, 9.0, {"a"}, last_seq=frames[-1].seq)
    mark = second.log.last_mark
    assert mark is not None
    return entries(second, 9.0), mark


@pytest.mark.parametrize("row_x_m", [-0.3, 0.0, 0.3])
def test_a_camera_up_or_down_the_belt_goes_on_where_it_was(tmp_path: Path, row_x_m: float) -> None:
    """Only a camera whose centre row lies at x = 0 went on where it was; others lost tubers or logged them twice."""
    pose = straight_down_belt_from_camera(0.46)
    pose[0, 3] += row_x_m
    bodies = [replace(body, place_x_m=body.place_x_m + row_x_m) for body in BODIES]
    scene = Scene(bodies, noise_m=0.001, belt_from_camera=pose)
    frames = [scene.frame(i, i * STEP_M) for i in range(FRAMES)]
    log, _ = killed_and_back(frames, tmp_path, killed_after=33, back_at=33)
    places = [(t.place_x_m, t.y_m) for e in log if (t := e.track) is not None]
    for body in bodies:
        near = [p for p in places if np.hypot(p[0] - body.place_x_m, p[1] - body.y_m) < 0.005]
        assert 1 <= len(near) <= 2, (body, places)


@pytest.mark.parametrize("answered", [20, 33, 50])
def test_what_the_sheet_calls_counted_is_in_the_log(frames: list[Frame], tmp_path: Path, answered: int) -> None:
    """Tracks that waited for weights when their process died were counted and in no log: the audit did not balance."""
    log, mark = killed_and_back(frames, tmp_path, killed_after=50, back_at=58, answered=answered)
    assert mark.tracks["counted"] == len([e for e in log if e.track is not None])
    assert mark.tracks["open"] == mark.views["outstanding"] == 0
    gone = sum(n for name, n in mark.tracks.items() if name.startswith("discarded_"))
    assert mark.tracks["opened"] == mark.tracks["counted"] + gone
    lost = sum(n for name, n in mark.views.items() if name.startswith("lost_"))
    assert mark.views["sent"] == mark.views["weighed"] + lost
    assert mark.views["weighed"] == sum(len(e.track.views) for e in log if e.track is not None)
