"""What an aggregator knows of its cameras by the line's config, before it hears of them."""

from __future__ import annotations

from pathlib import Path

from aggregator.ledger.writer import Ledger
from aggregator.opening import core_of, open_run
from conveyor.config import parse_config


def test_a_live_camera_keeps_its_clocks_pace_and_a_recording_its_speed(tmp_path: Path) -> None:
    """Only a recording that is held back, or played as fast as it goes, has a pace that its marks must tell.

    One that is played by the clock is stamped with the time of the day, at any speed: at half of it a stopped line told
    half of the belt that had run under a router that stood still.
    """
    cameras = {
        "device": {"source": "realsense"},
        "live": {"path": "x", "waits": False, "speed": 2.0},
        "by_the_clock": {"path": "x", "waits": False, "speed": 0.5, "starts_at_s": 1.0},
        "fast": {"path": "x", "waits": False, "speed": 0},
        "held": {"path": "x", "speed": 3.0},
    }
    config = parse_config({"name": "t", "cameras": cameras, "aggregator": {"out": str(tmp_path)}}, where="test")
    with Ledger(tmp_path / "ledger.db") as ledger:
        restored = open_run(ledger, "r", config=config, cameras=list(cameras), may_be_finished=True)
        core = core_of(ledger, "r", restored, config=config, cameras=list(cameras), now_s=0.0)
    paces = {name: (state.keeps_pace, state.pace) for name, state in core.cameras.states.items()}
    assert paces == {
        "device": (True, 1.0),
        "live": (True, 2.0),
        "by_the_clock": (True, 1.0),
        "fast": (False, 1.0),
        "held": (False, 1.0),
    }
