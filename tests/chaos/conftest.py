"""Chaos tests use the integration tests' recording and undisturbed run."""

from __future__ import annotations

from tests.integration.conftest import recording, run_dir

__all__ = ["recording", "run_dir"]
