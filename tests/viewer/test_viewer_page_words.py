"""One table of words: every text in every language with the same values, and none that is missing or of no use."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

import viewer.page.words as words_module
from tests.viewer.page_states import loaded_state
from tests.viewer.test_viewer_page_browser import Browser, browser, js, text, until, until_told
from viewer.page.board import Board
from viewer.page.server import PageServer
from viewer.page.snapshot import snapshot
from viewer.page.words import AGGREGATOR_REFUSALS, FRAME_DROPS, VIEW_LOSSES, said, span, table

__all__ = ["browser"]
PAGE = Path(words_module.__file__).parent
SHOWN = {
    "en": ("Running", "Load 3 · trailer 7", "90 % sure: 199.0 to 214.0 kg", "Start load …", "No alarms."),
    "de": ("Läuft", "Ladung 3 · trailer 7", "90 % sicher: 199,0 bis 214,0 kg", "Ladung beginnen …", "Keine Meldungen."),
    "nl": ("Loopt", "Lading 3 · trailer 7", "90 % zeker: 199,0 tot 214,0 kg", "Lading beginnen …", "Geen meldingen."),
    "ja": ("運転中", "積荷 3 · trailer 7", "90 % 信頼：199.0～214.0 kg", "積荷を開始…", "警報はありません。"),
}

OUNCES = {
    "en": ("ounces a tuber", "Ounces", "3.5 to 5.3", "Most tubers, 3 420, weigh 3.5 to 5.3 ounces", "counted, oz"),
    "de": ("Unzen (oz) je Knolle", "Unzen (oz)", "3,5 bis 5,3", "Die meisten Knollen, 3 420, wiegen 3,5 bis 5,3 Unzen",
           "gezählt, oz"),
    "nl": ("ounces (oz) per knol", "Ounces (oz)", "3,5 tot 5,3", "De meeste knollen, 3 420, wegen 3,5 tot 5,3 ounces",
           "geteld, oz"),
    "ja": ("1個のオンス数", "オンス", "3.5～5.3", "最も多い 3 420 個は 3.5～5.3 オンス", "計数済み（oz）"),
}  # fmt: skip
SVG = "document.querySelector('[data-put=histogram]')"
FIGURES = """(() => {
    const texts = [...document.querySelectorAll('[data-put=histogram] text')].map((text) => text.textContent);
    const table = document.querySelector('[data-put=classes]');
    const bars = [...document.querySelectorAll('[data-put=histogram] rect')];
    return {texts, said: document.querySelector('[data-put=histogram]').getAttribute('aria-label'),
        head: table.tHead.textContent, row: table.tBodies[0].rows[2].cells[0].textContent,
        mean: document.querySelector('[data-put=mean]').textContent,
        lefts: bars.map((bar) => Number(bar.getAttribute('x'))),
        marks: [...document.querySelectorAll('[data-put=histogram] text[text-anchor=middle]')].map(
            (text) => Number(text.getAttribute('x')))};
})()"""
"""What the histogram says in words and figures, and where its bars and the figures under them stand."""


def values_of(text: str) -> set[str]:
    return set(re.findall(r"\{\w+(?::[^}]+)?\}", text))


def test_every_text_is_there_in_every_language_with_the_same_values() -> None:
    for key, found in table().items():
        assert set(found) == set(SHOWN), key
        assert all(text.strip() for text in found.values()), key
        assert len({frozenset(values_of(text)) for text in found.values()}) == 1, key


def test_every_reason_has_its_words_and_no_word_is_of_no_use() -> None:
    made = {f"alarm.{counter}" for counter in AGGREGATOR_REFUSALS}
    made |= {f"drop.{reason}.{part}" for reason in FRAME_DROPS for part in ("now", "what", "todo")}
    made |= {f"lost.{reason}.{part}" for reason in VIEW_LOSSES for part in ("now", "what", "todo")}
    made |= {f"alarm.{role}.{what}" for role in ("camera", "segmenter") for what in ("gone", "quiet")}
    made |= {f"todo.{role}.gone" for role in ("camera", "segmenter")} | {"alarm.no_contact_for", "alarm.no_router_for"}
    assert made <= set(table())
    files = [*PAGE.glob("*.py"), *PAGE.glob("static/*.js"), *PAGE.glob("static/*.html")]
    source = "\n".join(file.read_text(encoding="utf-8") for file in files)
    heads = set(re.findall(r"`([a-z_.]+\.)\$\{", source))
    for key in set(table()) - made:
        used = f'"{key}"' in source or any(key.startswith(head) for head in heads)
        assert used, f"no one says '{key}'"


def test_values_are_told_as_the_text_wants_them() -> None:
    assert said("alarm.coverage", {"percent": 7.04}).startswith("7.0 % of the belt")
    assert said("alarm.camera.drift", {"camera": "left", "px": 0.2}).startswith(
        "The depth scale of camera left drifted by +0.20"
    )
    assert said("alarm.camera.gone", {"camera": "links", "for": 7300}, language="de") == (
        "Kamera links hat vor 2 h 1 min aufgehört."
    )
    assert span(130, language="ja") == "2分"


@pytest.mark.graph
def test_the_page_speaks_four_languages_and_three_units_and_remembers(browser: Browser) -> None:
    board = Board(["north"])
    with PageServer(board, host="127.0.0.1", port=0) as page:
        board.put(seen := {**snapshot(loaded_state()), "looks_only": ""})
        url = f"http://127.0.0.1:{page.port}/"
        for language, told in SHOWN.items():
            browser.page("Page.navigate", url=f"{url}?lang={language}")
            until_told(browser, board, seen, *told)
            assert js(browser, "document.documentElement.lang") == language
            assert not re.search(r"\{\w+", text(browser)), "a value that no one filled in"
        browser.page("Page.navigate", url=url)
        until_told(browser, board, seen, "Running")
        for name, value, told in (
            ("language", "nl", "90 % zeker: 199,0 tot 214,0 kg"),
            ("unit", "lb", "90 % zeker: 438,7 tot 471,8 lb"),
            ("unit", "t", "90 % zeker: 0,199 tot 0,214 t"),
        ):
            picked = f"Object.assign(document.getElementById('{name}'), {{value: '{value}'}})"
            js(browser, f"{picked}.dispatchEvent(new Event('change')); 1")
            until_told(browser, board, seen, told)
        browser.page("Page.navigate", url=url)
        until_told(browser, board, seen, "0,199 tot 0,214 t")
        axes = "[[0, 0.005, 0.01], [0, 2.5, 5]].map(steps)"
        js(browser, f"import('./charts.js').then(({{ steps }}) => {{ window.axes = {axes}; }}); 1")
        until(lambda: js(browser, "window.axes"), what="the figures of two axes")
        few = [["0,000", "0,005", "0,010"], ["0,0", "2,5", "5,0"]]
        assert js(browser, "window.axes") == few, "all figures of a chart of buckets in tons were 0,0"
        js(browser, "localStorage.clear(); 1")


@pytest.mark.graph
@pytest.mark.parametrize("language", OUNCES)
def test_single_tubers_are_told_in_ounces_where_loads_are_told_in_pounds(browser: Browser, language: str) -> None:
    """The histogram stayed in grams, beside a mean tuber in ounces; so did the weights on the cameras' pictures."""
    axis, unit, row, said_of_most, legend = OUNCES[language]
    board = Board(["north"])
    with PageServer(board, host="127.0.0.1", port=0) as page:
        board.put(seen := snapshot(loaded_state()))
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/?lang={language}")
        until_told(browser, board, seen, "3 · trailer 7")

        def laid_out() -> object:
            board.put(seen)
            return js(browser, f"{SVG}.viewBox.baseVal.width === {SVG}.clientWidth")

        until(laid_out, what="a histogram as wide as its place")
        grams = js(browser, FIGURES)
        assert grams["mean"] == "172 g"
        assert {"0", "100"} <= set(grams["texts"])
        picked = "Object.assign(document.getElementById('unit'), {value: 'lb'})"
        js(browser, f"{picked}.dispatchEvent(new Event('change')); 1")
        until_told(browser, board, seen, legend)
        found = js(browser, FIGURES)
        assert (found["head"].startswith(unit), found["row"]) == (True, row)
        assert (found["said"].replace("\u202f", " "), axis in found["texts"]) == (said_of_most, True)
        assert found["mean"].endswith(" oz")
        assert [text for text in found["texts"] if text in ("0", "4", "8", "12")] == ["0", "4", "8", "12"]
        assert found["lefts"] == grams["lefts"], "the classes stay those that the line counts in"
        per_gram = (found["lefts"][1] - found["lefts"][0]) / 50.0
        zero, four, *_ = found["marks"]
        assert four - zero == pytest.approx(4 * 28.349523125 * per_gram, abs=0.1)
        js(browser, "localStorage.clear(); 1")


