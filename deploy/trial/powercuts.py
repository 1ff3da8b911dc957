"""`make powercuts`: a machine with a running load loses its power again and again, at its boot too. See --help.

Law: after every cut the line goes on by itself; every tuber that its ledger held at a cut is in it at the end, with the
same numbers; and the ledger at the end is that of an undisturbed replay of what the camera could see. In the first
outages the belt runs on: the frames of that piece of belt are taken out of the recording, ahead of what has been looked
at, so that the camera never shows them and coverage has to tell. In the others it stands still with the power.

The camera begins its recording again after each cut. So a cut comes when the ledger holds a random number of tubers,
more than at the one before, or all: every run has to pass what was cut off and to count on from there.
"""

from __future__ import annotations

import argparse
import csv
import json
import random
from dataclasses import asdict, dataclass
from dataclasses import field as filled
from pathlib import Path
from time import monotonic, sleep

from deploy.trial import field
from deploy.trial.machine import Machine
from deploy.trial.machineroot import BOOTED_WITH, machines_on
from deploy.trial.tools import TrialError, ended, into_docs, say, table, until

FPS = 10
BELT_MPS = 0.1
AHEAD_FRAMES = 80
"""Frames beyond the last mark of the ledger that may have been sent already: four seconds at twice its speed."""
OFF_FRAMES = 40
"""Of one outage: 0.4 m of belt, more than a camera sees at once."""
MOST_OFF_FRAMES = 2 * OFF_FRAMES
AT_BOOT_S = (0.05, 4.0)
RUNNING_S = (4.0, 8.0)
"""The least that a machine is on before a cut of its running line."""
LAST_CUT = 0.6
"""Of the belt's tubers."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What is cut, and how often."""

    seed: int
    cuts: int
    tubers: int
    speed: float

    def moments(self) -> list[tuple[float, int | None]]:
        """(seconds after power on, tubers that the ledger must hold or None while booting) of each cut."""
        rng = random.Random(self.seed)
        at_boot = [rng.random() < 1 / 3 for _ in range(self.cuts)]
        counts = iter(sorted(rng.randint(0, int(LAST_CUT * self.tubers)) for _ in range(at_boot.count(False))))
        return [(rng.uniform(*(AT_BOOT_S if boot else RUNNING_S)), None if boot else next(counts)) for boot in at_boot]


@dataclass(slots=True)
class Cuts:
    """What the cuts so far came upon."""

    at_boot: int = 0
    running: int = 0
    unseen_frames: int = 0
    furthest_m: float = 0.0
    """That the segmenter has looked at; marks begin again with the camera."""
    tubers_at_cut: list[int] = filled(default_factory=list)
    committed: dict[str, str] = filled(default_factory=dict)
    """Every tuber that a ledger held at any cut, by its number."""

    @property
    def done(self) -> int:
        return self.at_boot + self.running


def kept(file: Path, plan: Plan) -> Cuts | None:
    """The cuts of this plan that an earlier call made; None where it has to begin."""
    if not file.exists():
        return None
    said = json.loads(file.read_text(encoding="utf-8"))
    return Cuts(**said["cuts"]) if said["plan"] == asdict(plan) else None


def keep(file: Path, plan: Plan, cuts: Cuts) -> None:
    draft = file.with_suffix(".draft")
    draft.write_text(json.dumps({"plan": asdict(plan), "cuts": asdict(cuts)}), encoding="utf-8")
    draft.replace(file)


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


def cut_once(machine: Machine, belt: Path, cuts: Cuts, moment: tuple[float, int | None]) -> None:
    """Switch on, wait for the moment, cut, and look at what is on the disk."""
    least_s, tubers = moment
    start = monotonic()
    machine.power_on()
    sleep(max(0.0, least_s - (monotonic() - start)))
    if tubers is not None:
        field.wait_for(machine, max(tubers, len(cuts.committed) + 1))
    on_s = monotonic() - start
    machine.cut_power()
    cuts.at_boot += tubers is None
    cuts.running += tubers is not None
    seen = field.Seen(machine.disk)
    take_stock(cuts, seen)
    cuts.furthest_m = max(cuts.furthest_m, seen.travelled_m)
    off = belt_runs_on(belt, cuts.furthest_m) if cuts.unseen_frames < MOST_OFF_FRAMES else 0
    cuts.unseen_frames += off
    say(
        f"cut {cuts.done}: {on_s:.2f} s after power on, {len(seen.tubers)} tubers, {seen.travelled_m:.2f} m, "
        f"{off} frames gone"
    )


