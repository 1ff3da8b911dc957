"""`tuberline run` ends by itself where it was told to, and where nothing is left that could work."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from conveyor.config import load_config
from conveyor.errors import PERMANENT, ConfigError, InputError, TuberlineError
from conveyor.taken_port import free_port
from regressor.network.stored import SHIPPED
from tests.belts import simulate, tuberline
from tests.chaos.test_chaos_resume import child, tubers
from tests.conftest import wait_until
from tests.conveyor.test_conveyor_orphan import gone
from tuberline.cli.config import check
from tuberline.cli.run import run, summarise_late
from tuberline.processes import usual_regressors

pytestmark = [pytest.mark.graph, pytest.mark.timeout(200)]


def line_file(folder: Path, recording: Path) -> Path:
    file = folder / "line.toml"
    file.write_text(
        f"""
[link]
router = "tcp/127.0.0.1:{free_port()}"
[cameras.front]
path = "{recording}"
speed = 0
[segmenter]
state_dir = "{folder}/state"
[regressor]
processes = 1
state_dir = "{folder}/weights"
[aggregator]
out = "{folder}/run"
exit_when_final = true
"""
    )
    return file


def test_a_line_ends_with_its_load_where_that_is_set(tmp_path: Path) -> None:
    """The aggregator had gone, and everybody else stayed forever."""
    recording = simulate(tmp_path / "belt", scene="singulated", tubers="4")
    done = tuberline("run", line_file(tmp_path, recording))
    assert done.returncode == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["final"], summary["state"]) == (True, "ended")
    assert summary["totals"]["count"] == 4


def test_a_run_that_cannot_go_on_is_refused_before_any_process_starts(tmp_path: Path) -> None:
    """Only the aggregator gave up: the line ran on, its cameras played, and nothing was counted."""
    file = line_file(tmp_path, simulate(tmp_path / "belt", scene="singulated", tubers="4"))
    tuberline("run", file, "--run", "monday")
    kept = (tmp_path / "run" / "summary.json").read_bytes()
    ledger, text = tmp_path / "run" / "ledger.db", file.read_text()
    for changed, said in (
        (text, f"ledger {ledger} already holds run 'monday', finished: counting it again would count every tuber"),
        (
            text.replace("[cameras.front]", "[cameras.back]\ncamera = 'front'").replace("exit_when_final = true", ""),
            f"run 'monday' in ledger {ledger} was begun with cameras front, the config has back; fix the config",
        ),
    ):
        file.write_text(changed)
        done = tuberline("run", file, "--run", "monday", check=False, timeout_s=60)
        assert (done.returncode, done.stderr.startswith(f"tuberline: {said}")) == (2, True), done.stderr
        assert len(done.stderr.splitlines()) == 1, "no process was started"
    assert (tmp_path / "run" / "summary.json").read_bytes() == kept


def test_a_line_stopped_while_its_aggregator_is_down_has_its_summary_from_the_ledger(tmp_path: Path) -> None:
    """There was none."""
    config = line_file(tmp_path, simulate(tmp_path / "belt", scene="singulated", tubers="12"))
    config.write_text(config.read_text().replace("speed = 0", "speed = 0.25"))
    command = [sys.executable, "-m", "tuberline", "run", str(config), "--run", "monday"]
    line = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    wait_until(lambda: tubers(tmp_path / "run") >= 2, what="two tubers in the ledger", timeout_s=90)
    aggregator = child(line.pid, "aggregator")
    assert aggregator is not None
    os.kill(aggregator, signal.SIGKILL)
    line.terminate()
    _, said = line.communicate(timeout=60)
    assert line.returncode == 0
    assert "the aggregator of run monday was down when the line was stopped" in said
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["run"], summary["final"], summary["state"]) == ("monday", False, "ended")
    assert summary["totals"]["count"] == tubers(tmp_path / "run") >= 2
    assert 0 < summary["coverage"] <= 1
    assert len((tmp_path / "run" / "tubers.csv").read_text().splitlines()) == 1 + summary["totals"]["count"]
    before = (tmp_path / "run" / "summary.json").read_bytes()
    (tmp_path / "run" / "summary.json").unlink()
    assert "of run monday" in tuberline("ledger", "summary", "--config", config).stdout
    assert json.loads(before)["totals"] == json.loads((tmp_path / "run" / "summary.json").read_text())["totals"]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 128 + signal.SIGTERM)])
def test_a_line_that_is_stopped_while_it_starts_starts_no_more(tmp_path: Path, number: int, code: int) -> None:
    """It started all its nodes first, each with what that loads: on a busy machine it left after 8 to 17 s."""
    config, logs = line_file(tmp_path, tmp_path / "belt"), tmp_path / "logs"
    command = [sys.executable, "-m", "tuberline", "run", str(config), "--logs", str(logs)]
    # Of a script's background job a shell lets Ctrl-C be ignored: these tests may run in one.
    line = subprocess.Popen(command, preexec_fn=lambda: signal.signal(number, signal.SIG_DFL))
    wait_until(lambda: (logs / "router.log").exists(), what="the first of its nodes", timeout_s=90)
    router = child(line.pid, "router")
    line.send_signal(number)
    assert line.wait(60) == code
    assert not (logs / "camera-front.log").exists()
    assert router is None or gone(router)


def test_the_summary_of_a_run_that_was_final_long_ago_is_left_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ctrl-C some seconds after a recording's end was told that the aggregator had been down."""
    line = load_config(line_file(tmp_path, tmp_path / "belt"))
    summary = tmp_path / "run" / "summary.json"
    summary.parent.mkdir()
    for text, told in (('{"run": "monday", "final": true}', False), ('{"run": "monday", "final": false}', True)):
        summary.write_text(text)
        os.utime(summary, (1, 1))
        summarise_late(line, "monday", stopped_s=100.0)
        assert ("was down" in capsys.readouterr().err) == told


