"""Nodes of 0.1 (commit a7bbfcc), of this version and of a later one on one line; three hosts upgraded during a load."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from aggregator.ledger.check import check_file
from conveyor import __version__
from conveyor.config import dump_toml
from conveyor.taken_port import free_port
from tests.belts import simulate
from tests.conftest import ROOT, wait_until
from tuberline.replayer import fingerprint, recording_cameras, replay_config

pytestmark = [pytest.mark.slow, pytest.mark.graph, pytest.mark.timeout(600)]
OLD_COMMIT = "a7bbfcc"
TUBERS = 8
SLOW = 0.02
"""Speed of a replay that lasts two and a half minutes."""
PATIENCE_S = 300.0
PACKAGES = ("tuberline", "conveyor", "camera_sim", "segmenter", "regressor", "aggregator", "viewer")
LATER = "0.3.0"
LATER_PART = (
    "return pack(type(self).__name__, header,",
    """header |= {} if self.LATER_FIELDS == "forbid" else {"of_later": {"unknown": [1]}}
        return pack(type(self).__name__, header,""",
)
"""What a later version may do: each of its reports says more than this one knows."""
HOSTS = {"edge": ("router", "aggregator"), "barn": ("regressor",), "harvester": ("segmenter", "camera")}


@pytest.fixture(scope="module")
def old(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources of 0.1."""
    folder = tmp_path_factory.mktemp("old")
    archive = subprocess.run(["git", "-C", str(ROOT), "archive", OLD_COMMIT], capture_output=True, check=False)
    if archive.returncode != 0:
        pytest.skip(f"commit {OLD_COMMIT} is not in this clone (git fetch --unshallow): mixed lines not tried")
    subprocess.run(["tar", "-x", "-C", str(folder)], input=archive.stdout, check=True)
    return folder


@pytest.fixture(scope="module")
def later(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources of a later version."""
    folder = tmp_path_factory.mktemp("later")
    for package in PACKAGES:
        (folder / package).symlink_to(ROOT / package)
    (folder / "conveyor").unlink()
    shutil.copytree(ROOT / "conveyor", folder / "conveyor", ignore=shutil.ignore_patterns("__pycache__"))
    for name, before, after in (
        ("__init__.py", f'"{__version__}"', f'"{LATER}"'),
        ("messages/base.py", *LATER_PART),
    ):
        file = folder / "conveyor" / name
        text = file.read_text(encoding="utf-8")
        assert text.count(before) == 1, f"{name}: {before}"
        file.write_text(text.replace(before, after), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def belt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate(tmp_path_factory.mktemp("belt") / "recording", scene="singulated", tubers=str(TUBERS), fps="10")


class Line:
    """A line of single processes, each of one of the versions."""

    def __init__(
        self,
        recording: Path,
        out: Path,
        old: Path,
        later: Path = ROOT,
        *,
        speed: float = 0.0,
        old_speed: float = 0.0,
    ) -> None:
        """`speed`, `old_speed`: of the replay by a camera of this version, and by one of 0.1."""
        self.out, self._old = out, old
        self._homes = {"old": old, "new": ROOT, "later": later}
        self.run = f"replay-{fingerprint(recording)}"
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        names = recording_cameras(recording)
        config = replay_config(
            recording, names, out=out, speed=speed, weights=None, regressors=1, rrd=None, settings={}
        )
        (self.camera,) = names
        (out / "line.toml").write_text(dump_toml(config))
        given = config.model_dump(mode="json", exclude_defaults=True, exclude_none=True)
        kept = self._known_to_old(given)
        kept["cameras"][self.camera]["speed"] = old_speed
        (out / "old.toml").write_text(tomli_w.dumps(kept))

    def _known_to_old(self, given: dict[str, Any]) -> dict[str, Any]:
        """What its host's file would say: of what is `given`, the keys that it has."""
        said = self._python(self._old, "-m", "conveyor", "config", "schema").stdout
        known = {name: set(part.get("properties", {})) for name, part in json.loads(said)["$defs"].items()}
        kept: dict[str, Any] = {"name": given["name"]}
        for name, section in given.items():
            if name == "cameras":
                keys = known["CameraConfig"]
                kept[name] = {camera: {k: v for k, v in c.items() if k in keys} for camera, c in section.items()}
            elif (keys := known.get(f"{name.capitalize()}Config")) is not None:
                kept[name] = {k: v for k, v in section.items() if k in keys}
        return kept

    def _environment(self, home: Path) -> dict[str, str]:
        return {**os.environ, "PYTHONPATH": str(home), "OMP_NUM_THREADS": "1"}

    def _python(self, home: Path, *words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, *words], capture_output=True, text=True, check=True, cwd=home, env=self._environment(home)
        )

    def start(self, *roles: str, version: str) -> None:
        for role in roles:
            home = self._homes[version]
            words = [role, "--config", str(self.out / f"{'old' if version == 'old' else 'line'}.toml")]
            words += [] if role == "router" else ["--run", self.run]
            own = {"regressor": ["--name", "r1"], "router": [], "aggregator": []}
            own |= {"viewer": ["--rrd", str(self.out / "pictures.rrd")]}
            words += own.get(role, ["--camera", self.camera])
            with (self.out / f"{role}.log").open("ab") as log:
                module = "conveyor" if version == "old" else "tuberline"
                self.processes[role] = subprocess.Popen(
                    [sys.executable, "-m", module, *words],
                    cwd=home,
                    env=self._environment(home),
                    stdout=log,
                    stderr=subprocess.STDOUT,
                )

    def stop(self, *roles: str) -> None:
        for role in reversed(roles):
            process = self.processes.pop(role)
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(15)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def page(self) -> str:
        """Start this version's page; the address of what it tells a browser."""
        port = free_port()
        words = ["page", "--config", str(self.out / "line.toml"), "--listen", f"127.0.0.1:{port}"]
        self.processes["page"] = subprocess.Popen([sys.executable, "-m", "tuberline", *words], cwd=ROOT)
        return f"http://127.0.0.1:{port}/events"

    def upgrade(self, host: str, *, version: str) -> None:
        self.stop(*HOSTS[host])
        self.start(*HOSTS[host], version=version)

    def lose_power(self, host: str) -> None:
        for role in HOSTS[host]:
            process = self.processes.pop(role)
            process.kill()
            process.wait()

    def tubers(self) -> dict[int, float]:
        """Place of every tuber in the ledger, by its number."""
        try:
            with closing(sqlite3.connect(f"file:{self.out / 'ledger.db'}?mode=ro", uri=True)) as db:
                return dict(db.execute("SELECT tuber_id, place_x_m FROM tuber"))
        except sqlite3.Error:
            return {}

    def finish(self, timeout_s: float = 200.0) -> dict[str, Any]:
        def ended() -> bool:
            refused = [role for role, process in self.processes.items() if process.poll() not in (None, 0)]
            assert refused == [], "\n".join(self.log(role) for role in refused)
            return self.processes["aggregator"].poll() is not None

        wait_until(ended, what="the summary", timeout_s=timeout_s)
        assert self.processes["aggregator"].returncode == 0, self.log("aggregator")
        summary: dict[str, Any] = json.loads((self.out / "summary.json").read_text())
        return summary

    def log(self, role: str) -> str:
        return (self.out / f"{role}.log").read_text(errors="replace")[-3000:]

    def close(self) -> None:
        self.stop(*self.processes)


def counted(page: str) -> int:
    """Tubers of the load that a page shows now."""
    data = told(page).removeprefix("data:")
    lines = json.loads(data)["lines"] if data else []
    return sum(line["load"]["count"] for line in lines if line.get("load"))


def told(page: str) -> str:
    """What a page tells a browser that opens it now."""
    try:
        with urllib.request.urlopen(page, timeout=10) as events:
            return next(line for line in events if line.startswith(b"data:")).decode()
    except OSError:
        return ""


@pytest.fixture
def line(belt: Path, old: Path, tmp_path: Path) -> Iterator[Line]:
    made = Line(belt, tmp_path, old)
    yield made
    made.close()


@pytest.mark.parametrize("roles", [("camera",), ("segmenter", "camera")])
def test_nodes_of_0_1_work_on_a_line_of_this_version_and_are_named(line: Line, roles: tuple[str, ...]) -> None:
    """A camera, and a host of cameras as a whole: its segmenter asks the new regressor, and can read the answers."""
    line.start("router", version="new")
    time.sleep(1.0)  # 0.1 gives up a router that is not there
    line.start(*(name for host in HOSTS.values() for name in host if name not in ("router", *roles)), version="new")
    line.start(*roles, version="old")
    summary = line.finish()
    assert summary["totals"]["count"] == TUBERS
    assert summary["software"] == __version__
    assert summary["other_versions"] == {f"{role}/{line.camera}": "0.1.0" for role in roles}
    assert f"runs tuberline 0.1.0, the ledger is kept by {__version__}" in line.log("aggregator")
    assert check_file(line.out / "ledger.db") == []


@pytest.mark.parametrize(
    ("role", "host", "word"), [("regressor", "barn", "View."), ("segmenter", "harvester", "CameraInfo.")]
)
def test_what_0_1_cannot_read_it_refuses_in_words(line: Line, role: str, host: str, word: str) -> None:
    """A regressor knows no resting level, so views wait for one that does; a segmenter knows its own host's camera.

    Upgrading the host is all it takes.
    """
    line.start("router", version="new")
    time.sleep(1.0)
    line.start(*(name for name in ("aggregator", "regressor", "segmenter", "camera") if name != role), version="new")
    line.start(role, version="old")
    page = line.page()
    wait_until(lambda: word in line.log(role), what="the refusal in words", timeout_s=PATIENCE_S)
    wait_until(lambda: f"Version 0.1.0 on {role}/" in told(page), what="it told by the page", timeout_s=60)
    wait_until(lambda: "runs tuberline 0.1.0" in line.log("aggregator"), what="it told by the ledger", timeout_s=60)
    assert "Traceback" not in line.log(role)
    line.upgrade(host, version="new")
    assert line.finish()["totals"]["count"] == TUBERS


def test_a_viewer_of_0_1_is_told_by_all_and_disturbs_nothing(line: Line) -> None:
    """It cannot read this version's totals, and says so."""
    line.start("router", version="new")
    time.sleep(1.0)
    line.start("viewer", version="old")
    line.start("aggregator", version="new")
    page = line.page()
    wait_until(lambda: "Totals." in line.log("viewer"), what="the refusal in words", timeout_s=120)
    wait_until(lambda: "Version 0.1.0 on viewer/" in told(page), what="it told by the page", timeout_s=60)
    wait_until(lambda: "runs tuberline 0.1.0" in line.log("aggregator"), what="it told by the ledger", timeout_s=60)
    line.start("regressor", "segmenter", "camera", version="new")
    assert line.finish()["totals"]["count"] == TUBERS
    assert "Traceback" not in line.log("viewer")


def test_people_see_the_load_while_the_ledger_is_a_later_versions(
    belt: Path, old: Path, later: Path, tmp_path: Path
) -> None:
    """The ledger's host is upgraded first: pages and viewers of this version read what they know of its reports."""
    line = Line(belt, tmp_path, old, later)
    try:
        line.start(*HOSTS["edge"], version="later")
        line.start("regressor", "segmenter", "viewer", version="new")
        page = line.page()
        wait_until(lambda: f"Version {__version__} on " in told(page), what="the versions on the page", timeout_s=200)
        line.start("camera", version="new")
        summary = line.finish()
        assert summary["totals"]["count"] == TUBERS
        assert summary["software"] == LATER
        assert set(summary["other_versions"].values()) == {__version__}
        wait_until(lambda: counted(page) == TUBERS, what="the load on the page", timeout_s=60)
        line.stop("viewer")
        assert [entry for entry in line.log("viewer").splitlines() if "of_later" in entry or "refused" in entry] == []
    finally:
        line.close()


def test_three_hosts_are_upgraded_during_a_load_and_no_tuber_is_lost(
    belt: Path, old: Path, tmp_path: Path, rng: np.random.Generator
) -> None:
    """First the edge with the ledger, then the regressors, the harvester last; each step with tubers in the ledger.

    Each host loses its power twice on the way: in its old version, and while the new one starts. The old camera is
    slow, so that the load lasts until its host is upgraded, however busy the machine is.
    """
    line = Line(belt, tmp_path, old, speed=0.2, old_speed=SLOW)
    try:
        for host in HOSTS:
            line.start(*HOSTS[host], version="old")
            time.sleep(1.0)
        before: dict[int, float] = {}
        for step, host in enumerate(HOSTS, start=1):
            wait_until(lambda n=step: len(line.tubers()) >= n, what=f"{step} tubers", timeout_s=PATIENCE_S)  # type: ignore[misc]
            line.lose_power(host)
            line.start(*HOSTS[host], version="new")
            time.sleep(rng.uniform(0.3, 4.0))
            line.lose_power(host)
            line.start(*HOSTS[host], version="new")
            now = line.tubers()
            assert before.items() <= now.items(), f"lost or moved before the upgrade of {host}"
            before = now
        summary = line.finish(300)
        assert before.items() <= line.tubers().items()
        assert summary["totals"]["count"] == len(line.tubers()) == TUBERS
        assert summary["other_versions"] == {}
        assert "conflicting" not in line.log("aggregator"), "entries of 0.1 sent again are the same entries"
        assert check_file(tmp_path / "ledger.db") == []
    finally:
        line.close()


def test_the_way_back_in_a_load_loses_no_tuber_and_leaves_the_ledger(belt: Path, old: Path, tmp_path: Path) -> None:
    """0.1 refuses a ledger of this version and does not touch it: that host stays, the two others go back."""
    line = Line(belt, tmp_path, old, speed=SLOW, old_speed=0.2)
    try:
        for host in HOSTS:
            line.start(*HOSTS[host], version="new")
            time.sleep(0.5)
        wait_until(lambda: len(line.tubers()) >= 1, what="a tuber", timeout_s=PATIENCE_S)
        line.stop("aggregator")
        held = line.tubers()
        line.start("aggregator", version="old")
        wait_until(lambda: line.processes["aggregator"].poll() is not None, what="its refusal", timeout_s=60)
        assert "schema version" in line.log("aggregator")
        assert line.processes["aggregator"].returncode != 0
        assert line.tubers() == held
        line.start("aggregator", version="new")
        for host in ("harvester", "barn"):
            line.upgrade(host, version="old")
            assert held.items() <= line.tubers().items(), f"lost or moved on the way back of {host}"
        summary = line.finish(300)
        assert held.items() <= line.tubers().items()
        assert summary["totals"]["count"] == len(line.tubers()) == TUBERS
        assert set(summary["other_versions"]) == {f"{role}/{line.camera}" for role in ("camera", "segmenter")} | {
            "regressor/r1"
        }
        assert check_file(tmp_path / "ledger.db") == []
    finally:
        line.close()
