"""Views weighed before their track is decided: the same tubers by the same views, only sooner."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from conveyor.messages import Frame, Track, TrackInView, TracksInView, View, Weight
from segmenter.camera_run import CameraRun
from segmenter.in_view import tracks_in_view
from segmenter.pipeline import ClosedTrack, Segmenter, Settings, StepResult
from segmenter.sheets import but_zeros
from tests.laws.virtual_overload import _TRACK, CAMERA, LIVE, RUN, MadeUpBelt, _frame, view
from tests.segmenter.segmenter_scene import MEDIUM, Scene, scattered

GRACE_S = 0.15


class ScriptedBelt(MadeUpBelt):
    """Says what the test tells it to say."""

    def __init__(self) -> None:
        super().__init__(1.0)
        self.next = StepResult(0.0, False, 0, ())

    def step(self, frame: Frame) -> StepResult:
        return self.next

    def complete_travel_m(self) -> float:
        return 0.0

    def take_foreign(self) -> tuple[()]:
        return ()


class Line:
    """A live camera's run whose core is scripted, and one regressor that answers when it is told to."""

    def __init__(self, log: Path | None = None) -> None:
        self.belt = ScriptedBelt()
        self.run = CameraRun(CAMERA, RUN, replace(LIVE, spare_grace_s=GRACE_S), log)
        self.run.core = self.belt  # type: ignore[assignment]
        self.run.open()
        self.seq = 0
        self.held: dict[str, View] = {}

    def step(self, now_s: float, *, early: tuple[View, ...] = (), closed: tuple[View, ...] = ()) -> list[str]:
        """One frame and one turn; returns the views that are sent."""
        tracks = (ClosedTrack(replace(_TRACK, track_id=closed[0].track_id), closed),) if closed else ()
        self.belt.next = StepResult(0.0, False, 0, tracks, early=early)
        self.run.frame(_frame(self.seq, self.seq), now_s)
        self.seq += 1
        return self.tick(now_s)

    def tick(self, now_s: float) -> list[str]:
        sent = [view for _, view in self.run.tick(now_s, {"w"})]
        self.held |= {view.view_id: view for view in sent}
        return [view.view_id for view in sent]

    def answer(self, view_id: str, *, refused: bool = False) -> None:
        one = self.held.pop(view_id)
        common = (one.view_id, one.track_id, CAMERA, RUN, one.seq)
        if refused:
            self.run.weight(Weight(*common, "refused", None, None, None, "pointraft", "m", (), "w", "few_points"))
        else:
            self.run.weight(Weight(*common, "weighed", 100.0, 90.0, 110.0, "pointraft", "m", (), "w"))

    def logged(self) -> list[Track]:
        return [entry.track for entry in self.run.log.due(0.0) if entry.track is not None]

    def balanced(self) -> bool:
        views = self.run.counts()["views"]
        return views["sent"] == views["weighed"] + views["outstanding"] + sum(
            n for name, n in views.items() if name.startswith("lost_")
        )


@pytest.mark.parametrize("closes", [True, False])
def test_a_view_counts_once_though_its_process_dies_between_mark_and_track(tmp_path: Path, closes: bool) -> None:
    """What was weighed before the last mark, and was logged after it, counted twice with the next process."""
    first = Line(tmp_path / "front.db")
    first.step(0.0, early=VIEWS[:3])
    first.answer(VIEWS[0].view_id)
    first.answer(VIEWS[1].view_id, refused=True)
    first.seq += 60  # another mark is due, and the next is not
    first.step(2.0)
    first.answer(VIEWS[2].view_id)
    if closes:
        first.step(2.01, closed=VIEWS[:3])
    assert len(first.logged()) == closes
    sheet = but_zeros(Line(tmp_path / "front.db").run.counts()["views"])
    lost = {"lost_refused_few_points": 1, "weighed": 2} if closes else {"lost_restart": 3}
    assert sheet == {"sent": 3, **lost}


VIEWS = tuple(view(1, rank, 0) for rank in range(4))


