"""The table of a line's processes: which node is started how, in which order."""

from __future__ import annotations

from pathlib import Path

from conveyor.config import LineConfig
from tuberline.supervisor import ProcessSpec

MOST_REGRESSORS = 2
"""Of a replay that was not told how many; each holds half a gigabyte."""


def usual_regressors(*, cameras: int, processors: int) -> int:
    """One for each processor that no camera needs, two at most: to start one takes five seconds of a processor."""
    return min(MOST_REGRESSORS, max(1, processors - cameras))


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
