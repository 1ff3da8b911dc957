"""Is the emulated link what it is set to? Round trips, lost share and TCP rate, set against measured.

python -m benchmarks link_check          # as root, about half a minute
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import dataclass
from typing import Any

from benchmarks.link_wire import LinkSettings
from benchmarks.options import parser_of
from benchmarks.site_net import TCP, Network

PORT = 5500
ECHOES = 400
ECHO_EVERY_S = 0.005
TCP_S = 4.0
SERVER = """
import socket, sys, threading
udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); udp.bind(("", {port}))
tcp = socket.create_server(("", {port}))
def echo():
    while True:
        data, who = udp.recvfrom(2048); udp.sendto(data, who)
threading.Thread(target=echo, daemon=True).start()
print("ready", flush=True)
while True:
    peer, _ = tcp.accept()
    while peer.recv(1 << 20): pass
    peer.close()
"""
PINGS = """
import json, select, socket, struct, sys, time
udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); udp.connect((sys.argv[1], {port}))
back, sent = {{}}, 0
def hear(until):
    while (left := until - time.monotonic()) > 0:
        if select.select([udp], [], [], left)[0]:
            n, at = struct.unpack("qd", udp.recv(2048)); back[n] = time.monotonic() - at
for n in range({echoes}):
    udp.send(struct.pack("qd", n, time.monotonic())); hear(time.monotonic() + {every})
hear(time.monotonic() + 1.0)
print(json.dumps(sorted(back.values())))
"""
UPLOAD = """
import json, socket, sys, time
peer = socket.create_connection((sys.argv[1], {port})); begun, sent = time.monotonic(), 0
while time.monotonic() < begun + {seconds}: sent += peer.send(bytes(16384))
peer.shutdown(socket.SHUT_WR); peer.recv(1)
print(json.dumps([sent, time.monotonic() - begun]))
"""


@dataclass(frozen=True, slots=True)
class LinkFigures:
    """What was measured through a link; sent and back, so that a round trip meets loss twice."""

    rtt_ms: tuple[float, float, float]
    """5th percentile, median, 95th percentile of the round trips."""
    round_trips_lost: float
    tcp_bits_per_s: float
    packets_lost: float
    """Share of all packets of both directions that the loss took, by the link's own counts."""
    queue_dropped: int


ALL = LinkSettings(delay_s=0.050, jitter_s=0.010, loss=0.05, bits_per_s=10e6)
CASES = {
    "nothing set": LinkSettings(),
    "delay 50 ms": LinkSettings(delay_s=0.050),
    "delay 50 ms, jitter 10 ms": LinkSettings(delay_s=0.050, jitter_s=0.010),
    "loss 5 %": LinkSettings(loss=0.05),
    "10 Mbit/s": LinkSettings(bits_per_s=10e6),
    "1 Mbit/s": LinkSettings(bits_per_s=1e6),
    "50 ms, 10 ms, 5 %, 10 Mbit/s": ALL,
}


def measure(settings: LinkSettings, *, echoes: int = ECHOES, tcp_s: float = TCP_S, tcp: str = TCP) -> LinkFigures:
    """Send echoes, then bytes over TCP where `tcp_s` is not 0, from a far host to one on the switch."""
    with Network(tcp=tcp) as network:
        network.add("near")
        link = network.add_far("far", settings)
        server = subprocess.Popen(
            network.command("near", [sys.executable, "-c", SERVER.format(port=PORT)]), stdout=subprocess.PIPE
        )
        try:
            assert server.stdout
            server.stdout.readline()
            address = network.address("near")
            pings = PINGS.format(port=PORT, echoes=echoes, every=ECHO_EVERY_S)
            rtts_s = _on(network, pings, address)
            sent, took_s = _on(network, UPLOAD.format(port=PORT, seconds=tcp_s), address) if tcp_s else (0, 1.0)
            there, back = link.counts()
        finally:
            server.kill()
            server.wait()
    entered = there.entered + back.entered
    # Without a single echo no round trip has an end.
    at = [rtts_s[int(share * (len(rtts_s) - 1))] if rtts_s else math.inf for share in (0.05, 0.5, 0.95)]
    return LinkFigures(
        rtt_ms=(1e3 * at[0], 1e3 * at[1], 1e3 * at[2]),
        round_trips_lost=1 - len(rtts_s) / echoes,
        tcp_bits_per_s=8 * sent / took_s,
        packets_lost=(there.lost_loss + back.lost_loss) / entered,
        queue_dropped=there.lost_queue + back.lost_queue,
    )


def main(arguments: list[str]) -> None:
    """Print the table."""
    parser = parser_of("link_check", __doc__)
    parser.add_argument("--tcp", default=TCP, help="congestion control of the hosts, e.g. bbr")
    options = parser.parse_args(arguments)
    print(
        "| set, each way | round trip ms (5 %, median, 95 %) | round trips lost | TCP Mbit/s | packets lost | queue |"
    )
    print("| --- | --- | --- | --- | --- | --- |")
    for name, settings in CASES.items():
        seen = measure(settings, tcp=options.tcp)
        rtt = ", ".join(f"{value:.1f}" for value in seen.rtt_ms)
        print(
            f"| {name} | {rtt} | {100 * seen.round_trips_lost:.1f} % | {seen.tcp_bits_per_s / 1e6:.2f} "
            f"| {100 * seen.packets_lost:.2f} % | {seen.queue_dropped} |"
        )


def _on(network: Network, code: str, address: str) -> Any:
    done = subprocess.run(
        network.command("far", [sys.executable, "-c", code, address]), capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)
