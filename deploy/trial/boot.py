"""`make boot`: a Debian machine with a line on it, started, hurt, met by a second one, uninstalled. See --help."""

from __future__ import annotations

import argparse
import json
import re
import shutil
from pathlib import Path
from time import monotonic, sleep

from deploy.trial import field, upgrade
from deploy.trial.machine import Machine
from deploy.trial.machineroot import BOOTED_WITH, machines_on
from deploy.trial.tools import TrialError, ended, into_docs, say, table, until

SEED = 1616
PARTS = ("one", "upgrade", "two")
"""One machine, an upgrade of it that loses its power, two machines of which the second is late."""
Rows = list[tuple[str, str]]
UNITS = (*field.UNITS, *(f"tuberline-{role}@field.service" for role in ("metrics", "page", "encoder", "gnss")))
ROLES = f"{field.ROLES},metrics,page,encoder,gnss"
LIVE = """name = "live"
[cameras.front]
source = "realsense"
belt_distance_m = 0.46
"""
WAITS = "systemd-networkd-wait-online.service"
TOKEN = ("--page-token", "/root/page-token")
"""Of one machine: those that watch are there too."""


def show(machine: Machine, unit: str, name: str) -> str:
    return machine.run("systemctl", "show", "--value", "--property", name, unit)


def started_us(machine: Machine, unit: str, name: str) -> int:
    return int(show(machine, unit, name) or 0)


def in_order(machine: Machine) -> str:
    """The router was ready before the aggregator began; what time each took to be ready."""
    router, aggregator = field.UNITS[:2]
    ready = started_us(machine, router, "ActiveEnterTimestampMonotonic")
    began = started_us(machine, aggregator, "ExecMainStartTimestampMonotonic")
    if not 0 < ready <= began:
        raise TrialError(f"the aggregator was started {(ready - began) / 1e6:.2f} s before the router was ready")
    first = min(started_us(machine, unit, "ExecMainStartTimestampMonotonic") for unit in UNITS)
    took = [
        f"{re.split('[-@]', unit)[1]} {(started_us(machine, unit, 'ActiveEnterTimestampMonotonic') - first) / 1e6:.1f}"
        for unit in UNITS
    ]
    return "seconds until ready: " + ", ".join(took)


def without_an_address(machine: Machine) -> None:
    """From the next start on its network gives it none: what waits for one waits for two minutes."""
    network = machine.disk / "etc/systemd/network/10-host0.network"
    network.write_text("[Match]\nName=host0\n[Network]\nDHCP=yes\n", encoding="utf-8")
    machine.run("systemctl", "enable", WAITS)
    machine.run("systemctl", "add-wants", "multi-user.target", "network-online.target")


def has_not_waited(machine: Machine) -> str:
    """The router began beside what waits for the network, and not after it."""
    began = started_us(machine, field.UNITS[0], "ExecMainStartTimestampMonotonic")
    waits = started_us(machine, WAITS, "ExecMainStartTimestampMonotonic")
    if not waits or began - waits > 60e6:
        raise TrialError(f"the router began {(began - waits) / 1e6:.0f} s after systemd began to wait for an address")
    return "all units active by themselves, though no address came,"


