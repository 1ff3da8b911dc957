"""What several tests of the ledger begin with."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.aggregator.finished_ledger import write_finished


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger at rest with a run that ended: all tables have rows, and all columns hold something somewhere."""
    path = tmp_path_factory.mktemp("finished") / "ledger.db"
    write_finished(path)
    return path
