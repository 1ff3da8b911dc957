"""What `tuberline status` and `top` say of the load while the aggregator is not there."""

from __future__ import annotations

import contextlib
import io
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from aggregator.ledger.writer import Ledger
from conveyor.config import LineConfig, LinkConfig, dump_toml
from conveyor.errors import PASSING, ConfigError, LinkError
from conveyor.messages import Counters, Totals
from conveyor.node import Node
from conveyor.taken_port import free_port
from tests.aggregator.loaded_story import story
from tests.aggregator.virtual_line import Aggregator
from tuberline.cli.address import LineAddress
from tuberline.cli.graph import line_graph, print_graph
from tuberline.cli.live import line_table
from tuberline.cli.status import status

TOTALS = Totals("r1", 3, 512.5, 480.0, 540.0, 0.75, 600.0, 550.0, 650.0, 1.5, 50.0, (0, 3), {}, final=False)


@pytest.mark.graph
def test_without_its_aggregator_a_line_tells_what_its_ledger_holds(
    link: LinkConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was headed 'waiting for the first tuber ...', though dozens had been counted."""
    config = LineConfig.model_validate(
        {"link": {"router": link.router}, "cameras": {"left": {}}, "aggregator": {"out": str(tmp_path / "out")}}
    )
    file = tmp_path / "line.toml"
    file.write_text(dump_toml(config), encoding="utf-8")
    ledger = tmp_path / "out" / "ledger.db"
    with Node("segmenter", "left", config=config, run="story"):

        def told(line: str | None = None) -> str:
            status(address=LineAddress(config=file, line=line), wait_s=0.5)
            said = " ".join(capsys.readouterr().out.replace("│", " ").split())
            assert "waiting for the first tuber" not in said
            assert "the aggregator is not there: nothing is added up until it is back" in said
            return said

        assert "what was counted before is not known here: give --config on the machine that has the ledger" in told()
        ledger.parent.mkdir()
        with Ledger(ledger) as opened:
            at_work = Aggregator(opened, story())
            at_work.commit_one_by_one()
            count = len(at_work.tubers())
        assert re.search(rf"its ledger tells of run story: {count} tubers, \d\.\d\d kg \(90 %: \d\.\d\d to ", told())
        assert "is not known here" in told(line="another"), "the ledger is not that line's"
        status(address=LineAddress(config=file), json=True, wait_s=0.5)
        found = json.loads(capsys.readouterr().out)
        assert (found["totals"], found["last_known"]["run"], found["last_known"]["count"]) == (None, "story", count)
        with Ledger(ledger) as opened:
            opened.open_run("empty", line="t", cameras=("left",), version="1", started_ns=0)
        assert "its ledger tells of run empty: nothing was seen" in told()
        ledger.write_bytes(b"no ledger" * 1000)
        assert "is not known here" in told()


def test_a_line_that_does_not_run_tells_what_its_ledger_holds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the evening, when all of the line is stopped, it said that no router answered and nothing more."""
    link = {"router": f"tcp/127.0.0.1:{free_port()}"}
    config = LineConfig.model_validate({"link": link, "cameras": {"left": {}}, "aggregator": {"out": str(tmp_path)}})
    file = tmp_path / "line.toml"
    file.write_text(dump_toml(config), encoding="utf-8")

    def told(*, json: bool) -> str:
        with pytest.raises(LinkError, match="no router answered") as ended:
            status(address=LineAddress(config=file), json=json, wait_s=0.0)
        assert ended.value.exit_code == PASSING
        return capsys.readouterr().out

    assert told(json=True) == "", "there is no ledger"
    with Ledger(tmp_path / "ledger.db") as opened:
        at_work = Aggregator(opened, story())
        at_work.commit_one_by_one()
        count = len(at_work.tubers())
    assert f"its ledger tells of run story: {count} tubers, " in told(json=False)
    found = json.loads(told(json=True))
    assert (found["totals"], found["last_known"]["count"], found["nodes"]) == (None, count, {})
    assert "segmenter/left" in found["missing"]


def test_totals_of_an_aggregator_that_left_are_the_last_ones() -> None:
    """`top` went on showing them as if it were there."""

    def shown(totals: Totals | None, *there: str) -> str:
        out = io.StringIO()
        nodes = {name: Counters(*name.split("/"), "r1", 7, "edge", "1", 3.0, {}, {}) for name in there}
        Console(file=out, width=100, color_system=None).print(line_table(totals, nodes, alive=set(there)))
        return out.getvalue()

    said = "the aggregator is not there: this is the load as it told it last"
    assert said in shown(TOTALS, "segmenter/left")
    assert said not in shown(TOTALS, "segmenter/left", "aggregator/aggregator")
    assert said not in shown(replace(TOTALS, final=True), "segmenter/left"), "it has done its work"
    assert said not in shown(TOTALS), "no one answers at all"
    assert "waiting for the first tuber" in shown(None), "of a line that starts"


@pytest.mark.parametrize("state", ["nothing seen", "starting", "counting"])
def test_what_a_peer_says_is_no_markup(state: str) -> None:
    """One message with a bracket ended `status` and `graph` with a traceback, and the table of `run` for good."""
    out, word = io.StringIO(), "[/red] [x]"
    node = Counters("camera", "left", "r1", 7, f"edge {word}", word, 3.0, {}, {"clock_unix_s": 0.0}, word)
    totals = replace(TOTALS, state=state, reason=f"no picture {word}", coverage=None)
    found = line_graph("line", {}, {"camera/left": node}, alive={"camera/left"}, now_unix_s=0.0)
    with contextlib.redirect_stdout(out):
        print_graph(found)
    assert f"host edge {word}  version {word}" in out.getvalue()
    Console(file=out, width=200, color_system=None).print(
        line_table(totals, {"camera/left": node}, alive={"camera/left"})
    )
    assert (out.getvalue().count(word), f"no picture {word}" in out.getvalue()) == (5, True)


@pytest.mark.parametrize("name", ["", "../x", "a b"])
def test_a_name_that_no_line_can_have_is_refused(name: str) -> None:
    """An empty one, as of a variable that is not set, was another line's; `bundle` took ../x for a folder."""
    for asked in (LineAddress(line=name).link, LineAddress(line=name).watched):
        with pytest.raises(ConfigError, match=f"line name '{name}' cannot be used"):
            asked()