def services_work(machine: Machine) -> Rows:
    """Status, journal, timer, quota, doctor."""
    rows: Rows = []
    status = machine.says("systemctl", "status", "--no-pager", "tuberline-*")
    active = status.count("Active: active (running)")
    if active < len(UNITS):
        raise TrialError(f"systemctl status shows {active} running units:\n{status[:800]}")
    rows.append(("`systemctl status 'tuberline-*'`", f"{active} units active (running)"))
    silent = [
        unit
        for unit in field.UNITS
        if "started run=" not in machine.says("journalctl", "--namespace=tuberline", "-o", "cat", "-u", unit)
        and "router" not in unit
    ]
    if silent:
        raise TrialError(f"the journal has no start of {silent}")
    use = machine.run("journalctl", "--namespace=tuberline", "--disk-usage")
    rows.append(
        ("`journalctl --namespace=tuberline -u UNIT`", f"each node's words; {use.split('take up')[-1].strip()}")
    )
    timer = machine.run("systemctl", "list-timers", "--no-pager", "prune-tuberline.timer")
    if "prune-tuberline.service" not in timer:
        raise TrialError(f"the timer is not there: {timer}")
    rows.append(("`prune-tuberline.timer`", f"active, {quota(machine)}"))
    words = ("runuser", "-u", "tuberline", "--", "tuberline", "doctor", "--config", "/etc/tuberline/lines/field.toml")
    said = machine.says(*words, "--json")
    found = json.JSONDecoder().raw_decode(said[said.index("{") :])[0]["findings"]
    faults = [f"{f['check']}: {f['text']}" for f in found if f["level"] == "fault"]
    if faults:
        raise TrialError(f"the doctor is not content: {faults}")
    warnings = [f["check"] for f in found if f["level"] == "warning"]
    rows.append(("`tuberline doctor`", f"{len(found)} findings, no fault, warnings: {', '.join(warnings) or 'none'}"))
    return rows


def quota(machine: Machine) -> str:
    """Three recordings above the quota: the oldest go, the newest stays."""
    folder = "/var/lib/tuberline/recordings"
    for age, name in enumerate(("new", "middle", "old")):
        machine.run(
            "sh", "-c", f"head -c 2M /dev/zero >{folder}/{name}.mcap; touch -d '-{age + 1} hour' {folder}/{name}.mcap"
        )
    machine.run("sed", "-i", "s/^TUBERLINE_RECORDINGS_GB=.*/TUBERLINE_RECORDINGS_GB=0/", "/etc/tuberline/environment")
    machine.run("systemctl", "start", "prune-tuberline.service")
    left = machine.run("ls", folder).split()
    machine.run("sed", "-i", "s/^TUBERLINE_RECORDINGS_GB=.*/TUBERLINE_RECORDINGS_GB=200/", "/etc/tuberline/environment")
    if left != ["new.mcap"]:
        raise TrialError(f"the quota left {left}")
    return "of 3 recordings over the quota the newest stays"


def stopped_node_is_replaced(machine: Machine) -> tuple[str, str]:
    """SIGSTOP a segmenter: its watchdog runs out, it is killed and started again."""
    unit = field.UNITS[2]
    pid = int(show(machine, unit, "MainPID"))
    machine.run("kill", "-STOP", str(pid))
    start = monotonic()
    until(
        lambda: show(machine, unit, "MainPID") not in ("0", str(pid)) and machine.active(unit),
        "the segmenter replaced",
    )
    took = monotonic() - start
    said = machine.says("journalctl", "--no-pager", "-o", "cat", "-u", unit, "--grep", "[Ww]atchdog", "-n", "1")
    return "a segmenter stopped by SIGSTOP", f"replaced and ready after {took:.0f} s; systemd: {said.splitlines()[-1]}"


def crash_loop_is_slowed(machine: Machine) -> tuple[str, str]:
    """A regressor that ends with 70 at once: from the sixth start on each waits, and the journal tells."""
    unit = field.UNITS[3]
    drop = machine.disk / f"etc/systemd/system/{unit}.d/90-crash.conf"
    drop.parent.mkdir(parents=True, exist_ok=True)
    broken = machine.disk / "usr/local/bin/broken"
    broken.write_text("#!/bin/sh\necho 'it fails at once' >&2\nexit 70\n", encoding="utf-8")
    broken.chmod(0o755)
    drop.write_text("[Service]\nEnvironment=TUBERLINE=/usr/local/bin/broken\nEnvironmentFile=\n", encoding="utf-8")
    machine.run("systemctl", "daemon-reload")
    machine.says("systemctl", "restart", "--no-block", unit)
    journal = ("journalctl", "--namespace=tuberline", "--no-pager", "-o", "cat", "-u", unit)
    until(lambda: "within five minutes" in machine.says(*journal), "the crash loop told")
    before = machine.says(*journal).count("it fails at once")
    sleep(45)
    after = machine.says(*journal).count("it fails at once")
    told = next(line for line in machine.says(*journal).splitlines() if "within five minutes" in line)
    shutil.rmtree(drop.parent)
    machine.run("systemctl", "daemon-reload")
    machine.says("systemctl", "restart", "--no-block", unit)
    field.all_active(machine, (unit,))
    if after - before > 2:
        raise TrialError(f"a crash loop went on with {after - before} starts in 45 s")
    return "a regressor that crashes at every start", f"{before} starts, then one each 30 s. The journal: '{told}'"


