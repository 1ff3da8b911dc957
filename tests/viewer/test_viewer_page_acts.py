"""Loads changed by hand: a real browser, the page and an aggregator as processes, and tubers that come meanwhile."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from aggregator.ledger.load_list import told_loads
from aggregator.ledger.reader import reading
from conveyor.config import LineConfig
from conveyor.node import Node
from conveyor.taken_port import free_port
from tests.aggregator.belt_story import tell
from tests.aggregator.test_aggregator_load_orders import Belt
from tests.aggregator.test_aggregator_node import Process, Segmenters, line, process
from tests.conftest import ROOT
from tests.deploy.remote_browser import Browser, BrowserError
from tests.viewer.test_viewer_page_browser import browser, js, text, until

__all__ = ["browser", "line", "process"]
pytestmark = [pytest.mark.graph, pytest.mark.timeout(180)]
TOKEN = "a-token-of-this-test"


@contextmanager
def page(path: Path, *words: str) -> Iterator[str]:
    """The address of `tuberline page` of a line."""
    port = free_port()
    command = [sys.executable, "-m", "tuberline", "page", "--config", str(path), "--listen", f"127.0.0.1:{port}"]
    running = subprocess.Popen([*command, *words], cwd=ROOT)
    try:
        yield f"http://127.0.0.1:{port}/"
    finally:
        running.terminate()
        running.wait(30)


@contextmanager
def acting_page(path: Path, folder: Path) -> Iterator[str]:
    """The address of a page that carries out what is asked with `TOKEN`; the file of that is put into `folder`."""
    token = folder / "token"
    token.write_text(TOKEN + "\n")
    with page(path, "--token-file", str(token)) as url:
        yield url


def look(browser: Browser, url: str, wanted: str) -> None:
    """Open the page, again while its server is still starting."""

    def there() -> bool:
        try:
            if js(browser, "location.href") != url:
                browser.page("Page.navigate", url=url)
            return wanted in text(browser)
        except BrowserError:  # asked while it went from one page to the next
            return False

    until(there, what=wanted)


def press(browser: Browser, action: str) -> None:
    """The button of the card, as soon as it can be pressed."""
    button = f"document.querySelector('[data-act={action}]')"
    until(lambda: js(browser, f"!{button}.hidden && !{button}.disabled"), what=f"button {action}")
    js(browser, f"{button}.click()")
    assert js(browser, "document.getElementById('order').open")


def confirm(browser: Browser, **typed: str) -> None:
    """Fill the dialog and press its first button."""
    for name, value in typed.items():
        js(browser, f"document.querySelector('#order form').elements.{name}.value = {json.dumps(value)}")
    js(browser, "document.querySelector('#order .yes').click()")


def closed(browser: Browser) -> bool:
    return not js(browser, "document.getElementById('order').open")


def until_shown(browser: Browser, words: str, *, place: str = "") -> None:
    """Anywhere on the page, or in one place of its card."""
    until(lambda: words in (figure(browser, place) if place else text(browser)), what=words)


def figure(browser: Browser, name: str) -> str:
    return str(js(browser, f"document.querySelector('[data-put={name}]').textContent"))


def test_a_load_is_started_ended_and_weighed_while_tubers_come(
    browser: Browser, line: tuple[LineConfig, Path], process: Process, tmp_path: Path
) -> None:
    config, path = line
    told = tell(21, cameras=2, n=40, length_m=3.6, noise_mm=0.0)
    with Node("segmenter", "cam0", config=config, run="story") as node, acting_page(path, tmp_path) as url:
        segmenters = Segmenters(node, told)
        until(lambda: segmenters.all_acknowledged(0), what="the aggregator")
        look(browser, url, "Start load")
        with Belt(segmenters):
            press(browser, "start")
            confirm(browser, name="trailer 7", variety="Agria", operator="Anna", token="not-the-right-one")
            until(lambda: "This token is wrong" in text(browser), what="the refusal")
            confirm(browser, token=TOKEN)
            until(lambda: closed(browser), what="the load is started")
            until(lambda: figure(browser, "which") == "Load 1 · trailer 7", what="the open load")
            until(lambda: int(figure(browser, "count") or 0) > 3, what="tubers of the load")
            press(browser, "end")
            confirm(browser)
            until(lambda: figure(browser, "which") == "No load is open", what="the load has ended")
            press(browser, "undo")
            confirm(browser)
            until(lambda: figure(browser, "which") == "Load 1 · trailer 7", what="the load is open again")
            press(browser, "ticket")
            confirm(browser, kg="much")
            until(lambda: "Type the weight in kg as a number" in text(browser), what="what a ticket is")
            confirm(browser, kg="8123,5")
            until(lambda: "8 123.5 kg" in text(browser), what="the ticket in the table of loads")
            press(browser, "end")
            confirm(browser)
            until(lambda: closed(browser), what="the end")
        segmenters.deliver()
    code, said = process.end()
    assert code == 0, said
    with reading(config.aggregator.out / "ledger.db") as view:
        (load,) = told_loads(view, limit=9)
    assert (load["name"], load["variety"], load["open"], load["net_g"]) == ("trailer 7", "Agria", False, 8123500.0)
    assert {each["by"] for each in load["said"]} == {"page: Anna"}


def test_a_page_without_a_token_says_that_it_only_looks(
    browser: Browser, line: tuple[LineConfig, Path], process: Process
) -> None:
    with page(line[1]) as url:
        look(browser, url, "Loads cannot be changed from this page: it was started without a token")
        assert js(browser, "document.querySelector('[data-put=acts]').hidden")


LOSE_AN_ANSWER = """{ const whole = window.fetch; window.fetch = async (...asked) => {
    await whole(...asked);
    window.fetch = whole;
    throw new TypeError("the answer is lost"); }; }"""


def test_a_retry_is_the_same_order_and_a_corrected_form_another(
    browser: Browser, line: tuple[LineConfig, Path], process: Process, tmp_path: Path
) -> None:
    """A form that was corrected after a lost answer went under the first one's id: "done", and nothing had changed."""
    config, path = line
    story = tell(21, cameras=2, n=4, length_m=0.5, noise_mm=0.0)
    with Node("segmenter", "cam0", config=config, run="story") as node, acting_page(path, tmp_path) as url:
        segmenters = Segmenters(node, story)
        until(lambda: segmenters.all_acknowledged(0), what="the aggregator")
        look(browser, url, "Start load")
        press(browser, "start")
        js(browser, LOSE_AN_ANSWER)
        confirm(browser, name="trailer 7", operator="Anna", token=TOKEN)
        until(lambda: "press again, it is carried out once" in text(browser), what="the lost answer")
        confirm(browser)
        until(lambda: closed(browser), what="the load is started")
        until(lambda: "The line says: load 1 (trailer 7) has begun" in text(browser), what="what was done")
        press(browser, "ticket")
        js(browser, LOSE_AN_ANSWER)
        confirm(browser, kg="8123,5")
        until(lambda: "press again, it is carried out once" in text(browser), what="the lost answer")
        until(lambda: "8 123.5 kg" in text(browser), what="the first ticket in the table of loads")
        confirm(browser, kg="8132,5")
        until(lambda: closed(browser), what="the second ticket")
        until(lambda: "8132.5 kg net on the scale" in text(browser), what="what was done")
        until(lambda: "8 132.5 kg" in text(browser), what="the second ticket in the table of loads")
    with reading(config.aggregator.out / "ledger.db") as view:
        (load,) = told_loads(view, limit=9)
    assert [each["text"] for each in load["said"]] == ["began", "net ticket 8123.5 kg", "net ticket 8132.5 kg"]


