"""What an operator sees of a running line, as pictures to look at: terminal, page, Rerun, Foxglove's file.

    python -m tests.walks.pictures RECORDING OUT

plays the recording of a camera `front` as a line, slowly, and writes terminal.png, rerun.png, foxglove.png and
the page by day and by night (page-panel.png, page-panel-night.png ...) at four widths into OUT. Needs Chromium and the
extras `viewer`, `foxglove` and `dev`.
Everything is shown as it stood in the middle of the run, while potatoes were in view that were not counted yet.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from urllib.parse import quote

import cv2
import numpy as np
from rich.console import Console
from rich.text import Text

from conveyor.config import load_config
from conveyor.formats import open_source
from conveyor.observer import Observer, observer_when_there
from conveyor.taken_port import free_port
from tests.deploy.remote_browser import Browser, chromium
from tests.walks.foxglove_picture import foxglove_picture

LASTS_S = 150.0
"""The belt is slowed to run so long: pictures are taken by software rendering on a busy machine meanwhile."""
LEAST_TUBERS, LEAST_SHOWN = 6, 5
"""Tubers that are counted, and frames that Rerun has, before pictures are taken."""
SIZES = {"phone": (390, 844), "cab": (800, 480), "panel": (1280, 800), "desk": (1680, 1050)}
"""Of the page, in pixels; each picture is the whole page at that width."""
SCHEMES = {"": "light", "-night": "dark"}
LIMIT_S = 400
RERUN_COLOURS = 400
"""Rerun's window without data has fewer; software rendering of it takes seconds a frame."""
LINE = """name = "monday"
[link]
router = "tcp/127.0.0.1:{port}"
[cameras.front]
source = "recording"
path = "{recording}"
speed = {speed}
[aggregator]
out = "run"
exit_when_final = true
[viewer]
rrd = "line.rrd"
profile = "remote"
"""


def main(recording: Path, out: Path) -> None:
    """See the module."""
    out.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix="operator-"))
    keys = open_source(recording, camera="front").keys()
    speed = (keys[-1].captured_ns - keys[0].captured_ns) / 1e9 / LASTS_S
    text = LINE.format(port=free_port(), recording=recording.resolve(), speed=f"{speed:.4f}")
    (folder / "line.toml").write_text(text, encoding="utf-8")
    link = load_config(folder / "line.toml").link
    with (folder / "line.log").open("w") as log, chromium(folder / "profile") as browser:
        line = _tuberline("run", "line.toml", folder=folder, stdout=log, stderr=log)
        port = free_port()
        page = _tuberline(
            "page", "--config", "line.toml", "--listen", f"127.0.0.1:{port}", folder=folder, stdout=log, stderr=log
        )
        try:
            with observer_when_there(link, line="monday", meanwhile=lambda: None, within_s=LIMIT_S) as observer:
                _until(lambda: _is_shown(observer), line)
            shutil.copy(folder / "line.rrd", folder / "middle.rrd")
            said = subprocess.run(
                [sys.executable, "-m", "tuberline", "status", "--config", "line.toml"],
                cwd=folder, capture_output=True, text=True, check=True, env=_env(), timeout=LIMIT_S,
            ).stdout  # fmt: skip
            for name, size in SIZES.items():
                _page(browser, f"http://127.0.0.1:{port}/", size, out / f"page-{name}.png")
            line.wait(LIMIT_S)
        finally:
            page.terminate()
            line.terminate()
        _terminal(browser, said, folder, out / "terminal.png")
        _rerun(browser, folder / "middle.rrd", out / "rerun.png")
    mcap = folder / "run.mcap"
    command = ["convert", "run", str(mcap), "--format", "foxglove", "--recording", str(recording.resolve())]
    _tuberline(*command, folder=folder, stdout=None, stderr=None).wait(LIMIT_S)
    cv2.imwrite(str(out / "foxglove.png"), foxglove_picture(mcap))
    sys.stdout.write(f"pictures in {out}; the line's own files in {folder}\n")


def _is_shown(observer: Observer) -> bool:
    told, nodes = observer.totals(), observer.nodes()
    shown = nodes["viewer/viewer"].count("frame_shown") if "viewer/viewer" in nodes else 0
    return told is not None and told.count >= LEAST_TUBERS and shown >= LEAST_SHOWN


def _env() -> dict[str, str]:
    return {**os.environ, "COLUMNS": "80", "NO_COLOR": "1", "OMP_NUM_THREADS": "1"}


def _tuberline(*words: str, folder: Path, **streams: object) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", "tuberline", *words], cwd=folder, env=_env(), **streams)  # type: ignore[call-overload, no-any-return]


def _until(true: Callable[[], bool], line: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not true():
        assert line.poll() is None, "the line ended"
        assert time.monotonic() < deadline
        time.sleep(0.2)


def _look(browser: Browser, url: str, out: Path, *, seconds: float, colours: int = 2) -> None:
    """A picture of the page once it shows so many colours, and stands still."""
    browser.page("Page.navigate", url=url)
    deadline, before = time.monotonic() + LIMIT_S, -1
    while time.monotonic() < deadline:
        time.sleep(seconds)
        if (picture := browser.png()) is None:
            continue
        out.write_bytes(picture)
        now = len(np.unique(cv2.imread(str(out)).reshape(-1, 3), axis=0))
        if now > colours and (colours == 2 or abs(now - before) < 0.02 * now):
            return
        before = now
    raise AssertionError(f"{url} did not come to show anything: {before} colours")


def _page(browser: Browser, url: str, size: tuple[int, int], out: Path) -> None:
    """The whole page at a width, by day and by night. Pictures of the belt come only for what is on the screen."""
    width, height = size

    def resize(high: int) -> None:
        metrics = {"width": width, "height": high, "deviceScaleFactor": 1, "mobile": width < 600}
        browser.page("Emulation.setDeviceMetricsOverride", **metrics)

    resize(height)
    _look(browser, url, out, seconds=3)
    asked = browser.page("Runtime.evaluate", expression="document.documentElement.scrollHeight", returnByValue=True)
    resize(int(asked["result"]["value"]))
    for ending, scheme in SCHEMES.items():
        browser.page("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        time.sleep(3)
        if picture := browser.png():
            out.with_stem(out.stem + ending).write_bytes(picture)
    browser.page("Emulation.setEmulatedMedia", features=[])


def _terminal(browser: Browser, said: str, folder: Path, out: Path) -> None:
    """The words of a command in a terminal of 80 columns."""
    browser.page("Emulation.clearDeviceMetricsOverride")
    console = Console(record=True, width=80, file=(folder / "terminal.txt").open("w"))
    console.print(Text(said), soft_wrap=False)
    console.save_svg(str(folder / "terminal.svg"), title="tuberline status")
    _look(browser, (folder / "terminal.svg").as_uri(), out, seconds=2)


def _rerun(browser: Browser, rrd: Path, out: Path) -> None:
    from viewer.rerun.launch import native_program

    hub, page = free_port(), free_port()
    words = ["--bind", "127.0.0.1", "--port", str(hub), "--serve-web", "--web-viewer-port", str(page)]
    program = subprocess.Popen([str(native_program()), *words, str(rrd)], stdout=subprocess.DEVNULL)
    try:
        time.sleep(3)
        url = f"http://127.0.0.1:{page}/?theme=dark&url=" + quote(f"rerun+http://127.0.0.1:{hub}/proxy", safe="")
        _look(browser, url + "&renderer=webgl", out, seconds=8, colours=RERUN_COLOURS)
    finally:
        program.terminate()
        program.wait(20)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
