"""Checks of the machine itself: disk, clock, processors, locked memory, USB."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import tempfile
import time
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from conveyor.config import LineConfig
from conveyor.files import cause
from conveyor.processors import usable
from tuberline.doctor.finding import Finding, fault, ok, warning

LITTLE_DISK_GB, NO_DISK_GB = 5.0, 0.5
SLOW_SYNC_MS = 250.0
CLOCK_BEHIND_S = 3600.0
"""More than a summer time that was taken for a fault; by less no load changes its day."""
USB3_MBIT = 5000
USB_DEVICES = Path("/sys/bus/usb/devices")
INTEL_USB = "8086"


def check_disk(folder: Path, *, what: str) -> list[Finding]:
    """Room in `folder` (or the nearest that exists), and that a file written there is durable quickly."""
    check = f"disk of {what}"
    place = folder
    try:
        while not place.exists() and place != place.parent:
            place = place.parent
        free_gb = shutil.disk_usage(place).free / 1e9
        sync_ms = _sync_ms(place)
    except OSError as error:
        return [fault(check, f"{place} cannot be written: {error.strerror or error}", _disk_fix(error, folder))]
    text = f"{folder}: {free_gb:.1f} GB free, a file is durable after {sync_ms:.0f} ms"
    if free_gb < NO_DISK_GB:
        return [fault(check, text, "remove old recordings and runs: under 0.5 GB the ledger may not be written")]
    if free_gb < LITTLE_DISK_GB:
        return [warning(check, text, "remove old recordings (30 frames/s of one camera are 10 to 50 GB an hour)")]
    if sync_ms > SLOW_SYNC_MS:
        return [warning(check, text, "a worn or slow disk: put the ledger on an SSD")]
    return [ok(check, text)]


def _disk_fix(error: OSError, folder: Path) -> str:
    """What helps where nothing can be written."""
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"give the user that runs Tuberline the right to write {folder}, or name another folder in the config"
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"remove old recordings and runs from the disk of {folder}, or name a folder of another in the config"
    if error.errno == errno.EROFS:
        return f"mount the file system of {folder} for writing, or name another folder in the config"
    _, _, fix = cause(error).partition("; ")
    return fix or f"check the disk of {folder}, or name another folder in the config"


def _sync_ms(folder: Path) -> float:
    with tempfile.NamedTemporaryFile(dir=folder, prefix=".tuberline-doctor-") as file:
        begun = time.perf_counter()
        file.write(b"\0" * 4096)
        file.flush()
        os.fsync(file.fileno())
        return 1e3 * (time.perf_counter() - begun)


def check_clock(ledger: Path, *, now_s: float) -> list[Finding]:
    """The clock is not before what was written here: many field computers have none that runs while they are off."""
    written = {}
    for file in (Path(__file__), ledger / "ledger.db"):
        with suppress(OSError):  # none there, or none that this user may see
            written[file] = file.stat().st_mtime
    newest = max(written, key=written.__getitem__)
    behind_s, at = written[newest] - now_s, datetime.fromtimestamp(now_s, UTC)
    if behind_s < CLOCK_BEHIND_S:
        return [ok("clock", f"{at:%Y-%m-%d %H:%M} UTC, later than what was written here")]
    text = f"it says {at:%Y-%m-%d %H:%M} UTC, and {newest} was written {behind_s / 3600:.1f} hours later"
    fix = "set it (`timedatectl set-time`, or from a time server): loads stand under its day, certificates go by it"
    return [warning("clock", text, fix)]


def check_processors(config: LineConfig, *, cores: int | None = None) -> list[Finding]:
    """Enough cores for the processes this line starts on one machine."""
    have = cores if cores is not None else usable()
    segmenters, workers = len(config.cameras), config.regressor.processes * config.regressor.threads
    looks, weighs = "segmenter" + "s" * (segmenters != 1), "regressor thread" + "s" * (workers != 1)
    text = f"{have} cores for {segmenters} {looks} and {workers} {weighs}"
    if segmenters + workers > have:
        fitting = max(1, have - segmenters)
        lower = f"lower regressor.processes to {fitting}, or run" if config.regressor.processes > fitting else "run"
        fix = (
            f"{lower} regressors on another machine: under overload fewer views per tuber are weighed, never fewer "
            "tubers"
        )
        return [warning("processors", text, fix)]
    return [ok("processors", text)]


def check_locked_memory(limit_bytes: int | None = None) -> list[Finding]:
    """Zenoh's shared memory would need much; it is switched off, so this only tells."""
    limit = limit_bytes if limit_bytes is not None else resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    shown = "unlimited" if limit == resource.RLIM_INFINITY else f"{limit / 2**20:.0f} MiB"
    return [ok("locked memory", f"{shown}; Tuberline locks none, for Zenoh's shared memory is off")]


def realsense_mbit(devices: Path = USB_DEVICES) -> list[float]:
    """How fast the RealSense devices of this machine are connected, Mbit/s. `devices` is the kernel's list."""
    speeds = []
    for vendor in sorted(devices.glob("*/idVendor")):
        product = vendor.parent / "product"
        if vendor.read_text().strip() == INTEL_USB and product.is_file() and "RealSense" in product.read_text():
            speeds.append(float((vendor.parent / "speed").read_text()))
    return speeds


def check_usb(config: LineConfig, *, devices: Path = USB_DEVICES) -> list[Finding]:
    """RealSense cameras are there and on USB 3. `devices` is the kernel's list."""
    wanted = [name for name, camera in sorted(config.cameras.items()) if camera.source == "realsense"]
    if not wanted:
        return []
    speeds = realsense_mbit(devices)
    text = f"{len(speeds)} RealSense devices for {len(wanted)} cameras ({', '.join(wanted)})"
    if len(speeds) < len(wanted):
        return [
            warning(
                "usb", text, "plug in the missing ones, unless they hang on another host; a udev rule may hide them"
            )
        ]
    if any(speed < USB3_MBIT for speed in speeds):
        slow = ", ".join(f"{speed:.0f} Mbit/s" for speed in speeds)
        return [
            fault("usb", f"{text}: {slow}", "use a USB 3 port and cable: USB 2 cannot carry 848x480 at 30 frames/s")
        ]
    return [ok("usb", text)]
