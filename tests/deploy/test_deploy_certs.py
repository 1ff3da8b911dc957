"""`tuberline certs`: what is made, what is never overwritten, and that generated router files really open."""

from __future__ import annotations

import json
import stat
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import pytest
import zenoh

from conveyor.config import load_config
from conveyor.errors import ConfigError, InputError
from conveyor.files import replacing
from conveyor.identity import Identity
from tests.conftest import ROOT
from tests.deploy.deploy_site import site_config
from tuberline.zenohd import router_file, settings_text

pytest.importorskip("cryptography", reason="certificates need tuberline[deploy]")

from tuberline.certs import issue, make_authority, read_certificate
from tuberline.cli.certs import add, make, router_hosts, show

NOW = datetime(2026, 5, 1, tzinfo=UTC)
LINE = """
name = "north"
[link]
router = "tls/10.0.0.7:7447"
listen = ["tls/0.0.0.0:7447"]
certs = "certs"
[access]
enabled = true
viewers = ["office"]
[cameras.front]
"""


@pytest.fixture
def line(tmp_path: Path) -> Path:
    path = tmp_path / "line.toml"
    path.write_text(LINE)
    return path


def test_make_gives_every_node_its_own_private_files(line: Path) -> None:
    make(line)
    folder = line.parent / "certs"
    names = {file.stem: read_certificate(file).common_name for file in folder.glob("*.pem")}
    assert names == {
        "ca": "Tuberline site north",
        "router": "router@north",
        "camera.front": "camera.front@north",
        "segmenter.front": "segmenter.front@north",
        "regressor.r1": "regressor.r1@north",
        "regressor.r2": "regressor.r2@north",
        "aggregator": "aggregator@north",
        "viewer.office": "viewer.office@north",
        "recorder": "recorder@north",
        "operator": "operator@north",
        "keeper": "keeper@north",
        "loader": "loader@north",
    }
    assert {stat.S_IMODE(file.stat().st_mode) for file in folder.iterdir()} == {0o600}
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert {file.stem for file in folder.glob("*.key")} == set(names)
    assert read_certificate(folder / "router.pem").hosts == ("10.0.0.7", "localhost", "127.0.0.1")


def test_a_key_is_private_from_its_first_byte_on(tmp_path: Path) -> None:
    """Also where a process that was killed left a part of one that all could read."""
    key, half = tmp_path / "camera.front.key", tmp_path / "camera.front.key.partial"
    half.write_bytes(b"left")
    half.chmod(0o644)
    with replacing(key, mode=0o600) as file:
        file.write(b"PRIVATE")
        assert stat.S_IMODE(half.stat().st_mode) == 0o600
    assert (key.read_bytes(), stat.S_IMODE(key.stat().st_mode)) == (b"PRIVATE", 0o600)


