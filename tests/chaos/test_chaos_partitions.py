"""The line on three hosts (network namespaces) with a bad network: the ledger is the undisturbed one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.link_wire import LinkSettings
from benchmarks.partitions import TROUBLES, Replayed, Trouble, canonical, troubled_replay, why_not

pytestmark = [pytest.mark.graph, pytest.mark.timeout(1000)]
SHORT = Trouble("loss, delay and a cut", LinkSettings(loss=0.05, delay_s=0.002), cut_s=1.0, timeout_s=170.0)


def assert_nothing_changed(recording: Path, run_dir: Path, out: Path, trouble: Trouble) -> Replayed:
    """A replay on troubled links has the undisturbed ledger, no gap, and balanced books."""
    if reason := why_not(trouble):
        pytest.skip(f"{trouble.name} not tested: {reason}")
    replayed = troubled_replay(recording, out, trouble)
    summary = json.loads((out / "summary.json").read_text())
    assert summary["balanced"]
    assert [sheet["frames"]["gaps"] for sheet in summary["cameras"].values()] == [0, 0]
    assert canonical(out) == canonical(run_dir)
    assert (replayed.total("lost_loss") > 0) == (trouble.link.loss > 0)
    assert (replayed.total("lost_cut") > 0) == (trouble.cut_s > 0)
    return replayed


@pytest.mark.slow
def test_loss_delay_and_a_short_cut_change_nothing(recording: Path, run_dir: Path, tmp_path: Path) -> None:
    assert_nothing_changed(recording, run_dir, tmp_path / "run", SHORT)


@pytest.mark.slow
@pytest.mark.parametrize("trouble", TROUBLES[1:], ids=lambda trouble: trouble.name)
def test_a_bad_network_changes_nothing(trouble: Trouble, recording: Path, run_dir: Path, tmp_path: Path) -> None:
    assert_nothing_changed(recording, run_dir, tmp_path / "run", trouble)
