"""The loops, threads and callbacks that only a live line has: each raises once, and its process comes back."""

from __future__ import annotations

import subprocess
import sys
import time
from collections import Counter
from functools import reduce
from operator import xor
from pathlib import Path

import pytest

from conveyor.config import dump_toml, parse_config
from conveyor.errors import FAULT
from conveyor.taken_port import free_port
from tests.chaos.harness import inject
from tests.chaos.test_chaos_raising_watchers import answer
from tests.chaos.test_chaos_resume import child
from tests.conftest import wait_until
from tuberline.supervisor import ProcessSpec, Supervisor

pytestmark = [pytest.mark.graph, pytest.mark.slow, pytest.mark.timeout(600)]
FAULTS = (
    "gnss camera_sim.gnss.node GnssNode._tell 2",
    "gnss conveyor.node Node._publish_counters 3",
    "segmenter segmenter.log_writer LogWriter._write_all 3",
    "aggregator aggregator.queries Queries._answer_loads 1",
    "aggregator aggregator.orders Orders._arrived 1",
    "aggregator aggregator.orders Orders.carry_out 1",
    "page tuberline.maps.live live_map 1",
    "page viewer.page.pictures PictureWatch._follow 2",
    "viewer viewer.foxglove.server_sink ServerSink._send 3",
    "viewer conveyor.delivery.inbox Inbox.push 4",
)


def nmea(fixes: int) -> str:
    """Recorded positions, one a second, each with the date and with their checksums."""
    said = []
    for n in range(fixes):
        clock = f"12{n // 60:02d}{n % 60:02d}.00"
        said.append(f"GNRMC,{clock},A,5231.0000,N,00525.0000,E,2.7,0.0,221126,,,A")
        said.append(f"GNGGA,{clock},5231.0000,N,00525.0000,E,4,18,0.7,12.0,M,45.0,M,1.0,0001")
    return "".join(f"${body}*{reduce(xor, body.encode()):02X}\r\n" for body in said)


def test_every_one_ends_its_process_and_the_line_is_whole_again(
    live_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An order about a load is done, though the aggregator fell over it twice."""
    (tmp_path / "track.nmea").write_text(nmea(600))
    config = parse_config(
        {
            "link": {"router": f"tcp/127.0.0.1:{free_port()}"},
            "cameras": {"front": {"path": str(live_recording), "waits": False, "speed": 0.02}},
            "segmenter": {"state_dir": str(tmp_path / "state")},
            "aggregator": {"out": str(tmp_path / "run")},
            "gnss": {"source": f"file:{tmp_path / 'track.nmea'}"},
        },
        where="of this test",
    )
    file = tmp_path / "line.toml"
    file.write_text(dump_toml(config))
    raised = inject(FAULTS, tmp_path, monkeypatch)
    wanted = {f"{role} {function}" for role, _, function, _ in (fault.split() for fault in FAULTS)}
    port, common = free_port(), ("--config", str(file), "--run", "r")
    specs = [
        ProcessSpec("router", ("router", "--config", str(file))),
        ProcessSpec("aggregator", ("aggregator", *common)),
        ProcessSpec("segmenter", ("segmenter", *common, "--camera", "front")),
        ProcessSpec("camera", ("camera", *common, "--camera", "front")),
        ProcessSpec("gnss", ("gnss", *common)),
        ProcessSpec("page", ("page", "--config", str(file), "--listen", f"127.0.0.1:{port}")),
        ProcessSpec("viewer", ("viewer", "--config", str(file), "--foxglove", "127.0.0.1:0")),
    ]
    order = [sys.executable, "-m", "tuberline", "load", "start", "trailer 1", "--config", str(file)]
    with Supervisor(specs, log_dir=tmp_path / "logs") as line:
        wait_until(lambda: '"front"' in answer(port, "/snapshot.json"), what="the page", timeout_s=120)
        deadline_s = time.monotonic() + 200
        while (told := subprocess.run(order, capture_output=True, text=True, check=False, timeout=90)).returncode:
            assert time.monotonic() < deadline_s, told.stderr
        wait_until(lambda: wanted <= {f.name for f in raised.iterdir()}, what=f"every one of {wanted}", timeout_s=200)
        # Two faults may come in two threads of one process at the same moment.
        ended = Counter(name for name, _ in {(f.name.split()[0], f.read_text()) for f in raised.iterdir()})
        wait_until(lambda: ended <= Counter(line.crashes), what=f"{ended} restarts", timeout_s=60)
        wait_until(lambda: '"front"' in answer(port, "/snapshot.json"), what="the page again", timeout_s=60)
        assert Counter(line.crashes) == ended
        assert line.failures == {}


def test_a_supervisor_that_fails_ends_and_takes_its_nodes_along(
    live_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = parse_config(
        {
            "link": {"router": f"tcp/127.0.0.1:{free_port()}"},
            "cameras": {"front": {"path": str(live_recording), "waits": False, "speed": 0.02}},
            "aggregator": {"out": str(tmp_path / "run")},
        },
        where="of this test",
    )
    (tmp_path / "line.toml").write_text(dump_toml(config))
    inject(("run tuberline.supervisor Supervisor.poll 60",), tmp_path, monkeypatch)
    line = subprocess.Popen([sys.executable, "-m", "tuberline", "run", str(tmp_path / "line.toml")])
    try:
        roles = ("router", "aggregator", "camera", "segmenter")
        wait_until(lambda: all(child(line.pid, role) for role in roles), what="its nodes", timeout_s=60)
        nodes = [child(line.pid, role) for role in roles]
        assert line.wait(timeout=120) == FAULT
        wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in nodes), what="their end", timeout_s=60)
    finally:
        line.kill()
