"""What went wrong on a day, one sentence each: belt not seen, tickets, cameras, weights, alarms."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from aggregator.core.reasons import unseen_in_words
from aggregator.ledger.ends import less_than_all
from conveyor.apart import apart_in_words
from conveyor.exchanged import exchanged_in_words
from conveyor.heights import heights_in_words
from conveyor.messages import CameraExchanged, CamerasApart, HeightChange
from tuberline.alarms import outbox
from tuberline.alarms.message import AlarmMessage
from tuberline.export.report.gather import DayFacts, LoadFacts, RunFacts

WORTH_TELLING = 0.005
"""Of a load's belt: less that was not seen is not told load by load."""
FEW = 0.02
"""Of tubers, frames or weight: a smaller share is not told."""


def what_went_wrong(facts: DayFacts) -> list[str]:
    """In the order of what matters to totals; empty where the ledgers know of nothing."""
    found = [*_unseen(facts), *_tickets(facts), *_weighing(facts)]
    for run in facts.runs:
        found += _of_run(run)
    for ledger, stated in {run.path: run.alarms for run in facts.runs}.items():
        found += _alarms(ledger, stated)
    return found


def _unseen(facts: DayFacts) -> Iterator[str]:
    for load in facts.loads:
        if load.coverage is None and load.tubers:
            yield (
                f"Load {load.label}: how much of its belt was seen is not known, for no two frames share any. Its "
                "weight is that of what was seen, and at most what the interval says."
            )
        elif not load.coverage:
            yield f"Load {load.label}: no belt was seen."
        elif load.coverage < 1 - WORTH_TELLING:
            where = unseen_in_words(load.unseen_m, decimals=1, least_m=0.05)
            metres = f" ({where}, mean of the cameras)" if where else ""
            yield (
                f"Load {load.label}: {100 * (1 - load.coverage):.0f} % of its belt was not seen{metres}. Its weight "
                "makes up for that."
            )


def _tickets(facts: DayFacts) -> Iterator[str]:
    for refused in facts.refused:
        yield f"A ticket does not calibrate: {refused}{'' if refused.endswith('?') else '.'}"
    for words in facts.doubts:
        yield f"{words[:1].upper()}{words[1:]}."
    for load in facts.loads:
        if load.ticket_kg is not None and load.saw and not load.low_kg <= load.ticket_kg <= load.high_kg:
            yield _outside(load, load.ticket_kg)
    if not facts.total.weighed:
        yield "No load was on a scale: no ticket says how right these weights are."


def _outside(load: LoadFacts, ticket_kg: float) -> str:
    return (
        f"Load {load.label}: its ticket says {ticket_kg:.1f} kg, outside of the interval "
        f"{load.low_kg:.1f} to {load.high_kg:.1f} kg."
    )


def _weighing(facts: DayFacts) -> Iterator[str]:
    doubt = facts.camera_doubt
    unlike, ungauged = 100 * doubt.unlike_share, 100 * doubt.ungauged_share
    if doubt.unlike_share > FEW:
        yield f"{unlike:.0f} % of the weight was seen by a camera unlike those the network was trained for."
    if doubt.off_mm > 1:
        yield f"The belt was seen {doubt.off_mm:.0f} mm off its calibration, in the mean."
    if doubt.ungauged_share > FEW:
        yield f"{ungauged:.0f} % of the weight was seen by a camera that did not find its gauge, the rods."
    if facts.late:
        yield f"{facts.late} tubers came late to the ledger: they are counted, and some may be counted twice."


def _of_run(run: RunFacts) -> Iterator[str]:
    summary = run.summary
    if run.end == "goes on":
        yield f"Run {run.run} goes on: this is what is committed so far."
    if less := less_than_all(run.run, run.end, lacks=run.lacks):
        yield less
    if not summary:
        return
    for text in summary.get("differences", []):
        yield f"The balance sheet of run {run.run} does not hold: {text}. `tuberline audit` says more."
    if said := apart_in_words(CamerasApart(**apart) for apart in summary.get("totals", {}).get("apart", ())):
        yield f"Run {run.run}: {said}."
    if said := exchanged_in_words(CameraExchanged(**each) for each in summary.get("totals", {}).get("exchanged", ())):
        yield f"Run {run.run}: {said}."
    if summary.get("layers"):
        yield f"Run {run.run}: {summary['layers']}."
    for load in (load for load in summary.get("loads", []) if load["number"] in run.loads):
        if said := heights_in_words(HeightChange(**change) for change in load.get("heights", ())):
            yield f"Load {load['name'] or load['number']}: {said}."
    methods, tubers = summary.get("methods", {}), summary.get("totals", {}).get("count") or 0
    if tubers and methods.get("volume", 0) > FEW * tubers:
        yield f"{methods['volume']} of {tubers} tubers of run {run.run} were weighed by their volume alone."
    for camera, sheet in summary.get("cameras", {}).items():
        yield from _of_camera(run.run, camera, sheet)
    for node, version in summary.get("other_versions", {}).items():
        yield f"{node} ran version {version}, the aggregator {summary.get('software', '')}."


def _of_camera(run: str, camera: str, sheet: dict[str, Any]) -> Iterator[str]:
    frames, views = sheet.get("frames", {}), sheet.get("views", {})
    published = max(frames.get("published", 0), 1)
    lost = {"lost on the way": frames.get("gaps", 0)}
    lost |= {_words(name, "dropped_"): n for name, n in frames.items() if name.startswith("dropped_")}
    told = ", ".join(f"{n} {why}" for why, n in lost.items() if n > FEW * published)
    if told:
        yield f"Camera {camera} of run {run}: of {published} frames {told}."
    gone = {_words(name, "lost_"): n for name, n in views.items() if name.startswith("lost_")}
    told = ", ".join(
        f"{n} {why}" for why, n in gone.items() if n > FEW * max(views.get("sent", 0), 1) and why != "not chosen"
    )
    if told:
        yield f"Camera {camera} of run {run}: of {views.get('sent', 0)} views {told}."


def _words(name: str, prefix: str) -> str:
    return name.removeprefix(prefix).replace("_", " ")


def _alarms(ledger: Path, stated: Path | None) -> Iterator[str]:
    """Alarms that had begun and not ended when the report was made; the file may be another program's, or none. Where
    the config does not say where they are, they lie beside the ledger, which may have been moved since.
    """
    file = (stated or ledger.parent / outbox.FOLDER) / outbox.FILE
    if not file.is_file():
        return
    try:
        begun = [AlarmMessage.decode(text) for text in _begun(file)]
    except (sqlite3.Error, ValueError, TypeError) as error:
        yield f"The alarms beside {ledger} cannot be read: {error}."
        return
    for alarm in begun:
        since = datetime.fromtimestamp(alarm.since_unix_s, UTC).strftime("%Y-%m-%d %H:%M")
        yield f"Alarm since {since} UTC: {alarm.text}"


def _begun(file: Path) -> list[str]:
    """The process that sends alarms holds the file's lock for as long as it runs: then it is read past that."""
    asked = "SELECT begun FROM active ORDER BY begun_unix_s"
    uri = f"{file.resolve().as_uri()}?mode=ro"
    try:
        with closing(sqlite3.connect(uri, uri=True, timeout=0)) as db:
            return [text for (text,) in db.execute(asked)]
    except sqlite3.OperationalError:
        with closing(sqlite3.connect(f"{uri}&immutable=1", uri=True)) as db:
            return [text for (text,) in db.execute(asked)]
