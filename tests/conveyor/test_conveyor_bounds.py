"""Bounded under foreign hands: names that no one configured and no one lives under fill no memory and hide no one."""

from __future__ import annotations

import time

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from conveyor import topics
from conveyor.access import known_nodes
from conveyor.config import LineConfig, LinkConfig
from conveyor.counters import FULL, MOST_NAMES, CounterSet
from conveyor.delivery import presence
from conveyor.delivery.bounded import ALIVE, CONFIGURED, MOST_KEYS, UNKNOWN, Bounded
from conveyor.messages import Counters
from conveyor.node import Node
from conveyor.observer import Observer
from conveyor.session import open_client
from tests.conftest import wait_until
from viewer.page.growth import MAX_COUNTERS, Growth
from viewer.page.snapshot import MAX_NODES as SHOWN
from viewer.page.snapshot import snapshot
from viewer.page.state import LineState
from viewer.page.watch import MAX_NODES, LineWatch, remembered

FORGED = 3000
KEYS = st.lists(st.integers(0, 30).map(str), max_size=200)


@given(keys=KEYS, configured=st.sets(st.integers(0, 30).map(str)), alive=st.sets(st.integers(0, 30).map(str)))
def test_the_higher_rank_is_kept_whoever_came_first(keys: list[str], configured: set[str], alive: set[str]) -> None:
    def rank(key: str) -> int:
        return CONFIGURED if key in configured else ALIVE if key in alive else UNKNOWN

    bounded = Bounded[int](most=8, rank=rank)
    refused = {key for n, key in enumerate(keys) if not bounded.put(key, n)}
    kept = bounded.all()
    assert len(kept) <= 8
    assert len(kept) == min(8, len(set(keys)))
    assert sorted(map(rank, kept), reverse=True) == sorted(map(rank, set(keys)), reverse=True)[:8]
    assert not refused or len(kept) == 8
    for key, n in kept.items():
        assert keys[n] == key


def test_counters_of_one_process_fit_its_report() -> None:
    counters = CounterSet()
    counters.add("real")
    for n in range(5000):
        counters.add(f"refused_from_forged{n}")
        counters.gauge(f"level{n}", 1.0)
    counters.add("real", 4)
    values, gauges = counters.snapshot()
    assert len(values) <= MOST_NAMES
    assert len(gauges) <= MOST_NAMES
    assert values["real"] == 5
    assert values[FULL] == (5000 - (MOST_NAMES - 2)) + (5000 - MOST_NAMES)
    report = Counters("camera", "left", "r", 1, "h", "0", 1.0, values, gauges)
    assert Counters.decode(report.encode()) == report


def test_counters_that_change_their_names_are_not_remembered_for_ever() -> None:
    growth = Growth()
    for n in range(20):
        values = {f"c{n}_{m}": m for m in range(200)}
        growth.add(Counters("camera", "left", "r", 1, "h", "0", float(n + 1), values, {}), float(n))
    assert len(growth.resting_s(20.0)) <= MAX_COUNTERS


@given(
    memory=st.dictionaries(st.integers(0, 40).map(str), st.floats(0, 100)),
    told=st.sets(st.integers(0, 40).map(str)),
    known=st.sets(st.integers(0, 40).map(str), max_size=8),
)
def test_who_is_remembered_is_bounded_and_the_configs_own_are_among_them(
    memory: dict[str, float], told: set[str], known: set[str]
) -> None:
    alive = {name for name in told if int(name) % 2}
    kept = remembered(memory, told=told, alive=alive, known=known, most=8)
    everybody = {*memory, *told}
    assert len(kept) == min(8, len(everybody))
    assert known & everybody <= kept
    left_out = everybody - kept - known
    if any(name in alive for name in left_out):
        assert all(name in alive or name in known for name in kept)


