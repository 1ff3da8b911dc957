"""The shared web viewer in a real browser, through TLS and the password. By name: minutes on a slow machine.

TUBERLINE_SCREENSHOT=docs/images/remote.png pytest -m slow tests/deploy/test_deploy_remote_browser.py
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from conveyor.config import dump_toml
from tests.deploy.remote_browser import Browser, chromium
from tests.deploy.remote_site import PASSWORD, USER, remote_proxy
from tuberline.processes import line_processes
from tuberline.replayer import prepare_out, recording_cameras, replay_config
from tuberline.supervisor import Supervisor

pytestmark = [pytest.mark.slow, pytest.mark.graph, pytest.mark.timeout(900)]
EMPTY_COLOURS = 100
"""A viewer without data has some dozens, in steps of 16."""
pytest.importorskip("rerun", reason="remote viewing needs tuberline[viewer]")


def colours(png: bytes) -> int:
    """Different colours in a picture, in steps of 16."""
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    return len(np.unique(picture.reshape(-1, 3) // 16, axis=0))


def test_a_browser_shows_the_line_through_tls_and_the_password(tmp_path: Path) -> None:
    recording, out = tmp_path / "recording", tmp_path / "out"
    belt = ["--seed", "3", "--tubers", "24", "--fps", "10", "--camera", "d405-848"]
    subprocess.run([sys.executable, "-m", "tuberline", "simulate", "--out", recording, *belt], check=True, timeout=120)
    prepare_out(out)
    with remote_proxy() as proxy:
        config = replay_config(
            recording,
            recording_cameras(recording),
            out=out,
            speed=1.0,
            weights=None,
            regressors=1,
            rrd=None,
            settings={"viewer": {"connect": proxy.hub.url, "profile": "remote"}},
        )
        (out / "line.toml").write_text(dump_toml(config))
        specs = line_processes(config, config_path=out / "line.toml", run="monday")
        with Supervisor(specs, log_dir=out / "logs") as line:
            deadline = time.monotonic() + 120
            while not line.finished("aggregator") and time.monotonic() < deadline:
                line.poll()
                time.sleep(0.1)
            assert line.finished("aggregator")
            with chromium(tmp_path / "profile") as browser:
                browser.open(proxy.url + "&renderer=webgl", user=USER, password=PASSWORD)
                png = _shown(browser)
    if wanted := os.environ.get("TUBERLINE_SCREENSHOT"):
        Path(wanted).write_bytes(png)


def _shown(browser: Browser, *, timeout_s: float = 200.0) -> bytes:
    """A picture of the page once it no longer changes much: everything has arrived and is drawn."""
    deadline, before = time.monotonic() + timeout_s, 0
    while time.monotonic() < deadline:
        time.sleep(4.0)  # software rendering of a frame takes about as long
        png = browser.png()
        now = colours(png) if png else 0
        if png and now > EMPTY_COLOURS and abs(now - before) < 8:
            return png
        before = now
    pytest.fail(f"the page still shows nothing after {timeout_s:g} s ({before} colours)")
