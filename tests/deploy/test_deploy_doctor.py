"""`tuberline doctor`, `health`, `bundle`, `metrics`: each fault is found with its fix, on real files and sessions."""

from __future__ import annotations

import errno
import json
import os
import resource
import signal
import socket
import subprocess
import sys
import tarfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import torch

from aggregator.calibration.tickets import Ticket, write_tickets
from conveyor import __version__, topics
from conveyor.config import AggregatorConfig, LineConfig, LinkConfig, RegressorConfig, load_config, parse_config
from conveyor.delivery import KeptPublisher
from conveyor.errors import LinkError
from conveyor.identity import Identity
from conveyor.messages import Counters, Totals
from conveyor.node import Node
from conveyor.observer import Observer
from conveyor.taken_port import free_port
from regressor.network.stored import SHIPPED, read_weights
from tests.conftest import wait_until
from tests.deploy.deploy_site import site_config
from tuberline.cli.address import LineAddress
from tuberline.cli.doctor import bundle, doctor
from tuberline.cli.health import health
from tuberline.doctor import Finding, Level, machine, worst
from tuberline.doctor.bundle import write_bundle
from tuberline.doctor.examine import Live, examine, look
from tuberline.doctor.gpu import check_gpu
from tuberline.doctor.line import ClockWatch, check_clocks, check_nodes, check_versions
from tuberline.doctor.link import check_certificates, check_port, no_router
from tuberline.doctor.machine import check_clock, check_disk, check_locked_memory, check_processors, check_usb
from tuberline.doctor.weights import check_tickets

NOW = datetime(2026, 5, 1, tzinfo=UTC)


def counters(name: str, **changes: object) -> Counters:
    role, node = name.split("/")
    values = {"host": "edge", "version": __version__, "status": "ok", **changes}
    return Counters(role, node, "r1", 7, uptime_s=3.0, values={}, gauges={}, **values)  # type: ignore[arg-type]


def only(findings: list[Finding]) -> Finding:
    assert len(findings) == 1, findings
    return findings[0]


def test_a_gpu_that_is_asked_for_is_looked_for() -> None:
    asked = RegressorConfig(device="cuda", processes=1)
    found = only(check_gpu(LineConfig(regressor=asked)))
    if torch.cuda.is_available():
        assert (found.level, "its sampling kernel can be built" in found.text) == (Level.OK, True)
    else:
        assert (found.level, "finds no CUDA GPU here" in found.text) == (Level.FAULT, True)
    assert check_gpu(LineConfig(regressor=RegressorConfig(device="cuda", processes=0))) == []
    assert check_gpu(LineConfig()) == []


def test_weights_of_regressors_on_other_hosts_are_not_missed_here(tmp_path: Path) -> None:
    """Where regressors run, weights that are not there are a fault, also on a host without torch."""
    for processes, level in ((0, Level.OK), (1, Level.FAULT)):
        asked = RegressorConfig(weights=tmp_path / "w.safetensors", processes=processes)
        found = examine(LineConfig(regressor=asked, aggregator=AggregatorConfig(out=tmp_path)), offline=True)
        assert [finding.level for finding in found if finding.check == "weights"] == [level]


def test_tickets_are_of_the_weights_that_weigh(tmp_path: Path) -> None:
    """A line whose weights changed weighed without a calibration, and nothing told of it."""
    config = LineConfig(aggregator=AggregatorConfig(tickets=tmp_path / "tickets.json"))
    assert check_tickets(LineConfig()) == []
    assert only(check_tickets(config)).level is Level.FAULT
    for model, level in (("monday@1", Level.WARNING), (read_weights(SHIPPED)[1].model_id, Level.OK)):
        write_tickets(tmp_path / "tickets.json", [Ticket("r", model, 9e3, 9.0, 8e3, 8.0, 1.0)])
        found = only(check_tickets(config))
        assert (found.level, "no ticket calibrates what" in found.text) == (level, level is Level.WARNING)
    assert "1 of tuberline-sim@" in found.text


