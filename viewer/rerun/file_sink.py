"""The .rrd file: readable at any moment, also after kill -9 but for the last batch; bounded in size."""

from __future__ import annotations

import logging
from datetime import UTC, datetime
from pathlib import Path

from conveyor.counters import CounterSet
from conveyor.files import free_name
from viewer.rerun.sink import RerunSink
from viewer.scene.primitives import Entry
from viewer.sink import IDLE_S


class FileSink(RerunSink):
    """See the module.

    Args:
        limit_bytes: from this size on pictures and clouds are left out, counted; weights and totals go on.
    """

    given_up_after = (OSError, RuntimeError)
    """A full disk, in Rerun's word or ours: a viewer that was started again would find it full too."""

    def __init__(
        self, path: Path, *, limit_bytes: int, run: str, tick_s: float, counters: CounterSet, log: logging.Logger
    ) -> None:
        super().__init__("file", run=run, tick_s=tick_s, counters=counters, log=log)
        self._first_path = path
        self._path = path
        self._limit_bytes = limit_bytes
        self._full = False
        counters.add("file_dropped_size_limit", 0)

    def _work(self) -> None:
        self._open()
        while not self._stop.is_set():
            self._write(self._outbox.take(IDLE_S))
            self._stop.wait(self._tick_s)
        self._write(self._outbox.take(0.0))
        self._close()

    def _write(self, batch: list[Entry]) -> None:
        if not batch:
            return
        self._under_way = len(batch)
        self._look_at_size()
        left_out = 0
        for entry in batch:
            if self._full and entry.heavy:
                left_out += 1
            else:
                self._draw(entry)
        self._stream.flush()
        self._counters.add("file_dropped_size_limit", left_out)
        self._counters.add("file_sent", len(batch) - left_out)
        self._counters.add("logged", len(batch) - left_out)
        self._under_way = 0

    def _look_at_size(self) -> None:
        size = self._path.stat().st_size
        self._counters.gauge("file_megabytes", size / 1e6)
        if not self._full and size > self._limit_bytes:
            self._full = True
            self._log.warning(
                "%s has reached its limit of %d MB: no more pictures go into it, weights and totals do",
                self._path,
                self._limit_bytes >> 20,
            )

    def _open(self) -> None:
        self._keep_earlier()
        self._new_stream()
        self._stream.save(self._path)
        self._log.info("writing %s", self._path)

    def _keep_earlier(self) -> None:
        """Move a file of an earlier process out of the way: a viewer that crashed and restarted overwrites nothing."""
        if not self._path.is_file() or self._path.stat().st_size == 0:
            return
        written = datetime.fromtimestamp(self._path.stat().st_mtime, UTC).strftime("%Y%m%dT%H%M%SZ")
        kept = free_name(self._path.with_name(f"{self._path.stem}-until-{written}{self._path.suffix}"))
        self._path.rename(kept)
        self._log.warning("%s exists: kept as %s", self._path, kept.name)

    def _close(self) -> None:
        self._stream.flush()
        self._stream.disconnect()  # writes the footer, without which a catalog cannot index the file

    def _switch_run(self, run: str) -> None:
        self._close()
        self._run_id = run
        self._path = self._first_path.with_name(f"{self._first_path.stem}-{run}{self._first_path.suffix}")
        self._full = False
        self._open()