@pytest.mark.graph
def test_a_flood_of_forged_names_through_a_real_router_hides_no_process_and_fills_no_memory(
    link: LinkConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without access control anybody may announce processes; 72,941 of them were once shown. Counts, not times.

    Who lives is not asked for meanwhile: an answer that comes late tells a token twice, and the count would depend on
    how long this takes.
    """
    monkeypatch.setattr(presence, "ASK_EVERY_S", float("inf"))
    config = LineConfig(name="north", link=link, cameras={"zebra": {"source": "realsense"}})
    known = known_nodes(config)
    looks: list[LineState] = []
    watch = LineWatch(link, line="north", tell=looks.append, known=known)
    watch.start()
    with open_client(link, name="forger") as forger, Observer(link, line="north", known=known) as observer:
        tokens = _forge(forger)
        wait_until(lambda: len(observer.nodes()) == MOST_KEYS, what="as many reports as are kept")
        wait_until(lambda: len(observer.alive()) >= MOST_KEYS, what="as many tokens as are kept")
        with Node("segmenter", "zebra", config=config, run="r"):
            wait_until(lambda: "segmenter/zebra" in observer.nodes(), what="the real segmenter's report")
            wait_until(lambda: observer.is_alive("segmenter/zebra"), what="the real segmenter's token")
            wait_until(lambda: _shows(looks, "segmenter/zebra"), what="the real segmenter on the page")
            _put(forger, range(FORGED, 2 * FORGED))
            refused = observer.counters.get
            wait_until(lambda: refused("kept_refused_full") >= 2 * FORGED - MOST_KEYS, what="refusals counted")
            assert len(observer.nodes()) <= MOST_KEYS
            assert len([n for n in observer.alive() if n.startswith("camera/")]) <= MOST_KEYS
            assert refused("alive_refused_full") == FORGED - MOST_KEYS
            assert "segmenter/zebra" in observer.nodes()
            shown = snapshot(looks[-1])
            assert len(looks[-1].nodes) <= MAX_NODES
            assert max(len(shown[table]) for table in ("cameras", "regressors", "others")) <= SHOWN
            assert len(watch._nodes) <= MAX_NODES
        del tokens
    watch.stop(10)


def _shows(looks: list[LineState], node: str) -> bool:
    return bool(looks) and node in looks[-1].nodes and looks[-1].nodes[node].report is not None


def _forge(session: zenoh.Session) -> list[object]:
    """Tokens and reports of processes that do not exist; also under names that no process can have."""
    tokens: list[object] = [
        session.liveliness().declare_token(f"tuberline/north/alive/camera/forged{n:05}") for n in range(FORGED)
    ]
    _put(session, range(FORGED))
    session.put("tuberline/north/counters/camera/%1b[2J forged", b"x")
    return tokens


def _put(session: zenoh.Session, numbers: range) -> None:
    for n in numbers:
        report = Counters("camera", f"forged{n:05}", "r", 1, "h", "0", 1.0, {"frames_published": n}, {})
        session.put(topics.COUNTERS.key("north", role="camera", name=report.name), report.encode())
        if n % 100 == 0:
            time.sleep(0.01)  # what a link drops is no message that must be refused


@pytest.mark.graph
def test_a_report_in_anothers_name_is_not_taken_for_the_others(link: LinkConfig) -> None:
    spoken = Counters("segmenter", "left", "r", 1, "h", "0", 1.0, {"frames_processed": 99}, {})
    own = Counters("camera", "own", "r", 1, "h", "0", 1.0, {}, {})
    with open_client(link, name="forger") as forger, Observer(link, line="north") as observer:

        def heard() -> bool:
            forger.put(topics.COUNTERS.key("north", role="camera", name="forger"), spoken.encode())
            forger.put(topics.COUNTERS.key("north", role="camera", name="own"), own.encode())
            return "camera/own" in observer.nodes()

        wait_until(heard, what="the report in its own name")
        assert set(observer.nodes()) == {"camera/own"}
