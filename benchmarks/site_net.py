"""Hosts on one machine: a network namespace each, all on one switch, some behind an emulated link."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import Self

from benchmarks.link import EmulatedLink
from benchmarks.link_wire import LinkSettings
from conveyor.errors import TuberlineError

SUBNET = "10.77.0"
TCP = "reno"
"""Congestion control: in every kernel, allowed in every namespace, and the one that loss slows down most."""


@dataclass(frozen=True, slots=True)
class Traffic:
    """Bytes through a host's one link since it was made, as the kernel counts them (Ethernet headers included)."""

    sent: int
    received: int


class Network:
    """A switch and hosts, in a `with` block; everything is taken down again, whatever happens inside.

    Args:
        tcp: congestion control of every host.

    Raises:
        TuberlineError: not root, no `ip` command, or a congestion control that namespaces may not use here.
    """

    def __init__(self, *, tcp: str = TCP) -> None:
        self._tcp = tcp
        self._prefix = f"tl{os.getpid():x}"
        self._addresses: dict[str, str] = {}
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        if os.geteuid() != 0 or shutil.which("ip") is None:
            raise TuberlineError("network namespaces need root and the command `ip` (Debian: apt-get install iproute2)")
        try:
            self._add_namespace("switch")
            ip("-n", self.namespace("switch"), "link", "add", "switch", "type", "bridge")
            ip("-n", self.namespace("switch"), "link", "set", "switch", "up")
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def namespace(self, host: str) -> str:
        """The host's namespace as `ip netns` lists it."""
        return f"{self._prefix}-{host}"

    def address(self, host: str) -> str:
        """The host's IPv4 address on the switch."""
        return self._addresses[host]

    def add(self, host: str) -> None:
        """A host on the switch, as fast as this machine."""
        inside, port = self._new_host(host)
        ip("link", "add", inside, "type", "veth", "peer", "name", port)
        self._wire(host, inside, port)

    def add_far(self, host: str, settings: LinkSettings, *, seed: int = 1) -> EmulatedLink:
        """A host behind an emulated link; its counts are from the host to the switch, and back."""
        inside, port = self._new_host(host)
        link = self._stack.enter_context(EmulatedLink(inside, port, settings, seed=seed))
        self._wire(host, inside, port)
        return link

    def limit(self, host: str, mbit: float) -> None:
        """Make the link of a host that was added with `add` so slow, each way (the kernel's token bucket)."""
        bucket = ("root", "tbf", "rate", f"{mbit:g}mbit", "burst", "64kb", "latency", "50ms")
        number = list(self._addresses).index(host) + 1
        for space, device in ((self.namespace(host), "eth0"), (self.namespace("switch"), f"{self._prefix}p{number}")):
            done = subprocess.run(
                ["tc", "-n", space, "qdisc", "add", "dev", device, *bucket], capture_output=True, text=True, check=False
            )
            if done.returncode != 0:
                raise TuberlineError(f"`tc` cannot limit {device} of {host}: {done.stderr.strip()}")

    def command(self, host: str, args: Sequence[str]) -> list[str]:
        """`args` as they run on `host`: in its namespace and under its name. The process keeps its pid."""
        named = ["unshare", "--uts", "sh", "-c", 'hostname "$0" && exec "$@"', host, *args]
        return ["ip", "netns", "exec", self.namespace(host), *named]

    def traffic(self, host: str) -> Traffic:
        """What went through the host's link."""
        link = json.loads(ip("-n", self.namespace(host), "-s", "-j", "link", "show", "eth0"))[0]["stats64"]
        return Traffic(sent=link["tx"]["bytes"], received=link["rx"]["bytes"])

    def _new_host(self, host: str) -> tuple[str, str]:
        self._add_namespace(host)
        self._addresses[host] = f"{SUBNET}.{len(self._addresses) + 1}"
        number = len(self._addresses)
        return f"{self._prefix}h{number}", f"{self._prefix}p{number}"

    def _add_namespace(self, host: str) -> None:
        ip("netns", "add", self.namespace(host))
        self._stack.callback(_delete_namespace, self.namespace(host))
        ip("-n", self.namespace(host), "link", "set", "lo", "up")
        ip(
            "netns",
            "exec",
            self.namespace(host),
            "sh",
            "-c",
            f"echo {self._tcp} > /proc/sys/net/ipv4/tcp_congestion_control",
        )

    def _wire(self, host: str, inside: str, port: str) -> None:
        space, switch = self.namespace(host), self.namespace("switch")
        ip("link", "set", inside, "netns", space)
        ip("link", "set", port, "netns", switch)
        ip("-n", switch, "link", "set", port, "master", "switch", "up")
        ip("-n", space, "link", "set", inside, "name", "eth0")
        ip("-n", space, "address", "add", f"{self._addresses[host]}/24", "dev", "eth0")
        ip("-n", space, "link", "set", "eth0", "up")


def ip(*args: str) -> str:
    """Run `ip`; its output. Its complaint becomes the error."""
    done = subprocess.run(["ip", *args], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise TuberlineError(f"`ip {' '.join(args)}` failed: {done.stderr.strip()}")
    return done.stdout


def _delete_namespace(name: str) -> None:
    with suppress(TuberlineError):
        ip("netns", "delete", name)