def test_a_line_whose_only_camera_gave_up_ends_with_its_code_and_a_sentence(tmp_path: Path) -> None:
    done = tuberline("run", line_file(tmp_path, tmp_path / "nowhere"), check=False)
    assert done.returncode == 2
    last = done.stderr[done.stderr.rindex("tuberline: ") :]
    assert last.startswith("tuberline: the line is not kept up: camera-front gave up\n")
    assert "nowhere does not exist" in done.stderr


def test_a_name_or_a_folder_that_cannot_be_is_refused_before_any_process_starts(tmp_path: Path) -> None:
    """Every process said so for itself, in ten lines; without its ledger's folder a line played on uncounted."""
    file = line_file(tmp_path, tmp_path / "belt")
    taken = tmp_path / "taken"
    taken.touch()
    with pytest.raises(TuberlineError, match=r"^run name 'mon/day' cannot be used: 1 to 64 letters") as told:
        run(file, run="mon/day")
    assert told.value.exit_code == PERMANENT
    with pytest.raises(InputError, match=rf"^folder {taken} \(--logs\) cannot be made: File exists") as told:
        run(file, logs=taken)
    assert told.value.exit_code == PERMANENT
    file.write_text(file.read_text().replace(f"{tmp_path}/run", f"{taken}/run"))
    with pytest.raises(InputError, match=rf"^folder {taken}/run \(aggregator\.out\) cannot be made: Not a directory"):
        run(file)


def test_a_line_whose_only_segmenter_gave_up_ends_with_its_code(tmp_path: Path) -> None:
    """Its camera played on, and nothing was counted: no more than without a camera."""
    file = line_file(tmp_path, simulate(tmp_path / "belt", scene="singulated", tubers="4"))
    (tmp_path / "state").touch()
    done = tuberline("run", file, check=False, timeout_s=90)
    assert done.returncode == 2
    last = done.stderr[done.stderr.rindex("tuberline: ") :]
    assert last.startswith("tuberline: the line is not kept up: segmenter-front gave up\n")
    assert f"folder {tmp_path}/state for the camera's log (segmenter.state_dir) cannot be used" in done.stderr


def test_what_keeps_a_line_from_its_work_is_warned_of_by_config_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`config check` called each of these fine, and `run` gave up, or waited for a router that nobody reaches."""
    (tmp_path / "file").touch()
    (tmp_path / "belt.csv").touch()
    file, camera = tmp_path / "line.toml", f'\n[cameras.b]\npath = "{tmp_path}"'
    for text, told in (
        ("", "no camera is named: `tuberline run` and the aggregator refuse that; a router and regressors need none"),
        ('[link]\nrouter = "tls/edge:7447"', "link uses tls/edge:7447: set link.certs"),
        ('[link]\ncerts = "certs"', "link has certificates but link.router is tcp/127.0.0.1:7447, not encrypted"),
        ('[link]\nrouter = "tls/edge:7447"\ncerts = "certs"', f"link.certs: there is no folder {tmp_path}/certs on"),
        (
            '[link]\nlisten = ["tcp/0.0.0.0:7448"]',
            "link.listen: the router listens on port 7448, and link.router names",
        ),
        ('[cameras.a]\nsource = "ros2"\nbelt_distance_m = 0.4', "cameras.a has no topic: a ros2 camera cannot start"),
        ('[cameras.a]\npath = "belt.csv"', f"cameras.a.path: {tmp_path}/belt.csv is no recording Tuberline knows"),
        (
            '[aggregator]\nout = "file/run"',
            f"aggregator.out: {tmp_path}/file is a file on this computer: no folder can",
        ),
        ('[segmenter]\nstate_dir = "file"', f"segmenter.state_dir: {tmp_path}/file is a file on this computer"),
        ('[regressor]\nstate_dir = "file/a"', f"regressor.state_dir: {tmp_path}/file is a file on this computer"),
    ):
        file.write_text(text if "[cameras" in text or not text else text + camera)
        check(file)
        said = capsys.readouterr()
        assert said.err.startswith(f"warning: {told}"), text
        assert "is accepted, with 1 warning:" in said.out, said.err
    file.write_text('[link]\nrouter = "tcp/edge:7447"\nlisten = ["tcp/0.0.0.0:7447#iface=eth0"]' + camera)
    check(file)
    assert capsys.readouterr().err == ""


def test_a_line_whose_tickets_or_contract_cannot_be_read_is_refused_before_it_starts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`config check` called it fine; its aggregator ended at once and for good, and cameras and segmenters ran on: a
    whole recording passed and nothing was counted."""
    file = tmp_path / "line.toml"
    (tmp_path / "contract.toml").write_text("classes = 3\n", encoding="utf-8")
    file.write_text(
        f'[cameras.left]\npath = "{tmp_path}"\n[aggregator]\ntickets = "gone.json"\ncontract = "contract.toml"\n',
        encoding="utf-8",
    )
    check(file)
    warned = capsys.readouterr().err.splitlines()
    assert warned[0] == f"warning: aggregator.tickets: tickets {tmp_path / 'gone.json'} cannot be read: " + (
        "No such file or directory"
    )
    assert warned[1].startswith("warning: aggregator.contract: ")
    with pytest.raises(ConfigError, match=r"(?s)aggregator\.tickets: .*; aggregator\.contract: .*count nothing"):
        run(file)