def test_a_fix_belongs_to_every_fault_and_to_no_ok() -> None:
    with pytest.raises(ValueError, match="a fix belongs"):
        Finding("disk", Level.FAULT, "full")
    assert worst([]) is Level.OK
    assert worst([Finding("a", Level.WARNING, "x", "y"), Finding("b", Level.OK, "z")]) is Level.WARNING


def test_disk_says_free_space_and_a_read_only_place(tmp_path: Path) -> None:
    found = only(check_disk(tmp_path / "not" / "yet", what="the ledger"))
    assert "GB free, a file is durable after" in found.text
    assert list(tmp_path.iterdir()) == [], "the check leaves nothing behind"
    readonly = only(check_disk(Path("/proc/self"), what="the ledger"))
    assert readonly.level is Level.FAULT
    assert "/proc/self cannot be written" in readonly.text


@pytest.mark.parametrize(
    ("number", "fix"),
    [
        (errno.ENOSPC, "remove old recordings and runs from the disk of"),
        (errno.EDQUOT, "remove old recordings and runs from the disk of"),
        (errno.EROFS, "mount the file system of"),
        (errno.EACCES, "give the user that runs Tuberline the right to write"),
        (errno.EIO, "the disk reports a fault: check it before you go on"),
        (errno.ENXIO, "check the disk of"),
    ],
)
def test_what_a_disk_refuses_is_told_with_what_helps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, fix: str
) -> None:
    """On a full disk it said to give a user the right to write."""

    def refuse(folder: Path) -> float:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(machine, "_sync_ms", refuse)
    found = only(check_disk(tmp_path, what="the ledger"))
    assert (found.level, found.text) == (Level.FAULT, f"{tmp_path} cannot be written: {os.strerror(number)}")
    assert found.fix.startswith(fix)


def test_a_clock_before_what_was_written_here_is_told(tmp_path: Path) -> None:
    """A computer without a clock of its own starts in 1970: a line counted, and its loads stood under that day."""
    assert only(check_clock(tmp_path, now_s=time.time())).level is Level.OK
    (tmp_path / "ledger.db").touch()
    os.utime(tmp_path / "ledger.db", (4e9, 4e9))
    assert only(check_clock(tmp_path, now_s=4e9 - 3000)).level is Level.OK
    late = only(check_clock(tmp_path, now_s=4e9 - 9000))
    assert (late.level, late.text) == (
        Level.WARNING,
        f"it says 2096-10-02 04:36 UTC, and {tmp_path / 'ledger.db'} was written 2.5 hours later",
    )
    assert "was written" in only(check_clock(tmp_path / "none", now_s=30)).text
    assert late.fix.startswith("set it (`timedatectl set-time`")


def test_processors_and_locked_memory() -> None:
    config = parse_config({"cameras": {"a": {}, "b": {}}, "regressor": {"processes": 4}}, where="test")
    assert only(check_processors(config, cores=6)).level is Level.OK
    short = only(check_processors(config, cores=4))
    assert (short.level, short.text) == (Level.WARNING, "4 cores for 2 segmenters and 4 regressor threads")
    assert "lower regressor.processes to 2" in short.fix
    one = parse_config({"cameras": {"a": {}}, "regressor": {"processes": 1}}, where="test")
    assert only(check_processors(one, cores=1)).fix.startswith("run regressors on another machine"), "1 is set already"
    assert "8 MiB" in only(check_locked_memory(8 << 20)).text
    assert "unlimited" in only(check_locked_memory(resource.RLIM_INFINITY)).text


def test_usb_finds_missing_and_slow_cameras(tmp_path: Path) -> None:
    config = parse_config({"cameras": {"left": {"source": "realsense"}}}, where="test")
    assert check_usb(LineConfig(), devices=tmp_path) == []
    assert only(check_usb(config, devices=tmp_path)).text.startswith("0 RealSense devices for 1 cameras (left)")
    device = tmp_path / "2-1"
    device.mkdir()
    for name, text in {"idVendor": "8086\n", "product": "Intel(R) RealSense(TM) Depth Camera 405\n"}.items():
        (device / name).write_text(text)
    (device / "speed").write_text("480\n")
    assert only(check_usb(config, devices=tmp_path)).fix.startswith("use a USB 3 port")
    (device / "speed").write_text("5000\n")
    assert only(check_usb(config, devices=tmp_path)).level is Level.OK


