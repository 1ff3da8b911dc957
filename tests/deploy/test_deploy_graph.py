"""The whole line, real processes, over mutual TLS and under the access rules: every tuber is counted and weighed."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from conveyor.config import parse_config
from tests.belts import simulate
from tests.deploy.deploy_site import make_certs
from tuberline.replayer import replay_recording

pytestmark = pytest.mark.graph


def test_a_line_with_certificates_and_rules_counts_everything(tmp_path: Path, free_port: int) -> None:
    pytest.importorskip("cryptography", reason="certificates need tuberline[deploy]")
    recording, certs, out = tmp_path / "recording", tmp_path / "certs", tmp_path / "out"
    simulate(recording, seed="3", tubers="4")
    link = {"router": f"tls/127.0.0.1:{free_port}", "certs": str(certs)}
    config = parse_config({"name": "replay", "link": link, "cameras": {"front": {}}}, where="of this test")
    make_certs(config, certs)

    summary = replay_recording(recording, out=out, settings={"link": link, "access": {"enabled": True}})

    truth = json.loads((recording / "truth.json").read_text())
    assert summary["totals"]["count"] == len(truth["tubers"])
    assert summary["balanced"] is True
    tubers = list(csv.DictReader((out / "tubers.csv").open()))
    assert {tuber["method"] for tuber in tubers} == {"pointraft"}, "views reached the regressors and weights came back"