def realsense_is_looked_for(machine: Machine) -> tuple[str, str]:
    """A camera's unit with nothing plugged in: the SDK finds its library, and may look under the unit's bans."""
    lines, unit = machine.disk / "etc/tuberline/lines", "tuberline-camera@live:front.service"
    (lines / "live.toml").write_text(LIVE, encoding="utf-8")
    (lines / "live.run").write_text("monday\n", encoding="utf-8")
    machine.says("systemctl", "start", "--no-block", unit)
    journal = ("journalctl", "--namespace=tuberline", "--no-pager", "-o", "cat", "-u", unit)
    until(lambda: "tuberline: " in machine.says(*journal), "the camera's word on the RealSense")
    said = next(line for line in machine.says(*journal).splitlines() if line.startswith("tuberline: "))
    machine.says("systemctl", "stop", unit)
    for name in ("live.toml", "live.run"):
        (lines / name).unlink()
    if "is not connected; connected: none" not in said:
        raise TrialError(f"a camera without a RealSense should say that none is connected, said: {said}")
    return "a camera's unit with no RealSense plugged in", f"the SDK looks and finds none: '{said}'"


def positions_kept(machine: Machine) -> tuple[str, str]:
    """The receiver's positions, beside the ledger."""
    rows = (machine.disk / field.LEDGER / "positions.csv").read_text(encoding="utf-8").splitlines()
    if len(rows) < 2:
        raise TrialError("the receiver's unit wrote no position")
    return "the receiver's unit", f"{len(rows) - 1} positions beside the ledger"


def uninstalled(machine: Machine) -> tuple[str, str]:
    """Units and scripts go; ledger, recordings and config stay."""
    ledger = (machine.disk / field.LEDGER / "ledger.db").read_bytes()
    machine.run("sh", field.INSTALL, "--uninstall")
    left = ("var/lib/tuberline/recordings/new.mcap", "etc/tuberline/lines/field.toml")
    lost = [path for path in left if not (machine.disk / path).exists()]
    units = [str(path) for path in (machine.disk / "etc/systemd/system").glob("*tuberline*")]
    running = machine.says("pgrep", "-u", "tuberline", "-a")
    if lost or units or running or not (machine.disk / field.LEDGER / "ledger.db").exists():
        raise TrialError(f"uninstalling lost {lost}, left {units}, running: {running}")
    size = len(ledger)
    return "`install.sh --uninstall`", f"no unit, no process left; ledger ({size // 1000} kB), recordings, config stay"


def one_machine(folder: Path, root: Path, recordings: Path, reference: list[str]) -> Rows:
    """Everything on one computer."""
    rows: Rows = []
    with Machine(folder, root, "harvester", 1, {str(recordings): "/recordings"}) as machine:
        machine.power_on()
        rows.append(("boot of the bare root", f"{machine.booted():.1f} s"))
        (machine.disk / "root/page-token").write_text("a-token-of-this-trial", encoding="utf-8")
        field.install(machine, field.config() + field.DEVICES, ROLES, *TOKEN)
        rows.append(
            (
                "`install.sh` in it",
                f"all {len(UNITS)} units active after {field.all_active(machine, UNITS):.0f} s",
            )
        )
        again = machine.run("sh", field.INSTALL, "--roles", ROLES, *TOKEN, "--run", "monday", "/root/field.toml")
        changed = [line for line in again.splitlines() if line.startswith(("created", "updated"))]
        rows.append(("`install.sh` again", f"changes {len(changed)} files"))
        without_an_address(machine)
        machine.shut_down()
        machine.power_on()
        took = field.all_active(machine, UNITS)
        rows.append(("shut down, switched on", f"{has_not_waited(machine)} after {took:.0f} s; {in_order(machine)}"))
        for step in (stopped_node_is_replaced, crash_loop_is_slowed, realsense_is_looked_for, positions_kept):
            rows.append(step(machine))
            say(f"{rows[-1][0]}: {rows[-1][1]}")
        rows += services_work(machine)
        rows.append(("what it counted meanwhile", field.counted_as(machine, reference)))
        rows.append(uninstalled(machine))
    return rows