def test_a_note_goes_to_the_load_that_was_chosen_whatever_others_are_named(
    browser: Browser, line: tuple[LineConfig, Path], process: Process, tmp_path: Path
) -> None:
    with acting_page(line[1], tmp_path) as url:
        look(browser, url, "Start load")
        for name in ("trailer 7", "1"):
            press(browser, "start")
            confirm(browser, name=name, operator="Anna", token=TOKEN)
            until_shown(browser, f"({name}) has begun")
        for chosen, said in (("1", "load 1 (trailer 7) is noted"), ("2", "load 2 (1) is noted")):
            until_shown(browser, f"{chosen} · ", place="told")
            press(browser, "note")
            confirm(browser, load=chosen, note="wet")
            until_shown(browser, said)
        send = [sys.executable, "-m", "tuberline", "load", "start", "--resume", "number:1", "--config", str(line[1])]
        subprocess.run(send, cwd=ROOT, check=True, timeout=60)
        until_shown(browser, "1 · trailer 7 (open)", place="told")
        press(browser, "note")
        assert js(browser, "document.querySelector('#order form').elements.load.value") == "1", (
            "the open load, not the last"
        )


IMPATIENT_PROXY = """{ const whole = window.fetch; window.fetch = async (...asked) => {
    await whole(...asked);
    window.fetch = whole;
    return new Response("<h1>504 Gateway Time-out</h1>", {status: 504, headers: {"Content-Type": "text/html"}}); }; }"""


def starts_once(browser: Browser, out: Path) -> None:
    """With the right token the load that was asked for is started, and that one alone."""
    confirm(browser, token=TOKEN)
    until(lambda: closed(browser), what="the load is started")
    until_shown(browser, "The line says: load 1 (trailer 7) has begun")
    with reading(out / "ledger.db") as view:
        assert [load["name"] for load in told_loads(view, limit=9)] == ["trailer 7"]


@pytest.mark.parametrize("lost", [LOSE_AN_ANSWER, IMPATIENT_PROXY], ids=["no answer", "a proxy's answer"])
def test_what_may_be_done_keeps_its_id_until_the_line_has_answered(
    lost: str, browser: Browser, line: tuple[LineConfig, Path], process: Process, tmp_path: Path
) -> None:
    """The page's own refusal of a retry, and a proxy's, gave the next one a new id: one load was started twice."""
    with acting_page(line[1], tmp_path) as url:
        look(browser, url, "Start load")
        press(browser, "start")
        js(browser, lost)
        confirm(browser, name="trailer 7", operator="Anna", token=TOKEN)
        until_shown(browser, "press again, it is carried out once")
        confirm(browser, token="not-the-right-one")
        until_shown(browser, "This token is wrong")
        starts_once(browser, line[0].aggregator.out)


def test_a_token_that_no_header_holds_is_a_wrong_one(
    browser: Browser, line: tuple[LineConfig, Path], process: Process, tmp_path: Path
) -> None:
    """A phone makes a dash of a minus: "the page's server did not answer", press again; and it was never asked."""
    with acting_page(line[1], tmp_path) as url:
        look(browser, url, "Start load")
        press(browser, "start")
        confirm(browser, name="trailer 7", operator="Anna", token=TOKEN.replace("-", "\u2013"))
        until_shown(browser, "This token is wrong")
        assert "did not answer" not in text(browser)
        js(browser, LOSE_AN_ANSWER)
        confirm(browser, token=TOKEN)
        until_shown(browser, "press again, it is carried out once")
        confirm(browser, token="\u201cquoted\u201d")
        until_shown(browser, "This token is wrong")
        starts_once(browser, line[0].aggregator.out)
