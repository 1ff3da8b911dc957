"""What version 0.1 (commit a7bbfcc) wrote is read by every later one: recordings, packs, config, tickets, weights."""

from __future__ import annotations

import csv
import hashlib
import json
import lzma
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import conveyor
from aggregator.calibration.tickets import read_tickets, with_ticket, write_tickets
from conveyor import config as config_module
from conveyor.config import load_config, parse_config
from conveyor.errors import ConfigError
from conveyor.formats import camera_names, open_source
from conveyor.formats.packs.belts import belt_pack_meta, belt_shards, read_belt
from conveyor.formats.packs.views import read_views, view_shards
from conveyor.geometry import straight_down_belt_from_camera
from regressor.network.checkpoint import load_checkpoint, save_checkpoint
from regressor.network.sidecar import Sidecar
from regressor.weigh.prepare import PreparedCloud, prepare_depth
from regressor.weigh.weigher import Weigher
from tests.conftest import ROOT
from tuberline.cli.commands import build_app

OLD = Path(__file__).parent / "v0_1"
DEPTH = "4e25889e085997fe6ab6f2ad46fb98ced204bb59e274b352729590c84de70a1e"
"""SHA-256 of all depth images one after the other, as 0.1 read them; the travel beside it."""
LAST_TRAVEL_M = 0.6199
MODEL = "small-0.1@17448026"
WEIGHED = (
    (148.53, 129.873, 168.747, 145.946),
    (139.653, 115.775, 165.026, 135.716),
    (165.483, 137.07, 197.498, 156.213),
    (161.358, 137.282, 188.225, 154.253),
)
"""What 0.1 made of each view of its pack by its small weights: weight, both ends of the interval, the network's, g."""


@pytest.mark.parametrize("name", ["folder", "own.mcap", "ros2.mcap"])
def test_recordings_of_0_1_give_the_same_frames(name: str) -> None:
    assert list(camera_names(OLD / name)) == ["front"]
    frames = list(open_source(OLD / name, camera="front").frames(run="r"))
    assert [frame.seq for frame in frames] == list(range(11))
    assert hashlib.sha256(b"".join(frame.depth.tobytes() for frame in frames)).hexdigest() == DEPTH
    assert frames[-1].travel_m == pytest.approx(LAST_TRAVEL_M, abs=1e-5)
    assert frames[0].belt_distance_m == pytest.approx(0.459656, abs=1e-6)
    assert frames[0].depth_scale_m == pytest.approx(0.001)


def test_packs_of_0_1_hold_their_views_and_frames() -> None:
    (shard,) = view_shards(OLD / "views")
    views = list(read_views(shard))
    assert [view.tuber for view in views] == [0, 0, 1, 1]
    assert [view.weight_g > 0 for view in views] == [True] * 4
    assert all(np.count_nonzero(view.depth) > 100 for view in views)
    (shard,) = belt_shards(OLD / "belts")
    belt = read_belt(shard)
    assert len(belt.frames) == 2
    assert belt.frames[0].depth.shape == (90, 160)
    assert "tuber" in belt.kinds
    assert belt_pack_meta(OLD / "belts")["seed"] == 101


def test_a_config_of_0_1_is_taken_or_told_the_new_names() -> None:
    """Every key that 0.1 wrote: accepted with its value, or refused with the name that it has now."""
    if config_module.FORMER_KEYS:
        with pytest.raises(ConfigError) as refused:
            load_config(OLD / "every_key.toml")
        faults = str(refused.value).splitlines()[1:]
        assert [fault for fault in faults if not re.search(r": now '[\w.]+'", fault)] == []
        return
    line = load_config(OLD / "every_key.toml")
    assert line.name == "field"
    assert line.cameras["left"].belt_distance_m == 0.46
    assert line.aggregator.out == Path("/var/lib/tuberline/field/ledger")


def test_a_renamed_key_is_refused_with_its_new_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(config_module.FORMER_KEYS, "segmenter.eyes", "segmenter.weights")
    monkeypatch.setitem(config_module.FORMER_KEYS, "cameras.*.height_m", "cameras.*.belt_distance_m")
    with pytest.raises(ConfigError) as refused:
        parse_config({"segmenter": {"eyes": "x.onnx"}, "cameras": {"left": {"height_m": 0.4}}}, where="line.toml")
    assert "segmenter.eyes: now 'segmenter.weights'" in str(refused.value)
    assert "cameras.left.height_m: now 'cameras.left.belt_distance_m'" in str(refused.value)


def test_former_keys_are_no_longer_keys_and_lead_to_keys_that_are() -> None:
    for former, now in config_module.FORMER_KEYS.items():
        for key, there in ((former, False), (now, True)):
            *section, last = key.split(".")
            assert (last in config_module._known_keys(tuple(section))) is there, key


def test_a_ledger_of_0_1_is_audited_totalled_and_exported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ledger = tmp_path / "run"
    shutil.copytree(ROOT / "tests" / "aggregator" / "data" / "v0_1", ledger)
    files = {form: tmp_path / f"out.{form}" for form in ("csv", "parquet", "html")}
    exports = [("export", str(ledger), "--format", form, "--out", str(file)) for form, file in files.items()]
    for words in (
        ("audit", str(ledger)),
        ("ledger", "check", str(ledger)),
        ("ledger", "totals", str(ledger)),
        *exports,
    ):
        with pytest.raises(SystemExit) as ended:
            build_app()(words)
        assert ended.value.code in (0, None), words
    assert capsys.readouterr().out.count("12 rows of tubers in ") == 2
    kept = (OLD.parents[1] / "aggregator" / "data" / "v0_1" / "tubers.csv").read_text(encoding="utf-8").splitlines()
    assert len(files["csv"].read_text(encoding="utf-8").splitlines()) == len(kept) == 13
    assert re.search(r"12 tubers.*0\.1\.0", files["html"].read_text(encoding="utf-8"), re.DOTALL)


