"""deploy/install.sh for a line with an encoder, a GNSS receiver, alarms or a viewer: what runs, with which rights."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.deploy.test_deploy_systemd import DEPLOY, LEDGER, TUBERLINE, contents, install

pytestmark = pytest.mark.skipif(not TUBERLINE.exists(), reason=f"{TUBERLINE} is not installed")

SECTIONS = {
    "encoder": '[encoder]\nsource = "serial:/dev/ttyACM0"\nmetres_per_pulse = 0.0005\nname = "shaft"\n',
    "gnss": '[gnss]\nsource = "serial:/dev/ttyUSB0?baud=9600"\nname = "roof"\n',
    "alarms": '[alarms]\nchannels = ["https://farm.example/alarms"]\n',
    "viewer": "[viewer]\n",
}
LIVE = (
    'name = "field"\n[cameras.left]\nsource = "realsense"\nserial = "000000000001"\nbelt_distance_m = 0.46\n' + LEDGER
)
RECORDED = f'name = "field"\n{LEDGER}[cameras.left]\npath = "/recording"\n'


def config(folder: Path, *sections: str, cameras: str = LIVE) -> Path:
    """A line's file with these of `SECTIONS`."""
    (file := folder / "line.toml").write_text(cameras + "".join(SECTIONS[section] for section in sections))
    return file


def devices(root: Path) -> set[str]:
    """Which of these roles line field starts."""
    nodes = (root / "etc/systemd/system/tuberline@field.target.d/nodes.conf").read_text()
    return set(re.findall(r"Wants=tuberline-(encoder|gnss|alarms|viewer)@field(?::viewer)?\.service", nodes))


def test_the_groups_of_a_camera_s_unit_may_open_a_realsense(tmp_path: Path) -> None:
    """Debian gives a camera's pictures to the group video and its USB device to root alone."""
    done = install(tmp_path, config=config(tmp_path))
    assert (done.returncode, done.stderr) == (0, "")
    rules = (tmp_path / "etc/udev/rules.d/60-tuberline.rules").read_text()
    given = re.findall(r'^SUBSYSTEM=="(\w+)".*"8086", ATTRS?{product}=="\*RealSense\*", GROUP="(\w+)"', rules, re.M)
    unit = (tmp_path / "etc/systemd/system/tuberline-camera@.service.d/20-device.conf").read_text()
    asked = re.findall(r"^DeviceAllow=char-(\w+) rw$", unit, re.M)
    (groups,) = re.findall(r"^SupplementaryGroups=(.*)$", unit, re.M)
    assert dict(given) == {"usb": "plugdev", "video4linux": "video"}
    assert asked == ["usb_device", "video4linux"]
    assert set(groups.split()) == {group for _, group in given}


def test_a_regressor_s_unit_may_open_a_gpu_and_keep_what_is_compiled_for_it(tmp_path: Path) -> None:
    """Nodes see no devices; Triton and the driver would write into a home that is not there."""
    done = install(tmp_path, config=config(tmp_path))
    assert (done.returncode, done.stderr) == (0, "")
    units = tmp_path / "etc/systemd/system"
    (own,) = (units / "tuberline-regressor@.service.d").iterdir()
    (common,) = (units / "tuberline-.service.d").iterdir()
    assert own.name > common.name
    said = own.read_text().splitlines()
    assert {"PrivateDevices=no", "DevicePolicy=closed", "DeviceAllow=char-nvidia* rw"} <= set(said)
    (kept,) = (line for line in said if line.startswith("Environment="))
    folders = re.findall(r"_(?:DIR|PATH)=(\S+)", kept)
    assert folders == ["/var/cache/tuberline/triton", "/var/cache/tuberline/cuda"]
    assert "CacheDirectory=tuberline" in common.read_text()


@pytest.mark.parametrize(
    ("sections", "cameras", "started"),
    [
        (("encoder", "gnss"), LIVE, {"encoder", "gnss"}),
        (("encoder",), LIVE, {"encoder"}),
        (("gnss",), LIVE, {"gnss"}),
        (("alarms",), LIVE, {"alarms"}),
        (("viewer",), LIVE, {"viewer"}),
        ((), LIVE, set()),
        (("encoder", "gnss"), RECORDED, {"gnss"}),
        (("encoder", "alarms"), RECORDED, {"alarms"}),
        (("encoder",), RECORDED + "waits = false\n", set()),
        (("encoder",), RECORDED + "waits = false\nstarts_at_s = 1795000000.0\n", {"encoder"}),
    ],
)
def test_without_roles_what_the_file_has_runs(
    tmp_path: Path, sections: tuple[str, ...], cameras: str, started: set[str]
) -> None:
    """As `tuberline run` starts it: a recording tells the belt's travel itself, but one that plays as a device does."""
    done = install(tmp_path / "root", config=config(tmp_path, *sections, cameras=cameras))
    assert done.returncode == 0, done.stderr
    assert devices(tmp_path / "root") == started
    assert "tuberline-aggregator@field.service" in done.stdout


def test_what_a_shell_would_read_as_an_escape_is_a_part_of_the_name(tmp_path: Path) -> None:
    """dash's echo made a tab of the \\t in the file's JSON, and Python a traceback of the tab."""
    file = config(tmp_path, "gnss", cameras=LIVE + 'cultivar = "Agria\\tnew"\n')
    done = install(tmp_path / "root", config=file)
    assert (done.returncode, done.stderr) == (0, "")
    assert devices(tmp_path / "root") == {"gnss"}


