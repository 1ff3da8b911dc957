"""How a run of the ledger is opened and gone on with: by the aggregator's process and by a late summary alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from aggregator.core.machine import Aggregation, Restored
from aggregator.ledger.files import write_whole
from aggregator.ledger.stated import CONFIG_FILE
from aggregator.ledger.writer import Ledger
from conveyor import __version__
from conveyor.config import LineConfig, dump_toml

KEPT = "# as the aggregator last had it; map, report and export read it\n"
LIVE_REACH_MM = 15.0
"""Behind a tuber of a live line with an encoder no other camera's track of it is waited for any longer: places of two
cameras agree to 9.3 mm on a simulated belt of 200 tubers. One that lies farther behind comes late, and counts once."""


def keep_config(config: LineConfig) -> None:
    """Write the line's config beside its ledger, for what is made of it later: working width, contract, densities.
    A file that a person or a replay has put there stays as it is.

    Raises:
        StorageError: the disk is full or the folder cannot be written.
    """
    path = config.aggregator.out / CONFIG_FILE
    text = KEPT + dump_toml(config)
    try:
        before = path.read_text(encoding="utf-8") if path.exists() else KEPT
    except (OSError, UnicodeDecodeError):
        return
    if before.startswith(KEPT) and before != text:
        write_whole(path, text)


def open_run(
    ledger: Ledger,
    run: str,
    *,
    config: LineConfig,
    cameras: Sequence[str],
    may_be_finished: bool,
    fingerprint: str = "",
) -> Restored:
    """Begin `run` of this line now, or go on with it; arguments and errors as `Ledger.open_run` has them."""
    now_ns = time.time_ns()
    return ledger.open_run(
        run,
        line=config.name,
        cameras=cameras,
        version=__version__,
        started_ns=now_ns,
        utc_offset_s=time.localtime(now_ns / 1e9).tm_gmtoff,
        fingerprint=fingerprint,
        may_be_finished=may_be_finished,
        histogram_step_g=config.aggregator.histogram_step_g,
    )


def core_of(
    ledger: Ledger,
    run: str,
    restored: Restored,
    *,
    config: LineConfig,
    cameras: Sequence[str],
    now_s: float,
    count: Callable[[str], None] = lambda name: None,
) -> Aggregation:
    """The state machine that goes on with the run as `restored`; `count` as in `Aggregation`."""
    core = Aggregation(
        run,
        cameras=cameras,
        merge_gate_mm=config.aggregator.merge_gate_mm,
        camera_stall_s=config.aggregator.camera_stall_s,
        committed=ledger.committed(run),
        now_s=now_s,
        restored=restored,
        reach_mm=None if any(camera.held_back for camera in config.cameras.values()) else LIVE_REACH_MM,
        count=count,
    )
    for name, state in core.cameras.states.items():
        pace = config.cameras[name].pace if name in config.cameras else None
        if pace is not None:
            state.pace, state.keeps_pace = pace, True
    return core
