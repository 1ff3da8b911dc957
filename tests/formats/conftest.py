"""Small recordings for these tests."""

from __future__ import annotations

from tests.small_recordings import small_recording, small_recording_once, small_settings

__all__ = ["small_recording", "small_recording_once", "small_settings"]
