"""Logs under foreign hands: one line an event, no control characters, so many lines a minute and the rest counted."""

from __future__ import annotations

import io
import json
import logging
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from conveyor.logs import (
    LINES_PER_MIN,
    MOST_PLACES,
    LimitedHandler,
    RateLimit,
    _JsonFormatter,
    _TextFormatter,
    one_line,
)

FORGED = "left\n12:00:00.000 error   ledger: lost\r\x1b[2J\x1b]0;title\x07\x00\u2028\u202egpj\x9b1mtail"


class Clock:
    """Seconds that a test moves."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def logger(name: str, *, clock: Clock | None = None) -> tuple[logging.Logger, io.StringIO, LimitedHandler]:
    """A logger of its own with our handler, and what it writes."""
    written = io.StringIO()
    handler = LimitedHandler(written, limit=RateLimit(clock=clock or Clock()))
    handler.setFormatter(_TextFormatter())
    made = logging.Logger(name)
    made.addHandler(handler)
    return made, written, handler


@given(text=st.text())
def test_any_text_is_one_line_without_control_characters(text: str) -> None:
    shown = one_line(text)
    assert len(shown.splitlines()) <= 1
    assert not re.search(r"[\x00-\x08\x0a-\x1f\x7f-\x9f]", shown)
    shown.encode()
    if text.isprintable():
        assert shown == text


def test_a_forged_event_stays_inside_the_one_it_came_with() -> None:
    log, written, _ = logger("page/" + FORGED)
    log.warning("no camera %s", FORGED)
    (line,) = written.getvalue().splitlines()
    assert re.match(r"\d\d:\d\d:\d\d\.\d{3}Z warning ", line), "a time without its zone"
    assert "\x1b" not in line
    assert r"left\n12:00:00.000 error   ledger: lost\r\x1b[2J" in line


def test_a_forged_traceback_is_indented_and_no_event() -> None:
    log, written, _ = logger("node")
    try:
        raise ValueError(FORGED + "\nMay 1 tuberline: all is lost")
    except ValueError:
        log.exception("it failed")
    first, *others = written.getvalue().splitlines()
    assert "it failed" in first
    assert others
    assert all(line.startswith("  ") for line in others)
    assert "\x1b" not in written.getvalue()


def test_json_events_are_one_line_each_and_clean() -> None:
    record = logging.LogRecord("a", logging.ERROR, "", 0, "%s", (FORGED,), None)
    line = _JsonFormatter().format(record)
    assert "\n" not in line
    assert json.loads(line)["text"] == one_line(FORGED)


def test_a_long_text_is_cut_and_says_how_long_it_was() -> None:
    shown = one_line("x" * 1_000_000)
    assert len(shown) < 5000
    assert shown.endswith("... (1000000 characters)")


def test_a_flood_of_one_kind_is_counted_and_holds_no_other_up() -> None:
    clock = Clock()
    log, written, _ = logger("node", clock=clock)
    for n in range(100_000):
        log.error("refused a message from %s", f"forged{n}")
    log.info("the load has %d tubers", 7)
    assert len(written.getvalue().splitlines()) == LINES_PER_MIN + 1
    clock.now_s = 61.0
    log.info("the load has %d tubers", 8)
    told = written.getvalue().splitlines()[LINES_PER_MIN + 1 :]
    assert f"{100_000 - LINES_PER_MIN} lines like 'refused a message from %s' were left out" in told[0]
    assert "the load has 8 tubers" in told[1]
    log.error("refused a message from %s", "again")
    assert written.getvalue().splitlines()[-1].endswith("refused a message from again")


def test_texts_without_arguments_share_a_limit_and_what_was_left_out_is_told_at_the_end() -> None:
    log, written, handler = logger("node")
    for n in range(500):
        log.warning(f"made again each time: {n}")
    handler.close()
    lines = written.getvalue().splitlines()
    assert len(lines) == LINES_PER_MIN + 1
    assert f"{500 - LINES_PER_MIN} lines without a template were left out" in lines[-1]


def test_places_that_are_remembered_have_an_end() -> None:
    limit = RateLimit(clock=Clock())
    admitted = sum(limit.admit(f"logger{n}", "%s") for n in range(5 * MOST_PLACES))
    assert len(limit) == MOST_PLACES + 1
    assert admitted == MOST_PLACES + LINES_PER_MIN
    assert limit.over(all_of_them=True) == [("", "", 4 * MOST_PLACES - LINES_PER_MIN)]
    assert len(limit) == 0


@pytest.mark.parametrize("text", ["plain", "tab\tstays", "Rübe 10 µm → 5 °C"])
def test_plain_text_stays_as_it_is(text: str) -> None:
    assert one_line(text) == text
