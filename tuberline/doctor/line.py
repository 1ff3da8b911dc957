"""Checks of a running line: who is there, who stalls, whose version or clock is off."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from statistics import median
from typing import Any

from conveyor import topics
from conveyor.config import LineConfig
from conveyor.errors import MessageError
from conveyor.lines import looked_for_elsewhere, strayed_regressors
from conveyor.messages import Counters
from conveyor.observer import Observer
from tuberline.doctor.finding import Finding, fault, ok, warning

SKEW_WARNING_S, SKEW_FAULT_S = 0.25, 2.0
CLOCK_GAUGE = "clock_unix_s"
"""Gauge in which every node says its wall clock when it publishes its counters."""


def expected_nodes(config: LineConfig) -> set[str]:
    """'role/name' of the nodes a complete line has, wherever they run; regressors may be any."""
    of_cameras = {f"{role}/{name}" for role in ("camera", "segmenter") for name in config.cameras}
    devices = {f"encoder/{config.encoder.name}"} if config.encoder is not None and config.hears_encoder else set()
    devices |= {f"gnss/{config.gnss.name}"} if config.gnss is not None else set()
    return {"aggregator/aggregator"} | of_cameras | devices


class ClockWatch:
    """Collects how far each node's clock is from this machine's, from counters as they come by."""

    def __init__(self, observer: Observer) -> None:
        self._offsets_s: dict[str, list[float]] = {}
        self._subscriber: Any = observer.session.declare_subscriber(
            topics.COUNTERS.key(observer.line, role="*", name="*"), self._on_sample
        )

    def _on_sample(self, sample: Any) -> None:
        arrived_s = time.time()
        try:
            counters = Counters.decode(sample.payload.to_bytes())
        except MessageError:
            return  # the observer's own subscriber counts and logs it
        if CLOCK_GAUGE in counters.gauges:
            node = f"{counters.role}/{counters.name}"
            self._offsets_s.setdefault(node, []).append(counters.gauges[CLOCK_GAUGE] - arrived_s)

    def offsets_s(self) -> dict[str, float]:
        """Clock of each node minus this machine's, seconds; the way here counts as being behind."""
        return {node: median(offsets) for node, offsets in list(self._offsets_s.items())}


def check_name(line: str, lines: Mapping[str, Collection[str]]) -> list[Finding]:
    """A config of this line names another one than its other hosts' do; `lines` as `nodes_of_lines` gives them."""
    found = []
    if elsewhere := looked_for_elsewhere(line, lines):
        fix = "correct `name` in this config, or --line, where that line is meant; else start this one's segmenters"
        found.append(fault("line's name", elsewhere, fix))
    if strayed := strayed_regressors(line, lines):
        fix = f"correct `name` in the config of their host, where line '{line}' is meant"
        found.append(warning("line's name", strayed, fix))
    return found


def check_nodes(config: LineConfig, nodes: Mapping[str, Counters], *, alive: set[str]) -> list[Finding]:
    """Everybody is there and makes progress."""
    found = []
    for name in sorted(expected_nodes(config) - alive):
        role, _, own = name.partition("/")
        unit = f"tuberline-{role}@{config.name}" + (f":{own}" if role in ("camera", "segmenter") else "")
        fix = f"start it (`tuberline run LINE.toml`, or systemctl start {unit}) and read its log"
        found.append(fault("nodes", f"{name} is not there", fix))
    if not any(name.startswith("regressor/") for name in alive):
        fix = "start one: `tuberline regressor --config LINE.toml --name r1 --run RUN`, RUN as `tuberline status` says"
        found.append(fault("nodes", "no regressor is there", fix))
    for name in sorted(alive - nodes.keys()):
        fix = "look again in some seconds; where it stays so, read its log, and see that it runs this version"
        found.append(warning("nodes", f"{name} is there, and no report of it that can be read has come", fix))
    for name, counters in sorted(nodes.items()):
        if name in alive and counters.status != "ok":
            found.append(
                fault(
                    "nodes",
                    f"{name} is {counters.status} (pid {counters.pid} on {counters.host})",
                    f"read its log on {counters.host} and restart it",
                )
            )
    return found or [ok("nodes", f"{len(alive)} nodes alive, none stalled")]


def check_versions(nodes: Mapping[str, Counters], *, own: str) -> list[Finding]:
    """All nodes run the version of this command."""
    others = {name: c for name, c in nodes.items() if c.version != own}
    if not others:
        return [ok("versions", f"all {len(nodes)} nodes run {own}")]
    told = ", ".join(f"{name} on {c.host} runs {c.version}" for name, c in sorted(others.items()))
    return [fault("versions", f"this is {own}, but {told}", "install the same version of tuberline on every host")]


def check_clocks(offsets_s: Mapping[str, float], nodes: Mapping[str, Counters]) -> list[Finding]:
    """Clocks agree: camera times of several hosts are compared when tubers are merged."""
    found = []
    for name, offset_s in sorted(offsets_s.items()):
        if abs(offset_s) < SKEW_WARNING_S:
            continue
        host = nodes[name].host if name in nodes else "its host"
        make = fault if abs(offset_s) >= SKEW_FAULT_S else warning
        side = "ahead of" if offset_s > 0 else "behind"
        found.append(
            make(
                "clocks",
                f"{name} on {host} is {abs(offset_s):.2f} s {side} this machine",
                f"let chrony or systemd-timesyncd set the clock on {host}, with one host of the line as server",
            )
        )
    if found or not offsets_s:
        return found
    most = max(abs(offset_s) for offset_s in offsets_s.values())
    return [ok("clocks", f"{len(offsets_s)} nodes within {most:.2f} s of this machine")]
