"""Ledgers into a real PostgreSQL that is killed and cut in the middle: nothing lost, nothing double."""

from __future__ import annotations

import json
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from aggregator.ledger.at_rest import order_at_rest
from aggregator.ledger.reader import read_tubers, reading
from aggregator.ledger.writer import Ledger
from conveyor.errors import InputError, LedgerError, LinkError, TakenError
from conveyor.messages import LoadOrder
from tests.aggregator.loaded_story import told_with_loads
from tests.sync.postgres import Postgres
from tests.written_run import write_run
from tuberline.sync import push as push_module
from tuberline.sync.push import connect, push

psycopg = pytest.importorskip("psycopg")

SEED, TUBERS = 7401, 900
START_NS = 1_789_400_000_000_000_000


@pytest.fixture(scope="module")
def ledger(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run."""
    sys.stdout.write(f"seed {SEED}\n")
    rng = np.random.default_rng(SEED)
    folder = tmp_path_factory.mktemp("runs") / "monday"
    crossed_ns = START_NS + np.sort(rng.integers(0, 10**11, TUBERS))
    write_run(folder, run="monday", crossed_ns=crossed_ns, weight_g=rng.normal(120, 30, TUBERS).clip(20))
    return folder


def tubers_there(server: Postgres) -> list[tuple[int, float]]:
    with psycopg.connect(server.url) as connection:
        return connection.execute("SELECT tuber, weight_g FROM tuberline.tuber ORDER BY run_id, tuber").fetchall()


def tubers_of(ledger: Path) -> list[tuple[int, float]]:
    with reading(ledger / "ledger.db") as view:
        return [(tuber.tuber_id, tuber.weight_g) for tuber in read_tubers(view, "monday")]


def test_a_sync_brings_all_and_a_second_one_nothing(empty: Postgres, ledger: Path) -> None:
    for new in (TUBERS, 0):
        done = subprocess.run(
            [sys.executable, "-m", "tuberline", "sync", empty.url, ledger], capture_output=True, text=True, check=True
        )
        assert f"{new} new tubers of 1 runs, 1 loads" in done.stdout
    assert tubers_there(empty) == tubers_of(ledger)
    with psycopg.connect(empty.url) as connection:
        (total,) = connection.execute("SELECT loads, tubers, weight_kg, low_kg, high_kg FROM tuberline.totals_by_line")
        (told,) = connection.execute("SELECT summary->'totals'->>'estimated_weight_g' FROM tuberline.run").fetchone()
    assert total[:2] == (1, TUBERS)
    assert total[2] == pytest.approx(float(told) / 1000)
    assert total[3] < total[2] < total[4]


@pytest.mark.parametrize("by", ["variety", "field"])
def test_a_name_is_one_however_it_is_typed(by: str, empty: Postgres, ledger: Path) -> None:
    with connect(empty.url) as connection:
        push(connection, ledger)
    typed = (("Agria", 1), ("  agria ", 2), ("AGRIA", 4), ("Agria  Gold", 8), ("agria gold", 16))
    with psycopg.connect(empty.url, autocommit=True) as connection:
        for place, (name, tubers) in enumerate(typed, start=100):
            named = ", ".join("%s::text" if column == by else column for column in ("field", "variety"))
            connection.execute(
                f"INSERT INTO tuberline.load SELECT line, ledger, %s, load, {named}, day, %s, raw_kg, weight_kg,"
                " low_kg, high_kg, coverage, ticket_kg FROM tuberline.load WHERE place < 100 ORDER BY place LIMIT 1",
                (place, name, tubers),
            )
        found = connection.execute(
            f"SELECT {by}, loads, tubers FROM tuberline.totals_by_{by} WHERE {by} ILIKE 'agria%' ORDER BY {by}"
        ).fetchall()
    assert found == [("Agria", 3, 7), ("Agria  Gold", 2, 24)]


def test_the_server_is_killed_in_the_middle(empty: Postgres, ledger: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Killed while the third batch is copied: what was committed stays, the next sync goes on after it."""
    monkeypatch.setattr(push_module, "BATCH", 100)
    seen = 0
    plain = push_module._row

    def killing(run_id: int, tuber: object) -> object:
        nonlocal seen
        seen += 1
        if seen == 250:
            empty.kill()
        return plain(run_id, tuber)  # type: ignore[arg-type]

    monkeypatch.setattr(push_module, "_row", killing)
    with pytest.raises(LinkError, match="went away"), connect(empty.url) as connection:
        push(connection, ledger)
    with pytest.raises(LinkError, match="cannot be reached"):
        connect(empty.url)
    empty.start()
    assert len(tubers_there(empty)) == 200
    monkeypatch.undo()
    with connect(empty.url) as connection:
        assert push(connection, ledger).tubers == TUBERS - 200
    assert tubers_there(empty) == tubers_of(ledger)


def test_the_link_is_cut_again_and_again(empty: Postgres, ledger: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Through a relay that hangs up after so many bytes, more each time, until all is there."""
    monkeypatch.setattr(push_module, "BATCH", 50)
    cuts = 0
    for most in range(4_000, 400_000, 24_000):
        with Relay(empty.port, most=most) as relay:
            url = empty.url.replace(str(empty.port), str(relay.port))
            try:
                with connect(url) as connection:
                    push(connection, ledger)
            except LinkError:
                cuts += 1
            else:
                break
    assert cuts >= 3
    assert tubers_there(empty) == tubers_of(ledger)


def test_two_syncs_of_one_ledger_bring_it_one_after_the_other(
    empty: Postgres, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sync by hand while the one of the line was at it failed by a duplicate key; or it brought the loads without a
    ticket that had been entered, and synced, meanwhile.
    """
    path, failed = tmp_path / "ledger.db", list[Exception]()
    with Ledger(path) as written:
        told_with_loads(written)
    plain, other = push_module._row, list[threading.Thread]()

    def second() -> None:
        try:
            with connect(empty.url) as connection:
                assert push(connection, path).tubers == 0
        except Exception as error:
            failed.append(error)

    def slow(run_id: int, tuber: object) -> object:
        if not other:
            assert order_at_rest(path, LoadOrder("t", "ticket", by="me", load="A", kg=1.0)).done
            other.append(threading.Thread(target=second))
            other[0].start()
            assert waits_or_ends(empty, other[0])
        return plain(run_id, tuber)  # type: ignore[arg-type]

    monkeypatch.setattr(push_module, "_row", slow)
    with connect(empty.url) as connection:
        push(connection, path)
    other[0].join(60)
    assert failed == []
    with psycopg.connect(empty.url) as connection:
        tickets = connection.execute("SELECT ticket_kg FROM tuberline.load ORDER BY place").fetchall()
    assert tickets == [(1.0,), (None,), (None,)]


def waits_or_ends(server: Postgres, sync: threading.Thread) -> bool:
    """Whether the server tells of one who waits for a lock, or `sync` is over."""
    deadline_s = time.monotonic() + 30
    with psycopg.connect(server.url, autocommit=True) as connection:
        while time.monotonic() < deadline_s:
            waiting = "SELECT count(*) FROM pg_stat_activity WHERE wait_event_type = 'Lock'"
            if not sync.is_alive() or connection.execute(waiting).fetchone() != (0,):
                return True
            time.sleep(0.02)
    return False


def test_a_sync_that_does_not_end_is_told(empty: Postgres, ledger: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(push_module._SERVER, "lock_timeout", "200ms")
    with (
        connect(empty.url) as first,
        connect(empty.url) as second,
        push_module._alone(first, ledger / "ledger.db"),
        pytest.raises(TakenError, match="is being synced by another process"),
    ):
        push(second, ledger)
    assert tubers_there(empty) == []
    with connect(empty.url) as third:
        assert push(third, ledger).tubers == TUBERS


def test_a_run_that_began_before_the_others_counts_no_load_twice(empty: Postgres, tmp_path: Path) -> None:
    """The loads went under the run that began first: a clock set back made that another one, and all counted twice."""

    def loads_there() -> list[tuple[str, int]]:
        with connect(empty.url) as connection:
            push(connection, tmp_path)
            return connection.execute("SELECT load, tubers FROM tuberline.load ORDER BY place").fetchall()

    for run, start_ns in (("tuesday", START_NS), ("wednesday", START_NS + 10**12)):
        write_run(tmp_path, run=run, crossed_ns=start_ns + np.arange(5) * 10**9, weight_g=np.full(5, 100.0))
    expected = [("tuesday", 5), ("wednesday", 5)]
    assert loads_there() == expected
    write_run(tmp_path, run="reset", crossed_ns=START_NS // 2 + np.arange(3) * 10**9, weight_g=np.full(3, 100.0))
    for _ in range(2):
        assert loads_there() == [("reset", 3), *expected]


def test_loads_stay_with_the_line_that_they_passed(empty: Postgres, tmp_path: Path) -> None:
    """A line that was named otherwise and kept its folder took all former loads along into its total."""
    for line, run, kg in (("north", "monday", 1), ("barn", "tuesday", 2)):
        write_run(tmp_path, run=run, crossed_ns=np.arange(10 * kg) * 10**9, weight_g=np.full(10 * kg, 100.0), line=line)
    with connect(empty.url) as connection:
        push(connection, tmp_path)
        found = connection.execute("SELECT line, raw_kg FROM tuberline.totals_by_line ORDER BY raw_kg").fetchall()
    assert found == [("north", pytest.approx(1.0)), ("barn", pytest.approx(2.0))]


def test_another_ledger_of_that_name_is_noticed(empty: Postgres, ledger: Path, tmp_path: Path) -> None:
    with connect(empty.url) as connection:
        push(connection, ledger)
        connection.execute("UPDATE tuberline.tuber SET crc = crc + 1 WHERE tuber = %s", (TUBERS,))
        with pytest.raises(InputError, match=f"holds another tuber {TUBERS} of run monday"):
            push(connection, ledger)
        connection.execute("UPDATE tuberline.tuber SET tuber = tuber + 1 WHERE tuber = %s", (TUBERS,))
        connection.execute("UPDATE tuberline.run SET summary = '{}'")
        with pytest.raises(InputError, match=f"lacks tuber {TUBERS + 1} of run monday .* an older copy"):
            push(connection, ledger)
        assert connection.execute("SELECT summary FROM tuberline.run").fetchall() == [({},)], "something was written"
        connection.execute("UPDATE tuberline.version SET version = 2")
    with pytest.raises(InputError, match="tables of version 2"):
        connect(empty.url)
    with pytest.raises(InputError, match=re.escape("takes postgresql://")):
        connect("mysql://x")


def test_a_copy_without_the_last_ticket_is_refused(empty: Postgres, tmp_path: Path) -> None:
    """It held every tuber, so it was taken: the loads in the database lost their ticket."""
    whole, copy = tmp_path / "ledger.db", tmp_path / "copy.db"
    with Ledger(whole) as written:
        told_with_loads(written)
    shutil.copy(whole, copy)
    assert order_at_rest(whole, LoadOrder("t", "ticket", by="me", load="A", kg=1.0)).done
    with connect(empty.url) as connection:
        push(connection, whole)
        with pytest.raises(InputError, match=f"{copy} lacks what was said last of the loads .*sync the one that has"):
            push(connection, copy)
        tickets = connection.execute("SELECT ticket_kg FROM tuberline.load ORDER BY place").fetchall()
        assert tickets == [(1.0,), (None,), (None,)]
        connection.execute("DROP TABLE tuberline.told")  # as a database of an earlier version is
    with connect(empty.url) as connection:
        with pytest.raises(InputError, match=f"{copy} lacks the ticket of 1 kg of load '1 A' in the database"):
            push(connection, copy)
        assert connection.execute("SELECT ticket_kg FROM tuberline.load ORDER BY place").fetchall() == tickets
        assert order_at_rest(whole, LoadOrder("u", "ticket", by="me", load="A", kg=2.0)).done
        push(connection, whole)
        assert connection.execute("SELECT event FROM tuberline.told").fetchall() == [(5,)]


def damaged(ledger: Path, copy: Path) -> Path:
    """A copy of a run's folder, with one bit of its last tuber flipped."""
    shutil.copytree(ledger, copy)
    data = bytearray((copy / "ledger.db").read_bytes())
    data[data.rfind(b"written@0")] ^= 1
    (copy / "ledger.db").write_bytes(data)
    return copy


def test_a_damaged_ledger_brings_nothing_wrong(empty: Postgres, ledger: Path, tmp_path: Path) -> None:
    copy = damaged(ledger, tmp_path / "copy")
    with connect(empty.url) as connection, suppress(LedgerError):
        push(connection, copy)
    assert tubers_there(empty) == tubers_of(ledger)[: len(tubers_there(empty))]


def test_one_damaged_ledger_keeps_no_other_from_the_database(empty: Postgres, ledger: Path, tmp_path: Path) -> None:
    """It ended the sync of all that came after it."""
    bad, away = damaged(ledger, tmp_path / "bad"), tmp_path / "away"
    command = [sys.executable, "-m", "tuberline", "sync", empty.url, bad, away, ledger]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert f"{ledger}: " in done.stdout
    *each, last = done.stderr.splitlines()
    assert [f"ledger {bad / 'ledger.db'}" in each[0], f"there is no ledger at {away}" in each[1]] == [True, True]
    assert f"2 of 3 ledgers were not synced: {bad}, {away}" in last
    assert tubers_there(empty) == tubers_of(ledger)


def test_a_ledger_that_is_put_right_comes_with_the_next_round(empty: Postgres, ledger: Path, tmp_path: Path) -> None:
    """What is wrong with the other is said once, not in every round; before, it ended `--every-s`."""
    bad, later = damaged(ledger, tmp_path / "bad"), tmp_path / "later"
    command = [sys.executable, "-m", "tuberline", "sync", empty.url, bad, later, ledger, "--every-s", "1"]
    made, errors = tmp_path / "made", tmp_path / "errors"
    write_run(made, run="later", crossed_ns=START_NS + np.arange(9) * 10**9, weight_g=np.full(9, 100.0))
    with errors.open("w") as stderr, subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True) as to:
        rounds = (line for line in to.stdout or () if line.startswith(f"{ledger}: "))
        watchdog = threading.Timer(60, to.kill)
        watchdog.start()
        try:
            assert [f"{n} new tubers" in next(rounds) for n in (TUBERS, 0)] == [True, True]
            made.rename(later)
            for _ in range(3):
                next(rounds)
        finally:
            watchdog.cancel()
            to.kill()
    said = errors.read_text().splitlines()
    assert [sum(f"{path}" in line for line in said) for path in (bad / "ledger.db", later)] == [1, 1]
    assert len(tubers_there(empty)) == TUBERS + 9


class Relay:
    """A TCP relay to the server that hangs up after `most` bytes from the client."""

    def __init__(self, port: int, *, most: int) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self._to, self._left = port, most
        threading.Thread(target=self._serve, daemon=True).start()

    def __enter__(self) -> Relay:
        return self

    def __exit__(self, *_: object) -> None:
        self._server.close()

    def _serve(self) -> None:
        with suppress(OSError):
            client, _ = self._server.accept()
            with client, socket.create_connection(("127.0.0.1", self._to)) as behind:
                threading.Thread(target=_pump, args=(behind, client), daemon=True).start()
                while data := client.recv(2048):
                    self._left -= len(data)
                    if self._left < 0:
                        break
                    behind.sendall(data)
                for end in (client, behind):
                    end.shutdown(socket.SHUT_RDWR)


def _pump(source: socket.socket, target: socket.socket) -> None:
    with suppress(OSError):
        while data := source.recv(65536):
            target.sendall(data)


def test_every_query_of_the_dashboard_runs(empty: Postgres, ledger: Path) -> None:
    """With Grafana's macros and variables filled in as it does; the figures are those of the read model."""
    board = json.loads((Path(__file__).parents[2] / "deploy" / "grafana" / "fleet.json").read_text())
    with connect(empty.url) as connection:
        push(connection, ledger)
    found: dict[str, tuple[list[str], list[tuple[object, ...]]]] = {}
    (line,) = (variable for variable in board["templating"]["list"] if variable["name"] == "line")
    with psycopg.connect(empty.url) as connection:
        lines = ", ".join(f"'{name}'" for (name,) in connection.execute(line["query"]))
        for panel in board["panels"]:
            (target,) = panel["targets"]
            sql = target["rawSql"].replace("${line:sqlstring}", lines)
            sql = sql.replace("$__timeFrom()", "'2026-09-01T00:00:00Z'").replace(
                "$__timeTo()", "'2026-09-30T00:00:00Z'"
            )
            cursor = connection.execute(sql)
            found[panel["title"]] = ([column.name for column in cursor.description or ()], cursor.fetchall())
            assert found[panel["title"]][1], panel["title"]
            if target["format"] == "time_series":
                assert found[panel["title"]][0] == ["time", "metric", "value"]
        ((kg,),) = connection.execute("SELECT weight_kg FROM tuberline.totals_by_line").fetchall()
    assert found["Potatoes"][1] == [(kg,)]
    assert found["Loads, tubers"][1] == [(1, TUBERS)]
    assert sum(row[2] for row in found["Tubers a minute"][1]) == TUBERS  # type: ignore[misc]
    assert sum(row[1] for row in found["Weights of tubers"][1]) == TUBERS  # type: ignore[misc]