def test_certificates_are_watched_for_expiry_privacy_and_the_routers_name(tmp_path: Path) -> None:
    certs = pytest.importorskip("tuberline.certs")
    config = site_config(7447, tmp_path)
    missing = only(check_certificates(config, now=NOW))
    assert "ca.pem cannot be read" in missing.text
    certs.make_authority(tmp_path, site="north", now=NOW)
    certs.issue(tmp_path, Identity("router"), line="north", hosts=["edge"], now=NOW)
    certs.issue(tmp_path, Identity("camera", "front"), line="north", days=20, now=NOW)
    (tmp_path / "camera.front.key").chmod(0o644)
    texts = {f.text: f for f in check_certificates(config, now=NOW + timedelta(days=5))}
    assert {text.removeprefix(str(tmp_path)): f.level for text, f in texts.items()} == {
        "/camera.front.pem expires in 15 days": Level.WARNING,
        "/camera.front.key can be read by others": Level.FAULT,
        "/router.pem is for edge, but nodes call 127.0.0.1": Level.FAULT,
    }
    anywhere = config.model_copy(update={"link": config.link.model_copy(update={"router": "tls/0.0.0.0:7447"})})
    assert any('link.listen = ["tls/0.0.0.0:7447"]' in f.fix for f in check_certificates(anywhere, now=NOW))
    late = check_certificates(config, now=NOW + timedelta(days=23))
    assert any("camera.front.pem expired 3 days ago" in f.text and "--renew" in f.fix for f in late)
    old = check_certificates(config, now=NOW + timedelta(days=3640))
    assert ["--out ANOTHER_FOLDER" in f.fix for f in old if "ca.pem expires in 10 days" in f.text] == [True]
    assert check_certificates(LineConfig(), now=NOW) == []


def test_a_port_nobody_listens_on(free_port: int) -> None:
    found = only(check_port(LinkConfig(router=f"tcp/127.0.0.1:{free_port}")))
    assert f"127.0.0.1:{free_port} does not answer" in found.text
    assert "tuberline router" in found.fix
    assert found.fix.startswith("start the line (`tuberline run`"), "most often it is only not started"
    assert "tuberline doctor --offline" in found.fix


def test_nodes_versions_and_clocks() -> None:
    config = parse_config({"cameras": {"front": {}}}, where="test")
    here = {"aggregator/aggregator", "camera/front", "segmenter/front", "regressor/r1"}
    nodes = {name: counters(name) for name in here}
    assert only(check_nodes(config, nodes, alive=here)).text == "4 nodes alive, none stalled"
    heard = {name: report for name, report in nodes.items() if name != "regressor/r1"}
    assert only(check_nodes(config, heard, alive=here)).text.startswith("regressor/r1 is there, and no report")
    nodes["segmenter/front"] = counters("segmenter/front", status="stalled")
    found = [f.text for f in check_nodes(config, nodes, alive=here - {"camera/front", "regressor/r1"})]
    assert found == ["camera/front is not there", "no regressor is there", "segmenter/front is stalled (pid 7 on edge)"]
    nodes["regressor/r1"] = counters("regressor/r1", version="0.0.9", host="barn")
    assert "regressor/r1 on barn runs 0.0.9" in only(check_versions(nodes, own=__version__)).text
    skewed = check_clocks({"camera/front": -3.5, "segmenter/front": 0.4, "regressor/r1": 0.01}, nodes)
    assert [(f.level, f.text) for f in skewed] == [
        (Level.FAULT, "camera/front on edge is 3.50 s behind this machine"),
        (Level.WARNING, "segmenter/front on edge is 0.40 s ahead of this machine"),
    ]


@pytest.fixture
def line(tmp_path: Path, link: LinkConfig) -> Path:
    """The config of a line whose router runs; its camera's recording does not exist."""
    path = tmp_path / "line.toml"
    path.write_text(
        f'name = "north"\n[link]\nrouter = "{link.router}"\n[cameras.front]\npath = "absent.mcap"\n'
        f'[regressor]\nweights = "absent.safetensors"\n[aggregator]\nout = "out"\n'
    )
    return path


