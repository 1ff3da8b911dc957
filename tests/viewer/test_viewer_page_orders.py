"""Who may change loads from the page, over real sockets: tokens, other pages, limits, and what an order may say."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from conveyor.config import LinkConfig
from conveyor.errors import InputError, LinkError
from conveyor.messages import LoadAnswer, LoadOrder
from viewer.page.acting import MAX_ASKED, MAX_BODY_BYTES, Acting, Rate
from viewer.page.board import Board
from viewer.page.orders import why_not
from viewer.page.server import PageServer

TOKEN = "a-token-of-this-test"
START = {"line": "north", "action": "start", "request": "page-1", "operator": " Anna ", "fields": {"name": "trailer 7"}}


class Line:
    """Carries out orders at once, or when it is let go."""

    def __init__(self) -> None:
        self.taken: list[tuple[str, LoadOrder]] = []
        self.go = threading.Event()
        self.go.set()

    def __call__(self, line: str, order: LoadOrder) -> LoadAnswer:
        self.taken.append((line, order))
        self.go.wait(20)
        if order.action == "end":
            raise LinkError("no answer: may this certificate change loads (access.loaders)?")
        return LoadAnswer(order.request, True, text="load 1 is started", load=1, name="trailer 7")


@pytest.fixture
def line() -> Line:
    return Line()


@pytest.fixture
def page(line: Line) -> Iterator[PageServer]:
    acting = Acting(line, lines=("north",), token=TOKEN)
    with PageServer(Board(["north"]), host="127.0.0.1", port=0, acting=acting) as running:
        yield running


def give(
    page: PageServer, order: dict[str, Any] | bytes, *, token: str = TOKEN, **headers: str
) -> tuple[int, dict[str, Any]]:
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=30)
    body = order if isinstance(order, bytes) else json.dumps(order).encode()
    connection.request("POST", "/order", body, {"X-Tuberline-Token": token, **headers})
    answer = connection.getresponse()
    found = answer.status, json.loads(answer.read())
    connection.close()
    return found


def test_a_note_goes_to_its_line_and_needs_a_text(page: PageServer, line: Line) -> None:
    note = {"line": "north", "action": "note", "request": "r-note", "operator": "Anna", "load": "1"}
    status, said = give(page, {**note, "note": "wet soil"})
    assert (status, line.taken[-1][1].action, line.taken[-1][1].note) == (200, "note", "wet soil")
    status, said = give(page, {**note, "note": "  "})
    assert (status, said["error"]) == (400, "type what is to be noted")


def test_an_order_goes_to_its_line_with_the_name_of_who_gave_it(page: PageServer, line: Line) -> None:
    status, said = give(page, START, Origin=f"http://127.0.0.1:{page.port}")
    assert (status, said["done"], said["text"]) == (200, True, "load 1 is started")
    ((name, order),) = line.taken
    assert (name, order.action, order.by) == ("north", "start", "page: Anna")
    assert order.fields == {"name": "trailer 7"}


@pytest.mark.parametrize("token", ["", "wrong", TOKEN[:-1], TOKEN + "x", "tokén-of-this-test"])
def test_a_wrong_token_changes_nothing(page: PageServer, line: Line, token: str) -> None:
    status, said = give(page, START, token=token)
    assert (status, line.taken) == (401, [])
    assert "token is wrong" in said["error"]


@pytest.mark.parametrize(
    ("changed", "status", "why"),
    [
        ({"line": "south"}, 404, "does not show a line 'south'"),
        ({"action": "erase"}, 400, "does not know how to 'erase'"),
        ({"operator": "  "}, 400, "who gives the order"),
        ({"operator": "A" * 61}, 400, "at most 60 characters"),
        ({"operator": 5}, 400, "who gives the order"),
        ({"fields": {"weight": "5"}}, 400, "a load is described by"),
        ({"fields": {"name": "a\nb"}}, 400, "name"),
        ({"request": "no id!"}, 400, "request"),
        ({"place_x_m": 3.0}, 400, "no others"),
        ({"action": "ticket"}, 400, "what the scale said"),
        ({"action": "ticket", "kg": -5}, 400, "such an order cannot be given: kg: must be at least 0.001 kg"),
        ({"action": "ticket", "kg": "many"}, 400, "such an order cannot be given: kg: must be a number"),
        ({"action": "end"}, 502, "access.loaders"),
    ],
)
def test_what_cannot_be_done_is_said_in_words(
    page: PageServer, line: Line, changed: dict[str, Any], status: int, why: str
) -> None:
    found, said = give(page, {**START, **changed})
    assert (found, said["done"]) == (status, False)
    assert why in said["error"]
    assert len(line.taken) == (status == 502)


def test_other_pages_and_what_is_no_order_are_refused(page: PageServer, line: Line) -> None:
    assert give(page, START, Origin="http://evil.example")[0] == 403
    assert give(page, b"{")[0] == 400
    assert give(page, b"[1]")[0] == 400
    status, said = give(page, {**START, "load": "x" * MAX_BODY_BYTES})
    assert (status, str(MAX_BODY_BYTES) in said["error"]) == (400, True)
    assert line.taken == []


def test_another_page_does_not_use_up_the_orders_of_a_minute(page: PageServer, line: Line) -> None:
    """A page elsewhere, open on the same computer, kept every hand out with 20 forms a minute, without any token."""
    for _ in range(MAX_ASKED + 1):
        assert give(page, START, token="wrong", Origin="http://evil.example")[0] == 403
    assert give(page, START)[0] == 200


def test_one_order_of_a_line_at_a_time(page: PageServer, line: Line) -> None:
    line.go.clear()
    found: list[tuple[int, dict[str, Any]]] = []
    first = threading.Thread(target=lambda: found.append(give(page, START)))
    first.start()
    while not line.taken:
        assert first.is_alive()
    assert give(page, START)[0] == 409
    line.go.set()
    first.join(20)
    assert found[0][0] == 200


def test_so_many_orders_a_minute_and_no_more(page: PageServer) -> None:
    assert [give(page, START, token="wrong")[0] for _ in range(MAX_ASKED)] == [401] * MAX_ASKED
    status, said = give(page, START)
    assert (status, "Wait a minute" in said["error"]) == (429, True)
    rate = Rate(most=2)
    assert [rate.take("a", at_s) for at_s in (0.0, 1.0, 2.0, 60.5)] == [True, True, False, True]
    assert rate.take("b", 2.0)


def test_a_page_without_a_token_takes_no_orders() -> None:
    with PageServer(Board(["north"]), host="127.0.0.1", port=0) as page:
        connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=10)
        connection.request("POST", "/order", b"{}")
        assert connection.getresponse().status == 404
        connection.close()
    with pytest.raises(InputError, match="at least 16"):
        Acting(Line(), lines=("north",), token="short")


def test_a_page_without_a_loaders_certificate_knows_why_it_only_looks(tmp_path: Path) -> None:
    assert why_not(LinkConfig()) == "", "a line without certificates lets everybody ask"
    said = why_not(LinkConfig(router="tls/10.0.0.1:7447", certs=tmp_path))
    assert "no certificate for loader" in said
    assert "tuberline certs add loader" in said