def test_a_line_without_what_its_file_names_is_refused_before_it_starts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`config check` called it fine; such a line had no regressor and counted nothing, or lost a camera, its alarms or
    its positions. On a camera's own computer there need be no weights: it is warned of, not refused.
    """
    (tmp_path / "belt" / "left").mkdir(parents=True)
    (tmp_path / "belt" / "left" / "camera.json").write_text("{}")
    text = f'''
[cameras.front]
path = "{tmp_path}/belt"
camera = "lefty"
[cameras.left]
path = "{tmp_path}/belt"
[regressor]
weights = "gone.safetensors"
[segmenter]
weights = "gone.onnx"
[alarms]
channels_file = "gone.txt"
[gnss]
source = "file:{tmp_path}/gone.nmea"
'''
    file = tmp_path / "line.toml"
    file.write_text(text, encoding="utf-8")
    check(file)
    told = capsys.readouterr()
    assert "is accepted, with 5 warnings: line" in told.out
    assert [" ".join(line.split()[:4]) for line in told.err.splitlines()] == [
        f"warning: regressor.weights: weights {tmp_path}/gone.safetensors",
        "warning: segmenter.weights: the segmenter's",
        f"warning: cameras.front.camera: {tmp_path}/belt has",
        f"warning: alarms.channels_file {tmp_path}/gone.txt cannot",
        f"warning: gnss.source {tmp_path}/gone.nmea cannot",
    ]
    assert "has no camera 'lefty'; known: left" in told.err
    with pytest.raises(ConfigError, match=r"(?s)gone\.safetensors.*gone\.onnx.*lefty.*gone\.txt.*gone\.nmea"):
        run(file)
    unused = text.replace("[regressor]", "[regressor]\nprocesses = 0").replace(
        "[segmenter]", '[segmenter]\nmethod = "classical"'
    )
    file.write_text(unused, encoding="utf-8")
    check(file)
    assert not {"regressor.weights", "segmenter.weights"} & set(capsys.readouterr().err.replace(":", "").split())


def test_weights_that_are_none_are_found_before_a_line_starts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A text as .pth was called fine: each regressor gave up once all had started, and nothing was weighed."""
    whole, file = tmp_path / "whole.pth", tmp_path / "line.toml"
    torch.save({"a": torch.zeros(100)}, whole)
    shipped = SHIPPED.read_bytes()
    for name, data, fine in (
        ("notes.txt", b"not yet trained", False),
        ("cut.pth", whole.read_bytes()[:-50], False),
        ("cut.safetensors", shipped[:-50], False),
        ("whole.pth", whole.read_bytes(), True),
        ("whole.safetensors", shipped, True),
    ):
        (tmp_path / name).write_bytes(data)
        file.write_text(f'[cameras.front]\npath = "{tmp_path}"\n[regressor]\nweights = "{name}"\n', encoding="utf-8")
        check(file)
        told = f"regressor.weights: weights {tmp_path / name} are no safetensors file or PyTorch state dict"
        assert (told in capsys.readouterr().err) != fine, name
        if not fine:
            with pytest.raises(ConfigError, match=re.escape(told)):
                run(file)


def test_access_control_without_certificates_is_refused_before_it_starts(tmp_path: Path) -> None:
    """Its router ended, and the line after it."""
    file = line_file(tmp_path, tmp_path / "belt")
    file.write_text(file.read_text() + "[access]\nenabled = true\n")
    with pytest.raises(ConfigError, match=r"line\.toml: access\.enabled needs an endpoint with certificates"):
        run(file)


@pytest.mark.parametrize(("processors", "expected"), [(1, 1), (2, 2), (16, 2)])
def test_two_weigh_a_replay_where_two_processors_are_there(processors: int, expected: int) -> None:
    assert usual_regressors(processors) == expected
