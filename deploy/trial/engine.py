"""buildah and podman with a storage of their own, so that nothing of this machine's images is touched."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from deploy.trial.tools import PATIENCE_S, run

TOOLS = {
    "buildah": "buildah",
    "podman": "podman",
    "runc": "runc",
    "conmon": "conmon",
    "catatonit": "catatonit",
    "iptables": "iptables",
    "nsenter": "util-linux",
    "ip": "iproute2",
}
SPACE = "tuberline-containers"
"""Of the network namespace, and of the network in it."""
LIMITS = ("--ulimit", "nofile=8192:8192", "--ulimit", "nproc=4096:4096")
"""Podman's own are higher than a machine may allow it to set."""
GATEWAY = "10.78.0.1"
"""What compose calls host-gateway: where a published port of the host is reached from a container."""


class Engine:
    """Builds and runs images under `folder`; `close` removes every container and network of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        driver = "overlay" if "overlay" in Path("/proc/filesystems").read_text(encoding="utf-8") else "vfs"
        driver = os.environ.get("STORAGE_DRIVER", driver)
        self.storage = ["--root", str(folder / "storage"), "--runroot", str(folder / "run"), "--storage-driver", driver]
        self._within: list[str] = []
        # Networks live in the engine's own folder too, not in /etc/containers.
        self._podman = ["podman", *self.storage, "--runtime", "runc", "--cgroup-manager", "cgroupfs"]
        self._podman += ["--network-config-dir", str(folder / "networks")]

    def within_own_network(self) -> None:
        """Run from here on in a network namespace made for it: ports and rules of this machine stay as they are.

        By nsenter and not by `ip netns exec`, which would hide the control groups.
        """
        self.leave_own_network()
        run(["ip", "netns", "add", SPACE])
        run(["ip", "-n", SPACE, "link", "set", "lo", "up"])
        self._within = ["nsenter", f"--net=/run/netns/{SPACE}"]
        self.podman("network", "create", "--subnet", "10.78.0.0/24", "--gateway", GATEWAY, SPACE)

    def start_within(self, *words: str) -> subprocess.Popen[str]:
        """A program of this machine that containers reach at `GATEWAY`."""
        return subprocess.Popen([*self._within, *words], stdout=subprocess.PIPE, text=True)

    def leave_own_network(self) -> None:
        """Remove it, and every container in it."""
        if self._within:
            self.close()
            self._within = []
        run(["ip", "netns", "delete", SPACE], check=False)

    def buildah(self, *words: str | Path, check: bool = True, timeout_s: float = 4 * PATIENCE_S) -> str:
        return run(["buildah", *self.storage, *words], check=check, timeout_s=timeout_s).stdout.strip()

    def podman(
        self, *words: str | Path, check: bool = True, timeout_s: float = PATIENCE_S
    ) -> subprocess.CompletedProcess[str]:
        # All of a container's processes share what one process of nice 0 would get: a replay has six.
        weight = ("--cpu-shares", str(round(5 * 1024 * 1.25 ** -os.nice(0)))) if words[0] == "run" else ()
        return run([*self._within, *self._podman, words[0], *weight, *words[1:]], check=check, timeout_s=timeout_s)

    def has(self, image: str) -> bool:
        return self.podman("image", "exists", image, check=False).returncode == 0

    def size_mb(self, image: str) -> int:
        """What the image takes unpacked, MB (1e6 bytes)."""
        return round(int(self.podman("image", "inspect", "--format", "{{.Size}}", image).stdout) / 1e6)

    def close(self) -> None:
        self.podman("rm", "--all", "--force", "--time", "2", check=False)
        self.podman("network", "prune", "--force", check=False)
        self.podman("volume", "prune", "--force", check=False)

    def remove(self) -> None:
        """Take the storage away, with every image in it; podman leaves its overlay mounted."""
        mounts = [line.split()[1] for line in Path("/proc/mounts").read_text(encoding="utf-8").splitlines()]
        for mount in sorted((m for m in mounts if m.startswith(f"{self.folder}/")), reverse=True):
            run(["umount", "--lazy", mount], check=False)
        for name in ("storage", "run", "networks"):
            shutil.rmtree(self.folder / name, ignore_errors=True)
