"""The operator's page in a real browser: what stands there, what it says when contact is lost, and that it fits."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import viewer.page.app as app_module
from tests.deploy.remote_browser import Browser, chromium
from tests.viewer.page_states import DOUBT, good_state, huge_state, loaded_state, segmenter, totals, with_node
from viewer.page.board import Board
from viewer.page.server import PageServer
from viewer.page.snapshot import snapshot

CSS = Path(app_module.__file__).parent / "static" / "page.css"
STICKS_OUT = """[...document.querySelectorAll('.line *, .bar *')].filter((e) => !e.closest('[hidden], svg, thead'))
    .filter((e) => e.getBoundingClientRect().right > innerWidth + 1
        || (e.clientWidth && e.scrollWidth > e.clientWidth + 1))
    .map((e) => e.outerHTML.slice(0, 80))"""
"""Elements that are wider than the screen, or hold more than they show."""
ENDS = {
    "en": "The open load ends there.",
    "de": "Die offene Ladung endet dort.",
    "nl": "De open lading eindigt daar.",
    "ja": "受入中の積荷はそこで終わります。",
}
SIZES = {"phone": (390, 844), "panel": (1280, 800)}


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with chromium(tmp_path_factory.mktemp("browser") / "profile", webgl=False) as running:
        yield running


def js(browser: Browser, expression: str) -> Any:
    """The value of an expression in the page."""
    found = browser.page("Runtime.evaluate", expression=expression, returnByValue=True)
    assert "exceptionDetails" not in found, found["exceptionDetails"]
    return found["result"].get("value")


def until(true: Callable[[], object], *, what: str, within_s: float = 60) -> None:
    """A browser that is just starting on a busy machine takes its time."""
    deadline = time.monotonic() + within_s
    while not true():
        assert time.monotonic() < deadline, f"waited in vain for: {what}"
        time.sleep(0.15)


def text(browser: Browser) -> str:
    """Everything a person can read."""
    return re.sub(r"\s+", " ", js(browser, "document.body?.innerText") or "")


def until_told(browser: Browser, board: Board, shown: dict[str, Any], *words: str) -> None:
    """The line goes on telling this, or its figures would be old; the page shows all of `words`."""

    def missing() -> list[str]:
        board.put(shown)
        found = text(browser)
        return [word for word in words if word not in found]

    until(lambda: not missing(), what=f"one of {words}")


def test_figures_alarms_and_lost_contact(browser: Browser) -> None:
    """Of a page that was started again without one of its lines, the browser kept that line's figures for good."""
    board = Board(["north", "south"])
    dark = segmenter("left", gauges={"frames_dropped_blind": 360.0}, growing_s={"frames_dropped_blind": 12.4})
    board.put(seen := snapshot(with_node(good_state(), "segmenter/left", dark)))
    with ExitStack() as first:
        page = first.enter_context(PageServer(board, host="127.0.0.1", port=0))
        port = page.port
        browser.page("Page.navigate", url=f"http://127.0.0.1:{port}/")
        until_told(browser, board, seen, "Page connected", "1 993 kg")
        js(browser, "document.querySelector('.health').open = document.querySelector('.runs').open = true")
        until_told(
            browser,
            board,
            seen,
            "Camera left is dark, for 12 s.",
            "Health: 7 of 7 processes work",
            "90 % sure: 1 894 to 2 093 kg",
            "Makes up for the 1.5 % of the belt that no camera saw.",
            "Tubers 11 590",
            "Belt speed 0.42 m/s",
            "360 frames not used: dark or covered",
            "1 530 kg",
        )
        assert js(browser, "document.querySelectorAll('.histogram rect').length") == 12
        alarms = js(browser, "document.querySelector('.alarms').textContent")
        assert "for 12\u00a0s" in alarms, "a figure and its unit stand on one line"
        assert "Camera left is dark, for …." in js(browser, "document.getElementById('spoken').textContent")
    until(lambda: "No contact: last heard" in text(browser), what="the page says that it lost contact")
    assert "Old figures: last heard" in text(browser)
    assert js(browser, "document.querySelector('.line').dataset.old") == "yes"
    assert js(browser, "getComputedStyle(document.querySelector('.side')).opacity") != "1"
    board = Board(["north"])
    with PageServer(board, host="127.0.0.1", port=port):
        board.put(snapshot(good_state()))
        until(lambda: "No alarms." in text(browser), what="the page comes back by itself")
        until(lambda: "Page connected" in text(browser) and "No contact" not in text(browser), what="it is live again")
        assert js(browser, "[document.querySelectorAll('.line').length, document.body.dataset.lines]") == [1, "1"]


