"""`make powercuts`: a machine with a running load loses its power again and again, at its boot too. See --help.

Law: after every cut the line goes on by itself; every tuber that its ledger held at a cut is in it at the end, with the
same numbers; and the ledger at the end is that of an undisturbed replay of what the camera could see. In the first
outages the belt runs on: the frames of that piece of belt are taken out of the recording, ahead of what has been looked
at, so that the camera never shows them and coverage has to tell. In the others it stands still with the power.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import random
import shutil
import signal
from dataclasses import dataclass
from dataclasses import field as filled
from pathlib import Path
from time import monotonic, sleep

from deploy.trial import field
from deploy.trial.boot import all_active, counted_as, install
from deploy.trial.machine import TOOLS, Machine, make_network, remove_network
from deploy.trial.machineroot import machine_root
from deploy.trial.tools import TrialError, ended, into_docs, need_root, need_tools, say, table, until, workdir

FPS = 10
BELT_MPS = 0.1
SPEED = 1.0
"""Of the replay. After a cut it begins at its first frame again: this belt of 47 s ends in no run of RUNNING_S."""
AHEAD_FRAMES = 80
"""Frames beyond the last mark of the ledger that may have been sent already: two seconds at four times its speed."""
OFF_FRAMES = 40
"""Of one outage: 0.4 m of belt, more than a camera sees at once."""
MOST_OFF_FRAMES = 5 * OFF_FRAMES
AT_BOOT_S = (0.05, 4.0)
RUNNING_S = (8.0, 45.0)


@dataclass(slots=True)
class Cuts:
    """What the cuts so far came upon."""

    at_boot: int = 0
    running: int = 0
    lines_active: int = 0
    unseen_frames: int = 0
    tubers_at_cut: list[int] = filled(default_factory=list)
    committed: dict[str, str] = filled(default_factory=dict)
    """Every tuber that a ledger held at any cut, by its number."""


def belt_runs_on(belt: Path, travelled_m: float) -> int:
    """Take the frames that pass while the power is off out of the recording; returns how many."""
    table_file = belt / "front" / "frames.csv"
    with table_file.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    head, frames = rows[0], rows[1:]
    looked_at = sum(float(row[2]) <= travelled_m for row in frames)
    start = looked_at + AHEAD_FRAMES
    # The last metres stay: what counts ends with the last frame.
    gone = frames[start : start + OFF_FRAMES] if start + OFF_FRAMES < len(frames) - 3 * FPS else []
    for row in gone:
        (belt / "front" / "depth" / f"{int(row[0]):06d}.png").unlink()
    with table_file.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([head, *(row for row in frames if row not in gone)])
    return len(gone)


def take_stock(cuts: Cuts, seen: field.Seen) -> None:
    """What the ledger on the disk holds after a cut: readable, and nothing that it held before has gone or changed."""
    if seen.fault and cuts.committed:
        raise TrialError(f"after a cut the ledger cannot be read: {seen.fault}")
    now = {str(json.loads(line)["tuber"]): line for line in seen.tubers}
    for number, line in cuts.committed.items():
        if now.get(number) != line:
            raise TrialError(f"tuber {number} was {line} and is {now.get(number)} after a cut")
    cuts.committed = now
    cuts.tubers_at_cut.append(len(now))


def cut_again_and_again(machine: Machine, belt: Path, *, seed: int, n: int) -> Cuts:
    """Switch on, wait for a random while, cut; a third of the cuts fall into the boot."""
    rng = random.Random(seed)
    cuts = Cuts()
    for number in range(1, n + 1):
        at_boot = rng.random() < 1 / 3
        after_s = rng.uniform(*(AT_BOOT_S if at_boot else RUNNING_S))
        machine.power_on()
        start = monotonic()
        cuts.at_boot += at_boot
        cuts.running += not at_boot
        while monotonic() - start < after_s:
            sleep(min(0.25, max(0.0, after_s - (monotonic() - start))))
        if not at_boot:
            cuts.lines_active += machine.active(field.UNITS[1])
        machine.cut_power()
        seen = field.Seen(machine.disk)
        take_stock(cuts, seen)
        off = belt_runs_on(belt, seen.travelled_m) if cuts.unseen_frames < MOST_OFF_FRAMES else 0
        cuts.unseen_frames += off
        say(
            f"cut {number}: {after_s:.2f} s after power on, {len(seen.tubers)} tubers, {seen.travelled_m:.2f} m, -{off}"
        )
    return cuts


def trial(folder: Path, root: Path, *, seed: int, n: int, tubers: int, speed: float) -> list[tuple[object, ...]]:
    recordings = field.simulate(folder / "cut-recordings", seed=seed, tubers=tubers, fps=FPS, speed_mps=BELT_MPS)
    machine = Machine(folder, root, "cut", 3, {str(recordings): "/recordings"}).make()
    try:
        machine.power_on()
        machine.booted()
        install(machine, field.config(speed=speed), field.ROLES)
        all_active(machine, field.UNITS)
        cuts = cut_again_and_again(machine, recordings / "belt", seed=seed, n=n)
        machine.power_on()
        went_on_s = all_active(machine, field.UNITS)
        until(lambda: field.Seen(machine.disk).finished, "the load counted", timeout_s=900, every_s=3.0)
        last = field.Seen(machine.disk)
        take_stock(cuts, last)
        reference = field.replayed(recordings, folder / "cut-reference")
        counted_as(machine, reference)
    finally:
        machine.remove()
    summary = json.loads((folder / "cut-reference/summary.json").read_text(encoding="utf-8"))
    coverage = summary["totals"]["coverage"]
    if cuts.unseen_frames and coverage >= 1.0:
        raise TrialError(f"{cuts.unseen_frames} frames were never seen and coverage is {coverage}")
    return [
        ("power cuts", f"{n}, seed {seed}: {cuts.at_boot} within {AT_BOOT_S[1]:g} s of power on, {cuts.running} later"),
        ("tubers in the ledger at the cuts", ", ".join(map(str, cuts.tubers_at_cut[:-1]))),
        ("after the last cut", f"all units active by themselves after {went_on_s:.0f} s"),
        ("acknowledged and lost, or changed", "0"),
        ("belt that ran on while the power was off", f"{cuts.unseen_frames} frames; coverage {100 * coverage:.1f} %"),
        ("ledger at the end", f"{len(last.tubers)} tubers, as an undisturbed replay's of the same frames"),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(prog="make powercuts", description=__doc__)
    parser.add_argument("--keep", action="store_true", help="keep the installed root for the next time")
    parser.add_argument("--seed", type=int, default=1630, help="of the belt and of the moments of the cuts")
    parser.add_argument("--cuts", type=int, default=30)
    parser.add_argument("--tubers", type=int, default=72)
    parser.add_argument("--speed", type=float, default=SPEED, help="of the replay: faster for fewer cuts")
    given = parser.parse_args()
    need_tools({**TOOLS, "debootstrap": "debootstrap"})
    folder = workdir("machine")
    need_root("make powercuts", f"it makes a Debian root under {folder}, mounts, and boots a machine that it kills")
    os.umask(0o022)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        root = machine_root(folder)
        make_network()
        rows = trial(folder, root, seed=given.seed, n=given.cuts, tubers=given.tubers, speed=given.speed)
        for row in rows:
            say(": ".join(map(str, row)))
        into_docs("powercuts", table(("what", "seen"), rows))
    finally:
        remove_network()
        if not given.keep:
            shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    ended(main)
