"""Loads in the ledger: each tuber in exactly one, sums carried along, an undo, kill -9 at every write point, damage."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from aggregator.core.load_orders import UNDO_WITHIN_S, answer, decide
from aggregator.core.loads import NO_LOAD, span_of
from aggregator.ledger.check import check_file
from aggregator.ledger.export import canonical_lines
from aggregator.ledger.load_list import told_loads
from aggregator.ledger.load_rows import read_book, read_span_sums
from aggregator.ledger.reader import read_sums, read_tubers, reading, the_run
from aggregator.ledger.repair import repair
from aggregator.ledger.schema import Table
from aggregator.ledger.steps import span_step
from aggregator.ledger.totals_by import totals_by
from aggregator.ledger.verified import LedgerView
from aggregator.ledger.writer import Ledger
from conveyor.errors import InputError
from conveyor.messages import LoadAnswer, LoadOrder, Tuber
from tests.aggregator.belt_story import Story, tell
from tests.aggregator.virtual_line import STALL_S, Aggregator
from tuberline.cli.address import LineAddress
from tuberline.cli.load_table import told_loads as asked_of

SEED = 5
S = 1_000_000_000


class Loads(Aggregator):
    """An aggregation whose loads change on the way, at places that are stated."""

    def order(
        self, request: str, action: str, *, now_ns: int = 0, x_m: float | None = None, **more: object
    ) -> LoadAnswer:
        """Carry out an order as the node does."""
        asked = LoadOrder(request, action, by="me", place_x_m=x_m, **more)  # type: ignore[arg-type]
        event = decide(asked, self.ledger.loads, run=self.story.run, now_ns=now_ns, line={}, place_x_m=self.place_x_m)
        self.ledger.say(event)
        return answer(asked, event, self.ledger.loads)

    def place_x_m(self, order: LoadOrder) -> float:
        assert order.place_x_m is not None
        return order.place_x_m


def story() -> Story:
    return tell(SEED, n=24, cameras=2, length_m=2.0, noise_mm=0.0)


def by_span(path: Path) -> dict[int, list[float]]:
    """Weights of the tubers of each load, by its number, from their rows alone."""
    with reading(path) as view:
        run = the_run(view, path, None).run
        spans = read_book(view).spans[run]
        found: dict[int, list[float]] = {span.load: [] for span in spans}
        for tuber in read_tubers(view, run):
            found[span_of(spans, tuber.place_x_m).load].append(tuber.weight_g)
        return found


def sums_by_load(path: Path) -> dict[int, tuple[int, float]]:
    """(count, grams) of each load by the sums carried along."""
    with reading(path) as view:
        run = the_run(view, path, None).run
        sums, found = read_span_sums(view, run), dict[int, tuple[int, float]]()
        for span in read_book(view).spans[run]:
            count, grams = found.get(span.load, (0, 0.0))
            load = sums[span.n].load
            found[span.load] = (count + load.count, grams + load.as_weighed_g)
        whole = read_sums(view, run).load
    assert sum(count for count, _ in found.values()) == whole.count
    assert sum(grams for _, grams in found.values()) == pytest.approx(whole.as_weighed_g)
    return found


def told_with_loads(ledger: Ledger) -> Loads:
    """A story during which one load follows another, with a pause."""
    it = Loads(ledger, story())
    for n in it.commits():
        if n == 2:
            it.order("a", "start", x_m=-0.4, fields={"name": "A", "variety": "Agria"})
        if n == 4:
            it.order("b", "start", x_m=-0.9, fields={"name": "B"})
        if n == 6:
            it.order("c", "end", x_m=-1.5)
    assert it.core.finished
    return it


def test_a_tuber_belongs_to_exactly_one_load(tmp_path: Path) -> None:
    path = tmp_path / "ledger.db"
    with Ledger(path) as ledger:
        it = told_with_loads(ledger)
        ledger.finish(it.story.run, "{}", sights=it.core.cameras.sights)
    true: dict[int, int] = {}
    for tuber in story().seen():
        load = NO_LOAD if tuber.x_m >= -0.4 else 1 if tuber.x_m >= -0.9 else 2 if tuber.x_m >= -1.5 else NO_LOAD
        true[load] = true.get(load, 0) + 1
    found = sums_by_load(path)
    assert {load: count for load, (count, _) in found.items()} == true
    assert {load: (len(g), pytest.approx(sum(g))) for load, g in by_span(path).items()} == found
    assert check_file(path) == []


def test_loads_change_nothing_of_the_tubers(tmp_path: Path) -> None:
    with Ledger(tmp_path / "plain.db") as ledger:
        plain = Aggregator(ledger, story())
        plain.commit_one_by_one()
        expected = plain.canonical()
    with Ledger(tmp_path / "ledger.db") as ledger:
        assert told_with_loads(ledger).canonical() == expected


def test_an_order_again_is_done_once(tmp_path: Path) -> None:
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Loads(ledger, story())
        it.commit()
        first = it.order("a", "start", x_m=-0.4, fields={"name": "A"})
        assert it.order("a", "start", x_m=-0.7, fields={"name": "A"}) == first
        assert [load.name for load in ledger.loads.loads.values()] == ["A"]
        assert it.order("b", "note", note="wet").load == 1
        assert it.order("b", "note", note="wet").event == 2
        assert len(ledger.loads.loads[1].notes) == 1


def test_an_id_stands_for_one_order(tmp_path: Path) -> None:
    """A form that was corrected was answered as done under the id of the first one, and nothing was changed."""
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Loads(ledger, story())
        it.commit()
        orders: list[tuple[str, dict[str, Any]]] = [
            ("start", {"x_m": -0.4, "fields": {"name": "A"}}),
            ("ticket", {"load": "last", "kg": 8123.5}),
            ("start", {"x_m": -0.6, "fields": {"name": "B"}}),
            ("note", {"load": "A", "fields": {"name": "C"}}),
            ("end", {"x_m": -0.7}),
            ("undo", {}),
            ("end", {"x_m": -0.8, "note": "rain"}),
            ("start", {"x_m": -0.9, "load": "C"}),
        ]
        first = [it.order(f"r{n}", action, now_ns=n * S, **more) for n, (action, more) in enumerate(orders)]
        again = [it.order(f"r{n}", action, now_ns=90 * S, **more) for n, (action, more) in enumerate(orders)]
        assert [(told.event, told.load) for told in again] == [(told.event, told.load) for told in first]
        for request, action, more in [
            ("r0", "start", {"x_m": -0.4, "fields": {"name": "trailer 8"}}),
            ("r0", "note", {"fields": {"name": "A"}}),
            ("r0", "start", {"x_m": -0.4, "load": "A", "fields": {"name": "A"}}),
            ("r1", "ticket", {"load": "last", "kg": 8132.5}),
            ("r1", "ticket", {"load": "last", "kg": 8123.5, "net": False}),
            ("r1", "ticket", {"load": "2", "kg": 8123.5}),
            ("r3", "note", {"load": "B", "fields": {"name": "C"}}),
            ("r6", "end", {"x_m": -0.8}),
            ("r7", "start", {"x_m": -0.9, "fields": {"name": "C"}}),
        ]:
            with pytest.raises(InputError, match=f"order {request} was carried out already, with other content"):
                it.order(request, action, now_ns=90 * S, **more)
        with pytest.raises(InputError, match=r"load 1 \(C\): 8123.5 kg net on the scale.*under an id of its own"):
            it.order("r1", "ticket", load="last", kg=1.0)
        assert ledger.loads.last_n == len(orders)


def test_an_undo_gives_the_belt_back(tmp_path: Path) -> None:
    path = tmp_path / "ledger.db"
    with Ledger(path) as ledger:
        it = Loads(ledger, story())
        for n in it.commits():
            if n == 2:
                it.order("a", "start", x_m=-0.4, fields={"name": "A"})
            if n == 3:
                it.order("b", "start", x_m=-0.6, fields={"name": "B"}, now_ns=100 * S)
            if n == 20:
                assert ledger.span_sums("story")[2].load.count > 0
                assert ledger.loads.loads[1].ended_ns is not None
                with pytest.raises(InputError, match="was 61 s ago, a change can be undone within 60 s"):
                    it.order("late", "undo", now_ns=round((101 + UNDO_WITHIN_S) * S))
                assert it.order("u", "undo", now_ns=110 * S).name == "B"
                assert ledger.loads.loads[1].ended_ns is None
                assert ledger.loads.loads[2].undone
                assert it.order("n", "note", note="still A").name == "A"
            if n == 22:
                it.order("e", "end", now_ns=200 * S, x_m=-1.7)
                it.order("ue", "undo", now_ns=210 * S)
                assert it.order("n2", "note", note="open again").name == "A"
    assert set(by_span(path)) == {NO_LOAD, 1}
    assert sums_by_load(path)[1][0] == sum(tuber.x_m < -0.4 for tuber in story().seen())
    assert check_file(path) == []


@pytest.mark.parametrize(
    ("action", "more", "error"),
    [
        ("end", {}, "no load is open: nothing to end"),
        ("undo", {}, "nothing to undo"),
        ("note", {"note": "x"}, "has no load yet: start one"),
        ("ticket", {"kg": 100.0, "load": "A"}, "no load 'A'; the last ones are none"),
    ],
)
def test_what_cannot_be_done_is_refused_in_words(
    action: str, more: dict[str, object], error: str, tmp_path: Path
) -> None:
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Loads(ledger, story())
        with pytest.raises(InputError, match=error):
            it.order("a", action, **more)  # type: ignore[arg-type]
        assert ledger.loads.last_n == 0


def test_tickets_keep_what_was_there(tmp_path: Path) -> None:
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Loads(ledger, story())
        it.order("a", "start", x_m=-0.4, fields={"name": "A"})
        it.order("t1", "ticket", kg=8123.0, load="A", now_ns=1)
        it.order("t2", "ticket", kg=8132.0, scale_error_kg=20.0, note="misread", now_ns=2)
        it.order("t3", "ticket", kg=8300.0, net=False, now_ns=3)
        load = ledger.loads.loads[1]
        net, gross = load.ticket(net=True), load.ticket(net=False)
        assert net is not None
        assert gross is not None
        assert (net.ticket_g, net.sd_g, gross.ticket_g) == (8132e3, 20e3, 8300e3)
        assert [(t.ticket_g, t.said_ns, t.said_by) for t in load.tickets if t.net] == [
            (8123e3, 1, "me"),
            (8132e3, 2, "me"),
        ]
        assert "withdrawn" in it.order("t4", "ticket", net=False).text
        assert ledger.loads.loads[1].ticket(net=False) is None
        with pytest.raises(InputError, match="no gross ticket to withdraw"):
            it.order("t5", "ticket", net=False)
        with pytest.raises(InputError, match="up to 200000 kg"):
            it.order("t6", "ticket", kg=1e6)


def test_a_number_that_is_also_a_name_is_refused(tmp_path: Path) -> None:
    """A ticket for the load named 3 went to load 3 without a word."""
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Loads(ledger, story())
        for n, name in enumerate(["3", "2", "A", "last", "5"]):
            it.order(f"s{n}", "start", x_m=-0.1 * (n + 1), fields={"name": name})
        for wanted, said in [
            ("3", r"'3' is the number of load 3 \(A\) and the name of load 1 \(3\): give number:3 or number:1"),
            ("last", r"'last' is the newest load, load 5 \(5\), and the name of load 4 \(last\): give number:5 or"),
            ("number:9", "no load 'number:9'; the last ones are"),
        ]:
            with pytest.raises(InputError, match=said):
                it.order("t", "ticket", load=wanted, kg=1.0)
        for n, (wanted, number) in enumerate(
            [("2", 2), ("number:3", 3), ("number:1", 1), ("A", 3), ("4", 4), ("5", 5), ("", 5)]
        ):
            assert it.order(f"u{n}", "ticket", load=wanted, kg=1.0).load == number
        it.order("s", "start", x_m=-0.7, fields={"name": "number:3"})
        assert it.order("v", "ticket", load="number:3", kg=1.0).load == 3, "such a name has its own number"
    shown = {
        wanted: [load["number"] for load in asked_of(LineAddress(), tmp_path / "ledger.db", wanted=wanted, limit=9)]
        for wanted in ("3", "number:1", "A", "5")
    }
    assert shown == {"3": [3, 1], "number:1": [1], "A": [3], "5": [5]}, "all that it may mean are shown"


def test_a_load_that_ended_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "ledger.db"
    with Ledger(path) as ledger:
        it = Loads(ledger, story())
        for n in it.commits():
            if n == 2:
                it.order("a", "start", x_m=-0.4, fields={"name": "A"})
            if n == 4:
                it.order("b", "end", x_m=-0.8)
            if n == 6:
                it.order("c", "start", load="A", x_m=-1.2)
                with pytest.raises(InputError, match=r"load 1 \(A\) is open already"):
                    it.order("d", "start", load="1", x_m=-1.3)
    assert sums_by_load(path)[1][0] == sum(t.x_m < -1.2 or -0.8 <= t.x_m < -0.4 for t in story().seen())
    assert check_file(path) == []


@pytest.mark.parametrize("restart", [False, True])
def test_late_tubers_of_a_slow_camera_come_to_the_load_of_their_place(restart: bool, tmp_path: Path) -> None:
    """One camera falls silent; loads change while it is away, and what it saw meanwhile is told afterwards."""
    path = tmp_path / "ledger.db"
    told = tell(8, n=30, cameras=2, length_m=2.0, noise_mm=0.0)
    with Ledger(path) as ledger:
        it = Loads(ledger, told)
        it.order("a", "start", x_m=-0.3, fields={"name": "A"})
        for n in range(1, 5):
            it.receive("cam0", n)
        for n in range(1, len(told.logs["cam1"]) + 1):
            it.receive("cam1", n)
        it.commit()
        it.now_s += STALL_S + 0.1
        it.order("b", "start", x_m=-1.0, fields={"name": "B"})
        it.commit()
        before = {n: sums.load.count for n, sums in ledger.span_sums("story").items()}
        if restart:
            it.start()
        it.deliver_the_rest()
        assert it.core.finished
        after = {n: sums.load.count for n, sums in ledger.span_sums("story").items()}
    late = sum("late" in tuber.flags for tuber in tubers_of(path))
    assert sum(after.values()) - sum(before.values()) == late > 3
    assert sums_by_load(path)[1][0] == sum(-1.0 <= t.x_m < -0.3 for t in told.seen())
    assert check_file(path) == []


def tubers_of(path: Path) -> list[Tuber]:
    with reading(path) as view:
        return list(read_tubers(view, the_run(view, path, None).run))


def test_what_loads_come_to_is_read_without_their_tubers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It costs the same at a million tubers: nothing but events and sums is read."""
    path = tmp_path / "ledger.db"
    with Ledger(path) as ledger:
        told_with_loads(ledger)
    read: set[str] = set()
    scan = LedgerView.scan

    def watched(self: LedgerView, table: Table, *more: Any, **named: Any) -> Any:
        read.add(table.name)
        return scan(self, table, *more, **named)

    monkeypatch.setattr(LedgerView, "scan", watched)
    with reading(path) as view:
        assert [load["name"] for load in told_loads(view, limit=5)] == ["B", "A"]
    assert len(totals_by([path], "field")[0]) == 2
    assert read == {"load_event", "load_total", "run", "summary", "total"}


