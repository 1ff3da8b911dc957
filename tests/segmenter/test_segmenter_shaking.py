"""A belt that stands and shakes by more than a millimetre, as over a running engine: each frame looks moved."""

from __future__ import annotations

import pytest
from segmenter_scene import Scene, scattered

from segmenter.perception import PerceptionSettings
from segmenter.pipeline import Segmenter, Settings
from segmenter.track.history import TravelHistory

STEP_M, SHAKES_M = 0.0133, 0.0015
KEPT = 48


def test_when_the_belt_was_where_is_not_forgotten_while_it_shakes(monkeypatch: pytest.MonkeyPatch) -> None:
    """After two minutes of it all that came before was forgotten: what had crossed just before the stop was said to
    have crossed during it, and all of it to be in the log up to then."""
    monkeypatch.setattr("segmenter.track.history.KEPT_FRAMES", KEPT)
    history = TravelHistory()
    for n in range(20):
        history.step(1000 * n, 0.01 * n)
    crossed_ns = history.ns_at(0.155)
    assert crossed_ns == 15_500
    for n in range(20, 20 + 10 * KEPT):
        history.step(1000 * n, 0.19 - SHAKES_M * (n % 2))
    assert history.ns_at(0.155) == crossed_ns
    history.step(10**6, 0.20)
    assert 1000 * (19 + 10 * KEPT) < history.ns_at(0.195) < 10**6, "it left when it went on, not when it stopped"


@pytest.mark.parametrize("encoder", [True, False])
def test_memory_is_bounded_while_it_shakes_and_every_tuber_counts_once(
    encoder: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each frame was kept with every tuber in view: gigabytes in a few hours, and medians over all of it."""
    for module in ("history", "track"):
        monkeypatch.setattr(f"segmenter.track.{module}.KEPT_FRAMES", KEPT, raising=False)
    scene, core = Scene(scattered(12, seed=3)), Segmenter(Settings(perception=PerceptionSettings(method="classical")))
    at_m = [STEP_M * n for n in range(40)]
    at_m += [at_m[-1] - SHAKES_M * (n % 2) for n in range(2 * KEPT)]
    at_m += [at_m[39] + STEP_M * n for n in range(1, 40)]
    closed = []
    for seq, travel_m in enumerate(at_m):
        closed += core.step(scene.frame(seq, travel_m, encoder=encoder)).closed
        assert all(len(track.hits) <= KEPT for track in core.tracks_in_view())
    closed += core.finish()
    assert len({one.track.track_id for one in closed}) == len(closed) == 12
    assert not core.discarded