def test_figures_of_a_line_that_fell_silent_are_shown_as_old(browser: Browser) -> None:
    board = Board(["north", "south"])
    board.put(snapshot(good_state(heard_s=14.0, totals_age_s=14.0)))
    with PageServer(board, host="127.0.0.1", port=0) as page:
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/")
        until(lambda: "Old figures: last heard" in text(browser), what="old figures")
        deadline = time.monotonic() + 4
        while time.monotonic() < deadline:
            board.put(snapshot(good_state("south")))
            time.sleep(0.5)
        found = js(browser, "[...document.querySelectorAll('.line')].map((line) => [line.dataset.old, line.innerText])")
    assert [old for old, _ in found] == ["yes", "no"]
    seconds = int(re.findall(r"last heard (\d+)\ss ago", found[0][1])[0])
    assert 16 <= seconds <= 40, "the age goes on though the watcher of that line says nothing more"


@pytest.mark.parametrize("size", SIZES)
def test_nothing_sticks_out_and_fingers_find_the_buttons(browser: Browser, size: str) -> None:
    board = Board(["north", "south"])
    board.put({**snapshot(loaded_state("north")), "looks_only": ""})
    board.put({**snapshot(good_state("south")), "looks_only": "no certificate"})
    width, height = SIZES[size]
    browser.page(
        "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
    )
    with PageServer(board, host="127.0.0.1", port=0) as page:
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/")
        until(lambda: "1 993 kg" in text(browser) and "206.4 kg" in text(browser), what="both lines")
        js(browser, "document.querySelectorAll('details').forEach((fold) => { fold.open = true; })")
        assert js(browser, "document.documentElement.scrollWidth") <= width
        until(lambda: js(browser, STICKS_OUT) == [], what=f"nothing sticks out of {size}")
        assert js(browser, "document.querySelector('#menu summary').getBoundingClientRect().height") >= 44
        assert js(browser, "parseFloat(getComputedStyle(document.querySelector('.seen b')).fontSize)") >= 40


@pytest.mark.parametrize("size", [*SIZES, "desk"])
@pytest.mark.parametrize("open_load", [True, False])
def test_a_day_of_a_thousand_tons_and_long_names_fit(browser: Browser, size: str, open_load: bool) -> None:
    """From 100 t on a load's figure lay over its estimate; a line's long name made the page wider than a phone."""
    board, state = Board([huge_state().line]), huge_state()
    if not open_load:
        assert state.totals is not None
        state = replace(state, totals=replace(state.totals, load=None))
    board.put({**snapshot(state), "looks_only": ""})
    width, height = {**SIZES, "desk": (1440, 900)}[size]
    browser.page(
        "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
    )
    with PageServer(board, host="127.0.0.1", port=0) as page:
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/")
        until(lambda: ("104 218 kg" if open_load else "1 250 620 kg") in text(browser), what="the figures")
        js(browser, "document.querySelectorAll('details').forEach((fold) => { fold.open = true; })")
        until(lambda: js(browser, STICKS_OUT) == [], what=f"nothing sticks out of {size}")
        assert js(browser, "document.documentElement.scrollWidth") <= width


TOPS = "['.alarms', '.load'].map((name) => document.querySelector(name).getBoundingClientRect().top)"