def test_nothing_is_overwritten_unless_asked(line: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make(line)
    folder = line.parent / "certs"
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    make(line)
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before
    with pytest.raises(InputError, match=r"viewer.office.pem or its key exists; --renew replaces both"):
        add("viewer/office", line)
    with pytest.raises(InputError, match=r"ca.pem exists; an authority is never replaced"):
        make_authority(folder, site="north")
    add("viewer/office", line, renew=True)
    after = {file.name: file.read_bytes() for file in folder.iterdir()}
    assert {name for name in before if before[name] != after[name]} == {"viewer.office.pem", "viewer.office.key"}
    add("viewer/lorry", line)
    assert "viewer/lorry is not among those that [access]" in capsys.readouterr().err


def test_a_name_that_the_router_is_given_is_in_its_certificate_and_stays_there(line: Path) -> None:
    """Beside a certificate that was there, `make --host` made none and said nothing; --renew forgot the name."""
    router = line.parent / "certs" / "router.pem"
    make(line)
    with pytest.raises(InputError, match=r"certs add router .*line.toml --renew --host edge.field"):
        make(line, host=("edge.field", "10.0.0.7"))
    add("router", line, host=("edge.field",), renew=True)
    assert "edge.field" in read_certificate(router).hosts
    make(line, host=("edge.field",))
    for again in (partial(make, line, renew=True), partial(add, "router", line, renew=True)):
        again()
        assert read_certificate(router).hosts == ("10.0.0.7", "edge.field", "localhost", "127.0.0.1")
    router.write_text("no certificate")
    add("router", line, renew=True)
    with pytest.raises(InputError, match="keeper needs none"):
        add("keeper", line, host=("edge.field",))


def test_validity_is_bounded_by_the_authority_and_starts_a_day_early(tmp_path: Path) -> None:
    make_authority(tmp_path, site="north", now=NOW)
    late = issue(tmp_path, Identity("viewer"), line="north", days=9000, now=NOW + timedelta(days=3600))
    assert late.not_after <= read_certificate(tmp_path / "ca.pem").not_after
    fresh = issue(tmp_path, Identity("camera", "front"), line="north", now=NOW)
    assert (fresh.not_before, fresh.not_after) == (NOW - timedelta(days=1), NOW + timedelta(days=730))
    assert fresh.days_left(NOW + timedelta(days=731)) == -1
    for hours in (-1, 24):
        over = read_certificate(tmp_path / "ca.pem").not_after - timedelta(hours=hours, seconds=-1)
        with pytest.raises(InputError, match=r"ca.pem expires on 20\d\d-\d\d-\d\d, and its certificates with it"):
            issue(tmp_path, Identity("keeper"), line="north", now=over)
    assert not list(tmp_path.glob("keeper.*"))
    with pytest.raises(InputError, match="names or addresses it is reached at"):
        issue(tmp_path, Identity("router"), line="north")


def test_show_tells_machines_what_expires(tmp_path: Path, capsys: pytest.CaptureFixture[str], site_certs: Path) -> None:
    make_authority(tmp_path, site="north")
    issue(tmp_path, Identity("camera", "front"), line="north", days=10)
    show(tmp_path, json=True)
    report = {entry["common_name"]: entry for entry in json.loads(capsys.readouterr().out)}
    assert 8.9 < report["camera.front@north"]["days_left"] <= 10
    assert report["Tuberline site north"]["authority"] is True
    (tmp_path / "broken.pem").write_text("no certificate")
    with pytest.raises(InputError, match=r"broken.pem is not a PEM certificate"):
        show(tmp_path)
    with pytest.raises(InputError, match="cannot be read"):
        show(tmp_path / "elsewhere.pem")
    make_authority(tmp_path / "other", site="x")
    (tmp_path / "ca.key").write_bytes((tmp_path / "other" / "ca.key").read_bytes())
    with pytest.raises(InputError, match=r"ca.key is not the key of"):
        issue(tmp_path, Identity("viewer"), line="north")


def test_router_hosts_are_those_it_is_reached_at() -> None:
    config = site_config(7447, Path("/nowhere"))
    link = config.link.model_copy(
        update={"router": "tls/edge.local:7447", "listen": ("tls/[::]:7447", "tls/[fd00::1]:1")}
    )
    hosts = router_hosts(config.model_copy(update={"link": link}), ("extra",))
    assert hosts == ["edge.local", "fd00::1", "extra", "localhost", "127.0.0.1"]


@pytest.mark.parametrize("name", ["machine", "site"])
def test_generated_zenohd_files_are_current_and_open(
    name: str, site_certs: Path, free_port: int, tmp_path: Path
) -> None:
    """Each file as it lies in deploy/, moved to a free port of this machine and to certificates that exist here."""
    config = load_config(ROOT / "deploy" / "examples" / f"{name}.toml")
    certs = Path("/etc/tuberline/certs") if name == "site" else None
    text = (ROOT / "deploy" / "zenohd" / f"{name}.json5").read_text()
    assert text == settings_text(router_file(config, certs=certs)), "generate it again: see deploy/zenohd/README.md"
    scheme = "tls" if certs else "tcp"
    for endpoint in (*config.link.listen, config.link.router):
        text = text.replace(endpoint, f"{scheme}/127.0.0.1:{free_port}")
    text = text.replace("/etc/tuberline/certs", str(site_certs))
    with zenoh.open(zenoh.Config.from_json5(text)) as session:
        assert str(session.info.zid())


def test_certificates_for_a_plain_link_are_refused() -> None:
    config = load_config(ROOT / "deploy" / "examples" / "machine.toml")
    with pytest.raises(ConfigError, match=r"tcp/127.0.0.1:7447: make it tls"):
        router_file(config, certs=Path("/etc/tuberline/certs"))
