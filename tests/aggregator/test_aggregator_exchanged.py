"""A camera that is exchanged, between two runs or within one, is told until something was calibrated with it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from aggregator.calibration.tickets import Ticket
from aggregator.core.device import MOST_DEVICES, Device
from aggregator.core.loads import Load
from aggregator.core.sight import CameraSight
from aggregator.ledger.exchanged import cameras_exchanged
from aggregator.ledger.reader import RunRow, read_sums, reading
from aggregator.ledger.stated import summary_told
from aggregator.ledger.writer import Ledger
from aggregator.report import Reporter
from conveyor.config import LineConfig
from conveyor.counters import CounterSet
from conveyor.exchanged import exchanged_in_words
from conveyor.geometry import Intrinsics
from conveyor.messages import CameraExchanged, CameraInfo
from tests.aggregator.belt_story import tell
from tests.aggregator.virtual_line import Aggregator

FORMER, NOW = (f"848x480, fx {fx}, fy 430, cx 423.5, cy 239.5 px, unit 0.1 mm" for fx in (430, 431.25))


def info(fx: float, *, at_s: int, serial: str | None = None, camera: str = "cam0") -> CameraInfo:
    """A camera that has sent its first frames."""
    lens = Intrinsics(848, 480, fx, 430.0, 423.5, 239.5)
    return CameraInfo(
        camera, "any", "streaming", "RealSense", 30.0, False, lens, 0.0001, 0, 9, 10, {}, live=True, serial=serial,
        first_captured_ns=at_s * 10**9, last_captured_ns=(at_s + 1) * 10**9,
    )  # fmt: skip


def sight(*infos: CameraInfo) -> CameraSight:
    made = CameraSight()
    for each in infos:
        made.published.take(each)
    return CameraSight.from_plain(json.loads(json.dumps(made.plain())))


def devices(*infos: CameraInfo) -> list[Device]:
    return sight(*infos).published.devices


def test_another_device_is_told_in_its_run_and_after_a_restart_and_not_in_the_next(tmp_path: Path) -> None:
    """Tickets and places of the camera that hung there before went on being trusted without a word."""
    told: dict[str, tuple[CameraExchanged, ...]] = {}
    with Ledger(tmp_path / "ledger.db") as ledger:
        for n, lenses in enumerate(((430.0,), (430.0,), (431.25,), (431.25, 430.0), (430.0,)), start=1):
            story = tell(5, cameras=2, n=12, length_m=2.0).in_run(f"r{n}")
            it = Aggregator(ledger, story)
            for at, fx in enumerate(lenses):
                it.core.cameras.info(info(fx, at_s=100 * n + 10 * at), 0.0)
            it.commit_one_by_one()
            it.start()  # from the ledger alone
            reporter = Reporter(ledger, it.core, config=LineConfig(), counters=CounterSet())
            told[story.run] = reporter.totals(1.0).exchanged
            reporter.write(tmp_path, 1.0)
            if story.run == "r3":
                with reading(tmp_path / "ledger.db") as view:
                    summary = summary_told(view, "r3", read_sums(view, "r3"))
                assert exchanged_in_words(told["r3"]) in reporter.headline(1.0)
    third, fourth = CameraExchanged("cam0", FORMER, NOW, 300 * 10**9), CameraExchanged("cam0", NOW, FORMER, 410 * 10**9)
    assert told == {"r1": (), "r2": (), "r3": (third,), "r4": (fourth,), "r5": ()}
    assert summary["totals"]["exchanged"] == [
        {"camera": "cam0", "before": FORMER, "now": NOW, "since_ns": 300_000_000_000}
    ]
    assert exchanged_in_words((third,)).startswith(
        f"camera cam0 was exchanged or is set otherwise: it was {FORMER}, it is {NOW}. "
    )


def ticket(run: str, part: str = "", *, kind: str = "load") -> Ticket:
    return Ticket(run, "m@1", 1e6, 1e3, 1e6, 1e3, 1.0, kind=kind, part=part)


LOADS = {n: Load(n, "tuesday", at_s * 10**9, "") for n, at_s in ((1, 150), (2, 250))}
RUNS = [RunRow(run, "line", ("a",), "", "1", at_s * 10**9, False) for run, at_s in (("monday", 90), ("wednesday", 290))]


@pytest.mark.parametrize(
    ("tickets", "told"),
    [
        ((), False),
        ((ticket("tuesday", "load 1"),), True),
        ((ticket("tuesday", "load 1"), ticket("tuesday", "load 2")), False),
        ((ticket("monday", kind="bucket"),), True),
        ((ticket("monday", kind="bucket"), ticket("wednesday", kind="bucket")), False),
        ((ticket("elsewhere", kind="bucket"),), True),
        ((replace(ticket("monday", kind="bucket"), set_aside="another camera"),), False),
    ],
)
def test_in_later_runs_it_is_told_as_long_as_tickets_from_before_calibrate(
    tickets: tuple[Ticket, ...], told: bool
) -> None:
    before = {"a": devices(info(430.0, at_s=100), info(431.25, at_s=200))}
    sights = {"a": sight(info(431.25, at_s=300)), "new": sight(info(430.0, at_s=300))}
    found = cameras_exchanged(sights, before, lambda: tickets, loads=LOADS, runs=lambda: RUNS)
    assert [(each.camera, each.since_ns) for each in found] == [("a", 200 * 10**9)] * told


def test_a_serial_number_tells_devices_apart_where_both_have_one() -> None:
    same = devices(info(430.0, at_s=1), info(430.0, at_s=2, serial="77"), info(430.0, at_s=3, serial="78"))
    assert [(each.since_ns, each.serial) for each in same] == [(10**9, "77"), (3 * 10**9, "78")]
    assert same[1].told == f"serial 78, {FORMER}"
    often = devices(*(info(430.0 + n, at_s=n) for n in range(30)))
    assert len(often) == MOST_DEVICES
    assert (often[0].since_ns, often[-1].since_ns) == (0, 29 * 10**9)
