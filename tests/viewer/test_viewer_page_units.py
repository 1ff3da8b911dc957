"""The page in another unit than the line: what the line says of tickets, in the unit that a person chose."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.viewer.page_states import DOUBT, loaded_state
from tests.viewer.test_viewer_page_browser import Browser, browser, js, until, until_told
from viewer.page.board import Board
from viewer.page.server import PageServer
from viewer.page.snapshot import snapshot

__all__ = ["browser"]
NAME = "20 sacks of 25 kg"
REFUSED = f"the ticket says 207.1 kg, load 1 ({NAME}) came to 400.0 kg: a ratio of 0.52"
TOLD = {
    "kg": f"{DOUBT}",
    "t": "says 0.2071 t, expected are 0.1812 t, 4.1 standard deviations",
    "lb": "says 456.6 lb, expected are 399.6 lb, 4.1 standard deviations",
}


@pytest.mark.parametrize("unit", TOLD)
def test_what_the_line_says_of_a_ticket_is_in_the_unit_of_the_page(browser: Browser, unit: str) -> None:
    """It stayed in kg beside tickets in pounds. The names that persons gave stay as they are."""
    state = loaded_state()
    first = replace(state.told[-1], name=NAME, refused=(REFUSED,))
    state = replace(state, told=(*state.told[:-1], first))
    board = Board(["north"])
    with PageServer(board, host="127.0.0.1", port=0) as page:
        board.put(seen := {**snapshot(state), "looks_only": ""})
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/?lang=en")
        until_told(browser, board, seen, "Load 3")
        js(
            browser,
            f"Object.assign(document.getElementById('unit'), {{value: '{unit}'}}).dispatchEvent(new Event('change'))",
        )
        came_to = {"kg": "400.0 kg", "t": "0.4000 t", "lb": "881.8 lb"}[unit]
        until_told(browser, board, seen, TOLD[unit], f"load 1 ({NAME}) came to {came_to}: a ratio of 0.52")
        js(browser, "localStorage.clear()")


SAID = """import('./words.js').then(({ choose, inUnit }) => {
    choose('unit', 'lb');
    window.said = [inUnit('a ticket of 1e+06 kg: up to 200000 kg'), inUnit(''), inUnit('8.5kg, kg, v1.2 kg', [])];
    localStorage.clear(); })"""


def test_only_weights_are_told_in_another_unit(browser: Browser) -> None:
    with PageServer(Board(["north"]), host="127.0.0.1", port=0) as page:
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/?lang=en")
        until(lambda: js(browser, "document.getElementById('unit')?.options.length"), what="the page")
        js(browser, SAID)
        until(lambda: js(browser, "window.said"), what="the texts")
        of_ticket, *others = js(browser, "window.said")
        assert of_ticket.replace("\u202f", " ") == "a ticket of 2 204 622.6 lb: up to 440 924.5 lb"
        assert others == ["", "8.5kg, kg, v1.2 kg"]
