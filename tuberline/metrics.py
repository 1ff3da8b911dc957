"""A line's counters, gauges and totals as Prometheus metrics, read from the topics when somebody scrapes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from conveyor.errors import ConfigError, LinkError
from conveyor.extras import missing_package
from conveyor.messages import Counters, Totals
from conveyor.observer import Observer
from conveyor.served import ServedAt

try:
    from prometheus_client import CollectorRegistry, start_http_server
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
    from prometheus_client.registry import Collector
except ImportError as error:
    raise ConfigError(missing_package(error, "prometheus-client", extra="deploy", what="serving metrics")) from error

PREFIX = "tuberline"
AGGREGATOR = "aggregator/aggregator"
NODE_LABELS = ("line", "role", "name", "host", "run")


class LineCollector(Collector):
    """What Prometheus reads of one line."""

    def __init__(self, observer: Observer) -> None:
        self._observer = observer

    def collect(self) -> Iterator[Metric]:
        """All metrics of this moment."""
        line = self._observer.line
        nodes, alive = self._observer.nodes(), self._observer.alive()
        yield from node_metrics(nodes, alive=alive, line=line)
        yield from totals_metrics(self._observer.totals(), line=line, told_now=AGGREGATOR in alive)


@contextmanager
def serving(observer: Observer, at: ServedAt) -> Iterator[int]:
    """Answer scrapes at http://HOST:PORT/metrics inside the `with` block; the port.

    Raises:
        LinkError: the port is taken or cannot be bound.
    """
    registry = CollectorRegistry()
    registry.register(LineCollector(observer))
    try:
        server, thread = start_http_server(at.port, at.host, registry)
    except OSError as error:
        raise LinkError(f"cannot listen on {at}: {error.strerror or error}") from error
    try:
        yield int(server.server_port)
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def node_metrics(nodes: Mapping[str, Counters], *, alive: set[str], line: str) -> Iterator[Metric]:
    """Every counter as `tuberline_<counter>_total`, every gauge as `tuberline_<gauge>`, and whether a node is up.

    Counters of nodes that are gone are left out: a last value that no longer grows is not a rate of zero.
    """
    up = GaugeMetricFamily(f"{PREFIX}_node_up", "1 while the node's process and link are alive", labels=_UP_LABELS)
    stalled = GaugeMetricFamily(f"{PREFIX}_node_stalled", "1 while its loop makes no progress", labels=NODE_LABELS)
    uptime = GaugeMetricFamily(f"{PREFIX}_node_uptime_seconds", "seconds since its start", labels=NODE_LABELS)
    for name in sorted({*nodes, *alive}):
        role, _, node = name.partition("/")
        up.add_metric((line, role, node, nodes[name].version if name in nodes else ""), float(name in alive))
    here = [counters for name, counters in sorted(nodes.items()) if name in alive]
    for counters in here:
        labels = _labels(counters, line)
        stalled.add_metric(labels, float(counters.status == "stalled"))
        uptime.add_metric(labels, counters.uptime_s)
    yield from (up, stalled, uptime)
    yield from _families(here, line)


def _families(nodes: Sequence[Counters], line: str) -> Iterator[Metric]:
    counts: dict[str, CounterMetricFamily] = {}
    levels: dict[str, GaugeMetricFamily] = {}
    for counters in nodes:
        for key, value in counters.values.items():
            name = f"{PREFIX}_{metric_name(key)}"
            if name not in counts:
                counts[name] = CounterMetricFamily(name, f"counter '{key}' of the nodes", labels=NODE_LABELS)
            counts[name].add_metric(_labels(counters, line), value)
    for counters in nodes:
        for key, level in counters.gauges.items():
            name = f"{PREFIX}_{metric_name(key)}"
            # What one role counts and another one sets: the level has a name of its own, for a family has one type.
            name = f"{name}_level" if name in counts else name
            if name not in levels:
                levels[name] = GaugeMetricFamily(name, f"level '{key}' of the nodes", labels=NODE_LABELS)
            levels[name].add_metric(_labels(counters, line), level)
    yield from counts.values()
    yield from levels.values()


def totals_metrics(totals: Totals | None, *, line: str, told_now: bool) -> Iterator[Metric]:
    """The load so far; nothing before the aggregator has said anything, no weight while there is none to tell, and no
    rate where it is not `told_now`.
    """
    if totals is None:
        return
    values = {
        "load_tubers": ("tubers counted", float(totals.count)),
        "load_final": ("1 when all cameras ended", float(totals.final)),
        "load_has_weight": (
            "0 while nothing was seen or is counted: then there are no weights",
            float(not totals.no_number),
        ),
    }
    if not totals.no_number:
        values |= {
            "load_weight_grams": ("weight of the load as seen", totals.weight_g),
            "load_weight_low_grams": ("lower bound of its 90 % interval", totals.low_g),
            "load_weight_high_grams": ("upper bound of its 90 % interval", totals.high_g),
            "load_estimated_weight_grams": ("weight of the load, missed belt included", totals.estimated_weight_g),
        }
    if not totals.no_number and told_now and not totals.final:
        values["load_tubers_per_second"] = ("tubers a second now", totals.tubers_per_s)
    if totals.coverage is not None:
        values["load_belt_seen_ratio"] = ("share of the belt's travel that was looked at", totals.coverage)
    for name, (about, value) in values.items():
        family = GaugeMetricFamily(f"{PREFIX}_{name}", about, labels=("line", "run"))
        family.add_metric((line, totals.run), value)
        yield family
    yield from _open_load(totals, line=line)


def _open_load(totals: Totals, *, line: str) -> Iterator[Metric]:
    """The load that is open, by its number and name; nothing where none is."""
    load = totals.load
    if load is None:
        return
    values = {
        "open_load_tubers": ("tubers of the open load", float(load.count)),
        "open_load_weight_grams": ("weight of the open load as seen", load.weight_g),
        "open_load_weight_low_grams": ("lower bound of its 90 % interval", load.low_g),
        "open_load_weight_high_grams": ("upper bound of its 90 % interval", load.high_g),
        "open_load_estimated_weight_grams": ("weight of the open load, missed belt included", load.estimated_weight_g),
        **({} if load.coverage is None else {"open_load_belt_seen_ratio": ("share of its belt", load.coverage)}),
    }
    for name, (about, value) in values.items():
        family = GaugeMetricFamily(f"{PREFIX}_{name}", about, labels=("line", "run", "load", "name"))
        family.add_metric((line, totals.run, str(load.number), load.name), value)
        yield family


def metric_name(text: str) -> str:
    """`text` in Prometheus' alphabet; a counter's own '_total' is not said twice."""
    return re.sub(r"[^a-zA-Z0-9_]", "_", text).removesuffix("_total").lower()


_UP_LABELS = ("line", "role", "name", "version")


def _labels(counters: Counters, line: str) -> tuple[str, ...]:
    return (line, counters.role, counters.name, counters.host, counters.run)
