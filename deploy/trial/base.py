"""A Debian root by debootstrap, kept as a folder: the base of images and of booted machines."""

from __future__ import annotations

import shutil
from pathlib import Path

from deploy.trial.tools import SUITE, TrialError, run, say

FOR_IMAGES = ("python3", "python3-venv", "ca-certificates")
FOR_MACHINES = (*FOR_IMAGES, "systemd", "systemd-sysv", "dbus", "iproute2", "procps", "libusb-1.0-0")
NOT_NEEDED = (
    "var/cache/apt",
    "var/lib/apt/lists",
    "var/cache/debconf",
    "usr/share/doc",
    "usr/share/man",
    "usr/share/info",
    "usr/share/locale",
)


def debian_root(folder: Path, packages: tuple[str, ...]) -> Path:
    """The root in `folder`, made on first use; a half-made one is thrown away."""
    ready = folder.with_suffix(".ready")
    if ready.exists() and folder.is_dir():
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    say(f"debootstrap {SUITE} into {folder}")
    try:
        run(["debootstrap", "--variant=minbase", f"--include={','.join(packages)}", SUITE, folder])
    except TrialError:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    for name in NOT_NEEDED:
        shutil.rmtree(folder / name, ignore_errors=True)
        (folder / name).mkdir(parents=True)
    # What the image python:3.11-slim-bookworm has, and the Dockerfile calls.
    (folder / "usr/local/bin/python").symlink_to("/usr/bin/python3")
    ready.touch()
    return folder
