"""The support bundle: one archive with what a helper needs to see, and no private key."""

from __future__ import annotations

import io
import json
import platform
import shutil
import subprocess
import sys
import tarfile
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

from aggregator.ledger.files import RESULT_FILES
from conveyor import __version__
from conveyor.access import access_control
from conveyor.config import LineConfig, dump_toml
from conveyor.files import told, whole_output
from conveyor.processors import usable

LOG_TAIL_BYTES = 2_000_000
JOURNAL_LINES = 5000
JOURNAL_WITHIN_S = 20.0
RESULT_LIMIT_BYTES = 20_000_000


def write_bundle(
    path: Path, config: LineConfig, *, reports: Mapping[str, Any], journal_within_s: float = JOURNAL_WITHIN_S
) -> list[str]:
    """Write the archive and return the names of its files.

    Args:
        path: the .tar.gz to write; replaced only when whole.
        config: the line.
        reports: further files, as values that JSON can hold.
        journal_within_s: how long the journal is waited for; what it gave by then is packed.

    Raises:
        InputError: it cannot be written.
    """
    names: list[str] = []
    with whole_output(path) as draft, tarfile.open(draft, "w:gz") as archive:
        for name, data in _members(config, reports, journal_within_s):
            info = tarfile.TarInfo(f"tuberline-{config.name}/{name}")
            info.size, info.mtime, info.mode = len(data), int(time.time()), 0o600
            archive.addfile(info, io.BytesIO(data))
            names.append(name)
    return names


def _members(config: LineConfig, reports: Mapping[str, Any], journal_within_s: float) -> Iterator[tuple[str, bytes]]:
    yield "config.toml", dump_toml(config).encode()
    yield "versions.json", _json(_versions())
    yield "access.json", _json(access_control(config))
    for name, value in reports.items():
        yield name, _json(value)
    yield from _of_run(config.aggregator.out)
    journal = _journal(config.name, journal_within_s)
    if journal:
        yield "logs/journal.txt", journal


def _of_run(out: Path) -> Iterator[tuple[str, bytes]]:
    """Results and logs; of what this user may not read, or a worn disk does not give, the reason."""
    names = [f"results/{name}" for name in RESULT_FILES]
    with suppress(OSError):  # where the folder cannot be entered, its results tell why
        names += [f"logs/{log.name}" for log in sorted((out / "logs").glob("*.log"))]
    for name in names:
        file = out / name.removeprefix("results/")
        try:
            if name.startswith("logs/"):
                yield name, _tail(file)
            elif file.is_file() and file.stat().st_size <= RESULT_LIMIT_BYTES:
                yield name, file.read_bytes()
        except OSError as error:
            yield f"{name}.unread", f"{told(error, file)}\n".encode()


def _json(value: Any) -> bytes:
    return json.dumps(value, indent=2, default=str).encode() + b"\n"


def _versions() -> dict[str, Any]:
    return {
        "tuberline": __version__,
        "python": sys.version,
        "platform": platform.platform(),
        "cores": usable(),
        "packages": {d.metadata["Name"]: d.version for d in sorted(distributions(), key=lambda d: str(d.name).lower())},
    }


def _tail(path: Path) -> bytes:
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - LOG_TAIL_BYTES))
        return file.read()


def _journal(line: str, within_s: float) -> bytes:
    """The newest lines of this line's units, where systemd keeps them; a worn disk may take minutes for them."""
    if shutil.which("journalctl") is None:
        return b""
    units = ["--namespace=+tuberline", "-u", f"tuberline-*@{line}.service", "-u", f"tuberline-*@{line}:*.service"]
    command = ["journalctl", "--no-pager", "-q", "-n", str(JOURNAL_LINES), *units]
    try:
        return subprocess.run(command, capture_output=True, check=False, timeout=within_s).stdout
    except subprocess.TimeoutExpired as late:
        return (
            late.stdout or b""
        ) + f"journalctl was not done after {within_s:g} s: what follows is missing\n".encode()