def test_what_runs_is_told_by_the_file_that_is_kept(tmp_path: Path) -> None:
    root = tmp_path / "root"
    assert install(root, config=config(tmp_path)).returncode == 0
    assert install(root, config=config(tmp_path, "encoder", "gnss")).returncode == 0
    assert devices(root) == set()
    refused = install(root, "--roles", "encoder", config=tmp_path / "line.toml")
    assert "field.toml, which is kept without --replace; add it with source" in refused.stderr
    assert install(root, "--replace", config=tmp_path / "line.toml").returncode == 0
    assert devices(root) == {"encoder", "gnss"}


@pytest.mark.parametrize(("role", "other"), [("encoder", "gnss"), ("gnss", "encoder")])
def test_with_roles_only_those_run(tmp_path: Path, role: str, other: str) -> None:
    file = config(tmp_path, role)
    done = install(tmp_path / "root", "--roles", f"camera,{role}", config=file)
    assert done.returncode == 0, done.stderr
    assert devices(tmp_path / "root") == {role}
    assert install(tmp_path / "root", "--roles", "camera", config=file).returncode == 0
    assert devices(tmp_path / "root") == set()
    before = contents(tmp_path / "root")
    refused = install(tmp_path / "root", "--roles", f"camera,{other}", config=file)
    assert refused.returncode == 2
    assert f'role {other}: there is no [{other}] in {file}; add it with source = "serial:/dev/' in refused.stderr
    assert ("metres_per_pulse" in refused.stderr) == (other == "encoder")
    named = install(tmp_path / "root", "--roles", f"{role}=shaft", config=file)
    assert (named.returncode, f"role '{role}=shaft' is not known" in named.stderr) == (2, True), "the file names it"
    assert contents(tmp_path / "root") == before


def test_alarms_without_channels_are_refused(tmp_path: Path) -> None:
    """Their unit would fail at every boot."""
    file = config(tmp_path)
    refused = install(tmp_path / "root", "--roles", "router,alarms", config=file)
    assert (refused.returncode, f"role alarms: there is no [alarms] in {file}; add it with" in refused.stderr) == (
        2,
        True,
    )
    assert not (tmp_path / "root").exists()


def test_each_gets_the_certificate_of_its_name_or_of_its_role(tmp_path: Path) -> None:
    (made := tmp_path / "certs").mkdir()
    for stem in ("ca", "operator", "encoder.shaft", "gnss"):
        for end in ("pem", "key"):
            (made / f"{stem}.{end}").write_text(f"{stem}.{end}")
    words = ("--roles", "encoder,gnss", "--certs", str(made))
    done = install(tmp_path / "root", *words, config=config(tmp_path, "encoder", "gnss"))
    assert done.returncode == 0, done.stderr
    copied = {file.name for file in (tmp_path / "root/etc/tuberline/certs").iterdir()}
    assert copied == {"ca.pem"} | {f"{s}.{x}" for s in ("operator", "encoder.shaft", "gnss") for x in ("pem", "key")}
    (made / "gnss.pem").unlink()
    refused = install(tmp_path / "other", *words, config=tmp_path / "line.toml")
    assert (refused.returncode, "gnss.pem is not there: " in refused.stderr) == (2, True)


def test_certs_make_makes_what_is_copied(tmp_path: Path) -> None:
    pytest.importorskip("cryptography", reason="certificates need tuberline[deploy]")
    from tuberline.cli.certs import make

    link = '[link]\nrouter = "tls/10.0.0.7:7447"\ncerts = "/etc/tuberline/certs"\n[access]\nenabled = true\n'
    file = config(tmp_path, "encoder", "gnss", cameras=LIVE + link)
    make(file, out=tmp_path / "certs")
    done = install(tmp_path / "root", "--certs", str(tmp_path / "certs"), config=file)
    assert done.returncode == 0, done.stderr
    copied = {each.name for each in (tmp_path / "root/etc/tuberline/certs").iterdir()}
    assert {"encoder.shaft.pem", "encoder.shaft.key", "gnss.roof.pem", "gnss.roof.key"} <= copied


@pytest.mark.parametrize("role", ["encoder", "gnss"])
def test_the_unit_may_read_serial_ports(role: str) -> None:
    """A drop-in that comes after what all nodes have in common, which shows a node no device."""
    units = DEPLOY / "systemd"
    (own,) = (units / f"tuberline-{role}@.service.d").iterdir()
    (common,) = (units / "tuberline-.service.d").iterdir()
    assert own.name > common.name
    assert "PrivateDevices=yes" in common.read_text()
    said = own.read_text().splitlines()
    assert {"PrivateDevices=no", "DevicePolicy=closed", "SupplementaryGroups=dialout"} <= set(said)
    assert [line for line in said if line.startswith("DeviceAllow")] == [
        f"DeviceAllow=char-{kind} rw" for kind in ("ttyUSB", "ttyACM", "ttyS", "ttyAMA", "ttyTHS")
    ]
    # What is not loaded at its start stays closed to it, and an adapter may be plugged in later.
    modules = "modprobe@usbserial.service modprobe@cdc_acm.service"
    assert {f"Wants={modules}", f"After={modules}"} <= set(said)
    assert "g dialout -" in (units / "sysusers.conf").read_text().splitlines()
