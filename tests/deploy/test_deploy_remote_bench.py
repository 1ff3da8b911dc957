"""The benchmarks' own parts: found by name; the site's network, slow link and CPU share do what they say."""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest

from benchmarks.__main__ import benchmarks
from benchmarks.link import EmulatedLink
from benchmarks.link_wire import LinkSettings
from benchmarks.options import above_zero, chosen, new_file, page_with, pixels, whole_number
from benchmarks.site_net import Network, Traffic, ip
from benchmarks.site_picture import draw_site, site_hosts
from benchmarks.site_share import CpuShare
from conveyor.errors import InputError, TuberlineError
from tests.conftest import ROOT

RATE_BITS_PER_S, DELAY_S = 8e6, 0.04
SERVER = """
import socket, sys
listener = socket.create_server(("", 5000)); print("ready", flush=True)
peer, _ = listener.accept(); peer.sendall(b"hello"); n = 0
while data := peer.recv(65536): n += len(data)
"""
CLIENT = """
import json, os, socket, sys, time
begun = time.monotonic(); peer = socket.create_connection((sys.argv[1], 5000)); peer.recv(5)
answered = time.monotonic() - begun
begun = time.monotonic(); peer.sendall(bytes(400_000)); peer.shutdown(socket.SHUT_WR); peer.recv(1)
print(json.dumps([answered, time.monotonic() - begun, os.uname().nodename]))
"""
BUSY = "import time\nend = time.monotonic() + 1.0\nwhile time.monotonic() < end: pass\nprint(time.process_time())"


def test_every_benchmark_is_found_by_name_and_says_what_it_measures() -> None:
    found = benchmarks()
    assert {"site", "site_codecs"} <= set(found)
    assert all(found.values())
    assert "site_net" not in found
    named = [
        re.findall(r'parser_of\("(\w+)", __doc__\)', (ROOT / f"benchmarks/{name}.py").read_text()) for name in found
    ]
    assert named == [[name] for name in found], "its help names the command that runs it"


def test_arguments_of_benchmarks_are_refused_before_anything_runs(tmp_path: Path) -> None:
    (page := tmp_path / "page.md").write_text("<!-- gauge: begin -->\n\n<!-- gauge: end -->\n")
    assert (whole_number(2)("2"), above_zero("0.5"), pixels("848x480")) == (2, 0.5, (848, 480))
    assert page_with("gauge")(str(page)) == page
    assert chosen("abc", None) == ["a", "b", "c"]
    assert chosen("abc", [2, 0]) == ["a", "c"]
    refused = [(whole_number(1), text) for text in ("0", "1.5", "x")] + [
        (above_zero, text) for text in ("0", "nan", "x")
    ]
    refused += [
        (pixels, "848"),
        (page_with("gauge", "heights"), str(page)),
        (new_file, str(tmp_path / "none" / "a.json")),
    ]
    for read, text in refused:
        with pytest.raises(argparse.ArgumentTypeError, match=re.escape(text)):
            read(text)
    with pytest.raises(InputError, match="give some from 0 to 2"):
        chosen("abc", [3])


def test_an_unknown_benchmark_is_refused_with_those_that_exist() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "sight"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "'sight' is unknown; known: " in done.stderr
    assert "site" in done.stderr


def test_the_far_host_has_the_links_rate_and_delay_and_its_own_name() -> None:
    try:
        network = Network().__enter__()
    except TuberlineError as error:
        pytest.skip(f"no network namespaces here, so the site was not built: {error}")
    try:
        network.add("edge")
        try:
            network.add_far("office", LinkSettings(bits_per_s=RATE_BITS_PER_S, delay_s=DELAY_S))
        except OSError as error:
            pytest.skip(f"no TAP devices here, so the slow link was not built: {error}")
        server = subprocess.Popen(network.command("edge", [sys.executable, "-c", SERVER]), stdout=subprocess.PIPE)
        assert server.stdout is not None
        server.stdout.readline()
        client = network.command("office", [sys.executable, "-c", CLIENT, network.address("edge")])
        answered_s, sending_s, name = json.loads(subprocess.run(client, capture_output=True, check=True).stdout)
        server.wait(10)
        traffic = network.traffic("office")
    finally:
        network.__exit__()
    assert name == "office"
    assert answered_s > 4 * DELAY_S, "ARP, connecting and hello: at least two round trips"
    assert sending_s > 8 * 400_000 / RATE_BITS_PER_S
    assert 400_000 < traffic.sent < 480_000
    assert network.namespace("office") not in ip("netns", "list"), "nothing is left behind"


def test_a_share_of_cpu_is_kept() -> None:
    try:
        share = CpuShare(f"tuberline-test-{os.getpid()}", share=0.2).__enter__()
    except (TuberlineError, OSError) as error:
        pytest.skip(f"no writable cgroups here, so the limit was not tried: {error}")
    try:
        process = subprocess.Popen(["sh", "-c", f"read go; exec {sys.executable} -c '{BUSY}'"], stdin=-1, stdout=-1)
        share.add(process.pid)
        out, _ = process.communicate(b"go\n", timeout=60)
    finally:
        share.__exit__()
    assert float(out) < 0.45, "one second at a fifth of a core, and the start of Python"


def test_the_picture_shows_every_host_and_its_bytes() -> None:
    hosts = site_hosts(4, share=0.1, office="8 Mbit/s, 40 ms")
    traffic = {host.name: Traffic(sent=1_500_000 + n, received=2_000) for n, host in enumerate(hosts)}
    text = draw_site(hosts, traffic, title="32 views/s")
    words = [element.text for element in ElementTree.fromstring(text).iter() if element.text]
    assert {host.name for host in hosts} <= set(words)
    assert words.count("→ 1.5 MB") == 4
    assert words.count("← 1.5 MB") == 5


def test_the_emulated_link_gives_its_devices_back() -> None:
    left, right = f"tlx{os.getpid() % 9999}", f"tly{os.getpid() % 9999}"
    try:
        with EmulatedLink(left, right, LinkSettings(bits_per_s=1e6, delay_s=0.01)):
            assert left in ip("link", "show")
    except (OSError, TuberlineError) as error:
        pytest.skip(f"no TAP devices here: {error}")
    deadline = time.monotonic() + 5
    while left in ip("link", "show") and time.monotonic() < deadline:
        time.sleep(0.02)
    assert left not in ip("link", "show")