def test_a_tuber_whose_views_are_answered_is_logged_when_it_closes() -> None:
    line = Line()
    assert line.step(0.0, early=VIEWS[:2]) == [VIEWS[0].view_id, VIEWS[1].view_id]
    for one in VIEWS[:2]:
        line.answer(one.view_id)
    assert line.tick(0.1) == []
    assert line.step(0.3, closed=VIEWS[:2]) == []  # nothing is weighed twice
    (track,) = line.logged()
    assert [found.view_id for found in track.views] == [VIEWS[0].view_id, VIEWS[1].view_id]
    assert (track.views_sent, track.views_lost, line.balanced()) == (2, {}, True)


def test_what_was_not_sent_early_or_not_answered_is_waited_for_as_ever() -> None:
    line = Line()
    line.step(0.0, early=VIEWS[:2])
    line.answer(VIEWS[0].view_id)
    assert line.step(0.3, closed=VIEWS[:3]) == [VIEWS[2].view_id]
    assert line.logged() == []
    line.answer(VIEWS[1].view_id)
    line.answer(VIEWS[2].view_id)
    line.tick(0.31)
    (track,) = line.logged()
    assert [found.view_id for found in track.views] == [found.view_id for found in VIEWS[:3]]


def test_grace_counts_from_the_moment_it_closes() -> None:
    line = Line()
    line.step(0.0, early=VIEWS[:1])
    line.answer(VIEWS[0].view_id)
    line.step(1.0, closed=VIEWS[:2])
    line.tick(1.0 + 0.9 * GRACE_S)
    assert line.logged() == []
    line.tick(1.0 + 1.1 * GRACE_S)
    (track,) = line.logged()
    assert (len(track.views), track.views_lost, line.balanced()) == (1, {"late": 1}, True)


@pytest.mark.parametrize(("answer_s", "sent"), [(0.9 * GRACE_S, 1), (1.1 * GRACE_S, 0)])
def test_no_spare_view_is_weighed_for_nothing(answer_s: float, sent: int) -> None:
    """Answers that take longer than a weighed tuber waits: on a full machine one view in five was weighed too late."""
    line = Line()
    line.step(0.0, early=VIEWS[:1])
    line.tick(answer_s)
    line.answer(VIEWS[0].view_id)
    assert len(line.step(1.0, closed=VIEWS[:2])) == sent
    assert (len(line.logged()), line.run.counts()["views"].get("lost_shed", 0)) == (1 - sent, 1 - sent)
    assert line.balanced()


def test_views_that_are_not_chosen_count_for_nothing_and_are_in_the_books() -> None:
    line = Line()
    line.step(0.0, early=(VIEWS[1], VIEWS[2]))
    line.answer(VIEWS[1].view_id)
    assert line.step(0.3, closed=VIEWS[:1]) == [VIEWS[0].view_id]
    line.answer(VIEWS[0].view_id)
    line.answer(VIEWS[2].view_id)  # it was given up, and its regressor did not know
    line.tick(0.31)
    (track,) = line.logged()
    assert [found.view_id for found in track.views] == [VIEWS[0].view_id]
    assert (track.views_sent, track.views_lost) == (1, {})
    assert (line.run.dispatcher.lost["not_chosen"], line.run.dispatcher.outstanding, line.balanced()) == (1, 0, True)


def test_an_answer_to_a_view_that_is_not_chosen_makes_no_chosen_view_a_spare_one() -> None:
    """What it waited for came after every other tuber's third view, and held all ledgers up for a second."""
    line = Line()
    line.step(0.0, early=VIEWS[2:3])
    line.answer(VIEWS[2].view_id)
    other = (view(2, 0, 0), view(2, 1, 0))
    line.belt.next = StepResult(0.0, False, 0, (), early=other)
    line.run.frame(_frame(line.seq, line.seq), 0.1)
    line.seq += 1
    assert line.step(0.1, closed=VIEWS[:1]) == [other[0].view_id, VIEWS[0].view_id]  # two in flight
    line.answer(other[0].view_id)
    assert line.tick(0.2) == [other[1].view_id]


