"""deploy/trial: `make images`, `make boot`, `make powercuts`, what they do before they need root and as a whole."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("yaml", reason="PyYAML is not installed: the trials of deploy/trial are unchecked")

from deploy.trial import boot, containers, engine, images, machine, powercuts, tools
from deploy.trial.compose import command_of, podman_words, services
from deploy.trial.pipsettings import write_settings
from deploy.trial.tools import TrialError
from tests.conftest import ROOT

TRIALS = {"images": images, "boot": boot, "powercuts": powercuts}
SITE = ROOT / "deploy" / "docker" / "compose.site.yaml"


def test_every_setting_of_a_compose_service_becomes_a_word_of_podman() -> None:
    site = services(SITE, {"RUN": "monday", "CERTS": "/certs", "PAGE_TOKEN": "/token"})
    words = podman_words(site["aggregator"], configs={"line": Path("/line.toml")}, project="calm")
    for word in (
        "--read-only",
        "--read-only-tmpfs=false",
        "--cap-drop=ALL",
        "--security-opt=no-new-privileges",
        "--tmpfs=/tmp:size=64m",
        "--memory=2g",
        "--init",
        "--restart=unless-stopped",
        "--stop-timeout=10",
        "--volume=/line.toml:/etc/tuberline/line.toml:ro",
        "--volume=/certs:/etc/tuberline/certs:ro",
        "--volume=calm-ledger:/var/lib/tuberline",
        "--add-host=edge.field.internal:host-gateway",
    ):
        assert word in words
    page = podman_words(site["page"], configs={"line": Path("/line.toml")}, project="calm")
    assert "--volume=/token:/run/secrets/page-token:ro" in page
    assert words[words.index("--health-cmd") + 1].startswith("tuberline health --config")
    assert command_of(site["aggregator"])[1][-2:] == ["--run", "monday"]
    assert command_of(site["regressor"])[0] == ["--entrypoint", "/bin/sh"]
    assert "$(hostname)" in command_of(site["regressor"])[1][1]
    with pytest.raises(TrialError, match="compose key 'privileged' is not known"):
        podman_words({"privileged": True}, configs={}, project="calm")
    with pytest.raises(TrialError, match="variable RUN is not set"):
        services(ROOT / "deploy" / "docker" / "compose.yaml", {})
    assert set(containers.ORDER) <= set(site)


def test_pip_settings_are_handed_on_with_the_paths_they_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    index = tmp_path / "index" / "simple"
    index.mkdir(parents=True)
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    for name in [name for name in os.environ if name.startswith("PIP_") and name != "PIP_CONFIG_FILE"]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("PIP_EXTRA_INDEX_URL", f"file://{index}")
    monkeypatch.setenv("PIP_TIMEOUT", "77")
    paths = write_settings(tmp_path / "pip.conf")
    assert paths == [tmp_path / "index"], "the files of an index lie beside it"
    text = (tmp_path / "pip.conf").read_text()
    assert f"extra-index-url = file://{index}\n" in text
    assert "timeout = 77\n" in text


@pytest.mark.parametrize("name", TRIALS)
def test_a_trial_refuses_without_its_tools_in_a_sentence(name: str, tmp_path: Path) -> None:
    environment = {**os.environ, "PATH": str(tmp_path), "PYTHONPATH": str(ROOT), "TUBERLINE_TRIAL": str(tmp_path / "t")}
    done = subprocess.run(
        [sys.executable, "-m", f"deploy.trial.{name}"],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env=environment,
        timeout=60,
    )
    assert done.returncode == 2
    (sentence,) = done.stderr.splitlines()
    assert "debootstrap" in sentence
    assert "apt-get install" in sentence
    assert list(tmp_path.iterdir()) == [], "nothing was made"


def test_a_trial_refuses_anybody_but_root_with_what_it_would_change(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tools.os, "geteuid", lambda: 1000)
    with pytest.raises(TrialError, match="make boot needs root: it mounts"):
        tools.need_root("make boot", "it mounts")


def test_a_second_trial_is_refused_while_the_first_has_the_network() -> None:
    space = f"tuberline-test-{os.getpid()}"
    try:
        with tools.alone(space), pytest.raises(TrialError, match=space), tools.alone(space):
            pytest.fail("two trials at once")
        with tools.alone(space):
            pass
    finally:
        Path("/run/lock", space).unlink(missing_ok=True)


def test_a_table_replaces_the_one_before_and_says_how_it_was_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "deploy.md"
    page.write_text("before\n<!-- boot -->\n<!-- end of boot -->\nafter\n")
    monkeypatch.setattr(tools, "DOCS", page)
    for seen in ("first", "second"):
        tools.into_docs("boot", tools.table(("what", "seen"), [("a boot", seen)]), ("env",))
    lines = page.read_text().splitlines()
    assert (lines[0], lines[-1]) == ("before", "after")
    assert re.search(r"\d{4}, `make boot`,\s+tuberline " + re.escape(tools.version()), page.read_text())
    assert "| a boot | second |" in lines
    assert "first" not in page.read_text()


def test_belt_that_passes_while_the_power_is_off_leaves_the_recording(tmp_path: Path) -> None:
    depth = tmp_path / "front" / "depth"
    depth.mkdir(parents=True)
    rows = [f"{seq},{seq * 100_000_000},{seq * 0.01:.2f}" for seq in range(300)]
    for seq in range(300):
        (depth / f"{seq:06d}.png").touch()
    (tmp_path / "front" / "frames.csv").write_text("seq,captured_ns,travel_m\n" + "\n".join(rows) + "\n")
    assert powercuts.belt_runs_on(tmp_path, travelled_m=0.495) == powercuts.OFF_FRAMES
    first = 50 + powercuts.AHEAD_FRAMES
    gone = set(range(first, first + powercuts.OFF_FRAMES))
    left = [int(line.split(",")[0]) for line in (tmp_path / "front" / "frames.csv").read_text().splitlines()[1:]]
    assert left == [seq for seq in range(300) if seq not in gone]
    assert {int(file.stem) for file in depth.iterdir()} == set(left)
    assert powercuts.belt_runs_on(tmp_path, travelled_m=1e9) == 0, "what has ended is left alone"


def test_power_cuts_in_parts_are_the_same_cuts(tmp_path: Path) -> None:
    """What an earlier call left is gone on with; of another plan nothing is taken over."""
    plan = powercuts.Plan(seed=1630, cuts=30, tubers=150, speed=4.0)
    moments = plan.moments()
    assert moments == plan.moments()
    counts = [count for _, count in moments if count is not None]
    assert counts == sorted(counts), "each cut comes with more in the ledger than the one before"
    assert 15 <= len(counts) <= 25
    assert counts[-1] < 150
    file = tmp_path / "cuts.json"
    assert powercuts.kept(file, plan) is None
    cuts = powercuts.Cuts(at_boot=2, running=3, unseen_frames=40, tubers_at_cut=[0, 0, 7], committed={"1": "{}"})
    powercuts.keep(file, plan, cuts)
    assert powercuts.kept(file, plan) == cuts
    assert powercuts.kept(file, replace(plan, seed=1)) is None


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("name", TRIALS)
def test_the_trial_itself(name: str, tmp_path: Path) -> None:
    needed = {**(engine.TOOLS if name == "images" else machine.TOOLS), "debootstrap": "debootstrap"}
    missing = [tool for tool in needed if shutil.which(tool) is None]
    if os.geteuid() != 0 or missing:
        pytest.skip(f"make {name} needs root and {', '.join(missing) or 'its tools'}: not run")
    done = subprocess.run(
        [sys.executable, "-m", f"deploy.trial.{name}"],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env={**os.environ, "TUBERLINE_TRIAL": str(tmp_path)},
    )
    assert done.returncode == 0, done.stderr[-2000:]
