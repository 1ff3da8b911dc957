"""Reasons have one home: the docs and the page's words are made from it, and their values never change."""

from __future__ import annotations

from pathlib import Path

import pytest

from conveyor.reasons import FrameDrop, InstanceRefusal, Reason, Requeue, TrackRefusal, ViewLoss
from viewer.page.words import FRAME_DROPS, VIEW_LOSSES

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("reasons", [TrackRefusal, FrameDrop, ViewLoss], ids=lambda reasons: reasons.__name__)
def test_the_docs_name_every_reason_with_its_meaning(reasons: type[Reason]) -> None:
    rows = "".join(f"| `{reason.value}` | {reason.meaning} |\n" for reason in reasons)
    table = f"| reason | what happened |\n| --- | --- |\n{rows}"
    assert table in (ROOT / "docs" / "segmentation.md").read_text(encoding="utf-8")


def test_the_page_has_words_for_every_dropped_frame_and_lost_view() -> None:
    assert set(FRAME_DROPS) == set(FrameDrop)
    # A regressor's own reasons are shown by their names; a view that was not chosen is no loss to anyone.
    assert set(VIEW_LOSSES) == set(ViewLoss) - {ViewLoss.REFUSED, ViewLoss.NOT_CHOSEN}


def test_values_are_those_of_ledgers_written_before() -> None:
    assert {str(reason) for reason in FrameDrop} == {
        "blind", "frozen", "camera_changed", "no_belt", "too_old", "overwritten", "overload", "behind",
    }  # fmt: skip
    assert {str(reason) for reason in TrackRefusal} == {
        "before_start", "not_crossed", "born_late", "vanished", "few_frames", "fragment", "small", "tiny", "flat",
        "outside", "duplicate", "thin", "sliver", "distractor", "out_of_range", "no_view", "restart",
    }  # fmt: skip
    assert {str(reason) for reason in ViewLoss} == {
        "shed", "late", "not_chosen", "overload", "max_attempts", "weigh_deadline", "restart", "refused",
    }  # fmt: skip
    assert {str(reason) for reason in Requeue} == {"regressor_left", "deadline", "lost_on_the_way"}
    assert {str(reason) for reason in InstanceRefusal} == {"small", "flat"}