def begin(machine: Machine, recordings: Path, plan: Plan) -> Cuts:
    """A new belt, and a machine with the line installed, switched off."""
    field.simulate(recordings, seed=plan.seed, tubers=plan.tubers, fps=FPS, speed_mps=BELT_MPS)
    machine.make()
    machine.power_on()
    machine.booted()
    field.install(machine, field.config(speed=plan.speed), field.ROLES, "--no-start")
    machine.shut_down()
    return Cuts()


def trial(folder: Path, root: Path, plan: Plan, part: int | None) -> list[tuple[object, ...]]:
    """The table; empty where only a part of the cuts was asked for and more are to come."""
    recordings, state = folder / "cut-recordings", folder / "cuts.json"
    machine = Machine(folder, root, "cut", 3, {str(recordings): "/recordings"})
    cuts = kept(state, plan)
    try:
        if cuts is None:
            cuts = begin(machine, recordings, plan)
            keep(state, plan, cuts)
        else:
            machine.unmount()  # an earlier call may have ended before it could
            machine.mount()
        last = plan.cuts if part is None else min(plan.cuts, cuts.done + part)
        for moment in plan.moments()[cuts.done : last]:
            cut_once(machine, recordings / "belt", cuts, moment)
            keep(state, plan, cuts)
        if last < plan.cuts:
            say(f"{cuts.done} of {plan.cuts} cuts; call it again for the others")
            return []
        rows = the_end(folder, machine, recordings, plan, cuts)
    finally:
        machine.unmount()
    state.unlink()
    machine.remove()
    return rows


def the_end(folder: Path, machine: Machine, recordings: Path, plan: Plan, cuts: Cuts) -> list[tuple[object, ...]]:
    """Power stays: the load is counted to its end, and compared."""
    machine.power_on()
    went_on_s = field.all_active(machine, field.UNITS)
    until(lambda: field.Seen(machine.disk).finished, "the load counted", every_s=3.0)
    last = field.Seen(machine.disk)
    at_cuts = list(cuts.tubers_at_cut)
    take_stock(cuts, last)
    reference = field.replayed(recordings, folder / "cut-reference")
    field.counted_as(machine, reference)
    summary = json.loads((folder / "cut-reference/summary.json").read_text(encoding="utf-8"))
    coverage = summary["totals"]["coverage"]
    if cuts.unseen_frames and coverage >= 1.0:
        raise TrialError(f"{cuts.unseen_frames} frames were never seen and coverage is {coverage}")
    booting = f"{cuts.at_boot} within {AT_BOOT_S[1]:g} s of power on"
    return [
        ("power cuts", f"{cuts.done}, seed {plan.seed}: {booting}, {cuts.running} later"),
        ("tubers in the ledger at the cuts", ", ".join(map(str, at_cuts))),
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
    parser.add_argument("--part", type=int, help="at most so many cuts now, the next call goes on; keeps the root")
    parser.add_argument("--tubers", type=int, default=150)
    parser.add_argument("--speed", type=float, default=2.0, help="of the replay")
    given = parser.parse_args()
    plan = Plan(seed=given.seed, cuts=given.cuts, tubers=given.tubers, speed=given.speed)
    with machines_on("make powercuts", keep=given.keep or given.part is not None) as (folder, root):
        rows = trial(folder, root, plan, given.part)
        for row in rows:
            say(": ".join(map(str, row)))
        if rows:
            into_docs("powercuts", table(("what", "seen"), rows), BOOTED_WITH)


if __name__ == "__main__":
    ended(main)
