"""The alarms of one line, from its messages to the channels: watches as the page does, keeps, sends."""

from __future__ import annotations

import logging
import threading
import time
from pathlib import Path
from typing import Self

from conveyor.access import known_nodes
from conveyor.config import LineConfig
from tuberline.alarms.channels import Channel
from tuberline.alarms.machine import Timing
from tuberline.alarms.outbox import Outbox, alarms_folder
from tuberline.alarms.seen import disk_stands_still, seen_alarms, unknown_keys
from tuberline.alarms.sender import Sender
from tuberline.doctor.finding import Finding
from tuberline.doctor.machine import check_disk
from viewer.page.state import LineState
from viewer.page.watch import LineWatch

log = logging.getLogger("alarms")

STEP_EVERY_S = 0.5
LOOK_LASTS_S = 15.0
"""The watcher tells a look each second, and where it must connect within 6 s: after this it stands still."""
STOP_WITHIN_S = 1.5
DISKS_EVERY_S = 60.0
DISKS_WITHIN_S = 180.0


class DiskWatch:
    """Looks at the line's disks on this machine once a minute; a thread of its own, since a failing disk stands still.

    Args:
        folders: by what lies in them.
    """

    def __init__(self, folders: dict[str, Path]) -> None:
        self._folders = folders
        self._lock = threading.Lock()
        self._found: tuple[Finding, ...] | None = None
        self._looked_s = time.monotonic()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="disks", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def stop(self) -> None:
        """Look no more."""
        self._stop.set()

    def findings(self, now_s: float) -> tuple[Finding, ...] | None:
        """What the last look found; None before the first."""
        with self._lock:
            still_s = now_s - self._looked_s
            if still_s > DISKS_WITHIN_S:
                return (disk_stands_still(still_s),)
            return self._found

    def _run(self) -> None:
        while not self._stop.is_set():
            found = [finding for what, folder in self._folders.items() for finding in check_disk(folder, what=what)]
            with self._lock:
                self._found, self._looked_s = tuple(found), time.monotonic()
            self._stop.wait(DISKS_EVERY_S)


class AlarmService:
    """Watches one line and sends its alarms. Use as a context manager; `step` is called by who owns it.

    Args:
        config: with an `alarms` section.
        channels: where to; see `open_channels`.
    """

    def __init__(self, config: LineConfig, channels: tuple[Channel, ...]) -> None:
        if config.alarms is None:
            raise ValueError("the config has no [alarms]")
        self._config = config
        self._outbox = Outbox(
            alarms_folder(config), channels=[channel.id for channel in channels], keep=config.alarms.keep
        )
        self._timing = Timing(config.alarms.after_s, config.alarms.clear_s, config.alarms.again_after_s)
        self._senders = [Sender(channel, self._outbox) for channel in channels]
        self._disks = DiskWatch(_folders(config))
        self._lock = threading.Lock()
        self._look: LineState | None = None
        self._told_s = time.monotonic()
        self._expected = known_nodes(config)
        self._watch = LineWatch(config.link, line=config.name, tell=self._tell, known=self._expected)

    def __enter__(self) -> Self:
        self._outbox.__enter__()
        now_s, unix_s = time.monotonic(), time.time()
        self._machine = self._outbox.machine(self._config.name, timing=self._timing, now_s=now_s, unix_s=unix_s)
        self._told_s = now_s
        self._disks.start()
        self._watch.start()
        for sender in self._senders:
            sender.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._disks.stop()
        for sender in self._senders:
            sender.stop()
        self._watch.stop()
        until_s = time.monotonic() + STOP_WITHIN_S
        for sender in self._senders:
            sender.join(max(0.0, until_s - time.monotonic()))
        self._outbox.__exit__()

    def step(self) -> bool:
        """Take what is new; False where the watcher stands still."""
        now_s, unix_s = time.monotonic(), time.time()
        with self._lock:
            look, told_s = self._look, self._told_s
        if look is not None:
            disks = self._disks.findings(now_s)
            active = {key: alarm.begun for key, alarm in self._machine.active.items()}
            unknown = unknown_keys(look, active, self._expected, disks_known=disks is not None, unix_s=unix_s)
            seen = seen_alarms(look, self._config, disks or ())
            messages = self._machine.step(seen, now_s=now_s, unix_s=unix_s, unknown=unknown)
            if messages:
                self._outbox.put(messages, self._machine, now_s=now_s, unix_s=unix_s)
        return now_s - told_s <= LOOK_LASTS_S

    def _tell(self, look: LineState) -> None:
        with self._lock:
            self._look, self._told_s = look, time.monotonic()


def _folders(config: LineConfig) -> dict[str, Path]:
    folders = {"the ledger": config.aggregator.out}
    if config.segmenter.state_dir is not None:
        folders["the camera log"] = config.segmenter.state_dir
    return folders