@pytest.fixture
def camera(line: Path) -> Iterator[Node]:
    with Node("camera", "front", config=load_config(line), run="r1") as node:
        node.counters.add("frames_published", 7)
        node.counters.gauge("frames published/odd", 2.5)
        done = threading.Event()
        turning = threading.Thread(target=lambda: [node.progress() for _ in iter(lambda: done.wait(0.5), True)])
        turning.start()
        yield node
        done.set()
        turning.join()


@pytest.mark.graph
def test_doctor_examines_a_running_line(line: Path, camera: Node, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        doctor(config=line, json=True)
    assert left.value.code == 1
    report = json.loads(capsys.readouterr().out)
    found = {(f["check"], f["level"]): f for f in report["findings"]}
    assert report["worst"] == "fault"
    assert "absent.mcap does not exist" in found["camera front", "fault"]["text"]
    assert "absent.safetensors" in found["weights", "fault"]["text"]
    assert "absent.safetensors" in found["weights", "fault"]["text"]
    assert found["router port", "ok"]["text"].endswith("answers")
    assert found["versions", "ok"]["text"] == f"all 1 nodes run {__version__}"
    assert "1 nodes within 0." in found["clocks", "ok"]["text"]
    assert [f["text"] for f in report["findings"] if f["check"] == "nodes"] == [
        "aggregator/aggregator is not there",
        "segmenter/front is not there",
        "no regressor is there",
    ]


@pytest.mark.graph
def test_health_is_a_yes_or_one_clear_no(line: Path, camera: Node, capsys: pytest.CaptureFixture[str]) -> None:
    health(address=LineAddress(line))
    health(address=LineAddress(line), node="camera/front", timeout_s=60.0)
    assert "camera/front is well" in capsys.readouterr().out
    with pytest.raises(LinkError, match="camera/rear of line 'north' is not alive; alive: camera/front"):
        health(address=LineAddress(line), node="camera/rear", timeout_s=0.5)


@pytest.mark.graph
def test_bundle_holds_what_helps_and_no_private_key(line: Path, camera: Node, tmp_path: Path) -> None:
    certs = pytest.importorskip("tuberline.certs")
    out = load_config(line).aggregator.out
    (out / "logs").mkdir(parents=True)
    (out / "logs" / "camera-front.log").write_text("no depth scale\n")
    (out / "summary.json").write_text("{}")
    certs.make_authority(out / "logs", site="north")
    bundle(config=line, out=tmp_path / "help.tar.gz")
    with tarfile.open(tmp_path / "help.tar.gz") as archive:
        files = {name: archive.extractfile(name) for name in archive.getnames()}
        content = {name.removeprefix("tuberline-north/"): file.read() for name, file in files.items() if file}
    assert {"config.toml", "versions.json", "access.json", "doctor.json", "results/summary.json"} < set(content)
    assert content["logs/camera-front.log"] == b"no depth scale\n"
    assert json.loads(content["counters.json"])["camera/front"]["values"]["frames_published"] == 7
    assert json.loads(content["versions.json"])["tuberline"] == __version__
    assert not [name for name, data in content.items() if b"PRIVATE KEY" in data]


def test_a_journal_that_takes_long_is_packed_as_far_as_it_came(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was a traceback, and no archive."""
    (tmp_path / "journalctl").write_text("#!/bin/sh\necho first words\nexec sleep 60\n")
    (tmp_path / "journalctl").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    write_bundle(tmp_path / "help.tar.gz", LineConfig(), reports={}, journal_within_s=1.0)
    with tarfile.open(tmp_path / "help.tar.gz") as archive:
        file = archive.extractfile("tuberline-line/logs/journal.txt")
        assert file is not None
        assert file.read().splitlines() == [
            b"first words",
            b"journalctl was not done after 1 s: what follows is missing",
        ]


@pytest.mark.graph
def test_an_unreachable_line_is_a_finding_not_a_crash(free_port: int, tmp_path: Path) -> None:
    config = parse_config(
        {"link": {"router": f"tcp/127.0.0.1:{free_port}"}, "aggregator": {"out": str(tmp_path)}}, where="test"
    )
    live = look(config.model_copy(update={"link": config.link.model_copy(update={"lease_ms": 2000})}))
    assert "no router answered" in live.unreachable
    findings = examine(config, live=live)
    assert {f.check for f in findings if f.level is Level.FAULT} == {"router port", "line"}
    assert worst(examine(config, live=Live(), offline=True)) is not Level.FAULT
    with socket.create_server(("127.0.0.1", free_port)):
        (found,) = no_router(config.link, check_port(config.link), live.unreachable)
    assert found.text.endswith(" s, though something listens there"), "another program; it said to start the line"
    assert f"`ss -ltnp 'sport = :{free_port}'`" in found.fix


@pytest.mark.graph
def test_a_clock_that_is_off_by_an_hour_is_seen(link: LinkConfig) -> None:
    with Observer(link, line="north") as observer:
        watch = ClockWatch(observer)
        publisher = KeptPublisher(observer, topics.COUNTERS, role="segmenter", name="front")
        late = replace(counters("segmenter/front"), gauges={"clock_unix_s": time.time() - 3600})
        publisher.put(late)
        wait_until(watch.offsets_s, what="counters with a clock")
        assert -3602 < watch.offsets_s()["segmenter/front"] < -3599


@pytest.mark.graph
def test_prometheus_scrapes_counters_levels_and_totals(line: Path, camera: Node) -> None:
    pytest.importorskip("prometheus_client", reason="metrics need tuberline[deploy]")
    totals = KeptPublisher(camera, topics.TOTALS)
    totals.put(Totals("r1", 3, 512.5, 480.0, 540.0, 0.75, 600.0, 550.0, 650.0, 1.5, 50.0, (0, 3), {}, final=False))
    address = f"127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "tuberline", "metrics", "--config", str(line), "--listen", address]
    with subprocess.Popen(command) as exporter:
        try:
            page = scrape_until(f"http://{address}/metrics", "tuberline_load_tubers", "frames_published_total")
        finally:
            exporter.send_signal(signal.SIGTERM)
        assert exporter.wait(30) == 0
    host = os.uname().nodename
    labels = f'{{host="{host}",line="north",name="front",role="camera",run="r1"}}'
    assert f"tuberline_frames_published_total{labels} 7.0" in page
    assert f"tuberline_frames_published_odd{labels} 2.5" in page
    assert f"tuberline_node_stalled{labels} 0.0" in page
    assert f'tuberline_node_up{{line="north",name="front",role="camera",version="{__version__}"}} 1.0' in page
    assert 'tuberline_load_weight_grams{line="north",run="r1"} 512.5' in page
    assert 'tuberline_load_belt_seen_ratio{line="north",run="r1"} 0.75' in page
    assert "# TYPE tuberline_frames_published_total counter" in page


def scrape_until(url: str, *wanted: str) -> str:
    """The first page that holds all `wanted`."""
    page = ""

    def complete() -> bool:
        nonlocal page
        try:
            with urllib.request.urlopen(url, timeout=2.0) as answer:
                page = answer.read().decode()
        except OSError:
            return False
        return all(text in page for text in wanted)

    wait_until(complete, what=f"{', '.join(wanted)} at {url}")
    return page


def test_a_name_that_is_both_counter_and_level_keeps_one_type() -> None:
    exporter = pytest.importorskip("tuberline.metrics")
    pair = [
        Counters("viewer", "a", "r1", 1, "h", "1", 1.0, {"queue": 4}, {}),
        Counters("regressor", "b", "r1", 1, "h", "1", 1.0, {}, {"queue": 2.0}),
    ]
    nodes = {f"{c.role}/{c.name}": c for c in pair}
    families = {family.name: family for family in exporter.node_metrics(nodes, alive=set(nodes), line="north")}
    told = {name: (found.type, {s.name: s.value for s in found.samples}) for name, found in families.items()}
    assert told["tuberline_queue"] == ("counter", {"tuberline_queue_total": 4})
    assert told["tuberline_queue_level"] == ("gauge", {"tuberline_queue_level": 2.0})