def test_a_list_of_loads_that_ends_before_the_first_one_says_so(browser: Browser) -> None:
    """Of a day of 40 loads the page showed the last 24, and looked complete."""
    state, board = loaded_state(), Board(["north"])
    numbered = tuple(replace(state.told[0], number=n, open=False) for n in range(40, 16, -1))
    with PageServer(board, host="127.0.0.1", port=0) as page:
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/?lang=en")
        older = "Older loads, up to number 16: tuberline load show --limit 50 lists them."
        until_told(browser, board, snapshot(replace(state, told=numbered)), older)
        until_told(browser, board, snapshot(state), "trailer 5")
        assert "Older loads" not in text(browser)
        first_24 = tuple(replace(load, number=load.number - 16) for load in numbered)
        until_told(browser, board, snapshot(replace(state, told=first_24)), "24 · trailer 7")
        assert "Older loads" not in text(browser)


def test_a_name_that_reads_from_right_to_left_turns_nothing_else_around(browser: Browser) -> None:
    """Field and variety changed places, "since" stood between them; 'abc' before 93 was shown as 'abc39'."""
    state, board = loaded_state(), Board(["north"])
    assert state.totals is not None
    assert state.totals.load is not None
    now = replace(
        state.totals.load, name="abc\u202edcba 93", trailer="", field="שדה 7", variety="حقل 12", customer="Coop"
    )
    told = (replace(state.told[0], name=now.name, field=now.field), *state.told[1:])
    with PageServer(board, host="127.0.0.1", port=0) as page:
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/?lang=en")
        shown = snapshot(replace(state, told=told, totals=replace(state.totals, load=now)))
        until_told(browser, board, shown, "Coop", "trailer 6")
        which, known = js(
            browser, "['which', 'known'].map((n) => document.querySelector(`[data-put=${n}]`).textContent)"
        )
        row = js(browser, "[...document.querySelectorAll('[data-put=told] tbody td')].map((cell) => cell.textContent)")
    assert which == "Load 3 · \u2068abcdcba 93\u2069"
    assert known.split(" · ")[1:4] == ["\u2068שדה 7\u2069", "\u2068حقل 12\u2069", "Coop"]
    assert (row[0], row[7]) == ("3 · \u2068abcdcba 93\u2069 (open)", "\u2068שדה 7\u2069")
