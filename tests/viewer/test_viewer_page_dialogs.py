"""The page's dialogs and its menu on a phone: nothing is cut off, buttons are in reach, keys do what they should."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from tests.viewer.page_states import huge_state, loaded_state
from tests.viewer.test_viewer_page_browser import Browser, browser, js, until
from viewer.page.board import Board
from viewer.page.server import PageServer
from viewer.page.snapshot import snapshot

__all__ = ["browser"]
ACTIONS = ("start", "end", "undo", "ticket", "note")
NAME = "Großbäckersheim-Überlingen am See, Schlag 17b hinter Äckern x"
LONG = f"""document.querySelectorAll('#order input').forEach((input) => {{ input.value = '{NAME}'; }});
    Object.assign(document.querySelector('.wrong'),
        {{hidden: false, textContent: 'Die Linie sagt: {NAME} ' + 'x'.repeat(90)}})"""
CUT_OFF = """(() => {
    const dialog = document.getElementById('order');
    const [high, wide] = [innerHeight, innerWidth];
    const off = ['yes', 'no'].filter((name) => {
        const at = dialog.querySelector(`.${name}`).getBoundingClientRect();
        const top = document.elementFromPoint((at.left + at.right) / 2, (at.top + at.bottom) / 2);
        return at.height < 44 || at.top < 0 || at.bottom > high || !dialog.querySelector(`.${name}`).contains(top);
    });
    const wider = [dialog, ...dialog.querySelectorAll('*')].filter((e) => e.getBoundingClientRect().right > wide);
    const scrolls = dialog.scrollWidth > dialog.clientWidth;
    return [...off, ...wider.map((e) => e.outerHTML.slice(0, 60)), ...(scrolls ? ['scrolls sideways'] : [])];
})()"""
"""Of an open dialog, buttons that no finger reaches and what is wider than the screen."""
CONTRAST = """(() => {
    const parts = (colour) => colour.match(/[\\d.]+/g).slice(0, 3).map(Number);
    const linear = (v) => (v <= .03928 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4);
    const light = (colour) => parts(colour).map((v) => linear(v / 255))
        .reduce((sum, v, n) => sum + v * [.2126, .7152, .0722][n], 0);
    const ratio = (a, b) => (Math.max(light(a), light(b)) + .05) / (Math.min(light(a), light(b)) + .05);
    const input = document.querySelector('#order input[name=name]');
    const ground = getComputedStyle(input).backgroundColor;
    const box = getComputedStyle(document.querySelector('#order input[type=checkbox]')).boxShadow;
    const behind = getComputedStyle(document.getElementById('order')).backgroundColor;
    return [ratio(getComputedStyle(input, '::placeholder').color, ground),
        ratio(box.match(/rgb\\([^)]*\\)/)?.[0] ?? behind, behind)];
})()"""
"""Of an example to its field, and of a box that can be ticked to the dialog."""


@contextmanager
def on_phone(
    browser: Browser, *, language: str = "en", high: int = 844, huge: bool = False
) -> Iterator[Callable[[], None]]:
    """A page of one line whose loads can be changed, on a phone. What it gives is called before a button is pressed: a
    line that has not been heard for a while takes no orders.
    """
    state = huge_state() if huge else loaded_state()
    board, shown = Board([state.line]), {**snapshot(state), "looks_only": ""}
    browser.page("Emulation.setDeviceMetricsOverride", width=390, height=high, deviceScaleFactor=1, mobile=True)
    with PageServer(board, host="127.0.0.1", port=0) as page:
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/?lang={language}")

        def usable() -> bool:
            board.put(shown)
            start = "document.querySelector('[data-act=start]')"
            return bool(js(browser, f"!!{start} && !{start}.disabled && !{start}.closest('[hidden]')"))

        def ready() -> None:
            until(usable, what="a line that takes orders")

        ready()
        yield ready
    browser.page("Emulation.setEmulatedMedia", features=[])


def key(browser: Browser, name: str) -> None:
    """Press it as a hand does."""
    code = {"Tab": 9, "Enter": 13, "Escape": 27}[name]
    text = {"text": "\r"} if name == "Enter" else {}
    for kind in ("keyDown", "keyUp"):
        browser.page("Input.dispatchKeyEvent", type=kind, key=name, code=name, windowsVirtualKeyCode=code, **text)


def focused(browser: Browser) -> str:
    """What the keys go to: its action, its name, its class."""
    first = "(({dataset, name, id, className, tagName}) => dataset.act || name || id || className || tagName)"
    return str(js(browser, f"{first}(document.activeElement)"))


def is_open(browser: Browser) -> bool:
    return bool(js(browser, "document.getElementById('order').open"))


@pytest.mark.parametrize("high", [844, 420])
@pytest.mark.parametrize("language", ["en", "de", "nl", "ja"])
def test_buttons_of_a_dialog_are_in_reach_whatever_stands_in_it(browser: Browser, language: str, high: int) -> None:
    """Below a long refusal, or beside a phone's keyboard, they lay beyond the screen."""
    with on_phone(browser, language=language, high=high, huge=True) as ready:
        for action in ACTIONS:
            ready()
            js(browser, f"document.querySelector('[data-act={action}]').click()")
            assert js(browser, CUT_OFF) == [], action
            js(browser, LONG)
            assert js(browser, CUT_OFF) == [], f"{action}, refused"
            js(browser, "document.getElementById('order').close()")