def test_killed_at_every_write_point_of_an_order(tmp_path: Path) -> None:
    """It is in the ledger, whole, or it is not; asked again under its id it is there once."""
    base = tmp_path / "base"
    base.mkdir()
    with Ledger(base / "ledger.db") as ledger:
        it = Loads(ledger, story())
        for n in it.commits():
            if n == 5:
                it.order("a", "start", x_m=-0.4, fields={"name": "A"})
                break
    statuses, at = [signal.SIGKILL.value], 0
    while statuses[-1]:
        folder = tmp_path / f"at{at}"
        shutil.copytree(base, folder)
        statuses.append(_killed(folder / "ledger.db", at, lambda it: it.order("b", "start", x_m=-0.9)))
        assert check_file(folder / "ledger.db") == []
        with Ledger(folder / "ledger.db") as ledger:
            it = Loads(ledger, story())
            it.order("b", "start", x_m=-0.9)
            assert sorted(ledger.loads.loads) == [1, 2]
            it.acknowledged = it.core.applied()
            it.deliver_the_rest()
        assert sums_by_load(folder / "ledger.db")[2][0] == sum(tuber.x_m < -0.9 for tuber in story().seen())
        assert check_file(folder / "ledger.db") == []
        at += 1
    assert at > 8


def _killed(path: Path, at: int, act: Callable[[Loads], object]) -> int:
    child = os.fork()
    if child == 0:
        left = [at]

        def step(_name: str) -> None:
            if left[0] == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            left[0] -= 1

        ledger = Ledger(path)
        ledger.__enter__()
        it = Loads(ledger, story())
        ledger._step = step
        ledger._loads._step = step
        act(it)
        os._exit(0)
    return os.waitpid(child, 0)[1]


