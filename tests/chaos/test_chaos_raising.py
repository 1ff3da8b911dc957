"""An exception in any loop, thread or callback of any node ends that node, it is started again, and nothing is lost."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.chaos.harness import DisturbedLine, canonical, disturbed_replay, inject

pytestmark = [pytest.mark.graph, pytest.mark.slow, pytest.mark.timeout(400)]

MAIN_LOOPS = (
    "router tuberline.cli.router notify 4",
    "aggregator aggregator.node AggregatorNode._commit 8",
    "regressor regressor.serve.node _Worker._answer 2",
    "segmenter segmenter.node SegmenterNode._turn 30",
    "camera camera_sim.node CameraNode._publish 5",
    "viewer viewer.scene.show Show.turn 30",
)
THREADS = (
    *(f"{role} conveyor.node Node._publish_counters 3" for role in ("aggregator", "regressor", "segmenter", "camera")),
    "viewer conveyor.node Node._publish_counters 3",
    "router tuberline.orphan notify 5",
    "regressor regressor.serve.service WeightsService._follow 1",
)
CALLBACKS = (
    "aggregator conveyor.delivery.inbox Inbox.push 2",
    "regressor conveyor.delivery.inbox Inbox.push 2",
    "segmenter conveyor.delivery.inbox Inbox.push 4",
    "viewer conveyor.delivery.inbox Inbox.push 2",
    "camera conveyor.delivery.kept KeptSubscriber._on_sample 3",
    "segmenter conveyor.delivery.presence Presence._on_token 1",
    "regressor regressor.serve.service WeightsService._tell 1",
)


@pytest.mark.parametrize(
    "faults",
    [
        pytest.param((*MAIN_LOOPS, *CALLBACKS), id="loops-and-callbacks"),
        pytest.param(THREADS, id="threads"),
    ],
)
def test_every_one_ends_the_node_and_nothing_is_lost(
    faults: tuple[str, ...], recording: Path, run_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A regressor's thread waited for a stop that no one set: 12 of 102 views were weighed, and its token lived."""
    raised = inject(faults, tmp_path, monkeypatch)
    wanted = {f"{role} {function}" for role, _, function, _ in (fault.split() for fault in faults)}

    def all_raised(line: DisturbedLine) -> None:
        line.wait(
            lambda: wanted <= {file.name for file in raised.iterdir()} or line.supervisor.finished("aggregator"),
            what="every fault",
            timeout_s=250,
        )

    out = tmp_path / "run"
    settings = {"aggregator": {"out": str(out), "exit_when_final": True, "camera_stall_s": 600.0}}
    summary = disturbed_replay(
        recording,
        out,
        all_raised,
        speed=0.25,
        rrd=tmp_path / "x.rrd",
        settings=settings,
        timeout_s=250,
    )
    assert {file.name for file in raised.iterdir()} == wanted, "a fault did not come: its function is called otherwise"
    assert summary["balanced"]
    assert sum(summary["restarts"].values()) >= len(wanted)
    for log in (out / "logs").glob("*.log"):
        told = log.read_text().count("RuntimeError: injected")
        assert summary["restarts"][log.stem] >= told, log.stem
    assert canonical(out) == canonical(run_dir)
