"""What is kept as foreign matter: bodies of a tuber's size."""

from __future__ import annotations

from dataclasses import replace

from segmenter.track.foreign import is_crumb
from tests.laws.virtual_overload import _TRACK


def test_a_clod_smaller_than_a_tuber_is_a_crumb() -> None:
    clod = replace(_TRACK, kind="lump")
    crumbs = [is_crumb(replace(clod, visible_volume_ml=ml), least_ml=12.0) for ml in (16.0, 17.0)]
    assert crumbs == [True, False], "what is body under its surface counts, not the air under its flanks"
    assert not is_crumb(replace(clod, kind="haulm", visible_volume_ml=1.0), least_ml=12.0)