def two_machines(folder: Path, root: Path, recordings: Path, reference: list[str], minutes: float) -> Rows:
    """Cameras boot first; the machine with the router, the ledger and the regressor minutes later."""
    text = field.config(router="tcp/10.77.0.2:7447", listen="tcp/0.0.0.0:7447")
    there = tuple(unit for unit in field.UNITS if "camera" in unit or "segmenter" in unit)
    with (
        Machine(folder, root, "harvester", 1, {str(recordings): "/recordings"}) as harvester,
        Machine(folder, root, "edge", 2) as edge,
    ):
        harvester.power_on()
        harvester.booted()
        field.install(harvester, text, "camera,segmenter", "--no-start")
        harvester.run("systemctl", "start", "--no-block", "tuberline@field.target")
        sleep(60.0 * minutes)
        restarts = sum(int(show(harvester, unit, "NRestarts")) for unit in there)
        waiting = harvester.says(
            "journalctl", "--namespace=tuberline", "-o", "cat", "--no-pager", "-n", "1", "-u", there[0]
        )
        edge.power_on()
        edge.booted()
        field.install(edge, text, "router,aggregator,regressor", "--no-start")
        start = monotonic()
        edge.run("systemctl", "start", "--no-block", "tuberline@field.target")
        field.all_active(edge, tuple(unit for unit in field.UNITS if unit not in there))
        field.all_active(harvester, there)
        took = monotonic() - start
        counted = field.counted_as(edge, reference)
    return [
        (
            f"cameras' machine booted {minutes:g} min before the router's",
            f"waited with {restarts} restarts ('{waiting}'); all active {took:.0f} s after the router came; {counted}",
        )
    ]


def main() -> None:
    parser = argparse.ArgumentParser(prog="make boot", description=__doc__)
    parser.add_argument("--keep", action="store_true", help="keep the installed root for the next time")
    parser.add_argument("--minutes", type=float, default=5.0, help="how long the second machine comes after the first")
    parser.add_argument("--only", choices=PARTS, help="one of the parts; keeps the root, the last one writes the table")
    given = parser.parse_args()
    with machines_on("make boot", keep=given.keep or given.only is not None) as (folder, root):
        state = folder / "boot.json"
        done: dict[str, Rows] = json.loads(state.read_text(encoding="utf-8")) if given.only and state.exists() else {}
        parts = [given.only] if given.only else PARTS
        recordings, reference = folder / "recordings", list[str]()
        if set(parts) & {"one", "two"}:
            field.simulate(recordings, seed=SEED, tubers=24)
            reference = field.replayed(recordings, folder / "reference")
        for part in parts:
            if part == "one":
                done[part] = one_machine(folder, root, recordings, reference)
            elif part == "upgrade":
                done[part] = upgrade.trial(folder, root)
            else:
                done[part] = two_machines(folder, root, recordings, reference, given.minutes)
            for what, seen in done[part]:
                say(f"{what}: {seen}")
            state.write_text(json.dumps(done), encoding="utf-8")
        if all(part in done for part in PARTS):
            into_docs("boot", table(("what", "seen"), [row for part in PARTS for row in done[part]]), BOOTED_WITH)


if __name__ == "__main__":
    ended(main)
