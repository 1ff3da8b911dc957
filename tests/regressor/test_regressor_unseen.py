"""A regressor whose config names another line than the segmenters' says so, and so do `doctor` and `status`."""

from __future__ import annotations

from pathlib import Path

import pytest

from conveyor.config import LineConfig, LinkConfig
from conveyor.lines import nodes_of_lines
from conveyor.node import Node
from regressor.serve.unseen import Lookout
from tests.conftest import wait_until
from tuberline.cli.address import LineAddress
from tuberline.cli.status import status
from tuberline.doctor import Level
from tuberline.doctor.examine import examine, look

pytestmark = pytest.mark.graph
TOLD = "no segmenter of line 'feild' is at this router, which carries line 'field'"


def said(node: Node, caplog: pytest.LogCaptureFixture, *, at_work_s: float | None = None) -> list[str]:
    """What it says of segmenters in a minute of turns, views having come at `at_work_s`."""
    now_s = 0.0
    lookout = Lookout(node, clock=lambda: now_s)
    caplog.clear()
    for _ in range(120):
        now_s += 0.5
        lookout.look(at_work=now_s == at_work_s)
    return [record.getMessage() for record in caplog.records if "segmenter" in record.getMessage()]


def test_a_regressor_of_a_mistyped_line_is_told(
    link: LinkConfig, tmp_path: Path, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was ready for ever, and weighed nothing, without a word."""

    def line(name: str) -> LineConfig:
        raw = {"name": name, "link": {"router": link.router}, "aggregator": {"out": str(tmp_path)}}
        return LineConfig.model_validate(raw)

    with Node("regressor", "r1", config=line("feild"), run="run") as stray:
        wait_until(lambda: "feild" in nodes_of_lines(stray.session), what="its token")
        assert said(stray, caplog) == ["no segmenter of line 'feild' was seen for 30 s: nothing is weighed so far"]
        with Node("segmenter", "front", config=line("field"), run="run") as segmenter:
            wait_until(lambda: len(nodes_of_lines(stray.session)) == 2, what="its token")
            assert said(stray, caplog) == [
                f"{TOLD}: nothing is weighed; if that is meant, correct `name` in the config"
            ]
            assert said(stray, caplog, at_work_s=29.5) == [], "an older router's rules may hide who is there"
            assert said(segmenter, caplog) == [], "there is one of this line"

            found = examine(line("feild"), live=look(line("feild"), listen_s=0.5))
            assert [(f.level, f.text) for f in found if f.check == "line's name"] == [(Level.FAULT, TOLD)]
            found = examine(line("field"), live=look(line("field"), listen_s=0.5))
            told = "this router has regressor/r1 of line 'feild', and none of 'field'"
            assert [(f.level, f.text) for f in found if f.check == "line's name"] == [(Level.WARNING, told)]
            for name, text in (("feild", TOLD), ("field", told)):
                status(address=LineAddress(connect=link.router, line=name), wait_s=0.5)
                assert text in " ".join(capsys.readouterr().out.split())

            with Node("regressor", "r1", config=line("field"), run="run"):
                wait_until(lambda: len(nodes_of_lines(stray.session)["field"]) == 2, what="its own regressor")
                status(address=LineAddress(connect=link.router, line="field"), wait_s=0.5)
                assert "feild" not in capsys.readouterr().out, "two lines may share a router"
