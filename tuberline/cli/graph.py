"""`tuberline graph`: who runs where and sends what to whom, from the topic table, the counters and the tokens."""

from __future__ import annotations

import json as json_module
import sys
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Annotated

from conveyor.errors import ConfigError
from conveyor.messages import Counters
from conveyor.observer import Observer
from conveyor.topics import COUNTERS, TOPICS, Delivery, Topic
from tuberline.cli.address import NO_ADDRESS, LineAddress
from tuberline.cli.live import Items, duration, losses, short_name
from tuberline.cli.numbers import within

NAMED_AFTER_CAMERA = ("camera", "segmenter")
SENT = {
    ("frame", "camera"): "frames_published",
    ("view", "segmenter"): "views_sent",
    ("weight", "regressor"): "views_weighed",
    ("track", "segmenter"): "tracks_counted",
    ("tuber", "aggregator"): "tubers_committed",
}
"""The counter that tells how much of a topic a role has sent."""
DOT_NEWLINE = "\\n"
"""As Graphviz wants it inside a label: a backslash and an n."""


@dataclass(frozen=True, slots=True)
class GraphNode:
    """One process. `age_s`: since its last report, by both hosts' clocks; None while it has not reported."""

    name: str
    state: str
    host: str
    version: str
    run: str
    age_s: float | None
    frame_age_ms: float | None
    rates_per_s: dict[str, float]
    drops: dict[str, float]


@dataclass(frozen=True, slots=True)
class GraphEdge:
    """A topic from one node to another. `rate_per_s` is the sender's, over all receivers; None where no one counts."""

    topic: str
    sender: str
    receiver: str
    delivery: str
    rate_per_s: float | None


@dataclass(frozen=True, slots=True)
class Graph:
    """A line as it is now."""

    line: str
    nodes: tuple[GraphNode, ...]
    edges: tuple[GraphEdge, ...]


def graph(
    *,
    address: LineAddress = NO_ADDRESS,
    json: bool = False,
    dot: bool = False,
    every: bool = False,
    wait_s: Annotated[float, within(0, 3600, "s")] = 3.5,
) -> None:
    """Show a running line as a graph: nodes, what they send to whom, rates, ages, drops, versions.

    Arrows follow the topic table; a light viewer, say, could have the frames and does not ask for them.

    Parameters
    ----------
    json
        For machines.
    dot
        For Graphviz: tuberline graph --dot | dot -Tsvg > line.svg
    every
        Show the counters' own way, too.
    wait_s
        How long to listen; nodes report once a second, and a rate needs two reports.
    """
    if json and dot:
        raise ConfigError("--json and --dot are two forms of the same output: give one of them")
    link, name = address.link()
    with Observer(link, line=name) as observer:
        first, last = _listen(observer, wait_s)
        found = line_graph(name, first, last, alive=observer.alive(), now_unix_s=time.time(), every=every)
    if json:
        sys.stdout.write(json_module.dumps(asdict(found), indent=2) + "\n")
    elif dot:
        sys.stdout.write(dot_text(found))
    else:
        print_graph(found)


def line_graph(
    line: str,
    first: Mapping[str, Counters],
    last: Mapping[str, Counters],
    *,
    alive: set[str],
    now_unix_s: float,
    every: bool = False,
) -> Graph:
    """The graph of a line from two looks at its counters, by 'role/name'. `every`: with the counters' topic."""
    names = sorted({*last, *alive})
    nodes = tuple(_node(n, first.get(n), last.get(n), alive=n in alive, now_unix_s=now_unix_s) for n in names)
    by_name = {node.name: node for node in nodes}
    living = [node.name for node in nodes if node.state != "gone"]
    edges = tuple(
        GraphEdge(topic.name, sender, receiver, topic.delivery.value, _sent_rate(topic, by_name[sender]))
        for topic in TOPICS
        if topic.delivery not in (Delivery.TOKEN, Delivery.QUERY) and (every or topic is not COUNTERS)
        for sender in living
        for receiver in living
        if reaches(topic, sender, receiver)
    )
    return Graph(line, nodes, edges)


def reaches(topic: Topic, sender: str, receiver: str) -> bool:
    """The topic table lets `sender` send this topic to `receiver` (both 'role/name')."""
    sender_role, _, sender_name = sender.partition("/")
    receiver_role, _, receiver_name = receiver.partition("/")
    if sender == receiver or sender_role not in topic.senders or receiver_role not in topic.receivers:
        return False
    own_camera = "camera" in topic.part_names and {sender_role, receiver_role} <= set(NAMED_AFTER_CAMERA)
    return not own_camera or sender_name == receiver_name


def dot_text(found: Graph) -> str:
    """The graph for Graphviz; topics between the same two nodes share one arrow."""
    lines = [f'digraph "{found.line}" {{', "  rankdir=LR;", '  node [shape=box, fontname="sans-serif"];']
    for node in found.nodes:
        facts = [node.name, f"{node.host} {node.version}".strip(), *(f"{k} {v:g}" for k, v in node.drops.items())]
        colour, label = "black" if node.state == "ok" else "red", DOT_NEWLINE.join(facts)
        lines.append(f'  "{node.name}" [color={colour}, label="{label}"];')
    arrows: dict[tuple[str, str], list[str]] = {}
    for edge in found.edges:
        rate = "" if edge.rate_per_s is None else f" {edge.rate_per_s:.1f}/s"
        arrows.setdefault((edge.sender, edge.receiver), []).append(edge.topic + rate)
    lines += [f'  "{a}" -> "{b}" [label="{DOT_NEWLINE.join(what)}"];' for (a, b), what in arrows.items()]
    return "\n".join([*lines, "}", ""])


