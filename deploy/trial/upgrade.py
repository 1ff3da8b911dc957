"""An upgrade of a running line that loses its power, again and again, and the way back: a part of `make boot`.

The next version is this clone with another number, installed beside the one that runs as docs/deploy.md says.
Law: after every cut the line comes up by itself, all of it in the old version or all of it in the new one, and its
ledger holds what it held; at the end it is that of an undisturbed replay.
"""

from __future__ import annotations

import random
import re
import shutil
from pathlib import Path
from time import sleep

from deploy.trial import field
from deploy.trial.machine import Machine
from deploy.trial.machineroot import copy_clone, in_root
from deploy.trial.powercuts import Cuts, take_stock
from deploy.trial.tools import TrialError, say, until, version

SEED = 1616
TUBERS, SPEED = 90, 0.4
"""75 s of belt, replayed in three minutes: longer than a boot with an upgrade, so that each cut comes in the load."""
TUBERS_EACH = 8
"""So many more tubers are in the ledger before each upgrade begins."""
INSTALLING_S = (0.5, 6.0)
"""From the upgrade's begin to a cut while the next version is installed; undisturbed that takes about ten seconds."""
SWITCHING_S = (0.0, 4.0)
"""From the moment that the next version is the chosen one to a cut while the line is started with it."""
CUTS = ((False, INSTALLING_S), (True, SWITCHING_S)) * 2
"""(whether the next version was chosen already, seconds) of each cut."""
CHOSEN = "/etc/tuberline/environment"
TUBERLINE = "/opt/tuberline/bin/tuberline"
NEXT = "/opt/tuberline-next"
WHEELS = "/usr/src/tuberline-next"
PREPARE = f"""set -e
rm -rf {NEXT}
python3 -m venv --without-pip {NEXT}
echo /opt/tuberline/lib/python3.11/site-packages >{NEXT}/lib/python3.11/site-packages/libraries.pth
/opt/tuberline/bin/pip --python {NEXT}/bin/python install --quiet --no-index --no-deps --ignore-installed {WHEELS}/*.whl
"""
"""The libraries are the old one's: what a wheel of ours needs is not to be had without a network."""
SWITCH = f"sh {field.INSTALL} --roles {field.ROLES} --program {NEXT}/bin/tuberline /root/field.toml"
BACK = ("sh", field.INSTALL, "--roles", field.ROLES, "--program", TUBERLINE, "/root/field.toml")


def next_version() -> str:
    return f"{version()}+next"


def make_wheel(folder: Path, root: Path) -> None:
    """The next version's wheel, in the root."""
    source = root / WHEELS.lstrip("/") / "source"
    copy_clone(source)
    home = source / "conveyor" / "__init__.py"
    home.write_text(
        re.sub(r"(?m)^__version__ = .*$", f'__version__ = "{next_version()}"', home.read_text(encoding="utf-8")),
        encoding="utf-8",
    )
    pip = ("/opt/tuberline/bin/pip", "wheel", "--quiet", "--no-deps", "--no-cache-dir")
    in_root(folder, root, *pip, "--wheel-dir", WHEELS, f"{WHEELS}/source")
    shutil.rmtree(source)


def runs(machine: Machine) -> str:
    """The version that the line's units run, all of them."""
    chosen = machine.run("sh", "-c", ". /etc/tuberline/environment; echo $TUBERLINE")
    said = machine.run(chosen, "--version")
    for unit in field.UNITS:
        pid = machine.run("systemctl", "show", "--value", "--property", "MainPID", unit)
        words = machine.run("cat", f"/proc/{pid}/cmdline")
        if str(Path(chosen).parent) not in words:
            raise TrialError(f"{unit} runs {words} where the environment says {chosen}")
    return said


def cut_in_upgrade(machine: Machine, chosen: bool, after_s: float) -> None:
    """Begin the upgrade and take the power away, so long after its begin or after the next version was chosen."""
    machine.run("sh", "-c", f"({PREPARE}\n{SWITCH}) >/root/upgrade.log 2>&1 &")
    if chosen:
        file = machine.disk / CHOSEN.lstrip("/")
        until(lambda: NEXT in file.read_text(encoding="utf-8"), "the next version chosen", every_s=0.02)
    sleep(after_s)
    machine.cut_power()


def go_back(machine: Machine) -> None:
    """The old program's name is all that it takes."""
    machine.run(*BACK)
    field.all_active(machine, field.UNITS)
    if runs(machine) != version():
        raise TrialError(f"after the way back the line runs {runs(machine)}")


def in_the_load(machine: Machine, cuts: Cuts) -> int:
    """Tubers that the ledger holds now, none lost; what is tried next is tried while more come."""
    seen = field.Seen(machine.disk)
    take_stock(cuts, seen)
    if seen.finished:
        raise TrialError("the load was over before the upgrade: it needs a longer recording")
    return len(seen.tubers)


def trial(folder: Path, root: Path) -> list[tuple[str, str]]:
    """Rows of the table of `make boot`."""
    make_wheel(folder, root)
    recordings = field.simulate(folder / "upgrade-recordings", seed=SEED, tubers=TUBERS, speed_mps=0.1)
    reference = field.replayed(recordings, folder / "upgrade-reference")
    rng, cuts, reached = random.Random(SEED), Cuts(), []
    with Machine(folder, root, "upgrade", 4, {str(recordings): "/recordings"}) as machine:
        machine.power_on()
        machine.booted()
        field.install(machine, field.config(speed=SPEED), field.ROLES)
        field.all_active(machine, field.UNITS)
        for number, (chosen, within_s) in enumerate(CUTS, start=1):
            field.wait_for(machine, TUBERS_EACH * number)
            after_s = rng.uniform(*within_s)
            cut_in_upgrade(machine, chosen, after_s)
            held = in_the_load(machine, cuts)
            machine.power_on()
            field.all_active(machine, field.UNITS)
            came = runs(machine)
            what = "after the next was chosen" if chosen else "after its begin"
            reached.append(f"{after_s:.1f} s {what} ({held} tubers): {came}")
            say(f"upgrade cut after {reached[-1]}")
            if came != version():
                go_back(machine)
        machine.run("sh", "-c", f"({PREPARE}\n{SWITCH}) 2>&1")
        field.all_active(machine, field.UNITS)
        if runs(machine) != next_version():
            raise TrialError(f"after the upgrade the line runs {runs(machine)}")
        held = in_the_load(machine, cuts)
        go_back(machine)
        counted = field.counted_as(machine, reference)
        take_stock(cuts, field.Seen(machine.disk))
    return [
        (
            f"power lost {len(CUTS)} times during an upgrade, seed {SEED}",
            f"came back by itself, no tuber lost; cut after {', '.join(reached)}",
        ),
        ("that upgrade to its end, and the way back, in the load", f"{held} tubers at the way back; {counted}"),
    ]