@pytest.mark.parametrize("light", ["light", "dark"])
def test_an_example_and_a_box_are_to_be_seen_in_any_light(browser: Browser, light: str) -> None:
    """An empty box for gross tickets was dark grey on black, an example grey on grey."""
    with on_phone(browser):
        browser.page("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": light}])
        js(browser, "document.documentElement.dataset.light = 'auto'")
        js(browser, "document.querySelector('[data-act=start]').click()")
        example, box = js(browser, CONTRAST)
        assert example >= 4.5
        assert box >= 3


def test_a_dialog_goes_by_keys_alone(browser: Browser) -> None:
    with on_phone(browser) as ready:
        js(browser, "document.querySelector('[data-act=ticket]').focus()")
        key(browser, "Enter")
        until(lambda: is_open(browser), what="the dialog")
        passed = [focused(browser)]
        while passed[-1] != "no":
            key(browser, "Tab")
            passed.append(focused(browser))
        assert passed == ["load", "kg", "gross", "operator", "token", "yes", "no"]
        key(browser, "Escape")
        assert not is_open(browser)
        assert focused(browser) == "ticket", "the button that opened it"
        ready()
        js(browser, "document.querySelector('[data-act=ticket]').focus()")
        key(browser, "Enter")
        js(browser, "Object.assign(document.querySelector('#order form').elements.kg, {value: 'much'})")
        js(browser, "for (const name of ['operator', 'token']) document.querySelector(`[name=${name}]`).value = 'x'")
        js(browser, "document.querySelector('[name=token]').focus()")
        key(browser, "Enter")
        until(
            lambda: "as a number" in js(browser, "document.querySelector('.wrong').textContent"), what="what is wrong"
        )
        assert focused(browser) == "kg", "what is to be typed otherwise"
        key(browser, "Escape")


@pytest.mark.parametrize("language", ["en", "de", "nl", "ja"])
def test_the_menu_shows_its_words_whole_and_closes_by_keys(browser: Browser, language: str) -> None:
    """'automatisch' was cut; Escape left the focus nowhere, and Tab went on below the open menu."""
    with on_phone(browser, language=language):
        js(browser, "document.querySelector('#menu summary').focus()")
        key(browser, "Enter")
        until(lambda: js(browser, "document.getElementById('menu').open"), what="the menu")
        fits = """[...document.querySelectorAll('#menu select')].filter((select) => {
            const pen = document.createElement('canvas').getContext('2d');
            pen.font = getComputedStyle(select).font;
            const longest = Math.max(...[...select.options].map((option) => pen.measureText(option.text).width));
            return select.clientWidth - 2 * parseFloat(getComputedStyle(select).paddingLeft) < longest + 12;
        }).map((select) => select.id)"""
        assert js(browser, fits) == []
        box = js(
            browser, "(({left, right}) => [left, right])(document.querySelector('#menu > div').getBoundingClientRect())"
        )
        assert 0 <= box[0] < box[1] <= 390
        for name in ("language", "unit", "light"):
            key(browser, "Tab")
            assert focused(browser) == name
        key(browser, "Escape")
        assert not js(browser, "document.getElementById('menu').open")
        assert focused(browser) == "SUMMARY"
        key(browser, "Enter")
        for _ in range(4):
            key(browser, "Tab")
        assert not js(browser, "document.getElementById('menu').open"), "the page below it is what is meant now"


LATE_ANSWER = """window.fetch = () => new Promise((resolve) => {
    const answer = { done: true, text: 'load 4 has begun', load: 4, name: '' };
    const headers = { 'Content-Type': 'application/json' };
    window.answer = () => resolve(new Response(JSON.stringify(answer), { headers }));
}); 1"""


def test_an_order_whose_dialog_was_closed_is_told_when_it_was_carried_out(browser: Browser) -> None:
    """Who pressed Escape while the line was asked never learned that the load had begun."""
    with on_phone(browser):
        js(browser, LATE_ANSWER)
        js(browser, "document.querySelector('[data-act=start]').click()")
        js(browser, "for (const name of ['operator', 'token']) document.querySelector(`[name=${name}]`).value = 'x'")
        js(browser, "document.querySelector('#order .yes').click()")
        until(lambda: js(browser, "'answer' in window"), what="the order is on its way")
        key(browser, "Escape")
        assert not is_open(browser)
        js(browser, "window.answer()")
        said = "document.querySelector('[data-put=said]').textContent"
        until(
            lambda: "Load 4 has begun. The line says: load 4 has begun" in js(browser, said), what="what became of it"
        )
