"""The line on three hosts (network namespaces) with a bad network: the ledger is the undisturbed one."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.partitions import TROUBLES, Trouble, canonical, troubled_replay, why_not

pytestmark = [pytest.mark.graph, pytest.mark.slow, pytest.mark.timeout(420)]


@pytest.mark.parametrize("trouble", TROUBLES[1:], ids=lambda trouble: trouble.name)
def test_a_bad_network_changes_nothing(trouble: Trouble, recording: Path, run_dir: Path, tmp_path: Path) -> None:
    if reason := why_not(trouble):
        pytest.skip(f"{trouble.name} not tested: {reason}")
    troubled_replay(recording, tmp_path / "run", trouble)
    assert canonical(tmp_path / "run") == canonical(run_dir)