def test_on_a_phone_trouble_stands_above_the_figures_that_it_makes_wrong(browser: Browser) -> None:
    board = Board(["north"])
    width, height = SIZES["phone"]
    browser.page("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=True)
    drift = segmenter("left", gauges={"belt_alarm": 1.0, "belt_drift_mm": 9.3})
    with PageServer(board, host="127.0.0.1", port=0) as page:
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/")
        until_told(browser, board, snapshot(loaded_state()), "No alarms.", "206.4 kg")
        alarms, load = js(browser, TOPS)
        assert load < alarms
        troubled = snapshot(with_node(loaded_state(), "segmenter/left", drift))
        until_told(browser, board, troubled, "Running, with trouble", "9 mm further than calibrated")
        alarms, load = js(browser, TOPS)
        assert alarms < load


def test_between_loads_the_one_that_ended_is_told_and_the_run_is_called_so(browser: Browser) -> None:
    state = loaded_state()
    assert state.totals is not None
    assert state.totals.load is not None
    ended = tuple(replace(load, open=False) for load in state.told)
    between = replace(state, totals=replace(state.totals, load=None), told=ended)
    none = totals(
        count=0, histogram=(), tubers_per_s=0.0, coverage=1.0, weight_g=0.0, low_g=0.0, high_g=0.0,
        estimated_weight_g=0.0, estimated_low_g=0.0, estimated_high_g=0.0,
    )  # fmt: skip
    board = Board(["north"])
    with PageServer(board, host="127.0.0.1", port=0) as page:
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/")
        weighed = "Load 3 weighed 206.4 kg (90 % sure: 199.0 to 214.0 kg)."
        until_told(browser, board, snapshot(between), "No load is open", weighed, "Run as seen", "Run as estimated")
        assert "Load as seen" not in text(browser)
        until_told(browser, board, snapshot(state), "Load as seen", "Load as estimated", "Not calibrated with a scale")
        weighed_load = replace(state.totals.load, calibrated_by="1 bucket: offset +0.4 mm +- 0.2")
        scale = replace(state, totals=replace(state.totals, load=weighed_load))
        until_told(browser, board, snapshot(scale), "Calibrated with a scale.")
        none_counted = {"count": 0, "weight_g": 0.0, "low_g": 0.0, "high_g": 0.0}
        first, *others = ended
        bare = good_state(totals=none, told=(replace(first, **none_counted), *others))
        runs = tuple(replace(run, **none_counted) for run in bare.loads)
        until_told(browser, board, snapshot(replace(bare, loads=runs)), "0.00 kg No tubers yet")
        assert "90 % sure: 0.00" not in text(browser)
        js(browser, "document.querySelector('.runs').open = true")
        assert "0.00 to 0.00" not in text(browser), "an interval of nothing, in the lists of loads and of runs"


def test_the_open_load_stands_first_and_contact_is_told_once(browser: Browser) -> None:
    board = Board(["north"])
    board.put({**snapshot(loaded_state()), "looks_only": ""})
    browser.page("Emulation.setTimezoneOverride", timezoneId="America/St_Johns")
    with PageServer(board, host="127.0.0.1", port=0) as page:
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/")
        until(lambda: "Load 3 · trailer 7" in text(browser), what="the open load")
        assert "11:43 AM UTC-2:30" in text(browser), "a person at a distance took it for the line's time"
        until_told(
            browser,
            board,
            {**snapshot(loaded_state()), "looks_only": ""},
            "206.4 kg",
            "90 % sure: 199.0 to 214.0 kg",
            "Tubers 1 200",
            "1.1 % 0.8 to 1.4 % of the weight",
            "Classes of the contract: packer 2026",
            "✕ broken",
            "The whole run: 1 993 kg (90 % sure: 1 894 to 2 093 kg), 11 590 tubers",
            f"207.1 kg: {DOUBT}",
            "Undo …",
            "No alarms.",
        )
        shown = text(browser)
        assert shown.index("Load 3") < shown.index("Belt left") < shown.index("Health:")
        board.put({**snapshot(loaded_state(heard_s=14.0, totals_age_s=14.0)), "looks_only": ""})
        until(lambda: "No contact with north" in text(browser), what="no contact")
        js(browser, "document.querySelectorAll('details').forEach((fold) => { fold.open = true; })")
        shown = text(browser)
        for contradicted in ("Page connected", "Running", "No alarms", "Working", "✓ ok", "frames a second"):
            assert contradicted not in shown, contradicted
        assert js(browser, "document.querySelector('[data-act=start]').disabled")
    browser.page("Emulation.setTimezoneOverride", timezoneId="")


@pytest.mark.parametrize("language", ENDS)
def test_a_start_ends_a_load_only_where_one_is_open(browser: Browser, language: str) -> None:
    """It said so of the first load of a day, too."""
    board = Board(["north"])
    opened = loaded_state()
    assert opened.totals is not None
    ended = replace(opened, totals=replace(opened.totals, load=None))  # the list does not know it yet
    states = [(good_state(), False), (ended, False), (opened, True), (replace(opened, totals=None), True)]
    with PageServer(board, host="127.0.0.1", port=0) as page:
        for n, (state, ends) in enumerate(states):
            board.put(seen := {**snapshot(state), "looks_only": ""})
            browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/?lang={language}&n={n}")
            until(lambda n=n: js(browser, "location.search").endswith(f"n={n}"), what="the page")
            until_told(browser, board, seen, "north")
            js(browser, "document.querySelector('[data-act=start]').click()")
            assert js(browser, "document.getElementById('order').open")
            what = js(browser, "document.querySelector('#order .what').textContent")
            assert what.strip()
            assert what.endswith(ENDS[language]) == ends, (n, what)


def test_a_line_that_was_switched_off_takes_no_orders(browser: Browser) -> None:
    """Its run is complete, which is no trouble; but a load that was started there got no answer. Of the runs before,
    one that was killed was told as stopped."""
    board = Board(["north"])
    over, *others = good_state().loads
    loads = (replace(over, final=False, end="cut off"), replace(over, final=False, end="stopped"), *others)
    disabled = "document.querySelector('[data-act=start]').disabled"
    with PageServer(board, host="127.0.0.1", port=0) as page:
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/")
        for heard_s, off in ((0.4, False), (120.0, True)):
            complete = good_state(totals=totals(final=True), heard_s=heard_s, totals_age_s=heard_s, loads=loads)
            told = {**snapshot(complete), "looks_only": ""}
            until_told(browser, board, told, "Run complete", *(["The line switched off"] if off else ["No alarms."]))
            assert js(browser, disabled) is off
        rows = "document.querySelectorAll('[data-put=loads] tr')"
        ends = js(browser, f"[...{rows}].map((row) => row.lastChild.textContent)")
        assert ends[-4:] == ["cut off", "stopped", "complete", "complete"]
        stopped = {**told, "state": "stopped", "load": {**told["load"], "final": False}, "told_s": 60.0}
        until_told(browser, board, stopped, "north Stopped", "Health: the line was stopped")
        assert "No contact" not in text(browser)
        assert js(browser, "document.querySelector('.line').dataset.old") == "no"


def press_key(browser: Browser, key: str, code: int, **more: Any) -> None:
    for kind in ("keyDown", "keyUp"):
        browser.page("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code, **more)


def test_day_and_night_by_the_keyboard(browser: Browser) -> None:
    board = Board(["north"])
    board.put(snapshot(good_state()))
    with PageServer(board, host="127.0.0.1", port=0) as page:
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/")
        until(lambda: "Page connected" in text(browser), what="the page")
        js(browser, "document.querySelector('#menu summary').focus()")
        press_key(browser, "Enter", 13, text="\r")
        assert js(browser, "document.querySelector('#menu').open")
        js(browser, "document.querySelector('#light').focus()")
        ground = "getComputedStyle(document.body).backgroundColor"
        for wanted in ("rgb(255, 255, 255)", "rgb(10, 12, 8)"):
            press_key(browser, "ArrowDown", 40)
            until(lambda wanted=wanted: js(browser, ground) == wanted, what=wanted)


def luminance(colour: str) -> float:
    """Relative luminance of '#rgb' or '#rrggbb' (WCAG 2)."""
    digits = colour.removeprefix("#")
    digits = "".join(2 * digit for digit in digits) if len(digits) == 3 else digits
    channels = [int(digits[at : at + 2], 16) / 255 for at in (0, 2, 4)]
    red, green, blue = (c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in channels)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def test_contrast_is_made_for_sunlight() -> None:
    """7 to 1 (WCAG AAA) for every word on every ground, by day and by night."""
    themes = re.findall(r"\{\s*color-scheme: \w+;(.*?)\}", CSS.read_text(), re.S)
    assert len(themes) == 3
    pairs = [("ink", ground) for ground in ("ground", "card", "good-ground", "trouble-ground", "warning-ground")]
    pairs += [("soft", "ground"), ("soft", "card"), ("good", "good-ground"), ("warning", "warning-ground")]
    pairs += [("trouble", "trouble-ground"), ("ground", "trouble"), ("bar", "card")]
    for theme in themes:
        colours = dict(re.findall(r"--([\w-]+): (#\w+);", theme))
        for front, back in pairs:
            light, dark = sorted((luminance(colours[front]), luminance(colours[back])), reverse=True)
            wanted = 4.5 if front == "bar" else 7.0 if front in ("ink", "soft", "ground") else 5.5
            assert (light + 0.05) / (dark + 0.05) >= wanted, (front, back, (light + 0.05) / (dark + 0.05))
