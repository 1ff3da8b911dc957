"""The operator's page of a real line in a real browser, through TLS and the password. By name: it takes minutes."""

from __future__ import annotations

import gzip
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from conveyor.config import dump_toml
from tests.deploy.remote_browser import Browser, chromium
from tests.deploy.remote_site import PASSWORD, USER, remote_proxy
from tuberline.processes import line_processes
from tuberline.replayer import prepare_out, recording_cameras, replay_config
from tuberline.supervisor import Supervisor
from viewer.page.snapshot import snapshot
from viewer.page.watch import LineWatch

pytestmark = [pytest.mark.slow, pytest.mark.graph, pytest.mark.timeout(900)]
pytest.importorskip("rerun", reason="the proxy's other half needs tuberline[viewer]")
SHOWN_TUBERS = 45
PATIENCE_S = 360.0


def test_a_browser_shows_a_real_line_through_tls_and_the_password(tmp_path: Path) -> None:
    recording, out = tmp_path / "recording", tmp_path / "out"
    belt = ["--scene", "two-cameras", "--seed", "21", "--tubers", "110", "--fps", "15"]
    subprocess.run([sys.executable, "-m", "tuberline", "simulate", "--out", recording, *belt], check=True, timeout=400)
    prepare_out(out)
    config = replay_config(
        recording,
        recording_cameras(recording),
        out=out,
        speed=0.15,
        weights=None,
        regressors=1,
        rrd=None,
        settings=None,
    )
    (out / "line.toml").write_text(dump_toml(config))
    specs = line_processes(config, config_path=out / "line.toml", run="monday")
    with remote_proxy() as proxy, chromium(tmp_path / "profile") as browser:
        watch = LineWatch(config.link, line=config.name, tell=lambda state: proxy.board.put(snapshot(state)))
        with Supervisor(specs, log_dir=out / "logs") as line:
            watch.start()
            browser.open(proxy.page_url, user=USER, password=PASSWORD)
            _until(lambda: _tubers(browser) >= SHOWN_TUBERS, line, lambda: f"tubers in the page: {_text(browser)}")
            assert "Page connected" in _text(browser)
            assert "Running" in _text(browser)
            _until(lambda: "Run complete" in _text(browser), line, lambda: "the load's end in the page")
            assert f"Tubers {proxy_count(proxy.ask('/page/snapshot.json')[2])}" in _text(browser)
        watch.stop()


def proxy_count(snapshot_json: bytes) -> str:
    """The load's count as the page writes it; `snapshot_json` as the proxy sends it, packed."""
    return re.findall(r'"count":(\d+)', gzip.decompress(snapshot_json).decode())[0]


def _text(browser: Browser) -> str:
    found = browser.page("Runtime.evaluate", expression="document.body?.innerText", returnByValue=True)
    return re.sub(r"\s+", " ", str(found["result"].get("value") or ""))


def _tubers(browser: Browser) -> int:
    found = re.findall(r"Tubers (\d[\d ]*) Tubers a minute", _text(browser))
    return int(found[0].replace(" ", "")) if found else 0


def _until(true: Callable[[], object], line: Supervisor, what: Callable[[], str]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not true():
        line.poll()
        assert time.monotonic() < deadline, f"waited in vain for {what()}"
        time.sleep(0.3)
