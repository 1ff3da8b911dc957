"""A whole line for the page's slow tests: a simulated belt, its cameras, and the page as a process."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from conveyor.config import LineConfig, dump_toml, parse_config
from conveyor.taken_port import free_port
from tests.conftest import ROOT
from tuberline.processes import line_processes
from tuberline.supervisor import Supervisor

TOKEN = "a-token-of-this-test"
CONTRACT = """
name = "packer 2026"
measure = "mesh"
classes = [
  {name = "under 35", to_mm = 35},
  {name = "35 to 55", from_mm = 35, to_mm = 55},
  {name = "over 55", from_mm = 55},
]
"""


@dataclass(frozen=True, slots=True)
class PageLine:
    """A running line and the address of its page."""

    config: LineConfig
    path: Path
    supervisor: Supervisor
    url: str


def recording(folder: Path, *, scene: str, tubers: int, seed: int, fps: float = 8) -> Path:
    """A simulated belt in colours."""
    out = folder / "recording"
    command = ["simulate", "--out", str(out), "--scene", scene, "--seed", str(seed), "--tubers", str(tubers)]
    options = ["--fps", f"{fps:g}", "--color", "--preset", "field"]
    subprocess.run([sys.executable, "-m", "tuberline", *command, *options], check=True, timeout=500, cwd=ROOT)
    return out


@contextmanager
def page_line(folder: Path, belt: Path, *, cameras: tuple[str, ...], speed: float, waits: bool) -> Iterator[PageLine]:
    """The line of a recording, whose cameras wait for their segmenters or for no one, and a page that may act."""
    out = folder / "run"
    out.mkdir()
    (folder / "contract.toml").write_text(CONTRACT)
    config = parse_config(
        {
            "name": "north",
            "link": {"router": f"tcp/127.0.0.1:{free_port()}", "connect_timeout_s": 60.0},
            "cameras": {
                name: {"path": str(belt), "speed": speed, "waits": waits, "ignore_masks": True} for name in cameras
            },
            "segmenter": {"state_dir": str(out / "state"), "max_age_ms": 5000},
            "regressor": {"processes": 1, "state_dir": str(out / "weights")},
            "aggregator": {"out": str(out), "camera_stall_s": 600.0, "contract": str(folder / "contract.toml")},
        },
        where="of this test",
    )
    path = folder / "line.toml"
    path.write_text(dump_toml(config))
    (folder / "token").write_text(TOKEN)
    port = free_port()
    page = ["page", "--config", str(path), "--listen", f"127.0.0.1:{port}", "--token-file", str(folder / "token")]
    with Supervisor(line_processes(config, config_path=path, run="monday"), log_dir=out / "logs") as supervisor:
        running = subprocess.Popen([sys.executable, "-m", "tuberline", *page], cwd=ROOT)
        try:
            yield PageLine(config, path, supervisor, f"http://127.0.0.1:{port}/")
        finally:
            running.terminate()
            running.wait(30)