def test_tickets_of_0_1_are_gone_on_with(tmp_path: Path) -> None:
    path = tmp_path / "tickets.json"
    shutil.copy(OLD / "tickets.json", path)
    (old,) = read_tickets(path)
    assert (old.run, old.model, old.ticket_g, old.coverage) == (
        "replay-020e78d7514b",
        "tuberline-sim@c9225214",
        2100.0,
        1.0,
    )
    assert old.estimated_g == pytest.approx(2381.46, abs=0.01)
    write_tickets(path, with_ticket((old,), replace(old, run="next", ticket_g=2200.0), again=False))
    assert [ticket.run for ticket in read_tickets(path)] == [old.run, "next"]


def test_a_sidecar_of_0_1_is_read_and_opens_its_weights(tmp_path: Path) -> None:
    text = (OLD / "weights.json").read_text(encoding="utf-8")
    sidecar = Sidecar.model_validate_json(text)
    assert sidecar.name == "tuberline-sim"
    assert sidecar.interval_rule is not None
    weights = tmp_path / "w.safetensors"
    shutil.copy(ROOT / "regressor" / "weights" / "tuberline-sim.safetensors", weights)
    if hashlib.sha256(weights.read_bytes()).hexdigest() != sidecar.sha256:  # others are shipped by now
        path = "a7bbfcc:regressor/weights/tuberline-sim.safetensors"
        found = subprocess.run(["git", "-C", str(ROOT), "show", path], capture_output=True, check=False)
        if found.returncode != 0:
            pytest.skip("its commit is not in this clone (git fetch --unshallow): 0.1's weights are not at hand")
        weights.write_bytes(found.stdout)
    (tmp_path / "w.json").write_text(text, encoding="utf-8")
    _, loaded = load_checkpoint(weights)
    assert loaded == sidecar


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights that 0.1 wrote, unpacked; their sidecar beside them."""
    path = tmp_path_factory.mktemp("weights") / "small.safetensors"
    path.write_bytes(lzma.decompress((OLD / "small.safetensors.xz").read_bytes()))
    shutil.copy(OLD / "small.json", path.with_suffix(".json"))
    return path


def clouds() -> list[PreparedCloud]:
    """The views of 0.1's pack, prepared as today."""
    (shard,) = view_shards(OLD / "views")
    return [
        prepare_depth(
            view.depth,
            depth_scale_m=view.depth_scale_m,
            fx=view.intrinsics.fx,
            fy=view.intrinsics.fy,
            cx=view.intrinsics.cx - view.u0,
            cy=view.intrinsics.cy - view.v0,
            belt_from_camera=straight_down_belt_from_camera(view.belt_distance_m),
        )
        for view in read_views(shard)
    ]


def test_weights_of_0_1_weigh_as_they_did(small: Path) -> None:
    """The network to a milligram on the same points. The third view has an island of false matches, dropped since."""
    weigher = Weigher.load(small)
    found = [weigher.weigh(cloud, belt_sd_m=0.0025) for cloud in clouds()]
    assert [weighed.model for weighed in found] == [MODEL] * 4
    for n, (weighed, (weight_g, low_g, high_g, network_g)) in enumerate(zip(found, WEIGHED, strict=True)):
        assert weighed.network_g == pytest.approx(network_g, rel=0.03 if n == 2 else 1e-5)
        told = weighed.weight_g, weighed.low_g, weighed.high_g
        assert told == pytest.approx((weight_g, low_g, high_g), rel=0.04 if n == 2 else 0.005)


def test_weights_of_0_1_are_gone_on_with(small: Path, tmp_path: Path) -> None:
    """What calibrates or fine-tunes them writes them again: the same tensors, with all that their sidecar said."""
    model, sidecar = load_checkpoint(small)
    again = tmp_path / "again.safetensors"
    save_checkpoint(again, model.state_dict(), sidecar)
    assert load_checkpoint(again)[1] == sidecar
    assert again.read_bytes() == small.read_bytes()


@pytest.mark.slow
@pytest.mark.graph
def test_a_line_weighs_by_weights_of_0_1(small: Path, tmp_path: Path) -> None:
    """And the ledger names them."""
    words = ["replay", str(OLD / "own.mcap"), "--out", str(tmp_path / "run"), "--weights", str(small)]
    subprocess.run([sys.executable, "-m", "tuberline", *words], check=True, cwd=ROOT, capture_output=True)
    rows = list(csv.DictReader((tmp_path / "run" / "tubers.csv").open(encoding="utf-8", newline="")))
    assert [(row["method"], row["model"]) for row in rows] == [("pointraft", MODEL)] * 2


def test_the_version_has_one_home_and_is_ahead_of_0_1() -> None:
    said = subprocess.run(
        [sys.executable, "-m", "tuberline", "--version"], capture_output=True, text=True, check=True, cwd=ROOT
    ).stdout.strip()
    assert said == conveyor.__version__
    assert tuple(int(part) for part in said.split(".")[:2]) > (0, 1)
    newest = re.search(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert newest is not None
    assert said in newest[1], "the changelog begins with this version"
    assert 'dynamic = ["version"]' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    for pack in ("views", "belts"):
        assert json.loads((OLD / pack / "meta.json").read_text(encoding="utf-8"))["tuberline"] == "0.1.0"
