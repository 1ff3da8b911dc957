"""`tuberline alarms`: alarms that leave the page."""

from __future__ import annotations

import logging
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from conveyor.config import load_config
from conveyor.errors import ConfigError, InputError, LinkError

if TYPE_CHECKING:
    from tuberline.alarms.channels import Channel


def alarms(config: Path, *, test: bool = False) -> None:
    """Send each alarm of a line once when it begins and once when it ends, to the channels of its [alarms].

    Parameters
    ----------
    config
        The line's TOML file.
    test
        Send one message to every channel, say which took it, and end; no line needed.
    """
    from tuberline.alarms.channels import open_channels

    line = load_config(config)
    if line.alarms is None:
        raise ConfigError(f'config {config} has no [alarms]; add it with channels = ["https://..."]')
    channels = open_channels(line.alarms)
    if test:
        _try(line.name, channels)
        return
    from conveyor.notify import notify
    from conveyor.signals import stop_when_told
    from tuberline.alarms.service import STEP_EVERY_S, AlarmService

    stop = threading.Event()
    stop_when_told(stop)
    with AlarmService(line, channels) as service:
        shown = ", ".join(channel.shown for channel in channels)
        logging.getLogger("alarms").info("alarms of line %s go to %s", line.name, shown)
        notify("READY=1")
        while not stop.wait(STEP_EVERY_S):
            if service.step():
                notify("WATCHDOG=1")


def _try(line: str, channels: tuple[Channel, ...]) -> None:
    import sys
    import time
    import uuid

    from tuberline.alarms.channels import ChannelError
    from tuberline.alarms.message import AlarmMessage

    name = f"test-{uuid.uuid4().hex[:12]}"
    text, fix = "This is a test of the line's alarms.", "Nothing needs to be done."
    message = AlarmMessage(f"{name}-begin", name, "begin", line, "", "test", "note", text, fix, time.time())
    failed, lasting = [], False
    for channel in channels:
        try:
            channel.send(message, lost_before=0)
            sys.stdout.write(f"{channel.shown} took it\n")
        except ChannelError as error:
            failed.append(f"{channel.shown} did not take it: {error}")
            lasting = lasting or error.lasting
    if lasting:
        failed.append("correct its address, path, key or certificate, in [alarms] or at the server, and try again")
        raise InputError("\n".join(failed))
    if failed:
        failed.append(
            "look whether it runs and this machine reaches it, and try again; `tuberline alarms` does so itself"
        )
        raise LinkError("\n".join(failed))
