"""A RealSense that is late, stalls, vanishes, refuses and comes back in another unit: the camera process heals it.

The SDK's module has a stand-in that does all of this in real time (`realsense/pyrealsense2.py`): no device was at hand.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from conveyor.config import LinkConfig, dump_toml
from conveyor.messages import Frame
from tests.camera_sim.camera_process import OtherSide, line, other_side
from tests.conftest import wait_until
from tuberline.supervisor import ProcessSpec, Supervisor

pytestmark = [pytest.mark.graph, pytest.mark.timeout(180)]
HERE = Path(__file__).parent / "realsense"
UNIT_M, DISTANCE_M, FPS = 0.0001, 0.46, 30


class Watched:
    """The frames that arrive of a supervised camera process, and the commands to its device."""

    def __init__(self, side: OtherSide, device: Path) -> None:
        self._side = side
        self._device = device
        self.frames: list[Frame] = []

    def more(self, n: int = 15) -> None:
        """Wait for `n` further frames."""
        wanted = len(self.frames) + n

        def came() -> bool:
            frame = self._side.frames.get(0.1)
            if frame is not None:
                self.frames.append(frame)
            return len(self.frames) >= wanted

        wait_until(came, what=f"{n} more frames", timeout_s=40)

    def drain(self) -> None:
        """Forget what came until now and what is on its way."""
        while (frame := self._side.frames.get(0.5)) is not None:
            self.frames.append(frame)

    def silence(self) -> None:
        """Wait until nothing comes any more."""
        wait_until(lambda: (self._side.counters() or _none).gauges.get("source_silent_s", 0) > 1, what="silence")
        self.drain()

    def do(self, *what: str, text: str = "") -> None:
        """Command the device."""
        for name in what:
            (self._device / name).write_text(text)

    def undo(self, what: str) -> None:
        """Take a command back."""
        (self._device / what).unlink(missing_ok=True)

    def asked(self) -> list[str]:
        """What the SDK was asked for."""
        file = self._device / "asked"
        return file.read_text().splitlines() if file.exists() else []


class _None:
    gauges: dict[str, float] = {}  # noqa: RUF012


_none = _None()


def test_it_is_reset_opened_again_and_aligned(
    link: LinkConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = tmp_path / "device"
    device.mkdir()
    monkeypatch.setenv("REALSENSE_STAND_IN", str(device))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep))
    config = line(link, source="realsense", belt_distance_m=DISTANCE_M)
    path = tmp_path / "line.toml"
    path.write_text(dump_toml(config))
    spec = ProcessSpec("camera", ("camera", "--config", str(path), "--run", "r1", "--camera", "front"))
    (device / "gone").touch()
    with other_side(config) as side, Supervisor([spec], log_dir=tmp_path) as supervisor:
        watched = Watched(side, device)

        def told(text: str) -> Callable[[], bool]:
            return lambda: text in supervisor.log_tail("camera", 40)

        # Power came back before the camera was on the bus.
        wait_until(told("is not connected; connected: none"), what="its absence")
        watched.undo("gone")
        watched.more()
        restarts = supervisor.restarts["camera"]
        assert supervisor.crashes == {"camera": 0}
        info = side.info()
        assert info is not None
        assert info.source == (
            "RealSense 123622270001 (USB 3.2, port 2-1.4): 848x480 at 30/s, preset default, exposure automatic"
        )

        watched.do("stalled")
        watched.silence()
        watched.more()
        assert "reset" in watched.asked()

        watched.do("gone", "refuses")
        watched.silence()
        watched.undo("gone")
        wait_until(told("the RealSense refuses: Couldn't resolve requests; tried again in"), what="its refusal")
        watched.undo("refuses")
        watched.more()

        watched.do("unit", text="0.001")
        watched.do("stalled")
        watched.silence()
        watched.more()
        assert "unit 0.0001" in watched.asked()

        watched.do("fixed")
        watched.do("unit", text="0.001")
        watched.do("stalled")
        watched.silence()
        watched.more()
        wait_until(told("its depths are converted to 0.0001 m"), what="the conversion told")

        assert supervisor.restarts["camera"] == restarts, "it healed without a restart"
        wait_until(
            lambda: (c := side.counters()) is not None and c.gauges["source_reopened"] == 4, what="four times reopened"
        )
    seqs = [frame.seq for frame in watched.frames]
    assert all(b > a for a, b in pairwise(seqs))
    assert max(b - a for a, b in pairwise(seqs)) >= 3 * FPS, "the belt that passed unseen is a gap in the numbers"
    for frame in watched.frames:
        assert frame.depth_scale_m == UNIT_M
        assert np.array_equal(frame.depth, np.full((48, 64), round(DISTANCE_M / UNIT_M)))
