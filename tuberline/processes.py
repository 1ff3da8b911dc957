"""The table of a line's processes: which node is started how, in which order."""

from __future__ import annotations

from pathlib import Path

from conveyor.config import LineConfig
from tuberline.supervisor import ProcessSpec

MOST_REGRESSORS = 2
"""Of a replay that was not told how many; each holds 170 MB, half of it shared with the other nodes."""


def usual_regressors(processors: int) -> int:
    """How many weigh a replay. Beside two cameras on two processors a second one takes no more time than it saves while
    frames come, and halves what is left to be weighed once the last has come.
    """
    return min(MOST_REGRESSORS, processors)


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
        specs.append(ProcessSpec("alarms", ("alarms", "--config", str(config_path))))
    return specs
