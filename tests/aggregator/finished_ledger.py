"""A ledger at rest in which every table has rows, and flips of its bits."""

from __future__ import annotations

import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path

from aggregator.ledger.schema import TABLES
from aggregator.ledger.writer import Ledger
from conveyor.messages import TrackEntry
from conveyor.messages.sizes import Sizes
from tests.aggregator.belt_story import Story, tell
from tests.aggregator.loaded_story import Loads
from tests.aggregator.test_aggregator_foreign import with_others


def write_finished(path: Path) -> None:
    """A run with loads, sizes and foreign bodies that ended, in the ledger at `path`."""
    with Ledger(path) as ledger:
        it = Loads(ledger, with_sizes(with_others(tell(11, n=14, cameras=2), {2, 7})))
        for n in it.commits():
            if n == 2:
                it.order("a", "start", x_m=-0.3, fields={"name": "A", "variety": "Agria"})
            if n == 4:
                it.order("b", "end", x_m=-0.8)
        it.order("c", "ticket", load="1", kg=1.5)
        assert it.core.finished
        ledger.finish(it.story.run, '{"totals": {"count": 12, "weight_g": 1.0, "low_g": 1.0, "high_g": 1.0, '
                      '"coverage": 1.0, "final": true}}')  # fmt: skip
    db = sqlite3.connect(path)
    for table in TABLES:
        for name in table.names:
            assert db.execute(f"SELECT 1 FROM {table.name} WHERE {name} IS NOT NULL").fetchone(), (table.name, name)
    db.close()


def with_sizes(story: Story) -> Story:
    """Every view says sizes, every track what the classifier believed."""
    sizes = Sizes(70.0, 55.0, 45.0, 50.0, 2.0, 2.0, 3.0, 2.0)

    def sized(entry: TrackEntry) -> TrackEntry:
        if entry.track is None:
            return entry
        views = tuple(replace(view, sizes=sizes) for view in entry.track.views)
        log_odds = 4.0 if entry.track.log_odds is None else entry.track.log_odds
        return replace(entry, track=replace(entry.track, views=views, log_odds=log_odds))

    return replace(story, logs={camera: [sized(entry) for entry in log] for camera, log in story.logs.items()})


def copied(finished: Path, folder: Path) -> Path:
    folder.mkdir(parents=True)
    for name in ("ledger.db", "ledger.ack"):
        shutil.copy(finished.with_name(name), folder / name)
    return folder / "ledger.db"


def flip(path: Path, at: int, bit: int) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= 1 << bit
    path.write_bytes(data)
