"""An exception in any loop, thread or callback of those who only watch ends them with 70, and they come back."""

from __future__ import annotations

import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from urllib.error import HTTPError

import pytest

from conveyor.config import dump_toml, parse_config
from conveyor.errors import FAULT
from conveyor.formats import open_source
from conveyor.taken_port import free_port
from tests.chaos.harness import inject
from tests.conftest import wait_until
from tuberline.supervisor import ProcessSpec, Supervisor

pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]

HEARD = "conveyor.delivery.kept KeptSubscriber._on_sample 3"
TOKEN = "conveyor.delivery.presence Presence._on_token 1"
ONE_OF_EACH = (
    "page viewer.page.watch LineWatch._hear 3",
    f"metrics {HEARD}",
    "alarms tuberline.alarms.service AlarmService.step 3",
)
ALL = (
    *ONE_OF_EACH,
    "page conveyor.notify notify 5",
    "page viewer.page.server PageServer._serve 1",
    f"page {HEARD}",
    f"page {TOKEN}",
    "metrics conveyor.notify notify 5",
    f"metrics {TOKEN}",
    "alarms conveyor.notify notify 5",
    "alarms tuberline.alarms.service check_disk 1",
    "alarms tuberline.alarms.sender Sender.send_next 3",
    "alarms viewer.page.watch LineWatch._hear 3",
    f"alarms {HEARD}",
    f"alarms {TOKEN}",
)
RECORDER = (
    "recorder conveyor.formats.mcap.writer McapFrameWriter.write 8",
    "recorder conveyor.node Node._publish_counters 2",
    "recorder conveyor.delivery.inbox Inbox.push 8",
)


@pytest.fixture
def line(live_recording: Path, tmp_path: Path) -> Path:
    """The file of a line with one camera that plays slowly; no one takes its frames but who records."""
    config = parse_config(
        {
            "link": {"router": f"tcp/127.0.0.1:{free_port()}"},
            "cameras": {"front": {"path": str(live_recording), "waits": False, "speed": 0.05}},
            "aggregator": {"out": str(tmp_path / "run")},
            "alarms": {"channels": [f"http://127.0.0.1:{free_port()}/"]},
        },
        where="of this test",
    )
    file = tmp_path / "line.toml"
    file.write_text(dump_toml(config))
    return file


@pytest.fixture
def camera(line: Path, tmp_path: Path) -> Iterator[None]:
    """The router and the camera at work."""
    arguments = ("--config", str(line))
    specs = [
        ProcessSpec("router", ("router", *arguments)),
        ProcessSpec("camera", ("camera", *arguments, "--run", "r", "--camera", "front")),
    ]
    with Supervisor(specs, log_dir=tmp_path / "logs"):
        yield


def answer(port: int, path: str) -> str:
    """What an HTTP server of this machine says; empty where none answers yet."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=10) as reply:
            return str(reply.read().decode())
    except HTTPError:
        raise
    except OSError:
        return ""


@pytest.mark.usefixtures("camera")
@pytest.mark.parametrize(
    "faults",
    [pytest.param(ONE_OF_EACH, id="one-of-each"), pytest.param(ALL, id="all", marks=pytest.mark.slow)],
)
def test_a_watcher_ends_on_every_fault_and_comes_back(
    faults: tuple[str, ...], line: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    raised = inject(faults, tmp_path, monkeypatch)
    wanted = {f"{role} {function}" for role, _, function, _ in (fault.split() for fault in faults)}
    page, metrics = free_port(), free_port()
    specs = [
        ProcessSpec("page", ("page", "--config", str(line), "--listen", f"127.0.0.1:{page}")),
        ProcessSpec("metrics", ("metrics", "--config", str(line), "--listen", f"127.0.0.1:{metrics}")),
        ProcessSpec("alarms", ("alarms", str(line))),
    ]
    with Supervisor(specs, log_dir=tmp_path / "watchers") as watchers:
        wait_until(lambda: wanted <= {f.name for f in raised.iterdir()}, what=f"every one of {wanted}", timeout_s=200)
        wait_until(lambda: '"front"' in answer(page, "/snapshot.json"), what="the page", timeout_s=60)
        wait_until(lambda: "frames_published" in answer(metrics, "/metrics"), what="metrics", timeout_s=60)
        wait_until(lambda: watchers.pid("alarms") is not None, what="alarms", timeout_s=60)
        # Two faults may come in two threads of one process at the same moment.
        ended = {(file.name.split()[0], file.read_text()) for file in raised.iterdir()}
        crashes = {name: sum(role == name for role, _ in ended) for name in ("page", "metrics", "alarms")}
        wait_until(lambda: watchers.crashes == crashes, what=f"{crashes} restarts", timeout_s=30)
        assert watchers.failures == {}


@pytest.mark.slow
@pytest.mark.usefixtures("camera")
def test_a_scrape_that_fails_is_the_scrapes_alone(line: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inject(("metrics tuberline.metrics node_metrics 1",), tmp_path, monkeypatch)
    port = free_port()
    spec = ProcessSpec("metrics", ("metrics", "--config", str(line), "--listen", f"127.0.0.1:{port}"))

    def failed() -> bool:
        try:
            return "nothing" in answer(port, "/metrics")
        except HTTPError as error:
            return error.code == 500

    with Supervisor([spec], log_dir=tmp_path / "watchers") as watchers:
        wait_until(failed, what="the scrape that fails", timeout_s=60)
        assert "tuberline_node_up" in answer(port, "/metrics")
        assert watchers.crashes == {"metrics": 0}


@pytest.mark.usefixtures("camera")
@pytest.mark.parametrize(
    "fault",
    [pytest.param(f, id=f.split()[2], marks=() if n == 0 else pytest.mark.slow) for n, f in enumerate(RECORDER)],
)
def test_a_recorder_ends_and_what_it_had_can_be_saved(
    fault: str, line: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By its loop the file is whole; ended in another thread or a callback, `tuberline recover` saves it."""
    inject((fault,), tmp_path, monkeypatch)
    out = tmp_path / "belt.mcap"
    command = [sys.executable, "-m", "tuberline", "recorder", "--config", str(line), "--run", "r", "--out", str(out)]
    begun = time.monotonic()
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == FAULT, done.stderr
    assert "injected" in done.stderr
    assert time.monotonic() - begun < 100
    if "McapFrameWriter" in fault:
        assert len(list(open_source(out, camera="front").frames(run="r"))) == 7
    else:
        saved = tmp_path / "saved.mcap"
        recover = [sys.executable, "-m", "tuberline", "recover", str(out), "--out", str(saved)]
        subprocess.run(recover, capture_output=True, text=True, check=True, timeout=60)
