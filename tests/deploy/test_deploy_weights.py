"""New weights for a line at work: every view is weighed once, by the old ones or by the new ones, and by no others."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from conveyor.errors import InputError
from conveyor.observer import Observer
from conveyor.session import open_client
from regressor.network.checkpoint import read_checkpoint
from regressor.network.stored import SHIPPED
from regressor.serve.client import all_states, use
from regressor.serve.messages import WeightsState, read_parcel
from tests.belts import simulate, tuberline
from tests.chaos.harness import DisturbedLine, Site, site
from tests.regressor.test_regressor_weights import scaled_weights
from tuberline.supervisor import ProcessSpec, Supervisor

pytestmark = [pytest.mark.graph, pytest.mark.timeout(400)]


@pytest.fixture(scope="module")
def belt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One camera, tubers one by one."""
    out = tmp_path_factory.mktemp("belt") / "recording"
    return simulate(out, scene="singulated", tubers="12", fps="10")


@pytest.mark.slow
def test_weights_change_while_a_belt_passes(belt: Path, tmp_path: Path) -> None:
    newer = scaled_weights(tmp_path / "newer.safetensors", 1.06)
    broken = scaled_weights(tmp_path / "broken.safetensors", 3.0)
    line_site = site(belt, tmp_path / "run", speed=0.1)
    (camera,) = line_site.config.cameras
    with at_work(line_site) as line, open_client(line_site.config.link, name="keeper") as keeper:
        line.wait_count("views_weighed", 4)
        changed = use(keeper, "replay", read_parcel(newer))
        assert not changed.missed
        assert {name: state.n for name, state in changed.after.items()} == {"r1": 1, "r2": 1}
        pairs = zip(changed.reports[0].answers, changed.reports[0].now_answers, strict=True)
        network_share = 1 - read_checkpoint(SHIPPED)[1].volume_share  # the rest is the visible volume's
        assert [new.weight_g / old.weight_g for new, old in pairs] == pytest.approx(
            [1.06**network_share] * 3, abs=0.003
        )

        wait_reports(line)
        at_change = line.count("views_weighed")
        with pytest.raises(InputError, match=r"r1 refuses: weights broken@\w+ fail on the reference clouds: network 2"):
            use(keeper, "replay", read_parcel(broken))
        line.wait_count("views_weighed", at_change + 4)
        line.signal(f"camera-{camera}", signal.SIGSTOP)  # so that the rest of the belt is still to come
        with a_newcomer(line, line_site):
            line.kill("regressor-r1")
            everybody = {"regressor/r1", "regressor/r2", "regressor/r3"}
            line.wait(lambda: everybody <= line.observer.alive(), what="three regressors", timeout_s=150)
            states = all_states(keeper, "replay")
            assert models(states) == {"r1": "newer", "r2": "newer", "r3": "newer"}
            assert states["r3"].previous_model.startswith("tuberline-sim@"), "who came later knows the way back"
            go_back_by_command(line_site.out / "line.toml", broken)
            line.signal(f"camera-{camera}", signal.SIGCONT)
            line.wait(lambda: line.supervisor.finished("aggregator"), what="the summary", timeout_s=180)
    check_ledger(line_site.out, truth=belt / "truth.json")


@contextmanager
def at_work(line_site: Site) -> Iterator[DisturbedLine]:
    """The line, whose belt begins to move when both regressors are there."""
    others = line_site.parts("router", "aggregator", "regressor", "segmenter")
    with (
        Supervisor(others, log_dir=line_site.out / "logs") as supervisor,
        Observer(line_site.config.link, line=line_site.config.name) as observer,
    ):
        line, both = DisturbedLine(supervisor, observer), {"regressor/r1", "regressor/r2"}
        line.wait(lambda: both <= observer.alive(), what="two regressors", timeout_s=150)
        with Supervisor(line_site.parts("camera"), log_dir=line_site.out / "logs") as cameras:
            line.watched.append(cameras)
            yield line


def wait_reports(line: DisturbedLine) -> None:
    """Until all regressors have counted again: what they say once a second may be from before a moment ago."""
    nodes = line.observer.nodes()
    then_s = {name: node.uptime_s for name, node in nodes.items() if node.role == "regressor"}

    def again() -> bool:
        return all(line.observer.nodes()[name].uptime_s > uptime_s + 1.5 for name, uptime_s in then_s.items())

    line.wait(again, what="counters made since")


@contextmanager
def a_newcomer(line: DisturbedLine, line_site: Site) -> Iterator[None]:
    """A third regressor, which no one has told of new weights."""
    (known, *_) = line_site.parts("regressor")
    newcomer = ProcessSpec("regressor-r3", tuple("r3" if part == "r1" else part for part in known.args))
    with Supervisor([newcomer], log_dir=line_site.out / "logs") as supervisor:
        line.watched.append(supervisor)
        yield


def go_back_by_command(config: Path, broken: Path) -> None:
    """As an operator does it."""
    told = tuberline("weights", "use", broken, "--config", config, check=False)
    assert told.returncode == 2
    assert told.stderr.startswith("tuberline: weights broken@")
    back = json.loads(tuberline("weights", "rollback", "--config", config, "--json").stdout)
    assert {name: state["n"] for name, state in back["after"].items()} == {"r1": 2, "r2": 2, "r3": 2}
    shown = json.loads(tuberline("weights", "list", "--config", config, "--json").stdout)["regressors"]
    assert {state["model"].split("@")[0] for state in shown.values()} == {"tuberline-sim"}
    assert {state["previous_model"].split("@")[0] for state in shown.values()} == {"newer"}


def models(states: dict[str, WeightsState]) -> dict[str, str]:
    return {name: state.model.split("@")[0] for name, state in states.items()}


def check_ledger(out: Path, *, truth: Path) -> None:
    """All tubers once, each with the weights that weighed it; all views answered once."""
    summary = json.loads((out / "summary.json").read_text())
    assert summary["balanced"]
    assert summary["totals"]["count"] == len(json.loads(truth.read_text())["tubers"]) == 12
    (sheet,) = summary["cameras"].values()
    views = {name: n for name, n in sheet["views"].items() if n}
    assert set(views) == {"sent", "weighed"}, "no view is lost"
    assert views["sent"] == views["weighed"]
    used = {name for together in summary["models"] for name in together.split("+")}
    assert {name.split("@")[0] for name in used} == {"tuberline-sim", "newer"}
    assert sum(summary["models"].values()) == 12
