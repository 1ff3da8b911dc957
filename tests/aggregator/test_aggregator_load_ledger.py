"""Loads in the ledger: each tuber in exactly one, sums carried along, kill -9 at every write point, damage."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from aggregator.core.load_orders import decide
from aggregator.core.loads import NO_LOAD
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
from conveyor.messages import LoadOrder, Tuber
from tests.aggregator.belt_story import tell
from tests.aggregator.loaded_story import Loads, by_span, story, sums_by_load, told_with_loads
from tests.aggregator.virtual_line import STALL_S, Aggregator


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
