"""The line that the booted machines run: config, recording, installing it, its ledger and what that should be."""

from __future__ import annotations

import shutil
import sqlite3
import sys
import tempfile
from contextlib import suppress
from itertools import zip_longest
from pathlib import Path
from time import monotonic

from aggregator.ledger.export import canonical_lines
from aggregator.ledger.reader import read_marks, read_runs, reading, the_run
from conveyor.errors import TuberlineError
from deploy.trial.machine import Machine
from deploy.trial.machineroot import SOURCE
from deploy.trial.tools import PATIENCE_S, TrialError, run, until

LEDGER = "var/lib/tuberline/field/ledger"
UNITS = (
    "tuberline-router@field.service",
    "tuberline-aggregator@field.service",
    "tuberline-segmenter@field:front.service",
    "tuberline-regressor@field:r1.service",
    "tuberline-camera@field:front.service",
)
ROLES = "router,aggregator,camera,segmenter,regressor"
DEVICES = """
[encoder]
source = "simulated:?speed_mps=0.1"
metres_per_pulse = 0.0005

[gnss]
source = "simulated:?row_m=50"
"""
"""An encoder and a receiver for the line's file. A recording has its own travel, so they change nothing that counts."""
INSTALL = f"{SOURCE}/deploy/install.sh"
TUBERLINE = (sys.executable, "-m", "tuberline")


def config(*, router: str = "tcp/127.0.0.1:7447", listen: str = "", speed: float = 1.0) -> str:
    """A line that replays /recordings/belt: it waits for every node as a replay does, so its ledger is the replay's."""
    return f"""name = "field"

[link]
router = "{router}"
{f'listen = ["{listen}"]' if listen else ""}

[cameras.front]
path = "/recordings/belt"
speed = {speed}

[segmenter]
state_dir = "/var/lib/tuberline/field/state"
weigh_deadline_s = 600.0

[regressor]
processes = 1
state_dir = "/var/lib/tuberline/field/weights"

[aggregator]
out = "/{LEDGER}"
camera_stall_s = 600.0
"""


def simulate(folder: Path, *, seed: int, tubers: int, fps: int = 10, speed_mps: float = 0.31) -> Path:
    """The recording that the machines find as /recordings/belt."""
    belt = folder / "belt"
    shutil.rmtree(folder, ignore_errors=True)
    options = ("--seed", str(seed), "--tubers", str(tubers), "--fps", str(fps), "--scene", "singulated")
    options += ("--speed-mps", str(speed_mps))
    run([*TUBERLINE, "simulate", "--out", belt, *options])
    return folder


def replayed(recordings: Path, out: Path) -> list[str]:
    """The canonical ledger of an undisturbed replay of the recording on this computer."""
    shutil.rmtree(out, ignore_errors=True)
    run([*TUBERLINE, "replay", recordings / "belt", "--out", out, "--regressors", "1"])
    with reading(out / "ledger.db") as view:
        return list(canonical_lines(view, the_run(view, out / "ledger.db", None)))


def copy_at_rest(ledger: Path, target: Path, tries: int = 50) -> None:
    """Copy the database and its log as they are at one moment: again where the aggregator wrote meanwhile.

    The index of the log (-shm) is left out; SQLite makes it again, and an older one would not fit.
    """

    def state() -> list[tuple[str, int, int]]:
        files = sorted(file for file in ledger.glob("ledger.*") if not file.name.endswith("-shm"))
        return [(file.name, file.stat().st_mtime_ns, file.stat().st_size) for file in files]

    for _ in range(tries):
        with suppress(FileNotFoundError):  # SQLite takes its own away
            before = state()
            for name, _, _ in before:
                shutil.copy(ledger / name, target)
            if state() == before:
                return
        for file in target.iterdir():
            file.unlink()
    raise TrialError(f"{ledger} was written to during each of {tries} copies")


class Seen:
    """A ledger of a machine as it is on its disk now, read from a copy so that the machine's own stays untouched."""

    def __init__(self, disk: Path) -> None:
        self.lines: list[str] = []
        self.finished = False
        self.travelled_m = 0.0
        self.fault = ""
        with tempfile.TemporaryDirectory() as folder:
            copy_at_rest(disk / LEDGER, Path(folder))
            path = Path(folder) / "ledger.db"
            if not path.exists():
                return
            try:
                with reading(path) as view:
                    if not read_runs(view):
                        return
                    row = the_run(view, path, None)
                    self.lines = list(canonical_lines(view, row))
                    self.finished = row.finished
                    self.travelled_m = max((mark.travelled_m for mark in read_marks(view, row).values()), default=0.0)
            except (TuberlineError, sqlite3.Error) as error:
                self.fault = str(error)

    @property
    def tubers(self) -> list[str]:
        return [line for line in self.lines if '"tuber":' in line]


WAIT = f"""
import sqlite3, sys, time
while True:
    try:
        db = sqlite3.connect("file:/{LEDGER}/ledger.db?mode=ro", uri=True)
        counts = [db.execute(f"SELECT count(*) FROM {{table}}").fetchone()[0] for table in ("tuber", "summary")]
        db.close()
        if counts[0] >= int(sys.argv[1]) or counts[1]:
            sys.exit(print("there"))
    except sqlite3.Error:
        pass
    time.sleep(0.1)
"""


def wait_for(machine: Machine, tubers: int) -> None:
    """Until the ledger of a running machine holds so many, or all there are.

    One process inside waits: where each look starts one, a busy machine counts on for seconds until the answer.
    """
    words = ("/opt/tuberline/bin/python", "-I", "-S", "-c", WAIT, str(tubers))
    # A machine that is only just starting has no such program yet.
    until(lambda: machine.says(*words) == "there", f"{tubers} tubers in the ledger")


def install(machine: Machine, text: str, roles: str, *options: str) -> str:
    """Put the line's file in and run install.sh inside the machine."""
    (machine.disk / "root/field.toml").write_text(text, encoding="utf-8")
    return machine.run("sh", INSTALL, "--roles", roles, "--run", "monday", *options, "/root/field.toml")


def all_active(machine: Machine, units: tuple[str, ...], timeout_s: float = PATIENCE_S) -> float:
    """Seconds until every unit is active."""
    start = monotonic()
    try:
        until(lambda: all(machine.active(unit) for unit in units), "all units active", timeout_s=timeout_s)
    except TrialError as error:
        states = {unit: machine.says("systemctl", "is-active", unit) for unit in units}
        raise TrialError(
            f"{error}: {states}\n{machine.says('journalctl', '--namespace=tuberline', '-n', '20')}"
        ) from error
    return monotonic() - start


def counted_as(machine: Machine, reference: list[str], timeout_s: float = PATIENCE_S) -> str:
    """The machine's ledger is finished and that of a replay on this computer."""
    until(lambda: Seen(machine.disk).finished, "the line counted", timeout_s=timeout_s, every_s=3.0)
    seen = Seen(machine.disk)
    if seen.lines != reference:
        differ = [pair for pair in zip_longest(seen.lines, reference) if pair[0] != pair[1]]
        told = "\n".join(f"{found}\ninstead of\n{wanted}" for found, wanted in differ)
        raise TrialError(
            f"the ledger differs from the replay's: {len(seen.tubers)} tubers, {len(differ)} lines, {seen.fault}\n"
            f"{told}"
        )
    return f"ledger as an undisturbed replay's: {len(seen.tubers)} tubers"