def test_a_refusal_before_the_decision_is_the_tracks_loss() -> None:
    line = Line()
    line.step(0.0, early=VIEWS[:1])
    line.answer(VIEWS[0].view_id, refused=True)
    line.tick(0.1)
    line.step(0.3, closed=VIEWS[:2])
    line.answer(VIEWS[1].view_id)
    line.tick(0.31)
    (track,) = line.logged()
    assert (len(track.views), track.views_lost, line.balanced()) == (1, {"refused_few_points": 1}, True)


def test_a_track_that_never_closes_leaves_nothing_outstanding() -> None:
    line = Line()
    line.step(0.0, early=VIEWS[:2])
    line.answer(VIEWS[0].view_id)
    line.run.end(1.0)
    line.tick(1.0)
    assert (line.run.dispatcher.outstanding, line.balanced(), len(line.run.early)) == (0, True, 0)


def test_the_same_tubers_by_the_same_views_as_without() -> None:
    scene = Scene(scattered(6, seed=5), intrinsics=MEDIUM, noise_m=0.0005, seed=5)
    frames = [scene.frame(seq, travel_m=0.014 * seq) for seq in range(60)]
    plain, hasty = Segmenter(Settings()), Segmenter(Settings(early_views=True))
    early: dict[str, View] = {}
    closed: list[ClosedTrack] = []
    for frame in frames:
        result = hasty.step(frame)
        expected = plain.step(frame)
        assert [track.track for track in result.closed] == [track.track for track in expected.closed]
        for track, other in zip(result.closed, expected.closed, strict=True):
            assert [one.encode() for one in track.views] == [one.encode() for one in other.views]
        early |= {one.view_id: one for one in result.early}
        closed += result.closed
    chosen = {one.view_id: one for track in closed for one in track.views}
    assert len(closed) >= 4
    assert len(chosen.keys() & early.keys()) >= 0.6 * len(chosen)
    for view_id in chosen.keys() & early.keys():
        assert replace(early[view_id], rank=chosen[view_id].rank).encode() == chosen[view_id].encode()


def test_what_is_in_view_is_told_with_the_weights_so_far() -> None:
    """Grey first, then with the early view's weight, while it is in view; ids are those of the log."""
    scene = Scene(scattered(4, seed=5), intrinsics=MEDIUM, noise_m=0.0005, seed=5)
    run = CameraRun(CAMERA, RUN, replace(LIVE, core=Settings(early_views=True)), None)
    run.open()
    told: dict[str, list[TrackInView]] = {}
    pictured: set[float | None] = set()
    for seq in range(45):
        frame = replace(scene.frame(seq, travel_m=0.018 * seq), camera=CAMERA, run=RUN)
        result = run.frame(frame, seq / 30)
        message = TracksInView.decode(tracks_in_view(run, frame.captured_ns).encode())
        for track in message.tracks:
            told.setdefault(track.track_id, []).append(track)
        if result is not None and (picture := run.picture(frame, result)) is not None:
            pictured |= {outline.weight_g for outline in picture.outlines} - {None}
        for _, one in run.tick(seq / 30, {"w"}):
            common = (one.view_id, one.track_id, CAMERA, RUN, one.seq)
            grams = 100.0 + 7.0 * one.rank
            run.weight(Weight(*common, "weighed", grams, grams - 10, grams + 10, "pointraft", "m", (), "w"))
    logged = {entry.track.track_id: entry.track for entry in run.log.due(9.0) if entry.track is not None}
    assert logged.keys() <= told.keys()
    assert len(logged) >= 2
    said = {one.weight_g for tracks in told.values() for one in tracks}
    assert pictured
    assert pictured <= said, "the page's picture and Rerun say the same grams"
    for track_id, track in logged.items():
        weights = [one.weight_g for one in told[track_id]]
        before = next(n for n, grams in enumerate(weights) if grams is not None)
        assert before > 0
        assert set(weights[:before]) == {None}
        assert told[track_id][before].state == "open", "weighed before it is decided"
        assert told[track_id][before].place_x_m == pytest.approx(track.place_x_m, abs=0.01)
        first = told[track_id][before]
        assert first.weight_g is not None
        assert (first.low_g, first.high_g) == (first.weight_g - 10, first.weight_g + 10)