@pytest.mark.parametrize(
    ("table", "change", "said"),
    [
        ("load_event", "place_x_m = -0.5", "row of load_event with a wrong checksum"),
        ("load_total", "payload = replace(payload, '\"count\":', '\"count\":1')", "row of load_total with a wrong"),
    ],
)
def test_a_changed_row_of_loads_is_found_and_repaired(table: str, change: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "ledger.db"
    with Ledger(path) as ledger:
        told_with_loads(ledger)
    before = sums_by_load(path)
    db = sqlite3.connect(path, isolation_level=None)
    db.execute(f"DROP TRIGGER {table}_update")
    db.execute(f"UPDATE {table} SET {change} WHERE rowid = 2")
    db.close()
    assert any(said in fault for fault in check_file(path))
    report = repair(path)
    assert check_file(path) == []
    if table == "load_total":
        assert sums_by_load(path) == {load: (n, pytest.approx(g)) for load, (n, g) in before.items()}
    else:
        assert any("event 2 of loads" in text for text in report.lost)
        assert sum(n for n, _ in sums_by_load(path).values()) == sum(n for n, _ in before.values())


def test_a_changed_width_of_classes_counts_loads_again(tmp_path: Path) -> None:
    path = tmp_path / "ledger.db"
    with Ledger(path) as ledger:
        it = told_with_loads(ledger)
    with Ledger(path) as ledger:
        ledger.open_run(
            it.story.run, line="t", cameras=it.story.names, version="1", started_ns=0, may_be_finished=True,
            histogram_step_g=25.0,
        )  # fmt: skip
        assert {sums.load.histogram_step_g for sums in ledger.span_sums(it.story.run).values()} == {25.0}
        assert sum(sum(s.load.classes) for s in ledger.span_sums(it.story.run).values()) == len(it.story.seen())


def of_width(it: Loads, step_g: float, ledger: Ledger | None = None) -> None:
    """Go on with the run of `it`, in classes of another width."""
    (ledger or it.ledger).open_run(
        it.story.run, line="t", cameras=it.story.names, version="1", started_ns=0, histogram_step_g=step_g
    )


def test_a_changed_width_of_classes_leaves_a_sound_ledger_at_every_moment(tmp_path: Path) -> None:
    """The run's sums went with the next transaction, those of its stretches only with the next tuber: a ticket, and
    the aggregator's end, left a ledger that no check believed any more."""
    path = tmp_path / "ledger.db"
    with Ledger(path) as ledger:
        it = Loads(ledger, story())
        for n in it.commits():
            if n == 2:
                it.order("a", "start", x_m=-0.4, fields={"name": "A"})
            if n == 8:
                break
    before = sums_by_load(path)
    with reading(path) as view:
        old = read_span_sums(view, it.story.run)
    with Ledger(path) as ledger:
        of_width(it, 25.0, ledger)
        assert check_file(path) == []
        assert {sums.load.histogram_step_g for sums in ledger.span_sums(it.story.run).values()} == {25.0}
        event = decide(
            LoadOrder("t", "ticket", kg=100.0),
            ledger.loads,
            run=it.story.run,
            now_ns=0,
            line={},
            place_x_m=it.place_x_m,
        )
        ledger.say(event)
        assert check_file(path) == []
    assert sums_by_load(path) == {load: (n, pytest.approx(grams)) for load, (n, grams) in before.items()}
    with Ledger(path) as ledger:
        for n, sums in old.items():
            span_step(ledger._db, it.story.run, n, sums)  # as an older version left it
        assert any("do not come to what its sums say" in fault for fault in check_file(path))
    with Ledger(path) as ledger:
        of_width(it, 25.0, ledger)
        assert check_file(path) == []
        ledger.finish(it.story.run, "{}")
    assert check_file(path) == []


def test_killed_at_every_write_point_of_a_changed_width(tmp_path: Path) -> None:
    """The sums of the run and of its stretches are all of one width, or all of the other."""
    base = tmp_path / "base"
    base.mkdir()
    with Ledger(base / "ledger.db") as ledger:
        told_with_loads(ledger)
    statuses, at = [signal.SIGKILL.value], 0
    while statuses[-1]:
        folder = tmp_path / f"at{at}"
        shutil.copytree(base, folder)
        statuses.append(_killed(folder / "ledger.db", at, lambda it: of_width(it, 25.0)))
        assert check_file(folder / "ledger.db") == []
        with reading(folder / "ledger.db") as view:
            widths = {read_sums(view, "story").load.histogram_step_g}
            widths |= {sums.load.histogram_step_g for sums in read_span_sums(view, "story").values()}
        assert len(widths) == 1
        at += 1
    assert at > 3


def test_a_ledger_of_version_2_takes_loads(tmp_path: Path) -> None:
    """Written by e1dbf15: story 11 after its ninth entries."""
    data = Path(__file__).parent / "data" / "v2_unfinished"
    for name in ("ledger.db", "ledger.ack"):
        shutil.copy(data / name, tmp_path / name)
    path = tmp_path / "ledger.db"
    with reading(path) as view:
        assert view.version == 2
        assert read_book(view).loads == {}
        lines = list(canonical_lines(view, the_run(view, path, None)))
    assert lines == (data / "canonical.jsonl").read_text().splitlines()
    with Ledger(path) as ledger:
        it = Loads(ledger, tell(11, n=12, cameras=2))
        it.order("a", "start", x_m=-0.7, fields={"name": "A"})
        it.acknowledged = it.core.applied()
        it.deliver_the_rest()
        assert it.core.finished
    assert check_file(path) == []
    assert set(sums_by_load(path)) == {NO_LOAD, 1}
