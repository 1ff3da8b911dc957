"""Answers the `query/...` topics with JSON, on Zenoh's threads and without touching the core's state."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import zenoh

from aggregator.ledger.load_list import told_loads
from aggregator.ledger.loads import last_loads
from aggregator.ledger.reader import read_sums, read_tubers, reading
from conveyor import topics
from conveyor.errors import InputError, TuberlineError
from conveyor.messages import Totals
from conveyor.messages.base import plain
from conveyor.node import Node
from conveyor.topics import Topic

DEFAULT_LIMIT, MOST = 100, 1000
DEFAULT_LOADS, MOST_LOADS = 10, 50


class Queries:
    """The queryables of an aggregator."""

    def __init__(self, node: Node, ledger: Path, *, run: str, totals: Totals) -> None:
        self._ledger = ledger
        self._run = run
        self._counters = node.counters
        self._log = node.log
        self._lock = threading.Lock()
        self._totals = totals
        self._queryables = [
            self._declare(node, topics.QUERY_TOTALS, self._answer_totals),
            self._declare(node, topics.QUERY_TUBERS, self._answer_tubers),
            self._declare(node, topics.QUERY_LOADS, self._answer_loads),
        ]

    def show(self, totals: Totals) -> None:
        """Answer with these totals from now on."""
        with self._lock:
            self._totals = totals

    def _declare(self, node: Node, topic: Topic, answer: Callable[[zenoh.Query], Any]) -> Any:
        key = topic.key(node.line)

        def handle(query: zenoh.Query) -> None:
            with query:  # an answered query that is not dropped keeps the asker waiting for its whole timeout
                self._counters.add(f"{topic.name}_answered")
                try:
                    query.reply(key, json.dumps(answer(query)))
                except TuberlineError as error:
                    self._log.warning("%s: %s", key, error)
                    query.reply_err(str(error))

        return node.session.declare_queryable(key, zenoh.handlers.Callback(handle, indirect=True))

    def _answer_totals(self, query: zenoh.Query) -> Any:
        with self._lock:
            return plain(self._totals)

    def _answer_tubers(self, query: zenoh.Query) -> Any:
        since = _whole(query, "since", default=0, most=2**62)
        limit = _whole(query, "limit", default=DEFAULT_LIMIT, most=MOST)
        with reading(self._ledger) as view:
            return [plain(tuber) for tuber in read_tubers(view, self._run, since=since, limit=limit)]

    def _answer_loads(self, query: zenoh.Query) -> Any:
        limit = _whole(query, "limit", default=DEFAULT_LOADS, most=MOST_LOADS)
        with reading(self._ledger) as view:
            if query.parameters.get("what") == "models":
                return read_sums(view, self._run).load.models()
            if query.parameters.get("what") != "loads":
                return last_loads(view, limit=limit)
            return told_loads(view, limit=limit, wanted=unquote(query.parameters.get("load") or ""))


def _whole(query: zenoh.Query, name: str, *, default: int, most: int) -> int:
    """A whole number from 0 to `most` among the query's parameters."""
    text = query.parameters.get(name)
    if text is None:
        return default
    if not text.isascii() or not text.isdigit() or len(text) > 19 or int(text) > most:
        raise InputError(f"parameter {name}={text[:20]}: give a whole number from 0 to {most}")
    return int(text)
