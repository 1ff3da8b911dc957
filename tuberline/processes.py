"""The table of a line's processes: which node is started how, in which order."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from conveyor.config import LineConfig
from tuberline.supervisor import ProcessSpec

if TYPE_CHECKING:
    from conveyor.formats.source import CameraDescription

MOST_REGRESSORS = 2
"""Of a replay that was not told how many; each holds 170 MB, half of it shared with the other nodes."""
LONG_FRAMES = 600
"""Of two processors that two cameras use a second regressor saves a twentieth of the time and costs a second of one: so
much of a recording that it pays."""


def usual_regressors(cameras: Sequence[CameraDescription], *, processors: int) -> int:
    """How many weigh a replay: one for each processor that no camera needs, two of a long recording, two at most."""
    if sum(camera.frames or 0 for camera in cameras) >= LONG_FRAMES:
        return MOST_REGRESSORS
    return min(MOST_REGRESSORS, max(1, processors - len(cameras)))


def line_processes(
    config: LineConfig, *, config_path: Path, run: str, router: bool = True, positions: bool = False
) -> list[ProcessSpec]:
    """Every process of `config` on this machine, in starting order: who listens comes before who speaks.

    `positions`: those beside the ledger are told again, in place of a receiver's.
    """
    common = ("--config", str(config_path), "--run", run)
    specs = [ProcessSpec("router", ("router", "--config", str(config_path)))] if router else []
    specs.append(ProcessSpec("aggregator", ("aggregator", *common)))
    specs += [
        ProcessSpec(f"regressor-{name}", ("regressor", *common, "--name", name))
        for name in (f"r{n}" for n in range(1, config.regressor.processes + 1))
    ]
    if config.hears_encoder:
        specs.append(ProcessSpec("encoder", ("encoder", *common)))
    for role in ("segmenter", "camera"):
        specs += [ProcessSpec(f"{role}-{name}", (role, *common, "--camera", name)) for name in sorted(config.cameras)]
    if config.viewer is not None:
        specs.insert(2, ProcessSpec("viewer", ("viewer", *common)))
    if positions:
        specs.append(ProcessSpec("gnss", ("gnss", *common, "--recorded")))
    elif config.gnss is not None:
        specs.append(ProcessSpec("gnss", ("gnss", *common)))
    if config.alarms is not None:
        specs.append(ProcessSpec("alarms", ("alarms", str(config_path))))
    return specs
