"""A booted Debian machine: systemd as process 1 of systemd-nspawn, on a copy of the root that is thrown away.

What stays of a machine between boots is its disk (an overlay over the root); `cut_power` kills every process of it at
once. The page cache is this computer's, so what had been written without being synced survives such a cut: a cut shows
that a line comes up again from whatever moment it was stopped at, not that the disk was told to sync.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep

from deploy.trial.tools import PATIENCE_S, TrialError, run, until

TOOLS = {"systemd-nspawn": "systemd-container", "nsenter": "util-linux", "ip": "iproute2", "mount": "mount"}
SPACE = "tuberline-trial"
CGROUPS = Path("/sys/fs/cgroup")


def make_network() -> None:
    """A network namespace with a bridge: the machines' only network, which leads nowhere else."""
    remove_network()
    run(["ip", "netns", "add", SPACE])
    for words in (
        ("link", "set", "lo", "up"),
        ("link", "add", "tl0", "type", "bridge"),
        ("addr", "add", "10.77.0.254/24", "dev", "tl0"),
        ("link", "set", "tl0", "up"),
    ):
        run(["ip", "-n", SPACE, *words])


def remove_network() -> None:
    run(["ip", "netns", "delete", SPACE], check=False)


class Machine:
    """One machine named `name` at 10.77.0.`number`; `folders` of this computer appear in it as they are named."""

    def __init__(self, folder: Path, root: Path, name: str, number: int, folders: dict[str, str] | None = None) -> None:
        self.name = name
        self.address = f"10.77.0.{number}"
        self._folder, self._base = folder / name, root
        self.disk = self._folder / "disk"
        self._folders = folders or {}
        self._process: subprocess.Popen[bytes] | None = None
        self._leader = 0

    def __enter__(self) -> Machine:
        return self.make()

    def __exit__(self, *_: object) -> None:
        self.remove()

    def mount(self) -> None:
        """Put the disk in: what is written goes beside the root, and what was written before is there."""
        for part in ("disk", "written", "work"):
            (self._folder / part).mkdir(parents=True, exist_ok=True)
        layers = f"lowerdir={self._base},upperdir={self._folder / 'written'},workdir={self._folder / 'work'}"
        run(["mount", "-t", "overlay", "-o", layers, "tuberline-trial", self.disk])

    def make(self) -> Machine:
        """Put a new disk in, with the machine's name and address on it."""
        self.remove()
        self.mount()
        (self.disk / "etc/hostname").write_text(f"{self.name}\n", encoding="utf-8")
        (self.disk / "etc/machine-id").unlink(missing_ok=True)
        network = f"[Match]\nName=host0\n[Network]\nAddress={self.address}/24\nLinkLocalAddressing=no\n"
        (self.disk / "etc/systemd/network").mkdir(parents=True, exist_ok=True)
        (self.disk / "etc/systemd/network/10-host0.network").write_text(network, encoding="utf-8")
        wants = self.disk / "etc/systemd/system/multi-user.target.wants"
        wants.mkdir(parents=True, exist_ok=True)
        (wants / "systemd-networkd.service").symlink_to("/lib/systemd/system/systemd-networkd.service")
        return self

    def unmount(self) -> None:
        """Power off without asking, and take the disk out; what is on it stays."""
        self.cut_power()
        run(["umount", "--lazy", self.disk], check=False)

    def remove(self) -> None:
        """The same, and the disk is thrown away."""
        self.unmount()
        shutil.rmtree(self._folder, ignore_errors=True)

    def power_on(self) -> None:
        """Start it; returns at once."""
        self._make_cgroups()
        log = (self._folder / "console.log").open("ab")
        words = ["systemd-nspawn", f"--directory={self.disk}", "--boot", "--register=no", "--keep-unit"]
        words += [f"--machine={self.name}", "--console=read-only", "--network-bridge=tl0", "--resolv-conf=off"]
        words += [f"--bind={here}:{there}" for here, there in self._folders.items()]
        self._process = subprocess.Popen(
            ["nsenter", f"--net=/run/netns/{SPACE}", *words],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            preexec_fn=self._enter_cgroups,
            start_new_session=True,
        )
        log.close()
        process = self._process
        until(lambda: self._find_leader() or process.poll() is not None, "process 1", every_s=0.01)
        if not self._leader:
            raise TrialError(f"{self.name} did not start: {self.console()[-500:]}")

    def _find_leader(self) -> int:
        """Process 1 of the machine, as this computer numbers it."""
        assert self._process is not None
        waiting = [self._process.pid]
        while waiting:
            pid = waiting.pop()
            with suppress(OSError):
                status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
                spaces = next(line for line in status.splitlines() if line.startswith("NSpid")).split()[1:]
                if len(spaces) > 1 and spaces[-1] == "1":
                    self._leader = pid
                    return pid
                for children in Path(f"/proc/{pid}/task").glob("*/children"):
                    waiting += [int(child) for child in children.read_text(encoding="utf-8").split()]
        return 0

    def cut_power(self) -> None:
        """Kill every process of the machine in one go; a machine that is off stays off."""
        if self._process is None:
            return
        for pid in (self._process.pid, self._leader):
            if pid:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
        self._process.wait(PATIENCE_S)
        leader, self._process, self._leader = self._leader, None, 0
        until(lambda: not Path(f"/proc/{leader}/stat").exists() or leader == 0, "the end of all processes")
        self._remove_cgroups()

    def shut_down(self) -> None:
        """As a person would: systemctl poweroff."""
        assert self._process is not None
        self.run("systemctl", "poweroff", check=False)
        self._process.wait(PATIENCE_S)
        self._process, self._leader = None, 0
        self._remove_cgroups()

    @property
    def on(self) -> bool:
        return self._process is not None and self._process.poll() is None

    def run(self, *words: str, check: bool = True, timeout_s: float = PATIENCE_S) -> str:
        """What a command said inside the running machine."""
        enter = ["nsenter", f"--target={self._leader}", "--mount", "--uts", "--ipc", "--net", "--pid", "--root", "--wd"]
        environment = ["env", "-i", "PATH=/opt/tuberline/bin:/usr/sbin:/usr/bin:/sbin:/bin", "LC_ALL=C.UTF-8"]
        done = run([*enter, *environment, *words], check=check, timeout_s=timeout_s)
        return (done.stdout + done.stderr).strip()

    def says(self, *words: str) -> str:
        """The same where the command may fail."""
        return self.run(*words, check=False)

    def booted(self, timeout_s: float = PATIENCE_S) -> float:
        """Seconds until systemd has started everything that it wants."""
        start = monotonic()
        until(
            lambda: self.says("systemctl", "is-system-running") in ("running", "degraded"),
            f"{self.name} booted",
            timeout_s=timeout_s,
        )
        return monotonic() - start

    def active(self, unit: str) -> bool:
        return self.says("systemctl", "is-active", unit) == "active"

    def console(self) -> str:
        return (self._folder / "console.log").read_text(encoding="utf-8", errors="replace")

    def _cgroups(self) -> Sequence[Path]:
        if (CGROUPS / "cgroup.controllers").exists():
            return [CGROUPS / f"tuberline-{self.name}"]
        return [h / f"tuberline-{self.name}" for h in CGROUPS.iterdir() if (h / "cgroup.procs").exists()]

    def _make_cgroups(self) -> None:
        for group in self._cgroups():
            group.mkdir(exist_ok=True)
            if group.parent.name == "cpuset":
                for name in ("cpuset.cpus", "cpuset.mems"):
                    (group / name).write_text((group.parent / name).read_text(encoding="utf-8"), encoding="utf-8")
            # All of a group's processes share what one process of nice 0 would get: a line has five.
            for name, normal in (("cpu.shares", 1024), ("cpu.weight", 100)):
                if (group / name).exists():
                    (group / name).write_text(str(round(5 * normal * 1.25 ** -os.nice(0))), encoding="utf-8")

    def _enter_cgroups(self) -> None:
        for group in self._cgroups():
            (group / "cgroup.procs").write_text(str(os.getpid()), encoding="utf-8")

    def _remove_cgroups(self) -> None:
        for _ in range(20):
            for group in self._cgroups():
                for folder, _, _ in os.walk(group, topdown=False):
                    with suppress(OSError):
                        Path(folder).rmdir()
            if not any(group.exists() for group in self._cgroups()):
                return
            sleep(0.1)
