"""A whole line and its page in a real browser: the belt is there to be seen, and a dead camera is told in time.

By name: it takes minutes. TUBERLINE_SCREENSHOT=FOLDER writes pictures there.
"""

from __future__ import annotations

import base64
import json
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from conveyor.observer import Observer
from tests.deploy.remote_browser import Browser, BrowserError
from tests.viewer.page_line import TOKEN, PageLine, page_line, recording
from tests.viewer.test_viewer_page_browser import STICKS_OUT, browser, js, text, until

__all__ = ["browser"]
pytestmark = [pytest.mark.slow, pytest.mark.graph, pytest.mark.timeout(900)]
TOLD_WITHIN_S = 3.0
LINE_S = 240.0
"""A whole line on a busy machine takes its time, to come up and to weigh."""
SIZES = {
    "phone": (390, 844, 1.5, "dark", "en"),
    "phone-light": (390, 844, 1.5, "light", "en"),
    "panel": (1280, 800, 1, "dark", "en"),
    "panel-light": (1280, 800, 1, "light", "en"),
    "desk": (1680, 1050, 1, "light", "en"),
    "desk-dark": (1680, 1050, 1, "dark", "en"),
    "german": (1280, 800, 1, "dark", "de"),
}
"""Of each picture: width, height, dots a pixel, colours, language."""
FIRST_LOAD_KG = "document.querySelector('[data-put=told] tbody tr:last-child').cells[2].textContent"
FIRST_LOAD_SEEN = "document.querySelector('[data-put=told] tbody tr:last-child').cells[5].textContent"
CANVASES = (
    "[...document.querySelectorAll('canvas[data-see]')].map((c) => [c.dataset.see, Number(c.dataset.outlines || 0)])"
)


def order(browser: Browser, action: str, **more: Any) -> dict[str, Any]:
    """An order as the page gives it."""
    body = {"line": "north", "action": action, "request": f"r-{action}-{time.monotonic_ns()}", "operator": "Anna"}
    head = json.dumps({"X-Tuberline-Token": TOKEN})
    sent = f"fetch('order', {{method: 'POST', headers: {head}, body: {json.dumps(json.dumps({**body, **more}))}}})"
    found = browser.page(
        "Runtime.evaluate", expression=f"{sent}.then((r) => r.json())", returnByValue=True, awaitPromise=True
    )
    told: dict[str, Any] = found["result"]["value"]
    return told


def tubers(browser: Browser) -> int:
    """Of the open load, or of the run where none is open."""
    return int("0" + js(browser, "document.querySelector('[data-put=count]').textContent"))


def opened(browser: Browser, line: PageLine, true: Callable[[], object], what: str) -> None:
    def there() -> object:
        line.supervisor.poll()
        try:
            if js(browser, "location.href") != line.url:
                browser.page("Page.navigate", url=line.url)
                time.sleep(1.0)
            return true()
        except BrowserError:
            return False  # one page gives way to the next

    deadline = time.monotonic() + LINE_S
    while not there():
        assert time.monotonic() < deadline, what
        time.sleep(0.3)


def test_the_belt_is_seen_and_loads_change_while_tubers_come(browser: Browser, tmp_path: Path) -> None:
    belt = recording(tmp_path, scene="two-cameras", tubers=600, seed=21, fps=12)
    with page_line(tmp_path, belt, cameras=("left", "right"), speed=0.06, waits=True) as line:
        opened(browser, line, lambda: all(n > 3 for _, n in js(browser, CANVASES) or [("", 0)]), "both belts")
        assert {see for see, _ in js(browser, CANVASES)} == {"north/left", "north/right"}
        until(lambda: tubers(browser) > 4, what="tubers", within_s=LINE_S)
        assert order(browser, "start", fields={"name": "trailer 6", "field": "North 4", "variety": "Agria"})["done"]
        until(lambda: "Load 1 · trailer 6" in text(browser) and tubers(browser) > 19, what="a load", within_s=LINE_S)
        assert order(browser, "start", fields={"name": "trailer 7", "field": "North 4", "variety": "Agria"})["done"]
        until(lambda: "Load 2 · trailer 7" in text(browser) and tubers(browser) > 9, what="the next", within_s=LINE_S)
        until(lambda: js(browser, FIRST_LOAD_SEEN) == "100.0 %", what="all of the first load", within_s=LINE_S)
        scale_kg = round(1.02 * float(js(browser, FIRST_LOAD_KG).split()[0]), 1)
        assert order(browser, "ticket", load="1", kg=scale_kg)["done"]
        assert order(browser, "note", load="1", note="wet")["done"]
        until(lambda: "wet (Anna)" in text(browser) and f"{scale_kg:g}" in text(browser), what="ticket and note")
        for name, size in SIZES.items():
            screenshot(browser, line, name, size)


def test_a_dead_camera_is_told_within_three_seconds(browser: Browser, tmp_path: Path) -> None:
    belt = recording(tmp_path, scene="singulated", tubers=60, seed=8, fps=6)
    with page_line(tmp_path, belt, cameras=("front",), speed=0.1, waits=False) as line:
        opened(
            browser, line, lambda: "Working" in text(browser) and "No alarms." in text(browser), "a line that is well"
        )
        with Observer(line.config.link, line="north") as observer:
            until(lambda: "camera/front" in observer.nodes(), what="the camera's report")
            pid = observer.nodes()["camera/front"].pid
        # One that stands still may be gone for the router before it is missed: what comes first is told.
        stopped = "Camera front stopped"
        for number, told in (
            (signal.SIGSTOP, ("No frames have come from camera front", stopped)),
            (signal.SIGKILL, (stopped,)),
        ):
            os.kill(pid, number)
            started_s = time.monotonic()
            while not any(words in text(browser) for words in told):
                took_s = time.monotonic() - started_s
                assert took_s < TOLD_WITHIN_S, f"{told!r} is not there after {took_s:.1f} s"
                time.sleep(0.05)


def screenshot(browser: Browser, line: PageLine, name: str, size: tuple[int, int, float, str, str]) -> None:
    """The whole page at one size, its belts in sight and nothing cut off; into the folder TUBERLINE_SCREENSHOT."""
    width, height, scale, scheme, language = size

    def resize(high: int) -> None:
        metrics = {"width": width, "height": high, "deviceScaleFactor": scale, "mobile": width < 600}
        browser.page("Emulation.setDeviceMetricsOverride", **metrics)

    resize(height)
    browser.page("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    browser.page("Page.navigate", url=f"{line.url}?lang={language}")
    until(lambda: "trailer 7" in text(browser), what=f"the load at {name}")
    assert js(browser, STICKS_OUT) == [], name
    # A page fetches no picture of what is scrolled away: all of it has to be on the screen.
    resize(int(js(browser, "document.documentElement.scrollHeight")))
    until(lambda: all(n for _, n in js(browser, CANVASES) or [("", 0)]), what=f"the belt at {name}")
    time.sleep(1.0)
    png = base64.b64decode(browser.page("Page.captureScreenshot", format="png")["data"])
    assert len(png) > 10_000
    if folder := os.environ.get("TUBERLINE_SCREENSHOT"):
        (Path(folder) / f"page-{name}.png").write_bytes(png)