def _listen(observer: Observer, wait_s: float) -> tuple[dict[str, Counters], dict[str, Counters]]:
    """Each node's first and last report of the next `wait_s` seconds."""
    first: dict[str, Counters] = {}
    deadline = time.monotonic() + wait_s
    while time.monotonic() < deadline:
        for name, counters in observer.nodes().items():
            if name not in first or first[name].pid != counters.pid:  # a node that started again counts from 0
                first[name] = counters
        time.sleep(0.1)
    return first, observer.nodes()


def _node(name: str, first: Counters | None, last: Counters | None, *, alive: bool, now_unix_s: float) -> GraphNode:
    if last is None:
        return GraphNode(name, "silent", "", "", "", None, None, {}, {})
    reported = last.gauges.get("clock_unix_s")
    return GraphNode(
        name=name,
        state=last.status if alive else "gone",
        host=last.host,
        version=last.version,
        run=last.run,
        age_s=None if reported is None else now_unix_s - reported,
        frame_age_ms=last.gauges.get("frame_age_ms"),
        rates_per_s=_rates(first, last) if alive else {},
        drops=losses(last),
    )


def _rates(first: Counters | None, last: Counters) -> dict[str, float]:
    """What grew between two reports, each second; empty where there was one report only."""
    if first is None or last.pid != first.pid or last.uptime_s <= first.uptime_s:
        return {}
    seconds = last.uptime_s - first.uptime_s
    counted = {*last.values, *(name for (_, role), name in SENT.items() if role == last.role)}
    return {name: (last.count(name) - first.count(name)) / seconds for name in sorted(counted)}


def _sent_rate(topic: Topic, sender: GraphNode) -> float | None:
    counter = SENT.get((topic.name, sender.name.partition("/")[0]))
    return None if counter is None else sender.rates_per_s.get(counter)


def _by_sender(edges: Iterable[GraphEdge]) -> dict[tuple[str, str], list[GraphEdge]]:
    """The arrows of each sender and topic: what it sends goes to all of them, or is shared among them."""
    found: dict[tuple[str, str], list[GraphEdge]] = {}
    for edge in edges:
        found.setdefault((edge.sender, edge.topic), []).append(edge)
    return found


def print_graph(found: Graph) -> None:
    """Nodes, then what they send to whom, for a person."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console(highlight=False)
    if not found.nodes:
        console.print(f"[red]no process of line '{found.line}' is running[/]: start it, or correct --line")
        return
    usual = {what: _usual(found.nodes, what) for what in ("host", "version", "run")}
    console.print("  ".join(f"{what} {value}" for what, value in usual.items()), markup=False)
    others = {
        node.name: [v for what, value in usual.items() if (v := getattr(node, what)) not in ("", value)]
        for node in found.nodes
    }
    nodes = Table("node", "state", "age", "frames", "dropped or lost", box=SIMPLE_HEAD)
    for column in nodes.columns[:4]:
        column.no_wrap = True
    if any(others.values()):
        nodes.add_column("other than above")
    for node in found.nodes:
        colour = "green" if node.state == "ok" else "red"
        nodes.add_row(
            short_name(node.name),
            f"[{colour}]{escape(node.state)}[/]",
            "-" if node.age_s is None else duration(node.age_s) if node.age_s >= 10 else f"{node.age_s:.1f} s",
            "-" if node.frame_age_ms is None else f"{node.frame_age_ms:.0f} ms",
            Items(f"{key} {n:g}" for key, n in node.drops.items()),
            *([Items(others[node.name])] if any(others.values()) else []),
        )
    edges = Table("from", "topic", "rate", "to", box=SIMPLE_HEAD)
    for column in edges.columns[:3]:
        column.no_wrap = True
    for (sender, topic), receivers in _by_sender(found.edges).items():
        rate = receivers[0].rate_per_s
        told = "-" if rate is None else f"{rate:.1f}/s"
        edges.add_row(short_name(sender), topic, told, together(edge.receiver for edge in receivers))
    console.print(nodes)
    console.print(edges)


def together(names: Iterable[str]) -> str:
    """'regressor/r1, r2' for regressor/r1 and regressor/r2: each role once."""
    by_role: dict[str, list[str]] = {}
    for name in names:
        role, _, own = name.partition("/")
        by_role.setdefault(role, []).append(own)
    return ", ".join(role if own == [role] else f"{role}/{', '.join(own)}" for role, own in by_role.items())


def _usual(nodes: tuple[GraphNode, ...], what: str) -> str:
    """What most nodes have."""
    found = Counter(value for node in nodes if (value := getattr(node, what)))
    return found.most_common(1)[0][0] if found else "-"
